"""Pipes in place of the files that commands read: no command waits for their other end."""

import os
import tempfile

import pytest
from cases import ALL, some
from commands import call
from record_flight import run_info
from waiting import TIMEOUT_S
from written_runs import synthetic, time_limit

from testbed.logs.file_record import RECORD_NAME, TAIL_NAME, record_files
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.reports import figures

COMMANDS = (
    ("list", "--runs", "logs"),
    ("list", "--runs", "logs", "--json=-"),
    ("prune", "logs", "--keep=1"),
    ("report", "{run}"),
    ("report", "{run}/run.mcap", "--out=it.html"),
    ("export", "{run}", "--format=csv"),
    ("export", "{run}/run.mcap", "--format=npz", "--out=it.npz"),
    ("compare", "{run}", "whole", "--numbers"),
    ("compare", "{run}", "whole", "--rrd=it.rrd"),
    ("view", "{run}", "--rrd=it.rrd"),
    ("recover", "{run}"),
    ("recover", "{run}/run.mcap"),
    ("study-report", "{run}"),
    ("validate", "{run}/scenario.resolved.yaml"),
    ("sweep", "{run}/scenario.resolved.yaml"),
    ("tune", "{run}/scenario.resolved.yaml"),
    ("prune", "logs", "--keep=1", "--yes"),
    ("prune", "logs", "--size=0kB", "--yes"),
)
# They draw, after they have read the run as `compare` does: for some of the pipes only.
DRAWING = {("compare", "{run}", "whole", "--rrd=it.rrd"), ("view", "{run}", "--rrd=it.rrd")}
PIPES = (
    *(LOG_NAME, METRICS_NAME, SCENARIO_NAME, RECORD_NAME, TAIL_NAME),
    *some(("law.py", "report.html", "run.csv", "study.parquet"), 2),
)


def run_with_pipe(folder, name, monkeypatch):
    """A run, cut short if the pipe is in place of what completes it, beside a whole one."""
    monkeypatch.setattr(figures, "MAKERS", ())
    run = folder / "logs" / "near" / "20260101T000000Z-0001"
    run.parent.mkdir(parents=True)
    for each in (run, folder / "whole"):
        synthetic(each, ended=each != run or name not in (METRICS_NAME, TAIL_NAME))
        (each / SCENARIO_NAME).write_text(run_info().scenario_yaml)
        record_files(each, LOG_NAME, SCENARIO_NAME)
    (run / name).unlink(missing_ok=True)
    os.mkfifo(run / name)
    return run


def outcome(words, folder, run):
    """Exit code and output of a command that ends in time."""
    arguments = [each.format(run=run.relative_to(folder)) for each in words]
    with tempfile.TemporaryFile("w+") as file:
        with time_limit(TIMEOUT_S):
            code = call(arguments, cwd=folder, columns=200, out=file, err=file)
        file.seek(0)
        return code, file.read()


@pytest.mark.parametrize("name", PIPES)
def test_no_command_waits_for_a_pipe(tmp_path, monkeypatch, name):
    run = run_with_pipe(tmp_path, name, monkeypatch)
    for words in COMMANDS:
        if words in DRAWING and not (ALL or name in (LOG_NAME, METRICS_NAME)):
            continue
        code, text = outcome(words, tmp_path, run)
        assert code in (0, 2, 3) and "Traceback" not in text, (words, code, text)
    assert (run / name).is_fifo()  # and the run with it
