"""Responses of followers to declared failures: exclusion and slot reassignment."""

import numpy as np
from fault_samples import NAMES, fault_manager, step

from testbed.core.records import LINK, allocate
from testbed.flight.faults import FaultManager
from testbed.flight.membership import FormationMembership
from testbed.formation.hbh23 import NEIGHBOUR
from testbed.scenario.faults import EngineOut

OFFSETS = np.array([[0.0, 0, 0], [-5, 5, 0], [-10, -5, 0], [-15, 5, 0]])
# a chain: each follower uses the leader and the follower before it; all gains differ
GAINS = np.zeros((3, 4, 3))
GAINS[:, 0] = [[1.0], [2.0], [3.0]]
GAINS[1, 1] = 4.0
GAINS[2, 2] = 5.0
ALL = np.arange(3)
EXCLUDED = "uav2 has failed: excluded"


def engine_out(at_s, duration_s=None):
    return EngineOut(kind="engine-out", at_s=at_s, duration_s=duration_s)


def membership(*, clearance_m=10.0, duration_s=None):
    """Return a membership whose uav2 fails at 10 s and declares it at 12 s, and the faults."""
    faults = fault_manager(engine_out(10.0, duration_s))
    step(faults, 10.0)
    return FormationMembership(NAMES, OFFSETS, GAINS, faults, clearance_m), faults


def measured(time_s, *, uav3=None):
    """Return times of measurement (n, N); uav3's newest message of uav2 may be older."""
    times = np.full((3, 4), time_s)
    if uav3 is not None:
        times[2, 2] = uav3
    return times


def links(measured_s, below=0.0):
    """Return LINK (n, N): a leader at 20 m/s north, all in their slots, uav2 this far below."""
    out = allocate(LINK, 3, 4)
    out["position_ned"] = OFFSETS + [0.0, 0.0, -100.0]
    out["position_ned"][:, 2, 2] += below
    out["velocity_ned"], out["measured_s"] = [20.0, 0.0, 0.0], measured_s
    return out


def events_of(member, now, received):
    """Return the events of a step, of which there are some where the call asks for it."""
    asks = member.bind(ALL, received)(now)
    events = list(member.changes(now, ALL, received))
    assert bool(asks) == bool(events)
    return [(e.source, e.text) for e in events]


def changes(member, now, times, below=0.0):
    return events_of(member, now, links(times, below))


def neighbours(member):
    """Return the records of neighbours as the members write them."""
    records = allocate(NEIGHBOUR, 3, 4)
    member.write_neighbours(records)
    return records


def test_follower_learns_of_a_failure_by_message():
    member, _ = membership()
    assert changes(member, 11.0, measured(11.0)) == []
    assert changes(member, 12.1, measured(12.1, uav3=11.9)) == [
        ("uav1", "uav2 has failed"),
        ("uav2", "leaves the formation"),
    ]
    assert member.known.tolist() == [[False, False, True, False], [False] * 4, [False] * 4]
    assert changes(member, 12.2, measured(12.2)) == [("uav3", EXCLUDED)]
    # it stays known without further messages
    assert changes(member, 13.0, measured(12.2, uav3=np.nan)) == []
    assert member.known[:, 2].tolist() == [True, False, True]  # not of itself


def test_slot_is_taken_once_it_is_clear():
    member, _ = membership()
    changes(member, 12.1, measured(12.1))
    assert changes(member, 14.0, measured(14.0), below=9.9) == []
    assert np.array_equal(member.offsets, OFFSETS)
    assert changes(member, 15.0, measured(15.0), below=10.1) == [
        ("uav1", "uav2 has left its slot"),
        ("uav3", "uav2 has left its slot, takes the slot of uav2"),
    ]
    assert member.left.tolist() == [False, True, False]
    assert changes(member, 16.0, measured(16.0), below=0.0) == []  # it stays taken
    assert member.slots.tolist() == [1, 2, 2]


def test_positions_are_compared_at_their_measurement():
    """The leader's message is 0.5 s newer: its 10 m of path are not a distance from a slot."""
    member, _ = membership(clearance_m=5.0)
    times = measured(14.0)
    times[:, 0] = 14.5
    received = links(times)
    received["position_ned"][:, 0, 0] += 10.0
    texts = [text for _, text in events_of(member, 14.5, received)]
    assert texts == ["uav2 has failed", EXCLUDED, "leaves the formation"]


def test_slot_has_its_own_offset_and_gains():
    member, _ = membership()
    changes(member, 12.1, measured(12.1), below=20.0)
    written = neighbours(member)
    # uav3 holds the slot of uav2: leader gain 2, and 4 of the first slot
    assert written["gain"][2, :, 0].tolist() == [2.0, 4.0, 0.0, 0.0]
    assert np.array_equal(written["offset"][2], OFFSETS[[0, 1, 2, 2]])
    # uav1 keeps its slot, and uav2 knows of no failure
    assert written["gain"][0, :, 0].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert written["gain"][1, :, 0].tolist() == [2.0, 4.0, 0.0, 0.0]
    assert np.array_equal(member.offsets, OFFSETS[[0, 1, 2, 2]])
    assert written["excluded"].tolist() == [
        [False, False, True, False],
        [True] * 4,  # it has left the formation
        [False, False, True, False],
    ]


def test_without_reassignment_slots_are_kept():
    member, _ = membership(clearance_m=None)
    texts = [text for _, text in changes(member, 12.1, measured(12.1), below=20.0)]
    assert texts == ["uav2 has failed", EXCLUDED]
    assert neighbours(member)["gain"][2, :, 0].tolist() == [3.0, 0.0, 0.0, 0.0]
    assert np.array_equal(member.offsets, OFFSETS)


def test_failed_aircraft_stays_out_after_its_fault():
    member, faults = membership(duration_s=5.0)
    changes(member, 12.1, measured(12.1), below=20.0)
    step(faults, 15.0)
    assert changes(member, 15.1, measured(15.1), below=0.0) == []
    assert member.slots.tolist() == [1, 2, 2]


def test_leader_that_fails_stays_the_leader():
    faults = fault_manager(engine_out(10.0), row=0)
    step(faults, 10.0)
    member = FormationMembership(NAMES, OFFSETS, GAINS, faults, 10.0)
    assert changes(member, 13.0, measured(13.0)) == []
    assert not member.known.any()


def test_only_the_free_slot_of_two_is_taken():
    """uav1 leaves its slot and uav2 does not: uav3 takes the first slot."""
    faults = FaultManager(NAMES, [[], [engine_out(1.0)], [engine_out(1.0)], []], 0.0)
    step(faults, 1.0)
    member = FormationMembership(NAMES, OFFSETS, GAINS, faults, 10.0)
    received = links(measured(2.0))
    received["position_ned"][:, 1, 2] += 50.0
    events_of(member, 2.0, received)
    assert member.slots[2] == 1
    assert member.left.tolist() == [True, True, False]
