"""Runs a program for as long as whoever started it lives: `python tether.py FOLDER PROGRAM ...`.

Standard input is a pipe, and only the starter holds its other end: the pipe closes when the starter
is gone, however that came about, even by SIGKILL. Then the folder is removed, if one is named, and
the program is killed with everything that it has started, which has to be in the process group that
this process leads.

Standard library alone, and no other module of the testbed: it starts in a moment.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading


def wait_for_the_end(folder: str) -> None:
    """Return never: the process group is killed when standard input closes."""
    while os.read(sys.stdin.fileno(), 4096):
        pass
    if folder:
        shutil.rmtree(folder, ignore_errors=True)
    os.killpg(os.getpid(), signal.SIGKILL)


def main(folder: str, *command: str) -> int:
    """Run a command; its exit code."""
    program = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    threading.Thread(target=wait_for_the_end, args=(folder,), daemon=True).start()
    return program.wait()


if __name__ == "__main__":
    os._exit(main(*sys.argv[1:]) & 0xFF)
