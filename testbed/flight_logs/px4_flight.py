"""Read flights of PX4 from its logs (.ulg): fixed-wing aircraft, and the wing-borne part of VTOLs.

Topics and fields: https://docs.px4.io/main/en/msg_docs/, also of older releases.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from testbed.core.frames import euler_from_quaternion
from testbed.core.records import Array, BoolArray
from testbed.flight_logs.flight_log import (
    ColumnSource,
    Firmware,
    FlightLog,
    LogSeries,
    MessageTable,
    ModeInterval,
    MotionSources,
    PositionFields,
    Unavailable,
    check_order,
    field_source,
    increasing,
    order_notes,
    transformed_source,
)
from testbed.flight_logs.flight_sections import ANY
from testbed.flight_logs.log_position import utc_clock
from testbed.flight_logs.ulog_file import TIME, read_topics
from testbed.mavlink.codec import MavlinkError

PX4 = Firmware(
    modes={
        0: "MANUAL",
        1: "ALTCTL",
        2: "POSCTL",
        3: "AUTO_MISSION",
        4: "AUTO_LOITER",
        5: "AUTO_RTL",
        10: "ACRO",
        12: "DESCEND",
        13: "TERMINATION",
        14: "OFFBOARD",
        15: "STAB",
        17: "AUTO_TAKEOFF",
        18: "AUTO_LAND",
        19: "AUTO_FOLLOW_TARGET",
        20: "AUTO_PRECLAND",
        21: "ORBIT",
        22: "AUTO_VTOL_TAKEOFF",
    },  # vehicle_status.nav_state
    default_mode=ANY,
    pitch_note=(
        "the commands are attitude setpoints of PX4: replay them with a tune in which "
        "STAB_PITCH_DOWN is 0"
    ),
)
_ATTITUDE, _SETPOINT, _STATUS = "vehicle_attitude", "vehicle_attitude_setpoint", "vehicle_status"
_VTOL, _LOCAL, _GLOBAL = "vtol_vehicle_status", "vehicle_local_position", "vehicle_global_position"
_GPS = ("vehicle_gps_position", "sensor_gps")
_WINDS = ("wind", "estimator_wind", "wind_estimate", "airspeed_wind")
_WIND = ("windspeed_north", "windspeed_east")
_CONTROLS = ("actuator_controls_1", "actuator_controls_0")  # of the wing of a VTOL; of others
_REMEDY = "have it logged (SDLOG_PROFILE)"
_Q = tuple(f"q[{k}]" for k in range(4))  # w, x, y, z
_QD = tuple(f"q_d[{k}]" for k in range(4))
_RATES = tuple(f"xyz[{k}]" for k in range(3))
_GYRO = tuple(f"gyro_rad[{k}]" for k in range(3))
_GPS_DEGREES = ("latitude_deg", "longitude_deg", "altitude_msl_m")  # since 1.14
_GPS_E7 = ("lat", "lon", "alt")  # before: 1e-7 degrees and mm
_OF_REFERENCE = ("ref_lat + x", "ref_lon + y", "ref_alt - z")  # fields that `_geodetic` adds
_PARAMS = ("MAV_TYPE",)
_FIELDS_BY_TOPIC: Mapping[str, tuple[str, ...]] = {
    _ATTITUDE: (*_Q, "rollspeed", "pitchspeed", "yawspeed"),
    _SETPOINT: ("roll_body", "pitch_body", *_QD, "thrust_body[0]", "thrust"),
    _STATUS: (
        *("nav_state", "system_type", "vehicle_type", "is_rotary_wing", "is_vtol"),
        *("is_vtol_tailsitter", "in_transition_mode"),
    ),
    _VTOL: ("vehicle_vtol_state", "vtol_in_rw_mode", "vtol_in_trans_mode"),
    _LOCAL: (
        *("x", "y", "z", "vx", "vy", "vz", "ref_lat", "ref_lon", "ref_alt"),
        *("xy_global", "z_global", "v_xy_valid", "v_z_valid", "z_valid"),
    ),
    _GLOBAL: ("lat", "lon", "alt", "vel_n", "vel_e", "vel_d", "lat_lon_valid", "alt_valid"),
    **dict.fromkeys(
        _GPS,
        (
            *(*_GPS_DEGREES, *_GPS_E7, "fix_type", "vel_ned_valid", "time_utc_usec"),
            *("vel_n_m_s", "vel_e_m_s", "vel_d_m_s"),
        ),
    ),
    "vehicle_angular_velocity": _RATES,
    "sensor_combined": _GYRO,
    "airspeed_validated": ("true_airspeed_m_s",),
    "airspeed": ("true_airspeed_m_s",),
    "vehicle_air_data": ("baro_alt_meter",),
    **dict.fromkeys(_WINDS, (*_WIND, "variance_north", "covariance_north")),
    **dict.fromkeys(_CONTROLS, tuple(f"control[{k}]" for k in range(4))),
}
# By topic: fields that are known only where the flag is at least this.
_VALID: Mapping[str, tuple[tuple[str, float, tuple[str, ...]], ...]] = {
    _LOCAL: (
        ("xy_global", 1.0, ("ref_lat", "ref_lon")),
        ("z_global", 1.0, ("ref_alt",)),
        ("v_xy_valid", 1.0, ("vx", "vy")),
        ("v_z_valid", 1.0, ("vz",)),
        ("z_valid", 1.0, ("z",)),
    ),
    _GLOBAL: (("lat_lon_valid", 1.0, ("lat", "lon")), ("alt_valid", 1.0, ("alt",))),
    **dict.fromkeys(
        _GPS,
        (
            ("fix_type", 3.0, (*_GPS_DEGREES, *_GPS_E7)),
            ("vel_ned_valid", 1.0, ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")),
        ),
    ),
    # without an estimate both are 0
    **dict.fromkeys(_WINDS, (("variance_north", 1e-12, _WIND), ("covariance_north", 1e-12, _WIND))),
}
_FIXED_WING = 1  # MAV_TYPE
_VTOL_TYPES = range(19, 26)  # MAV_TYPE
_TAILSITTERS = (19, 20, 23)  # MAV_TYPE
_TYPE_NAMES = {
    2: "a quadrotor",
    3: "a coaxial helicopter",
    4: "a helicopter",
    7: "an airship",
    8: "a balloon",
    10: "a ground vehicle",
    11: "a boat",
    12: "a submarine",
    13: "a hexarotor",
    14: "an octorotor",
    15: "a tricopter",
}
_ROTARY, _WING = 1, 2  # vehicle_status.vehicle_type
_VTOL_ON_WING = 4  # vtol_vehicle_status.vehicle_vtol_state
_ROW_S = 0.02  # of rows; PX4 logs up to 400 attitudes a second
_ROUNDING = 1e-3  # of a row, of times in binary numbers
_EARTH_RADIUS = 6_371_000.0  # m, of the sphere on which PX4's local frame lies
_WANTED = "give a log of a fixed-wing aircraft, or of a VTOL that flies on its wing"


def _euler_source(topic: str, fields: tuple[str, ...], axis: int, *, held: bool) -> ColumnSource:
    """Make a source of roll, pitch or yaw, rad, from a quaternion."""

    def source(log: FlightLog) -> LogSeries:
        table = log.tables.get(topic)
        if table is None or not table.fields.keys() >= {*fields}:
            raise Unavailable(f"no {topic} with {fields[0]} to {fields[-1]}")
        w, x, y, z = (table.fields[name] for name in fields)
        angle = euler_from_quaternion(np.stack([x, y, z, w], axis=-1))[:, axis]
        valid = np.isfinite(angle)
        if not valid.any():
            raise Unavailable(f"{topic} has no attitude")
        name = fields[0].partition("[")[0]
        return LogSeries(f"{topic}.{name}", table.time[valid], angle[valid], held)

    return source


def _more_frequent(*sources: ColumnSource) -> ColumnSource:
    """Make a source that reads the one with most values, the first of equal ones."""

    def source(log: FlightLog) -> LogSeries:
        found, reasons = [], []
        for each in sources:
            try:
                found.append(each(log))
            except Unavailable as error:
                reasons.append(str(error))
        if not found:
            raise Unavailable(", ".join(reasons))
        return max(found, key=lambda series: len(series.time))

    return source


def _pulse_sources(field: str, middle: float, scale: float) -> tuple[ColumnSource, ...]:
    """Make sources of pulses, µs, from the controls before they are mixed, −1 to 1."""
    return tuple(
        transformed_source(
            field_source(topic, field, held=True),
            lambda values: middle + scale * np.clip(values, -1.0, 1.0),
            "{}",
        )
        for topic in _CONTROLS
    )


def _speed_sources(axis: int) -> tuple[ColumnSource, ...]:
    """Make sources of the velocity to the north, to the east, or down."""
    names = ("vx", "vy", "vz"), ("vel_n", "vel_e", "vel_d"), ("vel_n_m_s", "vel_e_m_s", "vel_d_m_s")
    topics = (_LOCAL, _GLOBAL, *_GPS)
    return tuple(
        field_source(topic, fields[axis])
        for topic, fields in zip(topics, (*names, names[-1]), strict=True)
    )


def _above_first(topic: str, field: str) -> ColumnSource:
    return transformed_source(
        field_source(topic, field), lambda values: values - values[0], "{} above its first"
    )


_HEIGHT = field_source(_LOCAL, "z", -1.0)
COLUMNS: Mapping[str, tuple[ColumnSource, ...]] = {
    "theta_cmd_rad": (
        field_source(_SETPOINT, "pitch_body", held=True),
        _euler_source(_SETPOINT, _QD, 1, held=True),
    ),
    "phi_cmd_rad": (
        field_source(_SETPOINT, "roll_body", held=True),
        _euler_source(_SETPOINT, _QD, 0, held=True),
    ),
    "throttle_cmd": (
        field_source(_SETPOINT, "thrust_body[0]", held=True),
        field_source(_SETPOINT, "thrust", held=True),
    ),
    **{
        name: (_euler_source(_ATTITUDE, _Q, axis, held=False),)
        for axis, name in enumerate(("phi_rad", "theta_rad", "psi_rad"))
    },
    **{
        name: (
            field_source("vehicle_angular_velocity", _RATES[axis]),
            field_source(_ATTITUDE, ("rollspeed", "pitchspeed", "yawspeed")[axis]),
            field_source("sensor_combined", _GYRO[axis]),
        )
        for axis, name in enumerate(("p_radps", "q_radps", "r_radps"))
    },
    "airspeed_mps": (
        transformed_source(
            _more_frequent(
                field_source("airspeed_validated", "true_airspeed_m_s"),
                field_source("airspeed", "true_airspeed_m_s"),
            ),
            lambda values: np.maximum(values, 0.0),  # a sensor shows less than 0 at rest
            "{}",
        ),
    ),
    "altitude_m": (
        _HEIGHT,
        _above_first("vehicle_air_data", "baro_alt_meter"),
        _above_first(_GLOBAL, "alt"),
    ),
    "v_down_mps": _speed_sources(2),
    "pwm_ail": _pulse_sources("control[0]", 1500.0, 500.0),
    "pwm_ele": _pulse_sources("control[1]", 1500.0, -500.0),
    "pwm_thr": _pulse_sources("control[3]", 1000.0, 1000.0),
    "pwm_rud": _pulse_sources("control[2]", 1500.0, -500.0),
}
MOTION = MotionSources(
    positions=(
        PositionFields(_GLOBAL, "lat", "lon", "alt"),
        PositionFields(_LOCAL, *_OF_REFERENCE),
        *(
            fields
            for topic in _GPS
            for fields in (
                PositionFields(topic, *_GPS_DEGREES),
                PositionFields(topic, *_GPS_E7, 1e-7, 1e-3),
            )
        ),
    ),
    north=_speed_sources(0),
    east=_speed_sources(1),
    unix=tuple(utc_clock(topic, "time_utc_usec") for topic in _GPS),
    wind_north=tuple(field_source(topic, _WIND[0]) for topic in _WINDS),
    wind_east=tuple(field_source(topic, _WIND[1]) for topic in _WINDS),
)


def read_log(path: Path) -> FlightLog:
    """Read the log of a PX4 flight; times are from boot.

    Of a VTOL the attitudes in wing-borne flight are kept, and at most 50 of them a second.

    Raises:
        MissingExtraError: pyulog is not installed.
        MavlinkError: the file cannot be read, or is of another vehicle or autopilot.
    """
    contents = read_topics(path, _FIELDS_BY_TOPIC, _PARAMS)
    if contents.system not in ("", "PX4"):
        raise MavlinkError(f"{path}: a log of {contents.system}; give one of PX4")
    tables: dict[str, MessageTable] = {}
    left_out: dict[str, int] = {}
    for name in _FIELDS_BY_TOPIC:
        if name not in contents.topics:
            continue
        fields = dict(contents.topics[name])
        time = fields.pop(TIME)
        keep = increasing(time)
        left_out[name] = int(np.count_nonzero(~keep))
        if name == _ATTITUDE:
            check_order(path, name, len(time) - left_out[name], len(time))
        if keep.any():
            kept = {label: values[keep] for label, values in fields.items()}
            tables[name] = MessageTable(time[keep], _known(name, kept))
    vtol, vehicle_notes = _check_vehicle(path, tables, contents.params)
    notes = list(contents.notes)
    if contents.unreadable:
        notes.append(f"the definition of {', '.join(contents.unreadable)} is damaged")
    remedy = f"{_REMEDY}, or download it again: {'; '.join(notes)}" if notes else _REMEDY
    if _ATTITUDE in tables:
        tables[_ATTITUDE], rows_notes = _rows(path, tables, vtol=vtol)
        vehicle_notes += rows_notes
    end = max((float(table.time[-1]) for table in tables.values()), default=0.0)
    return FlightLog(
        path=path,
        tables=tables,
        params=contents.params,
        modes=_mode_intervals(tables, end),
        notes=(*vehicle_notes, *notes, *order_notes(left_out, _STATUS)),
        attitude=_ATTITUDE,
        columns=COLUMNS,
        remedy=remedy,
        home=(field_source(_LOCAL, _OF_REFERENCE[2]), _HEIGHT),
        motion=MOTION,
        firmware=PX4,
    )


def _known(topic: str, fields: Mapping[str, Array]) -> dict[str, Array]:
    """Return fields (M,), with NaN where their flags say that they are not known."""
    found = dict(fields)
    for flag, least, names in _VALID.get(topic, ()):
        if flag in fields:
            valid = fields[flag] >= least
            found |= {n: np.where(valid, found[n], np.nan) for n in names if n in found}
    if topic == _LOCAL and found.keys() >= {"x", "y", "z", "ref_lat", "ref_lon", "ref_alt"}:
        with np.errstate(invalid="ignore", over="ignore"):  # damage may make any number
            found |= zip(_OF_REFERENCE, _geodetic(found), strict=True)
    return found


def _geodetic(fields: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    """Return latitude and longitude, deg, and height, m, of PX4's local positions (M,).

    The frame is an azimuthal equidistant projection of a sphere about the reference. Source: PX4,
    src/lib/geo/geo.cpp, MapProjection::reproject.
    """
    north, east = fields["x"] / _EARTH_RADIUS, fields["y"] / _EARTH_RADIUS
    distance = np.hypot(north, east)
    latitude, longitude = np.radians(fields["ref_lat"]), np.radians(fields["ref_lon"])
    share = np.sinc(distance / np.pi)  # sin c / c
    sine = np.cos(distance) * np.sin(latitude) + north * share * np.cos(latitude)
    across = np.cos(latitude) * np.cos(distance) - north * share * np.sin(latitude)
    return (
        np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0))),
        np.degrees(longitude + np.arctan2(east * share, across)),
        fields["ref_alt"] - fields["z"],
    )


def _check_vehicle(
    path: Path, tables: Mapping[str, MessageTable], params: Mapping[str, float]
) -> tuple[bool, list[str]]:
    """Check that the vehicle has a wing.

    Returns:
        Whether it is a VTOL, and a note where the log does not say which vehicle it is of.

    Raises:
        MavlinkError: it is another vehicle, or a tailsitter.
    """
    status = tables[_STATUS].fields if _STATUS in tables else {}
    kind = _usual(status.get("system_type"))
    if not kind:
        kind = params.get("MAV_TYPE")
    vtol = _VTOL in tables or kind in _VTOL_TYPES or bool(_usual(status.get("is_vtol")))
    if kind in _TAILSITTERS or _usual(status.get("is_vtol_tailsitter")):
        raise MavlinkError(
            f"{path}: the vehicle is a tailsitter, whose logged attitudes are those of the "
            f"hovering body; {_WANTED}"
        )
    if vtol:
        return True, []
    rotors = _usual(status.get("vehicle_type")) == _ROTARY or _usual(status.get("is_rotary_wing"))
    if rotors and kind in (None, _FIXED_WING):
        raise MavlinkError(f"{path}: the vehicle is a multirotor; {_WANTED}")
    if kind not in (None, _FIXED_WING):
        name = _TYPE_NAMES.get(int(kind), "no aircraft with a wing")
        raise MavlinkError(f"{path}: the vehicle is {name} (MAV_TYPE {kind:g}); {_WANTED}")
    if kind is None and _usual(status.get("vehicle_type")) != _WING:
        return False, [
            "the log does not say which vehicle it is of: taken for a fixed-wing aircraft"
        ]
    return False, []


def _usual(values: Array | None) -> float | None:
    """Return the most frequent value of a field (M,), as damage may change some; None: no field."""
    if values is None or not len(values):
        return None
    found, counts = np.unique(values, return_counts=True)
    return float(found[np.argmax(counts)])


def _rows(
    path: Path, tables: Mapping[str, MessageTable], *, vtol: bool
) -> tuple[MessageTable, list[str]]:
    """Return the attitudes in wing-borne flight, at most one in `_ROW_S`, and notes.

    Raises:
        MavlinkError: a VTOL is never in wing-borne flight, or the log does not say when.
    """
    table, notes = tables[_ATTITUDE], []
    keep = np.ones(len(table.time), dtype=bool)
    if vtol:
        keep, source = _wing_borne(path, tables, table.time)
        if not keep.any():
            raise MavlinkError(
                f"{path}: the VTOL is never in wing-borne flight (by {source}); {_WANTED}"
            )
        if not keep.all():
            notes.append(
                f"{100.0 * keep.mean():.0f} % of the attitudes are of wing-borne flight, by "
                f"{source}; those in hover and transitions are left out"
            )
    _, first = np.unique(np.floor(table.time[keep] / _ROW_S + _ROUNDING), return_index=True)
    rows = np.flatnonzero(keep)[first]
    if len(rows) < np.count_nonzero(keep):
        notes.append(
            f"{_ATTITUDE}: {len(rows):,} of {np.count_nonzero(keep):,} messages are rows, at most "
            f"{1.0 / _ROW_S:g} a second"
        )
    fields = {name: values[rows] for name, values in table.fields.items()}
    return MessageTable(table.time[rows], fields), notes


def _wing_borne(
    path: Path, tables: Mapping[str, MessageTable], time: Array
) -> tuple[BoolArray, str]:
    """Mask the times (M,) at which a VTOL is in wing-borne flight, and say by which field."""
    for topic, field, on_wing, transition in (
        (_VTOL, "vehicle_vtol_state", _VTOL_ON_WING, ""),
        (_VTOL, "vtol_in_rw_mode", 0, "vtol_in_trans_mode"),
        (_STATUS, "vehicle_type", _WING, "in_transition_mode"),
        (_STATUS, "is_rotary_wing", 0, "in_transition_mode"),
    ):
        table = tables.get(topic)
        if table is not None and field in table.fields:
            state = table.fields[field] == on_wing
            if transition in table.fields:
                state &= table.fields[transition] == 0
            latest = np.searchsorted(table.time, time, side="right") - 1
            mask: BoolArray = state[np.maximum(latest, 0)]
            return mask, f"{topic}.{field}"
    raise MavlinkError(
        f"{path}: the log does not say when the VTOL is in wing-borne flight: no {_VTOL}, no "
        f"{_STATUS} with vehicle_type; {_REMEDY}"
    )


def _mode_intervals(tables: Mapping[str, MessageTable], end: float) -> tuple[ModeInterval, ...]:
    """Return the intervals of equal vehicle_status.nav_state."""
    table = tables.get(_STATUS)
    if table is None or "nav_state" not in table.fields:
        return ()
    modes = table.fields["nav_state"]
    begins = np.flatnonzero(np.concatenate([[True], np.diff(modes) != 0.0]))
    starts = table.time[begins].tolist()
    return tuple(
        ModeInterval(int(mode), start, stop)
        for mode, start, stop in zip(
            modes[begins].tolist(), starts, [*starts[1:], end], strict=True
        )
    )
