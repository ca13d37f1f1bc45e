"""Which vehicle a flight log is of: ArduPlane or another one, and one vehicle or several."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from testbed.core.frames import wrap_pi
from testbed.core.geodetic import ned_from_geodetic
from testbed.core.records import Array, NedOrigin
from testbed.mavlink.codec import MavlinkError

# The name and version of a firmware, and the hash of its sources: ArduPlane V4.5.7 (0358a9c2).
_BANNER = re.compile(
    r"(?:^|\[)(?P<name>[A-Za-z][\w:+-]*) (?:[Vv]\d+\.\d+|\d+\.\d+\S* \([0-9a-f]{6,40}\))"
)
_HASH = re.compile(r"\([0-9a-f]{6,40}\)")
_PLANE = re.compile(r"(?:APM:|Ardu)Plane")
_PLANE_PARAMS = frozenset(
    {"STAB_PITCH_DOWN", "ROLL_LIMIT_DEG", "LIM_ROLL_CD", "PTCH_LIM_MAX_DEG", "LIM_PITCH_MAX"}
)  # that no other vehicle of ArduPilot has
UNKNOWN_VEHICLE = (
    "the log does not say which vehicle it is of: mode numbers and units are taken for ArduPlane's"
)
_NEIGHBOURS = 1.0  # s between messages that are compared
_MIN_JUMPS, _MIN_SHARE = 3, 0.01  # of the pairs of messages
# Largest changes of roll, pitch, yaw, rad, and of the position less velocity times time, m:
# constant, and per second.
_ATTITUDE_STEP, _ATTITUDE_RATE = np.full(3, 0.1), np.array([6.0, 3.0, 3.0])
_POSITION_STEP, _POSITION_RATE = np.full(3, 3.0), np.full(3, 10.0)
_MAX_PITCH = 1.2  # rad; beyond it, roll and yaw turn quickly


def is_plane(path: Path, texts: Iterable[str], params: Iterable[str], *, first: bool) -> bool:
    """Check whether a log says that it is of ArduPlane, by its banner or its parameters.

    Banners without the hash of their sources count only in the first place, because scripts send
    texts, too.

    Args:
        path: the log.
        texts: messages of the autopilot, in order.
        params: names of its parameters.
        first: whether the texts start with the banner.

    Raises:
        MavlinkError: a banner is of another vehicle.
    """
    plane = False
    for text in texts:
        names = [banner["name"] for banner in _BANNER.finditer(text)]
        if not names or not (first or _HASH.search(text)):
            continue
        first = False
        if not any(_PLANE.fullmatch(name) for name in names):
            also = "also " if plane else ""
            raise MavlinkError(f"{path}: {also}a log of {names[0]}; give one of ArduPlane")
        plane = True
    return plane or not _PLANE_PARAMS.isdisjoint(params)


def jumps_of_attitude(time: Array, attitude: Array) -> bool:
    """Check whether attitudes (M, 3), roll, pitch, yaw in rad, turn faster than any aircraft."""
    order = np.argsort(time, kind="stable")
    time, attitude = time[order], attitude[order]
    change = wrap_pi(np.diff(attitude, axis=0))
    level = np.abs(attitude[:, 1]) < _MAX_PITCH
    change[~(level[1:] & level[:-1])] = 0.0
    return _jumps(time, change, _ATTITUDE_STEP, _ATTITUDE_RATE)


def jumps_of_position(time: Array, geodetic: Array, velocity_ned: Array) -> bool:
    """Check whether positions jump away from where the velocities lead.

    Args:
        time: (M,) s.
        geodetic: (M, 3) latitude and longitude, deg, and height, m.
        velocity_ned: (M, 3) m/s.
    """
    order = np.argsort(time, kind="stable")
    time, geodetic, velocity_ned = time[order], geodetic[order], velocity_ned[order]
    latitude, longitude, height = geodetic[0].tolist()
    position = ned_from_geodetic(geodetic, NedOrigin(latitude, longitude, height))
    mean_velocity = 0.5 * (velocity_ned[1:] + velocity_ned[:-1])
    change = np.diff(position, axis=0) - mean_velocity * np.diff(time)[:, None]
    return _jumps(time, change, _POSITION_STEP, _POSITION_RATE)


def _jumps(time: Array, change: Array, step: Array, rate: Array) -> bool:
    elapsed = np.diff(time)
    near = elapsed <= _NEIGHBOURS
    beyond = (np.abs(change) > step + rate * elapsed[:, None]).any(axis=1) & near
    count = int(np.count_nonzero(beyond))
    return count >= max(_MIN_JUMPS, _MIN_SHARE * np.count_nonzero(near))


def steps_back(sequences: Sequence[int]) -> int:
    """Count sequence numbers, modulo 256, that are not ahead of the one before."""
    ahead = np.mod(np.diff(np.array(sequences, dtype=np.int64)), 256)
    return int(np.count_nonzero((ahead == 0) | (ahead > 127)))
