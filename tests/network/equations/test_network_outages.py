"""Outages: which messages they lose, and their events."""

import numpy as np
import pytest

from testbed.network.links import PacketOutcome, resolve_links
from testbed.network.outages import OutageEvents, make_outages, scripted_outcomes
from testbed.scenario.network import Network

NAMES = ("leader", "uav1", "uav2", "uav3")
ALL_ROWS = np.arange(4)


def outages_of(network, names=NAMES):
    return make_outages(resolve_links(names, Network.model_validate(network)))


def at(outages, time, number=0):
    """Return the outcomes (n, N) of messages that all send at one time."""
    n, aircraft = outages.shape
    rows = np.arange(aircraft)
    return scripted_outcomes(outages, np.full(aircraft, time), rows, np.full(aircraft, number))


def links(*pairs):
    """Choose links (n, N) by name, sender first."""
    out = np.zeros((3, 4), dtype=bool)
    for source, destination in pairs:
        out[NAMES.index(destination) - 1, NAMES.index(source)] = True
    return out


OTHERS = links(
    *(
        (source, destination)
        for source in NAMES
        for destination in NAMES[1:]
        if source != destination
    )
)


def events_of(outages, times):
    events = OutageEvents(outages)
    return [
        (each.time_s, each.source, each.text) for time in times for each in events.changes(time)
    ]


def test_no_outages_lose_nothing_and_have_no_events():
    outages = outages_of({})
    assert not at(outages, 5.0).any()
    assert events_of(outages, [0.0, 1e9]) == []


@pytest.mark.parametrize(
    ("network", "outcome", "hit"),
    [
        ({"blackout_s": [[5, 6]]}, PacketOutcome.BLACKOUT, OTHERS),
        (
            {"links": {"leader": {"uav2": {"blackout_s": [[5, 6]]}}}},
            PacketOutcome.BLACKOUT,
            links(("leader", "uav2")),
        ),
        (
            {"blackout_s": [[5, 6]], "links": {"*": {"uav1": {"blackout_s": []}}}},
            PacketOutcome.BLACKOUT,
            OTHERS & ~links(("leader", "uav1"), ("uav2", "uav1"), ("uav3", "uav1")),
        ),
        (
            {"transmitter_off_s": {"uav2": [[5, 6]]}},
            PacketOutcome.MUTED,
            links(("uav2", "uav1"), ("uav2", "uav3")),
        ),
        (
            {"transmitter_off_s": {"leader": [[5, 6]]}},
            PacketOutcome.MUTED,
            links(("leader", "uav1"), ("leader", "uav2"), ("leader", "uav3")),
        ),
        (
            {"partitions": [{"window_s": [5, 6], "groups": [["leader", "uav1"]]}]},
            PacketOutcome.PARTITION,
            OTHERS & ~links(("leader", "uav1"), ("uav2", "uav3"), ("uav3", "uav2")),
        ),
        (
            {"partitions": [{"window_s": [5, 6], "groups": [["uav2"], ["leader", "uav1"]]}]},
            PacketOutcome.PARTITION,
            OTHERS & ~links(("leader", "uav1")),
        ),
    ],
)
def test_window_includes_its_begin_but_not_its_end(network, outcome, hit):
    outages = outages_of(network)
    for time in (5.0, 5.5, 5.999):
        assert np.array_equal(at(outages, time), np.where(hit, outcome, 0)), time
    for time in (4.999, 6.0, 7.0):
        assert not at(outages, time).any(), time


def test_window_tolerates_rounding_of_times():
    """0.3 is 0.1 + 0.1 + 0.1 in a scenario, if not in binary."""
    outages = outages_of({"blackout_s": [[0.3, 0.7]]})
    for time, dark in ((0.3 - 1e-16, True), (3 * 0.1, True), (0.7 - 1e-15, False), (0.7, False)):
        assert at(outages, time).any() == dark, time


def test_muted_comes_before_partition_and_blackout():
    outages = outages_of(
        {
            "transmitter_off_s": {"uav1": [[0, 10]]},
            "partitions": [{"window_s": [0, 10], "groups": [["uav2"]]}],
            "blackout_s": [[0, 10]],
            "drop": [0],
        }
    )
    outcome = at(outages, 1.0)
    assert set(outcome[:, 1]) == {0, PacketOutcome.MUTED}
    assert (outcome[1, [0, 3]] == PacketOutcome.PARTITION).all() and outcome[0, 2] == outcome[
        2, 2
    ] == PacketOutcome.PARTITION
    assert outcome[0, 0] == outcome[0, 3] == PacketOutcome.BLACKOUT
    assert np.array_equal(outcome != 0, OTHERS)


def test_drop_list_loses_exactly_its_packets():
    network = {
        "drop": [2],
        "links": {"leader": {"uav2": {"drop": [0, 5]}}, "uav3": {"*": {"drop": []}}},
    }
    outages = outages_of(network)
    own, blocked = links(("leader", "uav2")), links(("uav3", "uav1"), ("uav3", "uav2"))
    for number, hit in {
        0: own,
        1: own & ~own,
        2: OTHERS & ~own & ~blocked,
        5: own,
        6: own & ~own,
    }.items():
        assert np.array_equal(at(outages, 1.0, number), np.where(hit, PacketOutcome.LISTED, 0)), (
            number
        )
    each_its_own = scripted_outcomes(outages, np.ones(4), ALL_ROWS, np.array([5, 2, 2, 2]))
    hit = own | links(("uav1", "uav2"), ("uav1", "uav3"), ("uav2", "uav1"), ("uav2", "uav3"))
    assert np.array_equal(each_its_own, np.where(hit, PacketOutcome.LISTED, 0))


def test_single_senders_match_all_at_once():
    rng = np.random.default_rng(3)
    outages = outages_of(
        {
            "transmitter_off_s": {"uav1": [[2, 4], [7, 8]]},
            "partitions": [
                {"window_s": [3, 6], "groups": [["uav2"]]},
                {"window_s": [5, 9], "groups": [["leader"], ["uav1"]]},
            ],
            "blackout_s": [[1, 3]],
            "links": {"uav2": {"uav1": {"blackout_s": [[0, 9]], "drop": [1, 4, 9]}}},
        }
    )
    for _ in range(50):
        time, number = rng.uniform(0.0, 10.0, 4), rng.integers(0, 10, 4)
        together = scripted_outcomes(outages, time, ALL_ROWS, number)
        for m in ALL_ROWS:
            alone = scripted_outcomes(outages, time[[m]], np.array([m]), number[[m]])
            assert np.array_equal(alone[:, 0], together[:, m])


def test_events_at_begin_and_end_of_outages():
    outages = outages_of(
        {
            "transmitter_off_s": {"uav2": [[5, 6], [8, 12.5]]},
            "partitions": [{"window_s": [1, 2], "groups": [["leader", "uav1"]]}],
            "blackout_s": [[3, 4]],
            "links": {"leader": {"uav2": {"blackout_s": [[3, 4], [20, 30]]}}},
        }
    )
    assert events_of(outages, [0.5 * k for k in range(30)]) == [
        (1.0, "run", "partition leader uav1 | uav2 uav3 begins"),
        (2.0, "run", "partition leader uav1 | uav2 uav3 ends"),
        (3.0, "run", "blackout on all links begins"),
        (4.0, "run", "blackout on all links ends"),
        (5.0, "uav2", "transmitter off"),
        (6.0, "uav2", "transmitter on again"),
        (8.0, "uav2", "transmitter off"),
        (12.5, "uav2", "transmitter on again"),
    ]


@pytest.mark.parametrize(
    ("special", "words"),
    [
        ({"leader": {"uav2": ...}}, "from leader to uav2"),
        ({"leader": {"uav2": ..., "uav3": ...}}, "from leader to uav2 and uav3"),
        ({"leader": {"*": ...}}, "from leader to all"),
        ({"uav1": {"uav2": ..., "uav3": ...}}, "from uav1 to all"),
        (
            {"leader": {"uav1": ...}, "uav1": {"*": ...}},
            "from leader to uav1, from uav1 to all",
        ),
        ({"*": {"uav1": ...}}, "from leader to uav1, from uav2 to uav1, from uav3 to uav1"),
        (
            {"*": {"uav1": ...}, "uav1": {"uav3": ...}},
            "on 4 links of 4 aircraft",
        ),
        ({"*": {"*": ...}}, "on all links"),
    ],
)
def test_blackout_event_names_its_links(special, words):
    dark = {"blackout_s": [[1, 2]]}
    special = {m: dict.fromkeys(receivers, dark) for m, receivers in special.items()}
    (begins, _) = events_of(outages_of({"links": special}), [1.0, 2.0])
    assert begins[2] == f"blackout {words} begins"


def test_late_events_come_in_order():
    outages = outages_of({"transmitter_off_s": {"uav1": [[1, 2]]}, "blackout_s": [[1.5, 60]]})
    assert [text for _, _, text in events_of(outages, [10.0, 20.0])] == [
        "transmitter off",
        "blackout on all links begins",
        "transmitter on again",
    ]
