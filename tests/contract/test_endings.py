"""However a run ends, what it flew is in its log, and what went wrong is said in one line.

TESTBED_KILLS: how many runs are killed; each is a process of its own.
"""

import json
import os
import shutil

import pytest
from commands import call_command
from killing import LONGEST_S, PAGE, SECONDS, assert_same_beginning, hangar, kill, moments
from together import together

import testbed
from testbed.record.door import LogError
from testbed.record.read import read_log
from testbed.scenario import load, shorten
from testbed.sim.recover import recover

KILLS = int(os.environ.get("TESTBED_KILLS", "4"))
AT_ONCE = 10  # of them, by one test
SEED = 20261122
LOG, PAGE_FILE, METRICS = "run.mcap", "scenario.resolved.yaml", "metrics.json"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A flight that nobody disturbed."""
    out = tmp_path_factory.mktemp("whole") / "run"
    testbed.run(shorten(load(PAGE), SECONDS), out=out)
    return read_log(out / LOG)


@pytest.fixture(scope="module")
def ours():
    with hangar() as process:
        yield process


def errors(done):
    """What a command that failed said: one line."""
    lines = done.stderr.strip().splitlines()
    assert len([line for line in lines if line.startswith("error: ")]) == 1, done.stderr
    return lines[0]


def command(*arguments, cwd, code):
    return call_command(*arguments, cwd=cwd, code=code, columns=500)


@pytest.mark.parametrize("first", range(0, KILLS, AT_ONCE))
def test_a_run_that_is_killed_at_any_moment_is_recovered(first, whole, ours, tmp_path):
    """SIGKILL: half a second of the clock on the wall is missing at most, and no bit is wrong.

    That is promised of a machine that lets the run have its turns; see `GivenTime`.
    """
    for number, moment in enumerate([*moments(KILLS, SEED)][first : first + AT_ONCE], first):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert_recovered(moment, kill(ours, folder, moment), whole)
        shutil.rmtree(folder)


def assert_recovered(moment, run, whole):
    assert run.sockets == 0  # nobody asked for one
    try:
        before = read_log(run.out / LOG)
        frames = before.tick.size
    except LogError:
        frames = 0
    missing = run.missing_s(float(before.time_s[-1]) if frames else -1.0)
    facts = {"after": moment.after, "pace": moment.pace, "frames": frames, "missing_s": missing}
    print(json.dumps({**facts, "ended": run.ended}))  # pytest -rP shows it
    assert missing <= LONGEST_S
    if not frames:
        said = errors(command("recover", run.out, cwd=run.out.parent, code=2))
        assert "nothing was recorded" in said or not any(run.out.glob("*")), said
        return
    said = command("recover", run.out, cwd=run.out.parent, code=0).stdout
    assert f"{LOG}: {'is whole' if before.finished else 'finished'}" in said
    after = read_log(run.out / LOG)
    assert after.finished and after.tick.size == frames
    assert_same_beginning(after, whole)
    outcome = json.loads((run.out / METRICS).read_text())["outcome"]
    assert outcome == after.metrics["outcome"] == ("flown" if before.finished else "interrupted")
    assert (run.out / PAGE_FILE).read_text() == after.info.scenario_yaml
    assert load(run.out / PAGE_FILE).scenario.duration_s == moment.seconds


FLY = ("testbed", "run", PAGE, "--quiet")


def mounts(folder, options):
    """A small file system of its own there."""
    return ("sh", "-c", f"mkdir -p {folder} && mount -t tmpfs -o {options} tmpfs {folder}")


def fills(folder, after):
    """Something else that takes all the room there is, once a file is so large."""
    large = f'[ "$(stat -c %s {after} 2>/dev/null || echo 0)" -gt 200000 ]'
    return ("sh", "-c", f"until {large}; do sleep 0.02; done; cat /dev/zero > {folder}/other; true")


def kept(folder, into):
    """What is in it, for when it is gone with who mounted it."""
    return ("cp", "-r", folder, into)


def test_a_file_system_that_is_full_or_read_only_is_one_line_and_the_log_is_readable(tmp_path):
    disk, tiny, fixed = (tmp_path / name for name in ("disk", "tiny", "fixed"))
    alone, logged = ("--out", disk / "run"), ("--tlog", "--set=log.mcap=false")
    _, full, _, again, _, tlog, _, begun, _, new, empty, default, _ = together(
        tmp_path,
        [mounts(disk, "size=60m")],  # a whole log has room
        [(*FLY, *alone), fills(disk, disk / "run" / LOG)],
        [kept(disk / "run", "full")],
        [("testbed", "recover", disk / "run")],
        [("sh", "-c", f"rm -rf {disk}/*")],
        [(*FLY, *alone, *logged), fills(disk, disk / "run" / "run.tlog")],
        [mounts(tiny, "size=8k")],
        [(*FLY, "--out", tiny / "run", "--set=log.mcap=false", "--duration=2")],
        [("sh", "-c", f"mkdir -p {fixed} && mount -t tmpfs -o ro tmpfs {fixed}")],
        [(*FLY, "--out", fixed / "run")],
        [(*FLY, "--out", fixed)],
        [("cd", fixed, *FLY)],
        [("true",)],
        apart=True,
    )
    ((full, _), (again,), (tlog, _), (begun,), (new,), (empty,), (default,)) = (
        full, again, tlog, begun, new, empty, default
    )  # fmt: skip
    assert full.error == f"error: {disk}/run/{LOG}: cannot write the log: No space left on device"
    assert full.stderr.splitlines()[1:] == [f"log: {disk}/run"]
    log = read_log(tmp_path / "full" / LOG)
    assert log.tick.size > 100 and log.lost_bytes == 0 and not log.finished
    assert f"{disk}/run: " in again.error or LOG in again.error
    assert "No space left on device" in again.error
    assert tlog.error.endswith("run.tlog: cannot be written: No space left on device")
    assert begun.error.endswith(": No space left on device")
    for each, words in ((new, "cannot make the run directory"), (empty, "not writable")):
        assert f"{fixed}" in each.error and words in each.error, each.error
    assert "logs/simulation-3: cannot make the run directory: Read-only" in default.error
    assert {each.code for each in (full, again, tlog, begun, new, empty, default)} == {2}
    recovered = recover(tmp_path / "full")  # where there is room
    assert recovered.was_cut and read_log(recovered.log).tick.size == log.tick.size


def test_a_directory_that_vanishes_in_mid_flight_ends_the_run_with_its_name(tmp_path):
    """Rather than flying on for a log that nobody can find, and calling that a success."""
    large = '[ "$(stat -c %s run/run.mcap 2>/dev/null || echo 0)" -gt 200000 ]'
    deeds = [f"until {large}; do sleep 0.02; done; {deed}" for deed in ("rm -r run", "mv run away")]
    flight = (*FLY, "--out", "run", "--pace=20")
    pairs = together(tmp_path, *([flight, ("sh", "-c", deed)] for deed in deeds))
    for flown, _ in pairs:
        assert flown.code == 2
        assert flown.error == (
            f"error: run/{LOG}: the log is not there any more: run was removed or moved during the "
            "run"
        )
        assert flown.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()
    log = read_log(tmp_path / "away" / LOG)
    assert log.tick.size > 100 and log.time_s[-1] < 500.0  # of 1080


def test_runs_that_begin_at_the_same_moment_do_not_collide(tmp_path):
    """In one directory each has its own; of those that are given one place, one has it."""
    short = (*FLY, "--duration=0.2")
    rounds = 2
    free = [[(*short, f"--seed={k}") for k in (1, 2)]] * rounds
    bound = [
        [(*short, "--out", f"one-{number}", f"--seed={k}") for k in (1, 2)]
        for number in range(rounds)
    ]
    ended = together(tmp_path, *free, *bound)
    assert all(run.code == 0 for pair in ended[:rounds] for run in pair)
    found = [*(tmp_path / "logs" / PAGE).iterdir()]
    assert len(found) == 2 * rounds
    seeds = []
    for run in found:
        log, metrics = read_log(run / LOG), json.loads((run / METRICS).read_text())
        assert log.finished and log.info.seed == metrics["seed"]
        assert load(run / PAGE_FILE).scenario.seed == metrics["seed"]
        seeds.append(metrics["seed"])
    assert sorted(seeds) == [1] * rounds + [2] * rounds
    for number, pair in enumerate(ended[rounds:]):
        assert sorted(run.code for run in pair) == [0, 2], pair
        (winner,) = [k for k, run in enumerate(pair, 1) if run.code == 0]
        (refused,) = [run for run in pair if run.code == 2]
        assert f"--out one-{number}: " in refused.error
        assert "name a new or an empty directory" in refused.error
        run = tmp_path / f"one-{number}"
        assert {each.name for each in run.iterdir()} == {LOG, PAGE_FILE, METRICS}
        log = read_log(run / LOG)
        assert log.finished and log.info.seed == winner
        assert load(run / PAGE_FILE).scenario.seed == winner
        assert json.loads((run / METRICS).read_text())["seed"] == winner


def test_a_run_that_finds_anothers_page_in_its_directory_leaves_it_as_it_is(tmp_path, monkeypatch):
    """Both had found it empty."""
    run = tmp_path / "run"
    run.mkdir()
    (run / PAGE_FILE).write_text("another's")
    monkeypatch.setattr("testbed.sim.run.create_run_directory", lambda *_, **__: run)
    with pytest.raises(LogError, match="another run has just begun in it; name a new"):
        testbed.run(shorten(load(PAGE), 1.0), out=run)
    assert [each.name for each in run.iterdir()] == [PAGE_FILE]
    assert (run / PAGE_FILE).read_text() == "another's"
