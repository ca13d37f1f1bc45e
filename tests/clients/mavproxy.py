"""MAVProxy as a person at a terminal uses it: a line is typed, and something is waited for."""

import os
import subprocess
from contextlib import contextmanager

from outside_run import clients
from patience import until

MODULES = "signing,wp,param,mode,arm,misc,rc,cmdlong"


class Terminal:
    """What was typed and what was said."""

    def __init__(self, process, flight, paper):
        self._process, self._flight, self._paper = process, flight, paper
        self._read = 0

    @property
    def said(self):
        return self._paper.read_text()

    def type(self, line):
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def see(self, text):
        """Wait for something that was not there at the last look."""

        def seen():
            assert self._process.poll() is None, self.said
            assert self._flight.process.poll() is None, self._flight.said + self.said
            return text in self.said[self._read :]

        until(seen, f"no {text!r}")
        self._read = self.said.index(text, self._read) + len(text)


@contextmanager
def mavproxy(folder, flight, master, *options):
    """MAVProxy, with its state in this folder; it is over when the block is left."""
    folder.mkdir(exist_ok=True)
    paper = folder / "mavproxy.txt"
    bin = clients()
    command = [
        bin / "python",
        "-u",
        bin / "mavproxy.py",
        f"--master={master}",
        f"--default-modules={MODULES}",
        f"--state-basedir={folder}",
        "--target-system=1",
        "--source-system=245",
        *options,
    ]
    with paper.open("w") as file:
        process = subprocess.Popen(
            list(map(str, command)),
            cwd=folder,
            env={**os.environ, "HOME": str(folder), "TERM": "dumb"},
            stdin=subprocess.PIPE,
            stdout=file,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            yield Terminal(process, flight, paper)
        finally:
            process.terminate()
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdin.close()
