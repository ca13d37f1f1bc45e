"""Run commands in a child process, or in this process, which has imported everything."""

import contextlib
import os
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from places import ROOT
from snapshot import check_snapshot
from waiting import TIMEOUT_S

from testbed.cli.main import main

WRONG = ROOT / "tests" / "data" / "wrong_commands"
# Runs the commands of its arguments, one after the other, and prints their exit codes.
SEVERAL = """
import sys
from testbed.cli.main import main
for words in sys.argv[1:]:
    sys.argv = ["testbed", *words.split()]
    try:
        main()
    except SystemExit as ending:
        print("exit", ending.code, words, file=sys.stderr, flush=True)
"""
LONG, DIGITS = "n" * 300, "9" * 400  # stand for {long} and {digits}


@dataclass(frozen=True)
class Done:
    """Output of a command."""

    stdout: str
    stderr: str


def environment(columns, *folders):
    """Environment of a process that imports the testbed and modules of these folders."""
    paths = os.pathsep.join(map(str, [ROOT, *folders]))
    return {**os.environ, "PYTHONPATH": paths, "COLUMNS": str(columns)}


def children(of):
    """Ids of the child processes of a process."""
    tasks = Path(f"/proc/{of}/task").glob("*/children")
    return [int(each) for task in tasks for each in task.read_text().split()]


def run_command(*arguments, cwd, code, columns):
    """Output of a command in a child process; it must exit with this code, without traceback."""
    done = subprocess.run(
        [sys.executable, "-m", "testbed", *map(str, arguments)],
        cwd=cwd,
        env=environment(columns),
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )
    assert done.returncode == code, done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    return done


def call_command(*arguments, cwd, code, columns):
    """As `run_command`, in this process."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        exit_code = call(arguments, cwd=cwd, columns=columns, out=out, err=err)
        for file in (out, err):
            file.seek(0)
        done = Done(out.read(), err.read())
    assert exit_code == code, (exit_code, done.stderr + done.stdout)
    assert "Traceback" not in done.stderr
    return done


def refuse_all(name, cwd):
    """Run each line of tests/data/wrong_commands/<name>.txt: exit code 2, and nothing written.

    The errors are those of a snapshot.
    """
    before, blocks = times_of_files(cwd), []
    for line in (WRONG / f"{name}.txt").read_text("utf-8").splitlines():
        words = shlex.split(line.replace("{long}", LONG).replace("{digits}", DIGITS))
        error = call_command(*words, cwd=cwd, code=2, columns=200).stderr
        assert times_of_files(cwd) == before, line
        short = error.replace(f"{cwd}", ".").replace(LONG, "{long}").replace(DIGITS, "{digits}")
        rows = [each for each in short.splitlines() if each.startswith("error: ")]
        assert len(rows) == ("Usage: " not in short), error
        blocks += [f"$ testbed {line}", *(each[:200] for each in rows or short.splitlines()), ""]
    check_snapshot(f"wrong_commands_{name}", "\n".join(blocks))


def times_of_files(folder):
    """Return the time of the last write of every file and folder below a folder."""
    found = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*")}
    return {name: path.lstat().st_mtime_ns for name, path in found.items()}


def call(arguments, *, cwd, columns, out, err):
    """Exit code of a command that writes to two files."""
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as ending,
    ):
        patch.chdir(cwd)
        patch.setenv("COLUMNS", str(columns))
        patch.setattr(sys, "argv", ["testbed", *map(str, arguments)])
        # as the script of the same name; `python -m pytest` would have click print its own name
        patch.setattr(sys.modules["__main__"], "__package__", None)
        main()
    return ending.value.code or 0
