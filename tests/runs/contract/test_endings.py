"""Logs and errors of runs that are killed, that cannot write, or that share a directory.

TESTBED_KILLS: number of runs that are killed, and of runs that get two signals, each in its own
process.
"""

import csv
import json
import os
import re
import shutil
import signal

import golden_scenarios
import numpy as np
import pytest
from commands import call_command
from killing import (
    MAX_MISSING_S,
    SCENARIO,
    SECONDS,
    Moment,
    assert_same_beginning,
    interrupt,
    kill,
    kill_command,
    moments,
    process_starter,
    signal_pairs,
    start_run,
)
from small_study import in_this_process
from together import together
from waiting import until

import testbed
from testbed.golden.golden_table import read_table
from testbed.logs.file_record import RECORD_NAME
from testbed.logs.mcap_file import LogError
from testbed.logs.read import read_log
from testbed.runs.recover import recover
from testbed.scenario import load_scenario, set_duration

KILLS = int(os.environ.get("TESTBED_KILLS", "4"))
PER_TEST = 10
OTHERS = max(1, KILLS // 20)  # kills of each other command, and pairs of simultaneous runs
SEED = 20261122
LOG, SCENARIO_FILE, METRICS = "run.mcap", "scenario.resolved.yaml", "metrics.json"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Log of a run without interruption."""
    out = tmp_path_factory.mktemp("whole") / "run"
    testbed.run(set_duration(load_scenario(SCENARIO), SECONDS), out=out)
    return read_log(out / LOG)


@pytest.fixture(scope="module")
def starter():
    with process_starter() as process:
        yield process


@pytest.mark.parametrize("first", range(0, KILLS, PER_TEST))
def test_two_signals_leave_complete_metrics(first, whole, starter, tmp_path):
    """The second one comes 0.2 to 50 ms after the first."""
    without = []
    for number, pair in enumerate([*signal_pairs(KILLS, SEED)][first : first + PER_TEST], first):
        folder = tmp_path / str(number)
        folder.mkdir()
        code = interrupt(starter, folder, pair)
        # a signal after the files are written, while Python ends, may kill the process
        ended = code in (0, 130, -signal.SIGINT, -signal.SIGTERM)
        if not ended or not has_complete_metrics(folder / "run", whole):
            without.append((pair, code))
        shutil.rmtree(folder)
    print(f"{len(without)} without metrics")  # pytest -rP shows it
    assert not without


def has_complete_metrics(run, whole):
    """Return whether a run has a finished log, and metrics in it and beside it."""
    if not (run / METRICS).exists():
        return False
    log, metrics = read_log(run / LOG), json.loads((run / METRICS).read_text())
    if log.tick.size:
        assert_same_beginning(log, whole)
    wall_clock = dict.fromkeys(("wall_s", "real_time_factor"))
    assert log.finished and log.metrics == metrics | wall_clock
    assert metrics["outcome"] in ("interrupted", "completed")
    return True


def test_run_in_flight_is_not_recovered(whole, starter, tmp_path):
    """Its log is locked until it ends, or is killed."""
    process = start_run(starter, tmp_path, Moment("log", 0.0, pace=1.0))
    try:
        until(lambda: samples_of(tmp_path / "run") > 10)
        error = errors(command("recover", tmp_path / "run", cwd=tmp_path, code=2))
        assert f"run/{LOG}: this run is still flying" in error
        with pytest.raises(LogError, match="still flying"):
            recover(tmp_path / "run")
        assert not read_log(tmp_path / "run" / LOG).finished
        until(lambda: not [*tmp_path.joinpath("run").glob(".*.part")], "a folder was left")
    finally:
        os.kill(process, signal.SIGKILL)
        assert int(starter.stdout.readline()) == -signal.SIGKILL
    assert recover(tmp_path / "run").was_cut
    assert_same_beginning(read_log(tmp_path / "run" / LOG), whole)


def samples_of(run):
    """Return the number of samples that can be read from a log."""
    try:
        return read_log(run / LOG).tick.size
    except LogError:
        return 0


def errors(done):
    """The one line that a failed command printed."""
    lines = done.stderr.strip().splitlines()
    assert len([line for line in lines if line.startswith("error: ")]) == 1, done.stderr
    return lines[0]


def command(*arguments, cwd, code):
    return call_command(*arguments, cwd=cwd, code=code, columns=500)


@pytest.mark.parametrize("first", range(0, KILLS, PER_TEST))
def test_run_killed_at_any_moment_is_recovered(first, whole, starter, tmp_path):
    """At most half a second of the running time (`ProcessTime`) is missing from the log."""
    for number, moment in enumerate([*moments(KILLS, SEED)][first : first + PER_TEST], first):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert_recovered(moment, kill(starter, folder, moment), whole)
        shutil.rmtree(folder)


def assert_recovered(moment, run, whole):
    assert run.sockets == 0
    try:
        before = read_log(run.out / LOG)
        samples = before.tick.size
    except LogError:
        samples = 0
    missing = run.missing_s(float(before.time_s[-1]) if samples else -1.0)
    facts = {"after": moment.after, "pace": moment.pace, "samples": samples, "missing_s": missing}
    print(json.dumps({**facts, "ended": run.ended}))  # pytest -rP shows it
    assert missing <= MAX_MISSING_S
    if not samples:
        error = errors(command("recover", run.out, cwd=run.out.parent, code=2))
        assert "nothing was recorded" in error or not any(run.out.glob("*")), error
        return
    printed = command("recover", run.out, cwd=run.out.parent, code=0).stdout
    assert f"{LOG}: {'complete' if before.finished else 'finished'}" in printed
    after = read_log(run.out / LOG)
    assert after.finished and after.tick.size == samples
    assert_same_beginning(after, whole)
    outcome = json.loads((run.out / METRICS).read_text())["outcome"]
    assert (
        outcome == after.metrics["outcome"] == ("completed" if before.finished else "interrupted")
    )
    assert (run.out / SCENARIO_FILE).read_text() == after.info.scenario_yaml
    assert load_scenario(run.out / SCENARIO_FILE).scenario.duration_s == moment.seconds


FLY = ("testbed", "run", SCENARIO, "--quiet")


def mounts(folder, options):
    """Command that mounts a small file system."""
    return ("sh", "-c", f"mkdir -p {folder} && mount -t tmpfs -o {options} tmpfs {folder}")


def fills(folder, after):
    """Command that fills a disk once a file is larger than 200 kB."""
    large = f'[ "$(stat -c %s {after} 2>/dev/null || echo 0)" -gt 200000 ]'
    return ("sh", "-c", f"until {large}; do sleep 0.02; done; cat /dev/zero > {folder}/other; true")


def copy(folder, into):
    """Command that copies a folder from a file system that ends with its process."""
    return ("cp", "-r", folder, into)


def test_full_or_read_only_disk_is_one_error_line(tmp_path):
    disk, tiny, fixed = (tmp_path / name for name in ("disk", "tiny", "fixed"))
    out, tlog_only = ("--out", disk / "run"), ("--tlog", "--set=log.mcap=false")
    _, full, _, again, _, tlog, _, begun, _, new, empty, default, _ = together(
        tmp_path,
        [mounts(disk, "size=60m")],  # enough for the log alone
        [(*FLY, *out), fills(disk, disk / "run" / LOG)],
        [copy(disk / "run", "full")],
        [("testbed", "recover", disk / "run")],
        [("sh", "-c", f"rm -rf {disk}/*")],
        [(*FLY, *out, *tlog_only), fills(disk, disk / "run" / "run.tlog")],
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
    recovered = recover(tmp_path / "full")  # on a disk with free space
    assert recovered.was_cut and read_log(recovered.log).tick.size == log.tick.size


def test_removed_run_directory_ends_the_run(tmp_path):
    large = '[ "$(stat -c %s run/run.mcap 2>/dev/null || echo 0)" -gt 200000 ]'
    commands = [f"until {large}; do sleep 0.02; done; {c}" for c in ("rm -r run", "mv run away")]
    flight = (*FLY, "--out", "run", "--pace=20")
    pairs = together(tmp_path, *([flight, ("sh", "-c", each)] for each in commands))
    for result, _ in pairs:
        assert result.code == 2
        assert result.error == (
            f"error: run/{LOG}: the log is not there any more: run was removed or moved during the "
            "run"
        )
        assert result.stderr.count("\n") == 1
    assert not (tmp_path / "run").exists()
    log = read_log(tmp_path / "away" / LOG)
    assert log.tick.size > 100 and log.time_s[-1] < 500.0  # of 1080


def test_simultaneous_runs_use_separate_directories(tmp_path):
    """With the same --out one of them runs, and the other is refused."""
    short = (*FLY, "--duration=0.2")
    free = [[(*short, f"--seed={k}") for k in (1, 2)]] * OTHERS
    bound = [
        [(*short, "--out", f"one-{number}", f"--seed={k}") for k in (1, 2)]
        for number in range(OTHERS)
    ]
    ended = together(tmp_path, *free, *bound)
    assert all(run.code == 0 for pair in ended[:OTHERS] for run in pair)
    found = [*(tmp_path / "logs" / SCENARIO).iterdir()]
    assert len(found) == 2 * OTHERS
    seeds = []
    for run in found:
        log, metrics = read_log(run / LOG), json.loads((run / METRICS).read_text())
        assert log.finished and log.info.seed == metrics["seed"]
        assert load_scenario(run / SCENARIO_FILE).scenario.seed == metrics["seed"]
        seeds.append(metrics["seed"])
    assert sorted(seeds) == [1] * OTHERS + [2] * OTHERS
    for number, pair in enumerate(ended[OTHERS:]):
        assert sorted(run.code for run in pair) == [0, 2], pair
        (winner,) = [k for k, run in enumerate(pair, 1) if run.code == 0]
        (refused,) = [run for run in pair if run.code == 2]
        assert f"one-{number}: " in refused.error
        assert "name a new or an empty directory" in refused.error
        run = tmp_path / f"one-{number}"
        assert {each.name for each in run.iterdir()} == {LOG, SCENARIO_FILE, METRICS, RECORD_NAME}
        log = read_log(run / LOG)
        assert log.finished and log.info.seed == winner
        assert load_scenario(run / SCENARIO_FILE).scenario.seed == winner
        assert json.loads((run / METRICS).read_text())["seed"] == winner


def test_run_keeps_the_scenario_of_another_run(tmp_path, monkeypatch):
    """Both have found the directory empty before."""
    run = tmp_path / "run"
    run.mkdir()
    (run / SCENARIO_FILE).write_text("of another run")
    monkeypatch.setattr("testbed.runs.run.create_run_directory", lambda *_, **__: run)
    with pytest.raises(LogError, match="another run has just begun in it; name a new"):
        testbed.run(set_duration(load_scenario(SCENARIO), 1.0), out=run)
    assert [each.name for each in run.iterdir()] == [SCENARIO_FILE]
    assert (run / SCENARIO_FILE).read_text() == "of another run"


SEARCH = """
study: {schema: 1, name: small, scenario: ideal-figure-eight, duration_s: 1, seeds: [1]}
gains: {formation.k: {from: 1, to: 5}, formation.a: {from: 1, to: 5}}
objective: {metric: windows.approach.mean_rms_m, aggregate: mean}
search: {max_flights: 400, population: 4, held_out_seeds: [7, 8, 9]}
"""
UPDATE = ("check", "checked.yaml", "--update", "--reason", "new", "--seeds", "3", "--jobs", "1")


@pytest.mark.parametrize("number", range(OTHERS))
def test_killed_tune_leaves_whole_files(number, tmp_path):
    """Also its scenario is absent, or has the gains of the file beside it; another run goes on."""
    (tmp_path / "search.yaml").write_text(SEARCH)
    search = ("tune", "search.yaml", "--jobs", "1", "--out")
    out = tmp_path / "killed"
    moment_s = np.random.default_rng([SEED, number]).uniform(0.0, 2.0)
    kill_command((*search, out), tmp_path, (out / "candidates.csv").exists, moment_s)
    lines = (out / "candidates.csv").read_text().split("\n")
    assert lines.pop() == "" and len({line.count(",") for line in lines}) == 1
    for name in {"tuned.yaml"} & {each.name for each in out.iterdir()}:
        cost = re.search(r"over its flights is ([\d.e-]+)", (out / name).read_text())[1]
        best = min(csv.DictReader(lines), key=lambda row: float(row["cost"]))
        tuned = load_scenario(out / name)
        assert float(cost) >= float(f"{float(best['cost']):.4g}")
        assert any(float(row["formation.k"]) == tuned.formation.k for row in csv.DictReader(lines))
    (tmp_path / "search.yaml").write_text(SEARCH.replace("400", "9"))
    with in_this_process():
        command(*search, tmp_path / "again", cwd=tmp_path, code=0)
    assert (tmp_path / "again/result.json").exists()


@pytest.mark.parametrize("number", range(OTHERS))
def test_killed_check_leaves_the_old_table_or_the_new(number, tmp_path):
    golden_scenarios.write(tmp_path, "checked")
    table = tmp_path / "golden/checked.json"
    moment_s = np.random.default_rng([SEED, 1, number]).uniform(0.0, 2.5)
    kill_command(UPDATE, tmp_path, lambda: True, moment_s)
    if table.exists():
        read_table(table)
    with in_this_process():
        command(*UPDATE, cwd=tmp_path, code=0)
    read_table(table)
    assert [each.name for each in table.parent.iterdir()] == [table.name]
