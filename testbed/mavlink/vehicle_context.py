"""State of one MAVLink vehicle that its message handlers share."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from testbed.core.records import NedOrigin
from testbed.mavlink.outgoing import OutgoingMessage, StatusTexts
from testbed.mavlink.radio_buffer import RadioBuffer
from testbed.mavlink.rc_channels import (
    MAX_US,
    MIN_US,
    PITCH,
    ROLL,
    THROTTLE,
    TRIM_US,
    YAW,
    RcScaling,
    rc_scaling,
)
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.vehicle_control import VehicleControl

SYSTEM_ID = "SYSID_THISMAV"
_FUNCTIONS = (4, 19, 70, 21)  # SERVOn_FUNCTION: aileron, elevator, throttle, rudder


def _servo_parameters() -> Mapping[str, float]:
    """Return the parameters of outputs 1 to 4 as in SERVO_OUTPUT_RAW; pulses in µs."""
    parameters = {f"SERVO{THROTTLE}_MIN": MIN_US, f"SERVO{THROTTLE}_MAX": MAX_US}
    for number, function in enumerate(_FUNCTIONS, 1):
        parameters[f"SERVO{number}_FUNCTION"] = float(function)
        # not reversed, a long pulse would pitch up, or yaw right
        parameters[f"SERVO{number}_REVERSED"] = float(number in (PITCH, YAW))
        parameters[f"SERVO{number}_TRIM"] = MIN_US if number == THROTTLE else TRIM_US
    return parameters


SERVO_PARAMETERS = _servo_parameters()


def default_parameters(system: int) -> dict[str, float]:
    """Return system id and RC channel ranges, µs, with their defaults."""
    pulses = {"MIN": MIN_US, "TRIM": TRIM_US, "MAX": MAX_US}
    parameters: dict[str, float] = {SYSTEM_ID: system}
    for channel in (ROLL, PITCH, THROTTLE, YAW):
        parameters |= {f"RC{channel}_{name}": value for name, value in pulses.items()}
    # the throttle stick has no spring: it rests at its lower end
    parameters[f"RC{THROTTLE}_TRIM"] = MIN_US
    return parameters


@dataclass(slots=True)
class VehicleContext:
    """The aircraft of a MAVLink vehicle, its latest sample and its own parameters.

    Attributes:
        control: takes commands to the aircraft.
        system: its MAVLink system id.
        row: of the aircraft in samples.
        origin: of the scenario, which is home.
        version: of the testbed, as "0.7.0".
        epoch_us: Unix time of the start of the run, µs.
        snapshot: the latest sample; None: there was none yet.
        wall_s: wall-clock time of the message that is handled, or of the latest poll, s.
        own_parameters: parameters that `control` does not have.
        texts: makes its STATUSTEXTs.
        radio: what radios report of their buffers.
    """

    control: VehicleControl
    system: int
    row: int
    origin: NedOrigin
    version: str = "0"
    epoch_us: int = 0
    snapshot: TelemetrySnapshot | None = None
    wall_s: float = 0.0
    own_parameters: dict[str, float] = field(default_factory=dict)
    texts: StatusTexts = field(default_factory=StatusTexts)
    radio: RadioBuffer = field(default_factory=RadioBuffer)

    def __post_init__(self) -> None:
        """Set the default parameters."""
        self.own_parameters |= default_parameters(self.system)

    @property
    def lost(self) -> bool:
        """Return whether the aircraft has crashed or broken."""
        return self.snapshot is not None and self.snapshot.lost[self.row]

    @property
    def uid(self) -> bytes:
        """Sixteen bytes that identify this aircraft, the same in every run."""
        return hashlib.sha256(f"{self.system}/{self.control.name}".encode()).digest()[:16]

    def warn(self, text: str) -> list[OutgoingMessage]:
        """Make a warning; none if the same text was sent a short time ago."""
        return self.texts.make_warning(text, self.wall_s)

    def parameters(self) -> Mapping[str, float]:
        """Return all parameters that a ground station can read, in a fixed order."""
        return {**self.control.parameters, **self.own_parameters, **SERVO_PARAMETERS}

    def rc_scaling(self) -> RcScaling:
        """Return the scaling of stick pulses by the current parameters."""
        return rc_scaling(self.parameters())
