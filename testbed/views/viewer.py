"""Finding a Rerun viewer on this machine, or starting one that only this machine can reach."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

HOST = "127.0.0.1"
PROBE_S = 0.3
START_S = 20.0  # a first start on a slow machine


def listening(port: int) -> bool:
    """Whether something listens on the port."""
    try:
        with socket.create_connection((HOST, port), PROBE_S):
            return True
    except OSError:
        return False


def program() -> str | None:
    """The `rerun` program of this Python environment."""
    return shutil.which("rerun", path=str(Path(sys.executable).parent))


def obstacle(port: int) -> str | None:
    """Why no viewer can be had, or None if one is there or may be started."""
    if listening(port):
        return None
    if program() is None:
        return (
            f"there is no `rerun` program beside {sys.executable} and no viewer on "
            f"{HOST}:{port}. Install rerun-sdk, or save the view: `testbed view RUN --rrd FILE`."
        )
    if sys.platform == "linux" and not (
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    ):
        return (
            f"there is no display here and no viewer listens on {HOST}:{port}. Save the view with "
            "`testbed view RUN --rrd FILE` and open it elsewhere with `rerun FILE`."
        )
    return None


def start(port: int) -> bool:
    """Start a viewer that outlives this process, and wait until it listens.

    Returns:
        Whether it listens; False as soon as it gives up.
    """
    executable = program()
    if executable is None:
        return False
    viewer = subprocess.Popen(
        [executable, "--bind", HOST, "--port", str(port), "--hide-welcome-screen"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"RERUN_APP_ONLY": "true"},  # no questions on the terminal
        start_new_session=True,  # Ctrl-C ends the run, not the picture of it
    )
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline and viewer.poll() is None:
        if listening(port):
            return True
        time.sleep(0.1)
    return False
