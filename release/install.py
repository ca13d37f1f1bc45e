"""Run pip with a line of progress that fits into 80 columns.

usage: python release/install.py LOCK PYTHON -m pip install …

Shows how many of the lock file's packages pip has fetched and installed, and for how long, in one
line that is redrawn; not on a terminal, in lines ten seconds apart. If pip fails, the end of its
own output is printed, and its exit code returned.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path

WIDTH = 79
KEPT_LINES = 40  # of pip's output, for an error
REDRAW_S, LINE_S = 0.2, 10.0  # between updates on a terminal, and between lines elsewhere
PIN = re.compile(r"^[A-Za-z0-9][\w.-]*==", re.MULTILINE)
WHEEL = re.compile(r"(?:Downloading|Using cached) ([\w.]+)-\S+\.(?:whl|tar\.gz) \((.*)\)")


class PipProgress:
    """What pip is doing, from the lines that it prints."""

    def __init__(self, total: int, packages: Path) -> None:
        """Start before the first line.

        Args:
            total: packages of the lock file.
            packages: folder in which they are installed.
        """
        self.total, self._packages = total, packages
        self._fetched, self._wheel, self._installing = 0, "", False
        self._before = self._count()

    def read(self, line: str) -> None:
        """Take a line of pip's output."""
        if line.startswith("Ignoring "):  # for another system or Python
            self.total -= 1
        elif line.startswith(("Collecting ", "Processing ", "Requirement already satisfied")):
            self._fetched, self._wheel = self._fetched + 1, ""
        elif found := WHEEL.search(line):
            self._wheel = f"{found[1]}, {found[2]}"
        elif line.startswith("Installing collected packages"):
            self._installing, self._before = True, self._count()

    def text(self) -> str:
        """Return what is done, in words."""
        if not self._installing:
            return f"fetched {self._fetched} of {self.total}  {self._wheel}"
        return f"installed {self._count() - self._before} of {self.total} packages"

    def _count(self) -> int:
        return sum(1 for _ in self._packages.glob("*.dist-info"))


def shown_line(text: str, elapsed_s: float) -> str:
    """Return a line of progress, cut to the width."""
    return f"  {elapsed_s:4.0f} s  {text}"[:WIDTH]


def show(progress: PipProgress, begin: float, ended: threading.Event) -> None:
    """Show progress on standard error until the event is set."""
    terminal = sys.stderr.isatty()
    while not ended.wait(REDRAW_S if terminal else LINE_S):
        line = shown_line(progress.text(), time.monotonic() - begin)
        sys.stderr.write(f"\r{line:<{WIDTH}}" if terminal else f"{line}\n")
        sys.stderr.flush()
    if terminal:
        sys.stderr.write(f"\r{'':<{WIDTH}}\r")
        sys.stderr.flush()


def run(progress: PipProgress, command: list[str]) -> int:
    """Run pip; return its exit code."""
    begin, ended, last = time.monotonic(), threading.Event(), deque[str](maxlen=KEPT_LINES)
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    ) as pip:
        watcher = threading.Thread(target=show, args=(progress, begin, ended), daemon=True)
        watcher.start()
        try:
            lines: Iterable[str] = pip.stdout or ()
            for line in lines:
                last.append(line)
                progress.read(line)
            code = pip.wait()
        except KeyboardInterrupt:
            pip.wait()  # which Ctrl-C has reached, too
            code = 130
        finally:
            ended.set()
            watcher.join()
    if code == 0:
        print(f"  {progress.total} packages in {time.monotonic() - begin:.0f} s", file=sys.stderr)
    elif code != 130:
        sys.stderr.writelines(last)
    return code


def main(lock: str, *command: str) -> int:
    """Install the packages of a lock file by a command of pip; return its exit code."""
    python = Path(command[0]).absolute().parent.parent
    found = list(python.glob("lib/python*/site-packages")) or [python]
    total = len(PIN.findall(Path(lock).read_text(encoding="utf-8")))
    return run(PipProgress(total, found[0]), [*command, "--progress-bar", "off"])


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
