"""However a run ends, what it flew is in its log, and what went wrong is said in one line.

TESTBED_KILLS: how many runs are killed; each is a process of its own.
"""

import json
import os

import pytest
from commands import call_command
from killing import LONGEST_S, PAGE, SECONDS, assert_same_beginning, kill, moments

import testbed
from testbed.record.door import LogError
from testbed.record.read import read_log
from testbed.scenario import load, shorten

KILLS = int(os.environ.get("TESTBED_KILLS", "4"))
SEED = 20261122
LOG, PAGE_FILE, METRICS = "run.mcap", "scenario.resolved.yaml", "metrics.json"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A flight that nobody disturbed."""
    out = tmp_path_factory.mktemp("whole") / "run"
    testbed.run(shorten(load(PAGE), SECONDS), out=out)
    return out, read_log(out / LOG)


def errors(done):
    """What a command that failed said: one line."""
    lines = done.stderr.strip().splitlines()
    assert len([line for line in lines if line.startswith("error: ")]) == 1, done.stderr
    return lines[0]


def command(*arguments, cwd, code):
    return call_command(*arguments, cwd=cwd, code=code, columns=500)


@pytest.mark.parametrize("number", range(KILLS))
def test_a_run_that_is_killed_at_any_moment_is_recovered(number, whole, tmp_path, record_property):
    """SIGKILL: half a second of the clock on the wall is missing at most, and no bit is wrong."""
    moment = [*moments(KILLS, SEED)][number]
    run = kill(tmp_path, moment)
    assert run.sockets == 0  # nobody asked for one
    try:
        before = read_log(run.out / LOG)
        frames = before.tick.size
    except LogError as error:
        assert not run.notes or run.missing_s(-1.0) <= LONGEST_S, str(error)
        frames = 0
    missing = run.missing_s(float(before.time_s[-1]) if frames else -1.0)
    facts = {"after": moment.after, "pace": moment.pace, "frames": frames, "missing_s": missing}
    record_property("killed", json.dumps({**facts, "ended": run.ended}))
    assert missing <= LONGEST_S
    if not frames:
        said = errors(command("recover", run.out, cwd=tmp_path, code=2))
        assert "nothing was recorded" in said or not any(run.out.glob("*")), said
        return
    said = command("recover", run.out, cwd=tmp_path, code=0).stdout
    assert f"{LOG}: {'is whole' if before.finished else 'finished'}" in said
    after = read_log(run.out / LOG)
    assert after.finished and after.tick.size == frames
    assert_same_beginning(after, whole[1])
    outcome = json.loads((run.out / METRICS).read_text())["outcome"]
    assert outcome == after.metrics["outcome"] == ("flown" if before.finished else "interrupted")
    assert (run.out / PAGE_FILE).read_text() == after.info.scenario_yaml
    assert load(run.out / PAGE_FILE).scenario.duration_s == moment.seconds
