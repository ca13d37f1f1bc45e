"""Run a program while its starter lives: `python child_guard.py FOLDER PROGRAM ...`.

Standard input is a pipe whose other end only the starter holds: it closes when the starter ends,
also by SIGKILL. Then the folder is removed, if one is named, and the program and everything it
started are killed; all of them must be in the process group that this process leads.

Ends as the program does: with its exit code, or by its signal. SIGTERM is left to the program.
Imports the standard library only, so that it starts quickly.
"""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

CANNOT_START = 126  # exit code, as in shells


def guard_command(folder: Path | str, command: list[str]) -> list[str]:
    """Return the command that runs a command and ends it with the calling process.

    Start it with a pipe as standard input and `start_new_session`.

    Args:
        folder: removed if the caller is killed; empty: none.
        command: the program and its arguments.
    """
    return [sys.executable, "-I", "-S", __file__, str(folder), *command]


def kill_group_at_end_of_input(folder: str) -> None:
    """Wait until standard input closes, remove the folder and kill the process group."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    if folder:
        shutil.rmtree(folder, ignore_errors=True)
    os.killpg(os.getpid(), signal.SIGKILL)


def end_by_signal(number: int) -> None:
    """End this process by a signal, without a core file."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(OSError):  # SIGKILL has no handler
        signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


def main(folder: str, *command: str) -> int:
    """Run a command; return its exit code."""
    signal.signal(signal.SIGTERM, lambda *_: None)  # the program has the default again
    try:
        program = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    except OSError as error:
        print(f"{command[0]}: cannot be started: {error.strerror}", file=sys.stderr, flush=True)
        return CANNOT_START
    threading.Thread(target=kill_group_at_end_of_input, args=(folder,), daemon=True).start()
    code = program.wait()
    if code < 0:
        end_by_signal(-code)
    return code


if __name__ == "__main__":
    os._exit(main(*sys.argv[1:]) & 0xFF)
