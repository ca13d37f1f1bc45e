"""Commands of linear models with a law of the user: what they print, and what they refuse."""

import json
from pathlib import Path

import pytest
from cases import ALL, in_full
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from commands import call_command
from figure_texts import write_texts
from slow_control import RATES
from small_study import in_this_process
from user_laws import FILTERED

from testbed.linear import delay_flight, predicted_margins
from testbed.linear.delay_margin import delay_margins

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a law that also counts its steps."""
    folder = tmp_path_factory.mktemp("filtered")
    (folder / "law_filtered.py").write_text(FILTERED, "utf-8")
    law = 'controller: {law: "law_filtered:filtered"}'
    (folder / "own.yaml").write_text(f"extends: simulation-3\n{law}\n", "utf-8")
    return folder


def test_margins_name_the_memory_that_is_held(folder, monkeypatch):
    """In a line, and in JSON. Late messages are those of flights, as what it does is not known."""
    later = []

    def keep(maps, flights=None):
        later.append(flights)
        return delay_margins(maps, flights)

    monkeypatch.setattr(predicted_margins, "delay_margins", keep)
    words = ["margins", "own.yaml", "--bank", "0", "--jobs", "1", "--json", "m.json"]
    words += [word for each in RATES for word in ("--set", each)]
    with in_this_process():
        done = call_command(*words, cwd=folder, code=0, columns=80)
    assert "held, as whole numbers and flags have no derivatives: memory steps" in done.stdout
    [straight] = json.loads((folder / "m.json").read_text("utf-8"))["predicted"]
    assert straight["note"].endswith("memory steps") and not straight["problem"]
    roll = straight["followers"][0]["commands"]["roll"]
    assert not ALL or roll["latency_s"] == pytest.approx(0.92, abs=0.01)
    assert isinstance(later[0], predicted_margins._LaterMessages)


def test_delay_of_a_law_is_flown(folder, monkeypatch):
    """One row for each delay: the law receives messages as they are, and extrapolates them."""
    if not ALL:  # what settles for longer is of turns
        monkeypatch.setattr(delay_flight, "SETTLE_S", 100.0)
    write_texts(monkeypatch)
    words = ("delay", "own.yaml", "--delays", "0.2", "--json", "d.json", "--plot", "d.svg")
    with in_this_process():
        done = call_command(*words, cwd=folder, code=0, columns=80)
    assert "flown, because the equilibrium of a law of your own is not known" in done.stdout
    [row] = json.loads((folder / "d.json").read_text("utf-8"))["offsets"]
    assert row["extrapolate_from"] == "law" and row["predicted"] is None
    # as from the time of receipt: 22 m/s times 0.2 s behind
    assert row["flown"]["offset_m"]["uav1"]["forward"] == pytest.approx(-4.4, abs=0.1)
    assert "uav1, flown" in (folder / "d.svg").read_text("utf-8")


def test_class_is_refused_with_what_a_kernel_needs(tmp_path):
    """And with the method that measures it."""
    words = ("margins", "own-law-leader-follower", "--bank", "0")
    with in_this_process():
        done = call_command(*words, cwd=tmp_path, code=2, columns=400)
    assert "a law that is a Python class has a memory that is not known" in done.stderr
    assert "under @testbed.kernel that steps one follower, with its memory declared" in done.stderr
    assert "--method flown" in done.stderr


@in_full  # test_margins refuses a law that sends numbers, which is not compiled
def test_law_that_others_inform_is_refused(tmp_path):
    """Its messages carry numbers that the linear model does not have; flights measure it."""
    words = ("margins", EXAMPLES / "relayed-leader.yaml", "--bank", "0", "--set")
    perfect = "network.links={leader: {uav3: {loss: 0}}}"
    with in_this_process():
        done = call_command(*words, perfect, cwd=tmp_path, code=2, columns=400)
    assert "the law reads numbers that the laws of others send" in done.stderr
    assert "--method flown" in done.stderr


@in_full  # memory as a state: test_user_laws; flights of this kernel: test_law_outputs
def test_wrapped_built_in_law_has_its_margins(tmp_path):
    """An integral with a rate of zero changes nothing: the margins are those of the built-in law.

    The memory of the built-in law is then a state of the kernel.
    """
    found = []
    for scenario, options in (
        ("simulation-3", ()),
        (EXAMPLES / "integral-kernel.yaml", ("controller.options.rate_per_s=0",)),
    ):
        words = ["margins", scenario, "--bank", "0", "--jobs", "1", "--json", "m.json"]
        for each in options:
            words += ["--set", each]
        with in_this_process():
            call_command(*words, cwd=tmp_path, code=0, columns=80)
        [straight] = json.loads((tmp_path / "m.json").read_text("utf-8"))["predicted"]
        assert not straight["problem"]
        commands = [each["commands"] for each in straight["followers"]]
        found.append([one[c][k] for one in commands for c in one for k in ("gain", "latency_s")])
    assert found[0] == pytest.approx(found[1], rel=1e-4)
