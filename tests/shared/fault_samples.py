"""A formation of four with faults, for tests of faults, membership and losses."""

import numpy as np

from testbed.core.records import AIRCRAFT, VehicleState, allocate, write_fields
from testbed.flight.faults import FaultManager

NAMES = ["leader", "uav1", "uav2", "uav3"]
NONE_LOST = np.zeros(4, dtype=bool)


def truth(altitude=100.0, airspeed=20.0, bank=0.0):
    state = VehicleState(*np.zeros((5, 4, 3)), *np.full((2, 4), airspeed))
    state.position_ned[:, 2] = -altitude
    state.euler[:, 0] = bank
    return state


def fault_manager(*faults, row=2, declared_after_s=2.0):
    """Return a manager with faults of one aircraft, by default uav2."""
    each = [[], [], [], []]
    each[row] = list(faults)
    return FaultManager(NAMES, each, declared_after_s)


def step(manager, now, state=None, *, lost=NONE_LOST, charge=np.nan):
    """Step a manager; return its events."""
    aircraft = allocate(AIRCRAFT, 4)
    write_fields(aircraft["truth"], truth() if state is None else state)
    aircraft["lost"], aircraft["air"]["state_of_charge"] = lost, charge
    changes = manager.bind(aircraft)(now)
    events = [(e.time_s, e.level, e.source, e.text) for e in manager.changes(now)]
    assert changes or not events
    return events
