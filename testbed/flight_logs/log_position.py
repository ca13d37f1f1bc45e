"""Positions, ground velocities and UNIX times in flight logs.

Fields and units: https://ardupilot.org/plane/docs/logmessages.html and
https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.geodetic import geodetic_from_ned, has_position, ned_from_geodetic
from testbed.core.interpolation import hermite
from testbed.core.ranges import RECORDED
from testbed.core.records import Array, BoolArray, NedOrigin
from testbed.flight_logs.flight_log import (
    ColumnSource,
    FlightLog,
    LogSeries,
    MotionSources,
    PositionFields,
    Unavailable,
    field_source,
    first_available,
    resample,
)

POSITION = ("latitude_deg", "longitude_deg", "height_m")
HORIZONTAL = ("v_north_mps", "v_east_mps")
WIND = ("wind_north_mps", "wind_east_mps")
UNIX = "unix_s"
GPS_EPOCH_S = 315_964_800.0  # s from 1970 to 1980-01-06, when GPS time began
# UNIX time from which GPS time is so many seconds ahead of UTC: 2009-01-01, 2012-07-01, 2015-07-01
# and 2017-01-01. Source: Leap_Second.dat of the IERS, TAI - UTC, less the 19 s of TAI - GPS; its
# Bulletin C says twice a year whether there is another one.
LEAP_SECONDS = ((1_230_768_000, 15), (1_341_100_800, 16), (1_435_708_800, 17), (1_483_228_800, 18))
FIRST_WEEK = 1563  # of GPS time, from 2009-12-20: ArduPlane has no earlier logs
_ROLLOVER = 1024  # weeks, after which old receivers count from the begin again
_LATER = f"GPS.GWk/GMS, {_ROLLOVER} weeks later"
MAX_GAP_S = 1.0  # between two positions, for cubic interpolation
_WEEK_S = 604_800.0
_MAX_CLOCK_SPREAD = 0.05  # s about the median of UNIX time minus log time, without a note
_FIX_3D = 3  # GPS.Status


@dataclass(frozen=True, slots=True)
class LogPosition:
    """Known positions of a log, in order of time."""

    source: str
    time: Array  # (M,) s, increasing
    geodetic: Array  # (M, 3) latitude and longitude, deg, height above sea level, m
    preferred: str = ""  # why those of the messages that are preferred are not used

    def within(self, keep: BoolArray) -> LogPosition:
        """Select positions (M,)."""
        return replace(self, time=self.time[keep], geodetic=self.geodetic[keep])

    def near(self, time: Array) -> BoolArray:
        """Mask times (T,) that lie between two positions at most `MAX_GAP_S` apart, or at one."""
        after = np.searchsorted(self.time, time)  # the first position at or after each time
        last = len(self.time) - 1
        at = self.time[np.minimum(after, last)] == time
        inside = (after > 0) & (after <= last)
        gap = self.time[np.minimum(after, last)] - self.time[np.maximum(after - 1, 0)]
        near: BoolArray = at | (inside & (gap <= MAX_GAP_S))
        return near

    def interpolate(self, time: Array, velocity_ned: Array | None) -> Array:
        """Interpolate latitude, longitude and height (T, 3).

        Args:
            time: (T,) s.
            velocity_ned: (M, 3) m/s at the positions, for cubic interpolation; None: linear.
        """
        latitude, longitude, height = self.geodetic[0].tolist()
        origin = NedOrigin(latitude, longitude, height)
        ned = ned_from_geodetic(self.geodetic, origin)
        if velocity_ned is None or len(self.time) < 2:
            at = np.stack([np.interp(time, self.time, each) for each in ned.T], axis=-1)
        else:
            at, _ = hermite(
                np.clip(time, self.time[0], self.time[-1]), self.time, ned, velocity_ned
            )
        return geodetic_from_ned(at, origin)


def read_positions(log: FlightLog, sources: MotionSources) -> LogPosition:
    """Read the positions of the first message that knows any.

    Raises:
        Unavailable: none does.
    """
    reasons = []
    for fields in sources.positions:
        table = log.tables.get(fields.message)
        names = fields[1:4]
        if table is None or not table.fields.keys() >= {*names}:
            reasons.append(f"no {fields.message} with {', '.join(names)}")
            continue
        scales = (fields.angle_scale, fields.angle_scale, fields.height_scale)
        columns = [table.fields[name] for name in names]
        known = np.isfinite(columns).all(axis=0) & has_position(*columns[:2])
        for column, name, scale in zip(columns, POSITION, scales, strict=True):
            limits = RECORDED[name]
            known &= (column >= limits.low / scale) & (column <= limits.high / scale)
        known &= np.concatenate([[True], np.diff(table.time) > 0.0])
        if known.any():
            geodetic = np.stack(columns, axis=-1)[known] * scales
            source = f"{fields.message}.{'/'.join(names)}"
            return LogPosition(source, table.time[known], geodetic, ", ".join(reasons))
        reasons.append(f"{fields.message} knows no position")
    raise Unavailable(", ".join(reasons))


def ground_velocity(
    log: FlightLog, sources: MotionSources, down: LogSeries | None
) -> tuple[LogSeries, LogSeries, LogSeries] | None:
    """Return the velocity to the north, to the east and down; None: not all three are logged."""
    try:
        horizontal = first_available(log, sources.north), first_available(log, sources.east)
    except Unavailable:
        return None
    return None if down is None else (*horizontal, down)


def polar_source(message: str, speed: str, course_deg: str, *, east: bool) -> ColumnSource:
    """Make a source of a component of the ground velocity from speed and course."""

    def source(log: FlightLog) -> LogSeries:
        one = field_source(message, speed)(log)
        course = np.radians(field_source(message, course_deg)(log).values)
        if len(course) != len(one.values):
            raise Unavailable(f"{message} has damaged {speed} or {course_deg}")
        share = np.sin(course) if east else np.cos(course)
        return LogSeries(f"{message}.{speed}/{course_deg}", one.time, one.values * share)

    return source


def _towards(wind_from: ColumnSource) -> ColumnSource:
    """Make a source of a wind's velocity from one by the direction that it comes from."""

    def source(log: FlightLog) -> LogSeries:
        found = wind_from(log)
        return replace(found, values=-found.values)

    return source


def read_wind_estimate(log: FlightLog, time: Array) -> dict[str, LogSeries]:
    """Read the autopilot's estimate of the wind in the flight of rows (M,); empty: there is none.

    Its names are those of `WIND`.
    """
    try:
        wind = [
            log.of_same_flight(first_available(log, sources), time)
            for sources in (log.motion.wind_north, log.motion.wind_east)
        ]
    except Unavailable:
        return {}
    found = [each for each in wind if each is not None]
    return dict(zip(WIND, found, strict=True)) if len(found) == len(WIND) else {}


def gps_clock(log: FlightLog) -> LogSeries:
    """Return UNIX time minus log time by the week and millisecond of GPS fixes (.bin)."""
    table = log.tables.get("GPS")
    if table is None or not table.fields.keys() >= {"GWk", "GMS"}:
        raise Unavailable("no GPS with GWk and GMS")
    week, ms = table.fields["GWk"].copy(), table.fields["GMS"]
    valid = np.isfinite(week) & np.isfinite(ms) & (week > 0.0)
    if "Status" in table.fields:
        valid &= table.fields["Status"] >= _FIX_3D
    if not valid.any():
        raise Unavailable("GPS has no time of a fix")
    early = valid & (week < FIRST_WEEK)
    week[early] += _ROLLOVER * np.ceil((FIRST_WEEK - week[early]) / _ROLLOVER)
    unix = unix_from_gps(_WEEK_S * week[valid] + 1e-3 * ms[valid])
    time = table.time[valid]
    return LogSeries(_LATER if early.any() else "GPS.GWk/GMS", time, unix - time)


def unix_from_gps(gps_s: Array) -> Array:
    """Return UNIX times (…) of GPS times (…) since 1980-01-06, both s, from 2009 on."""
    since, seconds = np.array(LEAP_SECONDS, dtype=np.float64).T
    after = np.searchsorted(since + seconds, GPS_EPOCH_S + gps_s, side="right") - 1
    unix: Array = GPS_EPOCH_S + gps_s - seconds[np.maximum(after, 0)]
    return unix


def utc_clock(message: str, name: str) -> ColumnSource:
    """Make a source of UNIX time minus log time by a field that has UNIX time, µs."""

    def source(log: FlightLog) -> LogSeries:
        table = log.tables.get(message)
        if table is None or name not in table.fields:
            raise Unavailable(f"no {message} with {name}")
        valid = table.fields[name] > 0.0
        if not valid.any():
            raise Unavailable(f"{message} knows no time")
        time = table.time[valid]
        return LogSeries(message, time, 1e-6 * table.fields[name][valid] - time)

    return source


def sample_velocity(velocity: Sequence[LogSeries], time: Array) -> Array:
    """Sample a velocity (T, 3) at times (T,)."""
    return np.stack([resample(each, time) for each in velocity], axis=-1)


def sample_motion(
    log: FlightLog, position: LogPosition, down: LogSeries | None, time: Array
) -> tuple[dict[str, Array], dict[str, str]]:
    """Sample positions and horizontal velocities at times (M,) of one flight.

    Raises:
        Unavailable: there are gaps between the positions, or none in this flight.
    """
    same = log.flight_numbers(position.time) == log.flight_numbers(time[:1])
    if not same.any():
        raise Unavailable(f"{position.source} has no value in the flight from {time[0]:.1f} s on")
    position = position.within(same)
    near = position.near(time)
    if not near.all():
        at = time[int(np.argmin(near))]
        raise Unavailable(
            f"{position.source} has no value within {MAX_GAP_S:g} s of {at:.1f} s; choose a part "
            "with --from and --to"
        )
    velocity = ground_velocity(log, log.motion, down)
    if velocity is None:
        found = position.interpolate(time, None)
        return dict(zip(POSITION, found.T, strict=True)), dict.fromkeys(
            POSITION, f"{position.source}, linear"
        )
    found = position.interpolate(time, sample_velocity(velocity, position.time))
    columns = dict(zip(POSITION, found.T, strict=True))
    sources = dict.fromkeys(POSITION, position.source)
    for name, each in zip(HORIZONTAL, velocity[:2], strict=True):
        columns[name], sources[name] = resample(each, time), each.source
    return columns, sources


def unix_time(log: FlightLog, time: Array) -> tuple[Array | None, str, tuple[str, ...]]:
    """Return UNIX times of rows (M,), their source, and notes; None: not known."""
    with suppress(Unavailable):
        clock = first_available(log, log.motion.unix)
        if (flown := log.of_same_flight(clock, time)) is not None:
            offset = float(np.median(flown.values))
            spread = float(np.max(np.abs(flown.values - offset)))
            notes = []
            if clock.source == _LATER:
                notes.append(
                    f"{UNIX}: GPS.GWk has weeks before {FIRST_WEEK}, in 2009, when there was no "
                    "ArduPlane: the receiver counts weeks from the begin again; taken as "
                    f"{_ROLLOVER} weeks later"
                )
            if spread > _MAX_CLOCK_SPREAD:
                notes.append(
                    f"{UNIX}: {clock.source}, which varies by up to {spread:.3f} s about the median"
                )
            return time + offset, clock.source, tuple(notes)
    if log.receiver_start_unix_s is None:
        return None, "", ()
    source = "times of receipt"
    note = f"{UNIX}: {source}, as no SYSTEM_TIME has a time; the radio link delays them"
    return time + log.receiver_start_unix_s, source, (note,)


def home_height(log: FlightLog, time: Array) -> float | None:
    """Return the height of home above sea level, m; None: not known."""
    with suppress(Unavailable):
        above_sea, above_home = (source(log) for source in log.home)
        return float(resample(above_sea, time[:1])[0] - resample(above_home, time[:1])[0])
    return None


DATAFLASH = MotionSources(
    positions=(
        PositionFields("POS", "Lat", "Lng", "Alt"),
        PositionFields("GPS", "Lat", "Lng", "Alt"),
    ),
    north=(field_source("XKF1", "VN"), polar_source("GPS", "Spd", "GCrs", east=False)),
    east=(field_source("XKF1", "VE"), polar_source("GPS", "Spd", "GCrs", east=True)),
    unix=(gps_clock,),
    wind_north=(field_source("XKF2", "VWN"),),
    wind_east=(field_source("XKF2", "VWE"),),
)
TELEMETRY = MotionSources(
    positions=(PositionFields("GLOBAL_POSITION_INT", "lat", "lon", "alt", 1e-7, 1e-3),),
    north=(field_source("GLOBAL_POSITION_INT", "vx", 0.01),),
    east=(field_source("GLOBAL_POSITION_INT", "vy", 0.01),),
    unix=(utc_clock("SYSTEM_TIME", "time_unix_usec"),),
    wind_north=(_towards(polar_source("WIND", "speed", "direction", east=False)),),
    wind_east=(_towards(polar_source("WIND", "speed", "direction", east=True)),),
)
