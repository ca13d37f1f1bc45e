"""Read telemetry logs of ArduPlane flights, the .tlog files of ground stations.

Messages and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from testbed.core.records import Array
from testbed.mavlink.codec import MavlinkError, Message, constant
from testbed.mavlink.flight_log import (
    RAD_PER_DEG,
    ColumnSource,
    FlightLog,
    MessageTable,
    ModeInterval,
    field_source,
    increasing,
    mode_name,
    transformed_source,
    true_airspeed_source,
)
from testbed.mavlink.servo_outputs import (
    SERVO_COLUMNS,
    output_source,
    throttle_output_source,
    throttle_stick_source,
)
from testbed.mavlink.tlog import Tlog

_ATTITUDE = "ATTITUDE"
_REMEDY = "have it streamed (SRn_ parameters, or MAV_CMD_SET_MESSAGE_INTERVAL)"
_AUTOPILOT = 1  # component
_REBOOT = 1.0  # s by which the vehicle's clock decreases at a reboot
_HEARTBEAT_TIMEOUT = 5.0  # s without a heartbeat after which the mode is unknown


def _output_field(number: int) -> str:
    return f"servo{number}_raw"


def _channel_field(number: int) -> str:
    return f"chan{number}_raw"


_FIELDS_BY_MESSAGE: Mapping[str, tuple[str, ...]] = {
    "ATTITUDE": ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"),
    "NAV_CONTROLLER_OUTPUT": ("nav_roll", "nav_pitch"),
    "VFR_HUD": ("airspeed", "alt", "climb", "throttle"),
    "GLOBAL_POSITION_INT": ("alt", "relative_alt", "vz"),
    "SERVO_OUTPUT_RAW": tuple(_output_field(n) for n in range(1, 17)),
    "RC_CHANNELS": tuple(_channel_field(n) for n in range(1, 19)),
    "AOA_SSA": ("AOA", "SSA"),
}
_ABOVE_FIRST = transformed_source(
    field_source("VFR_HUD", "alt"), lambda values: values - values[0], "{} above its first"
)
COLUMNS: Mapping[str, tuple[ColumnSource, ...]] = {
    "theta_cmd_rad": (field_source("NAV_CONTROLLER_OUTPUT", "nav_pitch", RAD_PER_DEG, held=True),),
    "phi_cmd_rad": (field_source("NAV_CONTROLLER_OUTPUT", "nav_roll", RAD_PER_DEG, held=True),),
    "throttle_cmd": (
        throttle_output_source("SERVO_OUTPUT_RAW", _output_field),
        field_source("VFR_HUD", "throttle", 0.01, held=True),
        throttle_stick_source("RC_CHANNELS", _channel_field),
    ),
    "phi_rad": (field_source("ATTITUDE", "roll"),),
    "theta_rad": (field_source("ATTITUDE", "pitch"),),
    "psi_rad": (field_source("ATTITUDE", "yaw"),),
    "p_radps": (field_source("ATTITUDE", "rollspeed"),),
    "q_radps": (field_source("ATTITUDE", "pitchspeed"),),
    "r_radps": (field_source("ATTITUDE", "yawspeed"),),
    "airspeed_mps": (
        true_airspeed_source(
            field_source("VFR_HUD", "airspeed"),
            (),
            (field_source("VFR_HUD", "alt"), field_source("GLOBAL_POSITION_INT", "alt", 1e-3)),
        ),
    ),
    "altitude_m": (field_source("GLOBAL_POSITION_INT", "relative_alt", 1e-3), _ABOVE_FIRST),
    "v_down_mps": (
        field_source("GLOBAL_POSITION_INT", "vz", 0.01),
        field_source("VFR_HUD", "climb", -1.0),
    ),
    "beta_rad": (field_source("AOA_SSA", "SSA", RAD_PER_DEG),),
    "alpha_rad": (field_source("AOA_SSA", "AOA", RAD_PER_DEG),),
    **{
        column: (output_source("SERVO_OUTPUT_RAW", _output_field, column),)
        for column in SERVO_COLUMNS
    },
}
_MESSAGES = {
    "theta_cmd_rad": "NAV_CONTROLLER_OUTPUT",
    "phi_cmd_rad": "NAV_CONTROLLER_OUTPUT",
    "throttle_cmd": "VFR_HUD or SERVO_OUTPUT_RAW",
    "airspeed_mps": "VFR_HUD",
    "altitude_m": "GLOBAL_POSITION_INT or VFR_HUD",
    "v_down_mps": "GLOBAL_POSITION_INT or VFR_HUD",
    "beta_rad": "AOA_SSA",
    "alpha_rad": "AOA_SSA",
    **dict.fromkeys(SERVO_COLUMNS, "SERVO_OUTPUT_RAW"),
}


@dataclass(slots=True)
class _Received:
    """Messages of one autopilot with the times of their receipt, s."""

    messages: dict[str, list[tuple[float, Message]]] = field(default_factory=dict)
    heartbeats: list[tuple[float, Message]] = field(default_factory=list)
    params: dict[str, float] = field(default_factory=dict)
    end: float = 0.0

    def add(self, time: float, message: Message) -> None:
        self.end = time
        if message.name in _FIELDS_BY_MESSAGE:
            self.messages.setdefault(message.name, []).append((time, message))
        elif message.name == "HEARTBEAT":
            self.heartbeats.append((time, message))
        elif message.name == "PARAM_VALUE":
            self.params[str(message.fields["param_id"])] = message.number("param_value")


def read_log(path: Path, system: int | None = None) -> FlightLog:
    """Read the .tlog of an ArduPlane flight; times are from its first record.

    Radio links delay messages. Time stamps of the vehicle are used where messages have them;
    others get the time of the stamped messages received around them.

    Args:
        path: the log.
        system: id of the vehicle; None: the only one.

    Raises:
        MavlinkError: it cannot be read, does not have this vehicle or has several, or the vehicle
            is not ArduPlane.
    """
    records = Tlog(path)
    vehicles: dict[int, _Received] = {}
    start = None
    for time_us, message in records:
        start = time_us if start is None else start
        if message.component == _AUTOPILOT:
            vehicle = vehicles.setdefault(message.system, _Received())
            vehicle.add(1e-6 * (time_us - start), message)
    vehicle = _select_vehicle(path, vehicles, system)
    _check_vehicle(path, vehicle.heartbeats)
    clock = _VehicleClock(vehicle.messages[_ATTITUDE])
    tables = {
        name: _message_table(clock, messages, _FIELDS_BY_MESSAGE[name])
        for name, messages in vehicle.messages.items()
    }
    return FlightLog(
        path=path,
        tables=tables,
        params=vehicle.params,
        modes=_mode_intervals(vehicle.heartbeats, clock, vehicle.end),
        notes=_notes(records, vehicle.params),
        attitude=_ATTITUDE,
        columns=COLUMNS,
        messages=_MESSAGES,
        remedy=_REMEDY,
        home=(
            field_source("GLOBAL_POSITION_INT", "alt", 1e-3),
            field_source("GLOBAL_POSITION_INT", "relative_alt", 1e-3),
        ),
    )


class _VehicleClock:
    """Map the vehicle's clock and times of receipt to log time.

    The vehicle's clock is aligned with the log at the first attitude after each boot.
    """

    def __init__(self, attitudes: Sequence[tuple[float, Message]]) -> None:
        received = np.array([time for time, _ in attitudes])
        boot = _boot_times(attitudes)
        reboots = np.flatnonzero(np.diff(boot) < -_REBOOT) + 1
        starts = np.concatenate([[0], reboots])
        self._starts = received[starts]
        self._offsets = received[starts] - boot[starts]
        times = self.from_boot_times(received, boot)
        keep = increasing(times)
        self._received, self._times = received[keep], times[keep]

    def from_boot_times(self, received: Array, boot: Array) -> Array:
        """Convert times from the vehicle's boot, s, to log time."""
        epoch = np.maximum(np.searchsorted(self._starts, received, side="right") - 1, 0)
        times: Array = boot + self._offsets[epoch]
        return times

    def from_receipt(self, received: Array) -> Array:
        """Interpolate log time between the attitudes received before and after."""
        times = np.interp(received, self._received, self._times)
        early, late = received < self._received[0], received > self._received[-1]
        times[early] = received[early] - self._received[0] + self._times[0]
        times[late] = received[late] - self._received[-1] + self._times[-1]
        return times


def _boot_times(messages: Sequence[tuple[float, Message]]) -> Array:
    return 1e-3 * np.array([message.number("time_boot_ms") for _, message in messages])


def _message_table(
    clock: _VehicleClock, messages: Sequence[tuple[float, Message]], fields: Sequence[str]
) -> MessageTable:
    received = np.array([time for time, _ in messages])
    if "time_boot_ms" in messages[0][1].fields:
        time = clock.from_boot_times(received, _boot_times(messages))
    else:
        time = clock.from_receipt(received)
    keep = increasing(time)
    table = np.array([[m.number(name) for name in fields] for _, m in messages])[keep]
    return MessageTable(time[keep], {name: table[:, k] for k, name in enumerate(fields)})


def _select_vehicle(path: Path, vehicles: Mapping[int, _Received], system: int | None) -> _Received:
    airborne = {n: one for n, one in sorted(vehicles.items()) if _ATTITUDE in one.messages}
    listed = ", ".join(f"{n} ({_describe(one)})" for n, one in airborne.items())
    if not airborne:
        others = f"; it has systems {sorted(vehicles)}" if vehicles else ""
        raise MavlinkError(f"{path}: no autopilot sent ATTITUDE{others}; {_REMEDY}")
    if system is None and len(airborne) > 1:
        raise MavlinkError(f"{path}: several vehicles; write --system with one of {listed}")
    if system is not None and system not in airborne:
        raise MavlinkError(f"--system {system}: not in {path}; write one of {listed}")
    return airborne[next(iter(airborne)) if system is None else system]


def _describe(vehicle: _Received) -> str:
    attitudes = vehicle.messages[_ATTITUDE]
    modes = dict.fromkeys(mode_name(_mode(heartbeat)) for _, heartbeat in vehicle.heartbeats)
    duration = attitudes[-1][0] - attitudes[0][0]
    return " ".join([f"{duration:.0f} s", *modes])


def _mode(heartbeat: Message) -> int:
    mode = heartbeat.fields["custom_mode"]
    return mode if isinstance(mode, int) else -1


def _check_vehicle(path: Path, heartbeats: Sequence[tuple[float, Message]]) -> None:
    """Reject other vehicles, whose modes have other numbers.

    Raises:
        MavlinkError: it is not ArduPlane.
    """
    types = {constant("MAV_TYPE_FIXED_WING"), *range(19, 26)}  # and VTOL types
    for _, heartbeat in heartbeats:
        autopilot, kind = heartbeat.fields["autopilot"], heartbeat.fields["type"]
        if autopilot != constant("MAV_AUTOPILOT_ARDUPILOTMEGA") or kind not in types:
            raise MavlinkError(
                f"{path}: the vehicle is not ArduPlane (HEARTBEAT has autopilot {autopilot}, "
                f"type {kind}); give a log of ArduPlane"
            )


def _mode_intervals(
    heartbeats: Sequence[tuple[float, Message]], clock: _VehicleClock, log_end: float
) -> tuple[ModeInterval, ...]:
    """Find each mode from its first heartbeat to its last.

    Between two modes the mode is unknown.
    """
    if not heartbeats:
        return ()
    times = clock.from_receipt(np.array([time for time, _ in heartbeats]))
    modes: list[ModeInterval] = []
    for time, (_, heartbeat) in zip(times.tolist(), heartbeats, strict=True):
        mode = _mode(heartbeat)
        if modes and modes[-1].mode == mode and time - modes[-1].end <= _HEARTBEAT_TIMEOUT:
            modes[-1] = ModeInterval(mode, modes[-1].start, time)
        else:
            modes.append(ModeInterval(mode, time, time))
    end = float(clock.from_receipt(np.array([log_end]))[0])
    if end - modes[-1].end <= _HEARTBEAT_TIMEOUT:
        modes[-1] = ModeInterval(modes[-1].mode, modes[-1].start, end)
    return tuple(modes)


def _notes(records: Tlog, params: Mapping[str, float]) -> tuple[str, ...]:
    notes = []
    if params.get("PTCH_TRIM_DEG"):
        notes.append(
            f"PTCH_TRIM_DEG is {params['PTCH_TRIM_DEG']:g}: ArduPlane may have sent ATTITUDE.pitch "
            "without it"
        )
    if records.cut:
        notes.append(f"the last record is cut off; {records.cut} bytes were left out")
    if records.damaged:
        notes.append(f"{records.damaged} bytes are damaged and were left out")
    if records.unread:
        notes.append(f"{records.unread} records are damaged or of unknown messages")
    return tuple(notes)
