"""Where the compiled model ends: codes of rows that it no longer advances."""

from __future__ import annotations

FLYING = 0
IMPLAUSIBLE = 1  # not a number, or faster than any aircraft
ABOVE_ATMOSPHERE = 2  # above the layers of the atmosphere that are in the model

FASTEST = 1e9  # ft/s, rad/s
