"""One aircraft as the parts of its MAVLink vehicle know it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from testbed.links.channels import (
    LEAST_US,
    MOST_US,
    PITCH,
    ROLL,
    THROTTLE,
    TRIM_US,
    YAW,
    Scales,
    scales,
)
from testbed.links.cockpit import Cockpit
from testbed.links.replies import Texts
from testbed.links.scene import Scene
from testbed.state import Origin

SYSTEM_NAME = "SYSID_THISMAV"
_MOVES = (4, 19, 70, 21)  # SERVOn_FUNCTION: aileron, elevator, throttle, rudder


def _servos() -> Mapping[str, float]:
    """What outputs 1 to 4 move and which way, as SERVO_OUTPUT_RAW tells them; pulses in µs."""
    found = {f"SERVO{THROTTLE}_MIN": LEAST_US, f"SERVO{THROTTLE}_MAX": MOST_US}
    for number, moves in enumerate(_MOVES, 1):
        found[f"SERVO{number}_FUNCTION"] = float(moves)
        # not reversed, a long pulse would pitch up, or yaw right
        found[f"SERVO{number}_REVERSED"] = float(number in (PITCH, YAW))
        found[f"SERVO{number}_TRIM"] = LEAST_US if number == THROTTLE else TRIM_US
    return found


SERVOS = _servos()


def own_parameters(system: int) -> dict[str, float]:
    """Parameters that are the vehicle's own: of its sticks, µs, and its number."""
    pulses = {"MIN": LEAST_US, "TRIM": TRIM_US, "MAX": MOST_US}
    found: dict[str, float] = {SYSTEM_NAME: system}
    for channel in (ROLL, PITCH, THROTTLE, YAW):
        found |= {f"RC{channel}_{name}": value for name, value in pulses.items()}
    # the throttle stick has no spring: it rests at its lower end
    found[f"RC{THROTTLE}_TRIM"] = LEAST_US
    return found


@dataclass(slots=True)
class Craft:
    """What is known of one aircraft now.

    Attributes:
        cockpit: what may be done with it.
        system: its MAVLink number.
        row: of it in every frame.
        origin: of the scenario, which is home.
        version: of the testbed, as "0.7.0".
        epoch_us: what its clock calls the start of the run, µs since 1970.
        scene: the latest frame; None: there was none yet.
        own: parameters that the cockpit does not have.
        texts: what is said in words.
    """

    cockpit: Cockpit
    system: int
    row: int
    origin: Origin
    version: str = "0"
    epoch_us: int = 0
    scene: Scene | None = None
    own: dict[str, float] = field(default_factory=dict)
    texts: Texts = field(default_factory=Texts)

    def __post_init__(self) -> None:
        """Begin with the usual sticks."""
        self.own |= own_parameters(self.system)

    @property
    def lost(self) -> bool:
        """Whether it is on the ground or broken."""
        return self.scene is not None and self.scene.lost[self.row]

    @property
    def uid(self) -> bytes:
        """Sixteen bytes that are this aircraft's in every run."""
        return hashlib.sha256(f"{self.system}/{self.cockpit.name}".encode()).digest()[:16]

    def parameters(self) -> Mapping[str, float]:
        """All that a ground station can read, in a fixed order."""
        return {**self.cockpit.parameters, **self.own, **SERVOS}

    def scales(self) -> Scales:
        """What stick pulses mean now."""
        return scales(self.parameters())
