"""Events of followers that receive no messages of their leader, or of a neighbour."""

from math import nan

import numpy as np
import pytest

from testbed.core.flags import LimiterFlag
from testbed.core.records import FOLLOWER, LINK, allocate
from testbed.flight.monitors import (
    LEADER_WATCH,
    LINK_WATCH,
    LinkMonitor,
    check_leaders,
    check_links,
)
from testbed.formation.hbh23 import NEIGHBOUR
from testbed.network.link_statistics import initial_statistics

NAMES = ("leader", "uav1", "uav2", "uav3")
LEADER_TIMEOUT = int(LimiterFlag.LEADER_TIMEOUT)
ALL = np.arange(3)
LEFT_OUT, HELD = ", left out", ", held at its relative position"


class Links:
    """The links of three followers: uav2 uses messages of uav1, uav3 those of uav2, or all use all.

    Neighbours time out after 2 s, the leader after `leader_timeout_s`.
    """

    def __init__(self, *, leader_timeout_s=5.0, uses_all=False, **law):
        self.followers, self.links = allocate(FOLLOWER, 3), allocate(LINK, 3, 4)
        self.neighbours = allocate(NEIGHBOUR, 3, 4)
        self.neighbours["used"][:, 0] = True
        self.neighbours["used"][[1, 2], [1, 2]] = True
        self.neighbours["used"] |= uses_all
        self.neighbours["held_time_s"] = nan
        self.links["age_s"], self.links["received_s"] = nan, 0.0
        self.statistics = initial_statistics(3, 4)
        self.monitor = LinkMonitor(
            NAMES,
            self.neighbours,
            (self.followers, self.links),
            self.statistics,
            (leader_timeout_s, 2.0),
            **{"builtin": True, "hold": False, **law},
        )

    def leader_events(self, now, *flags):
        self.followers["limiter_flags"] = flags
        events = self.monitor.leader_changes(now) if self.monitor.leader_call(now) else ()
        return [(e.level, e.source) for e in events]

    def neighbour_changes(self, now, rows=ALL):
        found = self.monitor.neighbour_call(np.array(rows))(now)
        return self.monitor.neighbour_changes(now) if found else ()

    def neighbour_events(self, now, *, uav2=None, uav3=None, rows=ALL):
        """All messages arrive now, but for uav1's at uav2, and uav2's at uav3."""
        self.links["received_s"] = now
        self.links["received_s"][1, 1] = now if uav2 is None else uav2
        self.links["received_s"][2, 2] = now if uav3 is None else uav3
        return [(e.level, e.source, e.text) for e in self.neighbour_changes(now, rows)]


def test_leader_timeouts_begin_and_end_with_events():
    links = Links()
    assert links.leader_events(0.0, 0, 0, 0) == []
    assert links.leader_events(1.0, 7, 0, 1) == []  # other flags
    begun = [("warning", "uav1"), ("warning", "uav2")]
    assert links.leader_events(2.0, LEADER_TIMEOUT, LEADER_TIMEOUT | 4, 0) == begun
    assert links.leader_events(3.0, LEADER_TIMEOUT, LEADER_TIMEOUT, 0) == []
    assert links.leader_events(3.5, LEADER_TIMEOUT | 1, LEADER_TIMEOUT, 2) == []
    changed = [("info", "uav2"), ("warning", "uav3")]
    assert links.leader_events(4.0, LEADER_TIMEOUT, 0, LEADER_TIMEOUT) == changed
    assert links.leader_events(5.0, 0, 0, 0) == [("info", "uav1"), ("info", "uav3")]
    assert links.leader_events(6.0, 0, 0, 0) == []
    assert links.leader_events(7.0, 0, LEADER_TIMEOUT, 0) == [("warning", "uav2")]


def test_a_first_leader_message_may_take_the_timeout():
    links = Links()
    assert links.leader_events(0.0, LEADER_TIMEOUT, LEADER_TIMEOUT, 0) == []
    assert links.leader_events(0.1, 0, LEADER_TIMEOUT, 0) == []
    assert links.leader_events(4.9, LEADER_TIMEOUT, LEADER_TIMEOUT, 0) == [("warning", "uav1")]
    begun = [("info", "uav1"), ("warning", "uav2")]
    assert links.leader_events(5.0, 0, LEADER_TIMEOUT, 0) == begun


def test_followers_that_have_left_have_no_timeouts():
    links = Links(uses_all=True)
    links.monitor.set_left(np.array([False, True, False]))
    assert links.leader_events(6.0, 0, LEADER_TIMEOUT, 0) == []
    links = Links()
    assert len(links.neighbour_events(3.0, uav2=0.5, uav3=0.5)) == 2
    links.monitor.set_left(np.array([False, True, False]))
    assert [source for _, source, _ in links.neighbour_events(3.1)] == ["uav3"]


@pytest.mark.parametrize(("hold", "response"), [(False, LEFT_OUT), (True, HELD)])
def test_neighbour_timeouts_begin_and_end_with_events(hold, response):
    links = Links(hold=hold)
    links.neighbours["held_time_s"] = 0.0
    assert links.neighbour_events(1.0) == []
    # exactly the timeout is not too old, as in the law
    assert links.neighbour_events(3.0, uav2=1.0, uav3=1.0) == []
    text = f"neighbour timeout: no messages of uav1{response}"
    assert links.neighbour_events(3.01, uav2=1.0) == [("warning", "uav2", text)]
    assert links.neighbour_events(3.05, uav2=1.0) == []
    assert links.neighbour_events(9.0, uav2=8.5, uav3=5.0) == [
        ("info", "uav2", "receives uav1 again"),
        ("warning", "uav3", f"neighbour timeout: no messages of uav2{response}"),
    ]
    assert links.neighbour_events(9.1) == [("info", "uav3", "receives uav2 again")]
    assert links.neighbour_events(12.0, uav2=9.9) == [("warning", "uav2", text)]


def test_a_neighbour_never_received_is_left_out():
    links = Links(hold=True)
    assert links.neighbour_events(0.0, uav2=nan, uav3=nan) == []
    assert links.neighbour_events(2.0, uav2=nan) == []
    text = f"neighbour timeout: no messages of uav1{LEFT_OUT}"
    assert links.neighbour_events(2.1, uav2=nan) == [("warning", "uav2", text)]
    assert links.neighbour_events(2.2) == [("info", "uav2", "receives uav1 again")]


def test_timeouts_are_found_when_their_follower_steps():
    links = Links()
    late = {"uav2": 0.5, "uav3": 0.5}
    assert [source for _, source, _ in links.neighbour_events(3.0, **late, rows=[1])] == ["uav2"]
    found = links.neighbour_events(3.01, **late, rows=[0, 2])
    assert [source for _, source, _ in found] == ["uav3"]
    assert links.neighbour_events(3.02, rows=[0]) == []
    assert [source for _, source, _ in links.neighbour_events(3.03, rows=[2])] == ["uav3"]
    assert [source for _, source, _ in links.neighbour_events(3.04, rows=[1])] == ["uav2"]


def test_response_of_an_own_law_is_unknown():
    links = Links(uses_all=True, builtin=False)
    links.links["received_s"] = 3.0
    links.links["received_s"][0] = 0.5
    events = links.neighbour_changes(3.0)
    assert [(e.source, e.text) for e in events] == [
        ("uav1", "neighbour timeout: no messages of uav2"),
        ("uav1", "neighbour timeout: no messages of uav3"),
    ]


def test_check_links_matches_reference():
    rng = np.random.default_rng(11)
    links, watches = allocate(LINK, 3, 4), allocate(LINK_WATCH, 3, 4)
    statistics = initial_statistics(3, 4)
    watches["watched"] = rng.random((3, 4)) < 0.7
    uses, age_sum, seen = np.zeros((3, 4), dtype=int), np.zeros((3, 4)), set()
    for now in rng.uniform(0.0, 8.0, 400):
        rows = np.flatnonzero(rng.random(3) < 0.6)
        lost = rng.random((2, 3, 4)) < 0.2
        received, age = np.where(lost, nan, rng.uniform(0.0, 3.0, (2, 3, 4)))
        links["received_s"], links["age_s"] = now - received, age
        watches["reported"] = reported = rng.random((3, 4)) < 0.1
        late = np.array(watches["late"])
        too_old = now - np.fmax(links["received_s"], 0.0) > 2.0
        late[rows] = (watches["watched"] & too_old)[rows]
        expected = (late != reported)[rows].any()
        assert check_links(statistics, links, watches, 2.0, rows, now) == expected
        assert np.array_equal(watches["late"], late)
        uses[rows] += ~np.isnan(age[rows])
        age_sum[rows] += np.nan_to_num(age[rows])
        seen.add(bool(expected))
    assert seen == {False, True}
    assert np.array_equal(statistics["uses"], uses)
    np.testing.assert_allclose(statistics["age_sum"], age_sum, rtol=1e-12)


def test_check_leaders_matches_reference():
    rng = np.random.default_rng(12)
    followers, leaders, seen = allocate(FOLLOWER, 3), allocate(LEADER_WATCH, 3), set()
    for now in rng.uniform(0.0, 8.0, 400):
        followers["limiter_flags"] = flags = rng.integers(0, 256, 3) & [15, 247, 247]
        for name in ("waiting", "reported", "left"):
            leaders[name] = rng.random(3) < 0.3
        late = (flags & LEADER_TIMEOUT != 0) & ~leaders["left"]
        waiting = leaders["waiting"] & late & (now < 5.0)
        late &= ~waiting
        expected = (late != leaders["reported"]).any()
        assert check_leaders(followers, leaders, 5.0, now) == expected
        assert np.array_equal(leaders["waiting"], waiting)
        assert np.array_equal(leaders["late"], late)
        seen.add((bool(expected), bool(waiting.any()), bool(late.any())))
    assert len(seen) >= 6
