"""Messages and margins of an entry."""

import pytest
from tiny_benchmark import LIMITS, write_law, write_tasks

from testbed.benchmark import probes
from testbed.benchmark.entry import EntryLaw, open_law
from testbed.linear.flown_margins import directions
from testbed.linear.predicted_margins import predict_margins, worse_prediction
from testbed.scenario import load_scenario
from testbed.scenario.set_keys import SetKeys

BANKS_DEG = (0.0,)


@pytest.fixture(scope="module")
def tasks(tmp_path_factory):
    return write_tasks(tmp_path_factory.mktemp("benchmark") / "tiny")


@pytest.fixture(autouse=True)
def _one_bank(monkeypatch):
    monkeypatch.setattr(probes, "BANKS_DEG", BANKS_DEG)


def test_the_papers_law_needs_all_messages(tasks, monkeypatch):
    """Its margins are the least of all followers and commands, as `testbed margins` has them."""
    entry = ["controller.law=hbh23"]
    scenario = load_scenario(tasks / "four.yaml", entry).with_set_keys(SetKeys())
    turns = {each: predict_margins(scenario, each, 0.0) for each in directions(0.0)}
    expected = worse_prediction([*turns.values()])

    def predicted(of, bank_deg, *args):
        assert (of, args) == (scenario, (0.0,))
        return turns[bank_deg]

    monkeypatch.setattr(probes, "predict_margins", predicted)
    found = probes.probe_entry(EntryLaw("hbh23"), {}, folder=tasks, limits=LIMITS)
    assert found["messages"] == {"neighbours": True, "per_s": 75.0}
    commands = [each for of in expected.followers for each in of.commands.values()]
    (row,) = found["margins"]
    assert row["factor"] == min(each.gain for each in commands)
    assert row["latency_s"] == min(each.latency_s for each in commands)
    assert row["problem"] == ""


def test_a_law_that_reads_no_message_needs_the_leaders(tasks, tmp_path):
    """What a class remembers is not known, so there are no margins, with the reason."""
    law = open_law(write_law(tmp_path / "law.py"))
    found = probes.probe_entry(law, {}, folder=tasks, limits=LIMITS)
    assert found["messages"] == {"neighbours": False, "per_s": 25.0}
    (row,) = found["margins"]
    assert (row["damping"], row["factor"]) == (None, None)
    assert "not predicted" in row["problem"]


def test_a_law_that_fails_has_neither(tasks, tmp_path):
    law = open_law(write_law(tmp_path / "law.py", top="raise ValueError('no')"))
    found = probes.probe_entry(law, {}, folder=tasks, limits=LIMITS)
    assert found["messages"] is None
    assert found["margins"][0]["factor"] is None
