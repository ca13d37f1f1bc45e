"""A formation of four with faults, for tests of faults, membership and losses."""

import numpy as np

from testbed.core.records import VehicleState
from testbed.flight.faults import FaultManager

NAMES = ["leader", "uav1", "uav2", "uav3"]
NONE_LOST = np.zeros(4, dtype=bool)


def truth(altitude=100.0, airspeed=20.0, bank=0.0):
    state = VehicleState(*np.zeros((5, 4, 3)), *np.full((2, 4), airspeed))
    state.position_ned[:, 2] = -altitude
    state.euler[:, 0] = bank
    return state


def no_air():
    raise AssertionError("air data are not needed")


def fault_manager(*faults, row=2, declared_after_s=2.0):
    """Return a manager with faults of one aircraft, by default uav2."""
    each = [[], [], [], []]
    each[row] = list(faults)
    return FaultManager(NAMES, each, declared_after_s)


def step(manager, now, state=None):
    """Step a manager; return its events."""
    events = manager.changes(now, truth() if state is None else state, no_air, NONE_LOST)
    return [(e.time_s, e.level, e.source, e.text) for e in events]
