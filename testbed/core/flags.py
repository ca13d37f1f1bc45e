"""Sets of bits that laws and middle loops give, and that the log has."""

from __future__ import annotations

from enum import IntFlag


class LimiterFlag(IntFlag):
    """A limiter of the control law that acted."""

    SPEED_DESIRED_CLAMPED = 1  # s_d was outside S_d and clamped, its derivative set to zero
    OUTSIDE_SPEED_SET = 2  # s is outside S: second branch of (14)
    SPEED_COMMAND_CLIPPED = 4  # u + s_a − s was outside the speed bounds
    LEADER_TIMEOUT = 8  # no message of the leader for leader_timeout_s
    CLOSING_LIMITED = 16  # the separation filter has changed the desired velocity
    CLOSING_LIMITS_INFEASIBLE = 32  # no desired velocity is within all of its bounds
    INSIDE_SEPARATION_MARGIN = 64  # an aircraft is closer than separation and margin


class Saturation(IntFlag):
    """A limit of the middle loop's command that was reached."""

    PITCH = 1
    ROLL = 2
    THROTTLE = 4


def flag_names(kind: type[IntFlag]) -> list[str]:
    """Return the names of flags as documents and logs have them."""
    return [str(flag.name).lower() for flag in kind]
