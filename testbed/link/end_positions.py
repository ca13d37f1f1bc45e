"""Where the two ends of a link are, by the positions that pass through it.

An end is where its last GLOBAL_POSITION_INT says, with the attitude of its last ATTITUDE; both are
read from frames with a right checksum only, and out of range they are ignored.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import numpy as np

from testbed.core.geodetic import DEGREES, LocalFrame, local_frame, wrap_longitude
from testbed.core.records import Array, NedOrigin
from testbed.link.frame_cutter import Unit
from testbed.link.link_file import Position

GLOBAL_POSITION_INT, ATTITUDE = 33, 30  # message ids
_POSITION, _ATTITUDE = struct.Struct("<4xiii"), struct.Struct("<4xfff")
MAX_HEIGHT_M = 1e5


class EndPositions:
    """Positions of two ends.

    Attributes:
        updates: positions that were received of each end.
    """

    def __init__(self, fixed: Mapping[int, Position]) -> None:
        """Start with the ends that stay where they are, by their number."""
        self.updates = [0, 0]
        self._fixed = frozenset(fixed)
        self._frame: LocalFrame | None = None
        self._ned, self._euler = np.full((2, 3), np.nan), np.zeros((2, 3))
        for end, place in fixed.items():
            self._put(end, place.latitude_deg, place.longitude_deg, place.height_m)

    def read(self, end: int, unit: Unit) -> bool:
        """Take the positions and attitudes that an end has sent; return whether there were some."""
        changed = False
        for frame in unit.frames:
            if not frame.known or frame.message not in (GLOBAL_POSITION_INT, ATTITUDE):
                continue
            payload = unit.data[frame.payload : frame.payload_end].ljust(16, b"\0")
            if frame.message == ATTITUDE:
                angles = _ATTITUDE.unpack_from(payload)
                if all(map(math.isfinite, angles)):
                    self._euler[end] = angles
                    changed = True
            elif end not in self._fixed:
                changed |= self._read_position(end, payload)
        return changed

    def _read_position(self, end: int, payload: bytes) -> bool:
        latitude, longitude, height_mm = _POSITION.unpack_from(payload)
        out_of_range = abs(latitude) > 9e8 or abs(longitude) > 18e8
        if out_of_range or abs(height_mm) > 1e3 * MAX_HEIGHT_M or not (latitude or longitude):
            return False
        self.updates[end] += 1
        self._put(end, 1e-7 * latitude, 1e-7 * longitude, 1e-3 * height_mm)
        return True

    def _put(self, end: int, latitude: float, longitude: float, height_m: float) -> None:
        if self._frame is None:
            self._frame = local_frame(NedOrigin(latitude, longitude, height_m))
        frame = self._frame
        self._ned[end] = (
            (latitude - frame.latitude) * frame.metres_per_latitude,
            wrap_longitude(longitude - frame.longitude, DEGREES) * frame.metres_per_longitude,
            frame.elevation - height_m,
        )

    def seen_from(self, sender: int) -> tuple[Array, Array] | None:
        """Return positions (2, 3) m and attitudes (2, 3) rad, the sender first; None: unknown."""
        if np.isnan(self._ned).any():
            return None
        order = [sender, 1 - sender]
        return self._ned[order], self._euler[order]

    def distance_m(self) -> float | None:
        """Return the distance of the ends, m; None: unknown."""
        apart = self._ned[1] - self._ned[0]
        return None if np.isnan(apart).any() else float(np.sqrt(apart @ apart))
