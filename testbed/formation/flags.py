"""Bit flags that say which guard or saturation acted on an agent's command, and who is missed."""

from __future__ import annotations

from enum import IntFlag


class Guard(IntFlag):
    """A guard that kept the control law inside its domain."""

    SPEED_DESIRED_CLAMPED = 1  # s_d left S_d and was clamped, its derivative zeroed
    OUTSIDE_SPEED_SET = 2  # s left S: the second branch of (14)
    SPEED_COMMAND_CLIPPED = 4  # u + s_a − s left the speed bounds
    LEADER_SILENT = 8  # the leader was not heard for too long


class Missing(IntFlag):
    """What there is to tell of who hears whom."""

    OVERDUE = 1  # of a neighbour, or no longer
    DEAF = 2  # somebody, to the leader


class Saturation(IntFlag):
    """A limit of the middle loop's command that was reached."""

    PITCH = 1
    ROLL = 2
    THROTTLE = 4
