"""Lost aircraft, and the outcome of the run."""

import numpy as np
from fault_samples import NAMES, NONE_LOST, fault_manager, step

from testbed.flight.limits import ProximityMonitor
from testbed.flight.monitors import LossMonitor
from testbed.scenario.faults import EngineOut

FAR = np.array([[100.0 * i, 0.0, -100.0] for i in range(4)])


def monitor(*, fly_on, faults=None, collision_m=None):
    proximity = ProximityMonitor(NAMES, collision_m=collision_m)
    return LossMonitor(NAMES, np.ones(len(NAMES)), proximity, faults, fly_on=fly_on)


def uav2_failed():
    faults = fault_manager(EngineOut(kind="engine-out", at_s=1.0))
    step(faults, 1.0)
    return faults


def test_lost_aircraft_is_an_error_and_ends_the_run():
    losses = monitor(fly_on=False)
    assert list(losses.changes(3.0, FAR, NONE_LOST)) == []
    assert (losses.terminate, losses.outcome) == (False, "completed")
    events = list(losses.changes(3.5, FAR, np.array([False, True, True, False])))
    assert [(e.time_s, e.level, e.source) for e in events] == [
        (3.5, "error", "uav1"),
        (3.5, "error", "uav2"),
    ]
    assert (losses.terminate, losses.outcome) == (True, "lost")


def test_loss_of_an_aircraft_with_a_fault_completes():
    losses = monitor(fly_on=True, faults=uav2_failed())
    list(losses.changes(3.0, FAR, np.array([False, False, True, False])))
    assert (losses.terminate, losses.outcome) == (False, "completed")
    assert list(losses.changes(4.0, FAR, np.array([False, False, True, False]))) == []
    list(losses.changes(5.0, FAR, np.array([False, True, True, False])))  # uav1 has no fault
    assert (losses.terminate, losses.outcome) == (False, "lost")


def test_run_without_aircraft_ends():
    losses = monitor(fly_on=True)
    list(losses.changes(3.0, FAR, np.ones(4, dtype=bool)))
    assert (losses.terminate, losses.outcome) == (True, "lost")


def test_collided_aircraft_are_lost():
    losses = monitor(fly_on=True, faults=uav2_failed(), collision_m=3.0)
    near = FAR.copy()
    near[3] = near[2] + [0.0, 2.0, 0.0]
    before = losses.lost
    events = list(losses.changes(3.0, near, NONE_LOST))
    assert [(e.level, e.source) for e in events] == [("error", "uav2"), ("error", "uav3")]
    assert losses.lost.tolist() == [False, False, True, True]
    assert not before.any()  # observers keep the array
    assert losses.outcome == "lost"  # uav3 has no fault
