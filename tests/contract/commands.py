"""The command line as a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def environment(columns):
    return {**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": str(columns)}


def run_command(*arguments, cwd, code, columns):
    """What the command said; it ended with this code and without a traceback."""
    done = subprocess.run(
        [sys.executable, "-m", "testbed", *map(str, arguments)],
        cwd=cwd,
        env=environment(columns),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == code, done.stderr + done.stdout
    assert "Traceback" not in done.stderr
    return done
