"""The command line, as a process of its own or, where that is not the point, in this one."""

import contextlib
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from patience import PATIENCE_S

from testbed.cli import main

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Done:
    """What a command said."""

    stdout: str
    stderr: str


def environment(columns, *folders):
    """Of a process that imports the testbed, and modules of these folders."""
    paths = os.pathsep.join(map(str, [ROOT, *folders]))
    return {**os.environ, "PYTHONPATH": paths, "COLUMNS": str(columns)}


def children(of):
    """Ids of the processes that a process has begun."""
    tasks = Path(f"/proc/{of}/task").glob("*/children")
    return [int(each) for task in tasks for each in task.read_text().split()]


def run_command(*arguments, cwd, code, columns):
    """What the command said; it ended with this code and without a traceback."""
    done = subprocess.run(
        [sys.executable, "-m", "testbed", *map(str, arguments)],
        cwd=cwd,
        env=environment(columns),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == code, done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    return done


def call_command(*arguments, cwd, code, columns):
    """The same in this process, which has imported everything and loaded the machine code."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        ended = call(arguments, cwd=cwd, columns=columns, out=out, err=err)
        for paper in (out, err):
            paper.seek(0)
        done = Done(out.read(), err.read())
    assert ended == code, done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    return done


def call(arguments, *, cwd, columns, out, err):
    """The exit code of a command that writes to two files."""
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ending,
    ):
        patch.chdir(cwd)
        patch.setenv("COLUMNS", str(columns))
        patch.setattr(sys, "argv", ["testbed", *map(str, arguments)])
        main()
    return ending.value.code or 0
