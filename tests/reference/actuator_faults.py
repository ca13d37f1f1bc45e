"""Actuator faults of many aircraft at once, by numpy: a second version of the kernels."""

from typing import NamedTuple

import numpy as np

# of the trailing edges: with air from below, and with air from the right
WITH_FLOW = np.array([[0.0, 1.0, 0.0, 1.0, 1.0], [0.0, 0.0, -1.0, 0.0, 0.0]])


class Rule(NamedTuple):
    """What could be wrong."""

    stuck_wins: bool = True  # over floating
    thrust_is_lost: bool = True
    holds_last: bool = True  # a stuck surface that of the period before, not its command
    freezes: bool = True
    one_travel: bool = False  # up for both directions
    other_serves_both: bool = True  # the elevon that has not failed serves both axes


def positions(commands, mixing):
    """Positions (N, 5) of commands (N, 4): aileron, elevator, rudder, then both elevons."""
    aileron, elevator, rudder, _ = commands.T
    left = np.clip(mixing * (elevator - aileron), -1.0, 1.0)
    right = np.clip(mixing * (elevator + aileron), -1.0, 1.0)
    return np.stack([aileron, elevator, rudder, left, right], axis=1)


def actuate(commands, before, faults, flow, geometry, rule=Rule()):  # noqa: B008 - immutable
    """Return the state of surfaces and motors (N, 4), and the servos after the period.

    Args:
        commands: (N, 4) of the autopilots.
        before: commands (N, 4) and positions (N, 5) of the period before.
        faults: FaultState (N).
        flow: (N, 2) angle of attack and sideslip, rad.
        geometry: ControlGeometry (N).
        rule: planted mistakes.
    """
    frozen = faults.frozen[:, np.newaxis] & rule.freezes
    held = np.where(frozen, before[0], commands)
    free = positions(held, geometry.mixing)
    angle = faults.floats * (flow @ WITH_FLOW)
    travel = np.where((angle > 0.0) | rule.one_travel, geometry.up, geometry.down)
    floating = np.clip(angle / np.where(travel > 0.0, travel, np.inf), -1.0, 1.0)
    last = before[1] if rule.holds_last else free
    stuck = np.where(np.isnan(faults.stuck_at), last, faults.stuck_at)
    both = [(faults.floating, floating), (faults.stuck, stuck)]
    out, failed = free, np.zeros(free.shape, dtype=bool)
    for which, where in both if rule.stuck_wins else reversed(both):
        which = which & geometry.fitted
        out, failed = np.where(which, where, out), failed | which
    surfaces = held.copy()
    surfaces[:, :3] = out[:, :3]
    mixed = failed[:, 3:].any(axis=1) & rule.other_serves_both
    left, right = out[mixed, 3:].T
    surfaces[mixed, 0] = (right - left) / (2.0 * geometry.mixing[mixed])
    surfaces[mixed, 1] = (right + left) / (2.0 * geometry.mixing[mixed])
    surfaces[:, 3] *= faults.power if rule.thrust_is_lost else 1.0
    return surfaces, (held, out)
