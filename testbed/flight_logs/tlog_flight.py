"""Read telemetry logs of ArduPlane flights, the .tlog files of ground stations.

Messages and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from testbed.core.records import Array
from testbed.flight_logs.flight_log import (
    RAD_PER_DEG,
    ColumnSource,
    FlightLog,
    MessageTable,
    ModeInterval,
    check_order,
    field_source,
    increasing,
    mode_name,
    no_source,
    order_notes,
    transformed_source,
    true_airspeed_source,
)
from testbed.flight_logs.log_identity import (
    UNKNOWN_VEHICLE,
    is_plane,
    jumps_of_attitude,
    jumps_of_position,
    steps_back,
)
from testbed.flight_logs.log_position import TELEMETRY
from testbed.flight_logs.servo_outputs import (
    SERVO_COLUMNS,
    output_source,
    throttle_output_source,
    throttle_stick_source,
)
from testbed.flight_logs.tlog_clock import Received, VehicleClock
from testbed.mavlink.codec import MavlinkError, constant
from testbed.mavlink.tlog import Tlog

_ATTITUDE, _POSITION, _OUTPUTS = "ATTITUDE", "GLOBAL_POSITION_INT", "SERVO_OUTPUT_RAW"
_HEARTBEAT = "HEARTBEAT"
_REMEDY = "have it streamed (SRn_ parameters, or MAV_CMD_SET_MESSAGE_INTERVAL)"
OTHER_SENDERS = "messages of other senders were left out"
_AUTOPILOT = 1  # component
_MIN_BACK = 0.01  # of the sequence numbers, which datagrams out of order do not reach
_MAX_STEP_BACK, _DAY = 1.0, 86400.0  # s
_HEARTBEAT_TIMEOUT = 5.0  # s without a heartbeat after which the mode is unknown


def _output_field(number: int) -> str:
    return f"servo{number}_raw"


def _channel_field(number: int) -> str:
    return f"chan{number}_raw"


_FIELDS_BY_MESSAGE: Mapping[str, tuple[str, ...]] = {
    "ATTITUDE": ("roll", "pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"),
    "NAV_CONTROLLER_OUTPUT": ("nav_roll", "nav_pitch"),
    "VFR_HUD": ("airspeed", "alt", "climb", "throttle"),
    _POSITION: ("lat", "lon", "alt", "relative_alt", "vx", "vy", "vz"),
    _OUTPUTS: tuple(_output_field(n) for n in range(1, 17)),
    "RC_CHANNELS": tuple(_channel_field(n) for n in range(1, 19)),
    "AOA_SSA": ("AOA", "SSA"),
    "SYSTEM_TIME": ("time_unix_usec",),
    "WIND": ("direction", "speed"),
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
            no_source,
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


@dataclass(slots=True)
class _Vehicle:
    """Messages of one autopilot."""

    messages: dict[str, list[Received]] = field(default_factory=dict)
    heartbeats: list[Received] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    params: dict[str, float] = field(default_factory=dict)
    sequences: list[int] = field(default_factory=list)
    other_ports: int = 0  # messages of outputs above the 16th
    end: Received = field(init=False)  # the last message

    def add(self, received: Received) -> None:
        message, self.end = received.message, received
        self.sequences.append(message.sequence)
        if message.name == _OUTPUTS and message.fields["port"] != 0:
            self.other_ports += 1
        elif message.name in _FIELDS_BY_MESSAGE:
            self.messages.setdefault(message.name, []).append(received)
        elif message.name == _HEARTBEAT:
            self.heartbeats.append(received)
        elif message.name == "STATUSTEXT":
            self.texts.append(str(message.fields["text"]))
        elif message.name == "PARAM_VALUE":
            self.params[str(message.fields["param_id"])] = message.number("param_value")


@dataclass(frozen=True, slots=True)
class TlogContents:
    """The messages of all autopilots in a .tlog.

    Attributes:
        path: the file.
        records: that were read, with counts of damage.
        vehicles: by system.
        others: messages by system and component of other senders.
        times: of receipt of all messages, s since the first one.
        start_us: µs from 1970 to the first record.
    """

    path: Path
    records: Tlog
    vehicles: Mapping[int, _Vehicle]
    others: Mapping[tuple[int, int], int]
    times: Array
    start_us: int

    @property
    def systems(self) -> tuple[int, ...]:
        """Ids of the autopilots that sent attitudes."""
        return tuple(n for n, one in sorted(self.vehicles.items()) if _ATTITUDE in one.messages)


def read_contents(path: Path) -> TlogContents:
    """Read the messages of a .tlog.

    Raises:
        MavlinkError: it cannot be read.
    """
    records = Tlog(path)
    vehicles: dict[int, _Vehicle] = {}
    others: Counter[tuple[int, int]] = Counter()
    times: list[float] = []
    start = _start(records)
    for order, (time_us, message) in enumerate(records):
        times.append(1e-6 * (time_us - start))
        if message.component == _AUTOPILOT:
            vehicle = vehicles.setdefault(message.system, _Vehicle())
            vehicle.add(Received(order, times[-1], message))
        elif message.name in _FIELDS_BY_MESSAGE:
            others[message.system, message.component] += 1
    return TlogContents(path, records, vehicles, others, np.array(times), start)


def make_log(contents: TlogContents, system: int | None = None) -> FlightLog:
    """Make the log of an ArduPlane flight; times are from the first record.

    Radio links delay messages. Time stamps of the vehicle are used where messages have them;
    others get the time of the stamped messages received around them.

    Args:
        contents: of the .tlog.
        system: id of the vehicle; None: the only one.

    Raises:
        MavlinkError: the log does not have this vehicle or has several, also several with one id,
            or the vehicle is not ArduPlane.
    """
    path, vehicles, others = contents.path, contents.vehicles, contents.others
    number = _select_vehicle(path, vehicles, others, system)
    vehicle = vehicles[number]
    plane = _check_vehicle(path, vehicle)
    try:
        clock = VehicleClock(vehicle.messages[_ATTITUDE])
        links = _check_one_vehicle(vehicle, clock)
    except MavlinkError as error:
        raise MavlinkError(
            f"{path}: system {number}: {error}; give a log of one of them, and each aircraft its "
            "own system id (SYSID_THISMAV, MAV_SYSID)"
        ) from error
    tables, left_out = {}, {}
    for name, messages in vehicle.messages.items():
        tables[name], left_out[name] = _message_table(clock, messages, _FIELDS_BY_MESSAGE[name])
    total = len(vehicle.messages[_ATTITUDE])
    check_order(path, _ATTITUDE, total - left_out[_ATTITUDE], total)
    received = contents.times
    credible = [_has_credible_time(received, each.order) for each in vehicle.heartbeats]
    left_out[_HEARTBEAT] = credible.count(False)
    return FlightLog(
        path=path,
        tables=tables,
        params=vehicle.params,
        modes=_mode_intervals(vehicle.heartbeats, credible, clock, vehicle.end),
        notes=(
            *([] if plane else [UNKNOWN_VEHICLE]),
            *links,
            *_left_out_notes(vehicle, {n: v for n, v in vehicles.items() if n != number}, others),
            *order_notes(left_out, _HEARTBEAT),
            *_receiver_notes(received),
            *_notes(contents.records, vehicle.params),
        ),
        attitude=_ATTITUDE,
        columns=COLUMNS,
        remedy=_REMEDY,
        home=(field_source(_POSITION, "alt", 1e-3), field_source(_POSITION, "relative_alt", 1e-3)),
        motion=TELEMETRY,
        clock_starts=clock.starts,
        receiver_start_unix_s=1e-6 * contents.start_us,
    )


def _start(records: Tlog) -> int:
    """Return the time of the first record, µs, or of the next ones if it is damaged."""
    first = [time_us for time_us, _ in islice(records, 3)] or [0]
    middle = sorted(first)[len(first) // 2]
    return first[0] if abs(first[0] - middle) < 1e6 * _DAY else middle


def _message_table(
    clock: VehicleClock, messages: Sequence[Received], fields: Sequence[str]
) -> tuple[MessageTable, int]:
    """Make a table, and count the messages whose times are out of order."""
    if "time_boot_ms" in messages[0].message.fields:
        time = clock.from_boot_times(messages)
    else:
        time = clock.from_receipt(messages)
    keep = increasing(time)
    table = np.array([[one.message.number(name) for name in fields] for one in messages])[keep]
    columns = {name: table[:, k] for k, name in enumerate(fields)}
    return MessageTable(time[keep], columns), len(messages) - int(np.count_nonzero(keep))


def _check_one_vehicle(vehicle: _Vehicle, clock: VehicleClock) -> tuple[str, ...]:
    """Compare attitudes and positions where the messages have more than one counter.

    A sender counts its messages on each link, so one counter means one vehicle.

    Returns:
        A note, if there are several counters.

    Raises:
        MavlinkError: the attitudes or the positions are of several vehicles.
    """
    back = steps_back(vehicle.sequences)
    if not back:
        return ()

    def table(name: str, *fields: str) -> tuple[Array, Array]:
        messages = vehicle.messages.get(name, [])
        values = [[one.message.number(field) for field in fields] for one in messages]
        time = clock.from_boot_times(messages)
        return time, np.array(values).reshape(len(messages), len(fields))

    time, attitude = table(_ATTITUDE, "roll", "pitch", "yaw")
    jumping = ["attitudes"] if jumps_of_attitude(time, attitude) else []
    time, position = table(_POSITION, "lat", "lon", "alt", "vx", "vy", "vz")
    if len(time):
        geodetic, velocity = position[:, :3] * [1e-7, 1e-7, 1e-3], 0.01 * position[:, 3:]
        if jumps_of_position(time, geodetic, velocity):
            jumping.append("positions")
    if jumping:
        raise MavlinkError(f"several vehicles: {' and '.join(jumping)} jump between them")
    if back <= _MIN_BACK * len(vehicle.sequences):
        return ()
    return (
        f"{back} of {len(vehicle.sequences)} sequence numbers step back: the vehicle was received "
        "over several links, or there are several with this system id; their attitudes and "
        "positions agree",
    )


def _left_out_notes(
    vehicle: _Vehicle, others: Mapping[int, _Vehicle], components: Mapping[tuple[int, int], int]
) -> tuple[str, ...]:
    """Say which messages were not used because of their senders."""
    counts = {(number, _AUTOPILOT): _count(other) for number, other in others.items()}
    senders = ", ".join(
        f"{count} of system {system}, component {component}"
        for (system, component), count in sorted({**counts, **components}.items())
        if count
    )
    notes = [f"{OTHER_SENDERS}: {senders}"] if senders else []
    if vehicle.other_ports:
        notes.append(
            f"{vehicle.other_ports} {_OUTPUTS} of other ports, outputs above the 16th, were left "
            "out"
        )
    return tuple(notes)


def _count(vehicle: _Vehicle) -> int:
    return sum(map(len, vehicle.messages.values()))


def _receiver_notes(times: Array) -> tuple[str, ...]:
    """Say where the receiver's clock stepped."""
    steps = np.diff(times)
    back = int(np.count_nonzero(steps < -_MAX_STEP_BACK))
    ahead = int(np.count_nonzero(steps > _DAY))
    if not back and not ahead:
        return ()
    return (
        f"the receiver's clock stepped back {back} times, and by more than a day {ahead} times: "
        "only the vehicle's clock is used there",
    )


def _select_vehicle(
    path: Path,
    vehicles: Mapping[int, _Vehicle],
    components: Mapping[tuple[int, int], int],
    system: int | None,
) -> int:
    airborne = {n: one for n, one in sorted(vehicles.items()) if _ATTITUDE in one.messages}
    listed = ", ".join(f"{n} ({_describe(one)})" for n, one in airborne.items())
    if not airborne:
        others = f"; it has systems {sorted(vehicles)}" if vehicles else ""
        if components:
            senders = ", ".join(f"{n}, component {c}" for n, c in sorted(components))
            others += f", and flight data of system {senders} (an autopilot's is 1)"
        raise MavlinkError(f"{path}: no autopilot sent ATTITUDE{others}; {_REMEDY}")
    if system is None and len(airborne) > 1:
        raise MavlinkError(f"{path}: several vehicles; write --system with one of {listed}")
    if system is not None and system not in airborne:
        raise MavlinkError(f"--system {system}: not in {path}; write one of {listed}")
    return next(iter(airborne)) if system is None else system


def _describe(vehicle: _Vehicle) -> str:
    attitudes = vehicle.messages[_ATTITUDE]
    modes = dict.fromkeys(mode_name(_mode(heartbeat)) for heartbeat in vehicle.heartbeats)
    duration = attitudes[-1].time - attitudes[0].time
    return " ".join([f"{duration:.0f} s", *modes])


def _mode(heartbeat: Received) -> int:
    mode = heartbeat.message.fields["custom_mode"]
    return mode if isinstance(mode, int) else -1


def _check_vehicle(path: Path, vehicle: _Vehicle) -> bool:
    """Check whether the log says that the vehicle is ArduPlane; other modes have other numbers.

    Raises:
        MavlinkError: it says that it is another one.
    """
    types = {constant("MAV_TYPE_FIXED_WING"), *range(19, 26)}  # and VTOL types
    for heartbeat in vehicle.heartbeats:
        fields = heartbeat.message.fields
        autopilot, kind = fields["autopilot"], fields["type"]
        if autopilot != constant("MAV_AUTOPILOT_ARDUPILOTMEGA") or kind not in types:
            raise MavlinkError(
                f"{path}: the vehicle is not ArduPlane (HEARTBEAT has autopilot {autopilot}, "
                f"type {kind}); give a log of ArduPlane"
            )
    plane = is_plane(path, vehicle.texts, vehicle.params, first=False)
    return plane or bool(vehicle.heartbeats)


def _mode_intervals(
    heartbeats: Sequence[Received],
    credible: Sequence[bool],
    clock: VehicleClock,
    last_message: Received,
) -> tuple[ModeInterval, ...]:
    """Find each mode from its first heartbeat to its last.

    Between two modes the mode is unknown, also where one of them is left out.

    Args:
        heartbeats: in file order.
        credible: whether each has a credible time; others are left out.
        clock: of the vehicle.
        last_message: of the vehicle.
    """
    times = clock.from_receipt(heartbeats).tolist()
    modes: list[ModeInterval] = []
    changed = False  # by a heartbeat that is left out
    for time, heartbeat, valid in zip(times, heartbeats, credible, strict=True):
        mode, last = _mode(heartbeat), modes[-1] if modes else None
        if not valid:
            changed |= last is not None and mode != last.mode
        elif last and last.mode == mode and not changed and time - last.end <= _HEARTBEAT_TIMEOUT:
            modes[-1] = ModeInterval(mode, last.start, time)
        else:
            modes.append(ModeInterval(mode, time, time))
            changed = False
    end = float(clock.from_receipt([last_message])[0])
    if modes and not changed and end - modes[-1].end <= _HEARTBEAT_TIMEOUT:
        modes[-1] = ModeInterval(modes[-1].mode, modes[-1].start, end)
    return tuple(modes)


def _has_credible_time(times: Array, order: int) -> bool:
    """Check that a time of receipt (M,) is within 1 s of the interval of its neighbours.

    The first and the last one are: only a pause may be beside them.
    """
    if not 0 < order < len(times) - 1:
        return True
    low, high = sorted((times[order - 1], times[order + 1]))
    return bool(low - _MAX_STEP_BACK <= times[order] <= high + _MAX_STEP_BACK)


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
