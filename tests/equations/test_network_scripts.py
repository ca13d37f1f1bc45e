"""What is written down to go wrong: which messages it takes, and what the log says of it."""

import numpy as np
import pytest

from testbed.network.links import Fate
from testbed.network.scripts import Calendar, blocked, make_scripts
from testbed.scenario.network import Network

NAMES = ("leader", "uav1", "uav2", "uav3")
EVERYONE = np.arange(4)


def scripts_of(network, names=NAMES):
    return make_scripts(names, Network.model_validate(network))


def at(scripts, time, number=0):
    """Fates (n, N) of a round sent at one time."""
    n, aircraft = scripts.shape
    everyone = np.arange(aircraft)
    return blocked(scripts, np.full(aircraft, time), everyone, np.full(aircraft, number))


def links(*pairs):
    """A table (n, N) of links by name, sender first."""
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


def told(scripts, times):
    calendar = Calendar(scripts)
    return [
        (each.time_s, each.source, each.text) for time in times for each in calendar.changes(time)
    ]


def test_without_a_script_nothing_is_taken_and_nothing_said():
    scripts = scripts_of({})
    assert not at(scripts, 5.0).any()
    assert told(scripts, [0.0, 1e9]) == []


@pytest.mark.parametrize(
    ("network", "fate", "hit"),
    [
        ({"blackout_s": [[5, 6]]}, Fate.BLACKOUT, OTHERS),
        (
            {"links": {"leader": {"uav2": {"blackout_s": [[5, 6]]}}}},
            Fate.BLACKOUT,
            links(("leader", "uav2")),
        ),
        (
            {"blackout_s": [[5, 6]], "links": {"*": {"uav1": {"blackout_s": []}}}},
            Fate.BLACKOUT,
            OTHERS & ~links(("leader", "uav1"), ("uav2", "uav1"), ("uav3", "uav1")),
        ),
        (
            {"mute_s": {"uav2": [[5, 6]]}},
            Fate.MUTE,
            links(("uav2", "uav1"), ("uav2", "uav3")),
        ),
        (
            {"mute_s": {"leader": [[5, 6]]}},
            Fate.MUTE,
            links(("leader", "uav1"), ("leader", "uav2"), ("leader", "uav3")),
        ),
        (
            {"partitions": [{"window_s": [5, 6], "groups": [["leader", "uav1"]]}]},
            Fate.PARTITION,
            OTHERS & ~links(("leader", "uav1"), ("uav2", "uav3"), ("uav3", "uav2")),
        ),
        (
            {"partitions": [{"window_s": [5, 6], "groups": [["uav2"], ["leader", "uav1"]]}]},
            Fate.PARTITION,
            OTHERS & ~links(("leader", "uav1")),
        ),
    ],
)
def test_a_window_takes_what_is_sent_from_its_begin_to_before_its_end(network, fate, hit):
    scripts = scripts_of(network)
    for time in (5.0, 5.5, 5.999):
        assert np.array_equal(at(scripts, time), np.where(hit, fate, 0)), time
    for time in (4.999, 6.0, 7.0):
        assert not at(scripts, time).any(), time


def test_a_tick_that_rounding_moved_is_still_the_same_moment():
    """0.3 is 0.1 + 0.1 + 0.1 on a page, if not in binary."""
    scripts = scripts_of({"blackout_s": [[0.3, 0.7]]})
    for time, dark in ((0.3 - 1e-16, True), (3 * 0.1, True), (0.7 - 1e-15, False), (0.7, False)):
        assert at(scripts, time).any() == dark, time


def test_who_is_mute_does_not_send_into_a_divided_or_dark_network():
    scripts = scripts_of(
        {
            "mute_s": {"uav1": [[0, 10]]},
            "partitions": [{"window_s": [0, 10], "groups": [["uav2"]]}],
            "blackout_s": [[0, 10]],
            "drop": [0],
        }
    )
    fate = at(scripts, 1.0)
    assert set(fate[:, 1]) == {0, Fate.MUTE}
    assert (fate[1, [0, 3]] == Fate.PARTITION).all() and fate[0, 2] == fate[2, 2] == Fate.PARTITION
    assert fate[0, 0] == fate[0, 3] == Fate.BLACKOUT
    assert np.array_equal(fate != 0, OTHERS)


def test_a_list_takes_these_packets_of_these_links_and_no_others():
    network = {
        "drop": [2],
        "links": {"leader": {"uav2": {"drop": [0, 5]}}, "uav3": {"*": {"drop": []}}},
    }
    scripts = scripts_of(network)
    own, silent = links(("leader", "uav2")), links(("uav3", "uav1"), ("uav3", "uav2"))
    for number, hit in {
        0: own,
        1: own & ~own,
        2: OTHERS & ~own & ~silent,
        5: own,
        6: own & ~own,
    }.items():
        assert np.array_equal(at(scripts, 1.0, number), np.where(hit, Fate.LISTED, 0)), number
    each_its_own = blocked(scripts, np.ones(4), EVERYONE, np.array([5, 2, 2, 2]))
    hit = own | links(("uav1", "uav2"), ("uav1", "uav3"), ("uav2", "uav1"), ("uav2", "uav3"))
    assert np.array_equal(each_its_own, np.where(hit, Fate.LISTED, 0))


def test_one_sender_at_a_time_meets_what_all_at_once_would():
    rng = np.random.default_rng(3)
    scripts = scripts_of(
        {
            "mute_s": {"uav1": [[2, 4], [7, 8]]},
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
        together = blocked(scripts, time, EVERYONE, number)
        for m in EVERYONE:
            alone = blocked(scripts, time[[m]], np.array([m]), number[[m]])
            assert np.array_equal(alone[:, 0], together[:, m])


def test_the_log_says_what_begins_and_what_ends():
    scripts = scripts_of(
        {
            "mute_s": {"uav2": [[5, 6], [8, 12.5]]},
            "partitions": [{"window_s": [1, 2], "groups": [["leader", "uav1"]]}],
            "blackout_s": [[3, 4]],
            "links": {"leader": {"uav2": {"blackout_s": [[3, 4], [20, 30]]}}},
        }
    )
    assert told(scripts, [0.5 * k for k in range(30)]) == [
        (1.0, "run", "the network is divided: leader uav1 | uav2 uav3"),
        (2.0, "run", "no longer divided: leader uav1 | uav2 uav3"),
        (3.0, "run", "blackout on all links begins"),
        (4.0, "run", "blackout on all links ends"),
        (5.0, "uav2", "is mute"),
        (6.0, "uav2", "is no longer mute"),
        (8.0, "uav2", "is mute"),
        (12.5, "uav2", "is no longer mute"),
    ]


@pytest.mark.parametrize(
    ("special", "words"),
    [
        ({"leader": {"uav2": ...}}, "from leader to uav2"),
        ({"leader": {"uav2": ..., "uav3": ...}}, "from leader to uav2 and uav3"),
        ({"leader": {"*": ...}}, "from leader to everyone"),
        ({"uav1": {"uav2": ..., "uav3": ...}}, "from uav1 to everyone"),
        (
            {"leader": {"uav1": ...}, "uav1": {"*": ...}},
            "from leader to uav1, from uav1 to everyone",
        ),
        ({"*": {"uav1": ...}}, "from leader to uav1, from uav2 to uav1, from uav3 to uav1"),
        (
            {"*": {"uav1": ...}, "uav1": {"uav3": ...}},
            "on 4 links of 4 aircraft",
        ),
        ({"*": {"*": ...}}, "on all links"),
    ],
)
def test_a_blackout_says_where_it_is(special, words):
    dark = {"blackout_s": [[1, 2]]}
    special = {m: dict.fromkeys(receivers, dark) for m, receivers in special.items()}
    (begins, _) = told(scripts_of({"links": special}), [1.0, 2.0])
    assert begins[2] == f"blackout {words} begins"


def test_what_was_missed_is_told_late_and_in_order():
    scripts = scripts_of({"mute_s": {"uav1": [[1, 2]]}, "blackout_s": [[1.5, 60]]})
    assert [text for _, _, text in told(scripts, [10.0, 20.0])] == [
        "is mute",
        "blackout on all links begins",
        "is no longer mute",
    ]
