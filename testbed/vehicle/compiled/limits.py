"""Where the compiled model ends: codes of rows that it no longer advances."""

from __future__ import annotations

FLYING = 0
IMPLAUSIBLE = 1  # not a number, or faster than any aircraft
NEAR_GROUND = 2  # a part of the aircraft may touch the ground, whose forces are not in the model
ABOVE_TROPOPAUSE = 3  # above the layer of the atmosphere that is in the model

FASTEST = 1e9  # ft/s, rad/s
