"""Altitude frames of mission items and positions: MAV_FRAME.

The ground is flat, at home's height: an altitude above terrain is one above home.
"""

from __future__ import annotations

from testbed.core.records import NedOrigin

MISSION_FRAME = 2  # of items without a position
SEA_LEVEL, ABOVE_HOME, ABOVE_TERRAIN = (0, 5), (3, 6), (10, 11)  # each also with _INT
POSITION_FRAMES = (*SEA_LEVEL, *ABOVE_HOME, *ABOVE_TERRAIN)
TERRAIN_NOTE = "altitudes above terrain count above home: the ground is flat"


def altitude_above_home(frame: int, altitude: float, origin: NedOrigin) -> float | None:
    """Convert an altitude, m, in a frame to one above home; None: not a frame of positions."""
    if frame not in POSITION_FRAMES:
        return None
    return altitude - origin.elevation_m if frame in SEA_LEVEL else altitude


def frame_error(frame: int) -> str:
    """Return why a frame is refused, and what to write."""
    return f"MAV_FRAME {frame}: write altitudes above home (3), sea level (0) or terrain (10)"
