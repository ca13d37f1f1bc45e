"""`controller.safety` in flights: what it refuses, leaves alone, tells, and does for every law."""

from pathlib import Path

import numpy as np
import pytest
from commands import call_command

import testbed
from testbed.scenario import find_scenario

WRAPPED = '''"""The built-in law as a class of a user's."""


class Wrapped:
    def __init__(self, config):
        self.law = config.hbh23

    def start(self, own):
        return self.law.start(own)

    def step(self, now, own, inbox, memory):
        return self.law.step(now, own, inbox, memory)
'''
EXAMPLES = Path(__file__).parents[3] / "examples"
# the built-in law as a class and as a kernel, whose integral has a rate of zero
LAWS = {
    "class": ("controller.law={}/wrapped_class.py:Wrapped",),
    "kernel": (
        f"controller.law={EXAMPLES}/integral_kernel.py:integral_action",
        "controller.options.rate_per_s=0",
    ),
}
# they begin behind each other's slots
CROSS = ("fleet.uav2.start_m=[-20, 8, -2]", "fleet.uav1.start_m=[-20, -8, 0]")
STAMPS = "controller.extrapolate_from=timestamp"
BARRIER = "controller.safety={{kind: barrier, separation_m: {}, margin_m: {}}}".format


def positions(flight):
    return [flight[f"state_position_{axis}_m"] for axis in ("north", "east", "down")]


@pytest.fixture
def fly(tmp_path):
    return Flights(tmp_path)


class Flights:
    """Flies to a folder and reads the log."""

    def __init__(self, folder):
        self.folder, self.count = folder, 0

    def __call__(self, *settings, duration_s=12.0):
        self.count += 1
        out = self.folder / f"run{self.count}"
        testbed.run("simulation-3-wide", settings, duration_s=duration_s, out=out)
        return testbed.load_run(out)


@pytest.fixture(scope="module")
def crossed(tmp_path_factory):
    return Flights(tmp_path_factory.mktemp("crossed"))(*CROSS)


def refused(tmp_path, *words):
    return call_command("validate", *words, cwd=tmp_path, code=2, columns=200).stderr


@pytest.mark.parametrize(
    ("settings", "text", "remedy"),
    [
        (
            (STAMPS, BARRIER(6, 3.5)),
            "the slots of leader and uav1 are 7.071 m apart, less than separation_m + margin_m, "
            "6 + 3.5 m",
            (STAMPS, BARRIER(4, 2)),
        ),
        (
            (BARRIER(4, 2),),
            "write controller.extrapolate_from: timestamp",
            (STAMPS, BARRIER(4, 2)),
        ),
        (
            (STAMPS, BARRIER(4, 2), "controller.law=leader_follower:LeaderFollower"),
            "LeaderFollower commands fly-by-wire A",
            (STAMPS, "controller.law=leader_follower:LeaderFollower"),
        ),
    ],
)
def test_refusals_have_a_remedy(tmp_path, settings, text, remedy):
    words = [word for each in settings for word in ("--set", each)]
    assert text in " ".join(refused(tmp_path, "simulation-3", *words).split())
    words = [word for each in remedy for word in ("--set", each)]
    call_command("validate", "simulation-3", *words, cwd=tmp_path, code=0, columns=200)


def test_filter_that_never_acts_changes_no_bit(fly):
    off, on = fly("controller.safety=null"), fly(BARRIER(0.2, 0))
    for a, b in zip(positions(off), positions(on), strict=True):
        np.testing.assert_array_equal(a, b)


def test_filter_acts_where_followers_cross(crossed, fly):
    """And says so: in events, in the log's bits and in the metrics."""
    off = fly(*CROSS, "controller.safety=null")
    assert crossed.metrics["min_separation_m"] > 6.0
    assert crossed.metrics["min_separation_m"] > off.metrics["min_separation_m"] + 1.0
    limited = crossed.flags("formation_limiter_bits")["closing_limited"]
    assert limited.any()
    counted = crossed.metrics["limiter_flags"]["uav1"]["by_kind"]["closing_limited"]
    assert counted == limited[:, 1].sum() > 0
    texts = [each.text for each in crossed.events if "separation filter" in each.text]
    assert any("closing is limited" in each for each in texts)


@pytest.mark.parametrize("kind", LAWS)
def test_laws_of_users_fly_behind_it_as_the_built_in(tmp_path, crossed, fly, kind):
    (tmp_path / "wrapped_class.py").write_text(WRAPPED)
    flown = fly(*CROSS, *(each.format(tmp_path) for each in LAWS[kind]))
    for ours, theirs in zip(positions(crossed), positions(flown), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_used_margin_names_the_roll_of_the_leader(fly):
    """The slots are 0.5 m outside the margin, and the first corner is at 29 s."""
    flown = fly(duration_s=31.0)
    [text] = [each.text for each in flown.events if "less than separation_m" in each.text][:1]
    assert "from leader, less than separation_m + margin_m, 9.5 m" in text
    assert "while the leader rolls at" in text


def test_shipped_scenario_keeps_its_separation(fly):
    assert find_scenario("simulation-3-wide").is_file()
    assert fly(duration_s=100.0).metrics["min_separation_m"] > 6.0
