"""Run a program while its starter lives: `python child_guard.py FOLDER PROGRAM ...`.

Standard input is a pipe whose other end only the starter holds: it closes when the starter ends,
also by SIGKILL. Then the folder is removed, if one is named, and the program and everything it
started are killed; all of them must be in the process group that this process leads.

Imports the standard library only, so that it starts quickly.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading


def kill_group_at_end_of_input(folder: str) -> None:
    """Wait until standard input closes, remove the folder and kill the process group."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    if folder:
        shutil.rmtree(folder, ignore_errors=True)
    os.killpg(os.getpid(), signal.SIGKILL)


def main(folder: str, *command: str) -> int:
    """Run a command; return its exit code."""
    program = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    threading.Thread(target=kill_group_at_end_of_input, args=(folder,), daemon=True).start()
    return program.wait()


if __name__ == "__main__":
    os._exit(main(*sys.argv[1:]) & 0xFF)
