"""Use MAVProxy as at a terminal: type a line, wait for a text."""

import os
import subprocess
from contextlib import contextmanager

from external_run import clients
from waiting import until

MODULES = "signing,wp,param,mode,arm,misc,rc,cmdlong"


class Terminal:
    """Input and output of a MAVProxy process."""

    def __init__(self, process, flight, output_file):
        self._process, self._flight, self._output_file = process, flight, output_file
        self._read = 0

    @property
    def output(self):
        return self._output_file.read_text()

    def type(self, line):
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def see(self, text):
        """Wait for a text after the last one seen."""

        def found():
            assert self._process.poll() is None, self.output
            assert self._flight.process.poll() is None, self._flight.output + self.output
            return text in self.output[self._read :]

        until(found, f"no {text!r}")
        self._read = self.output.index(text, self._read) + len(text)


@contextmanager
def start_mavproxy(folder, flight, master, *options):
    """Start MAVProxy with its state in this folder; the process ends with the block."""
    folder.mkdir(exist_ok=True)
    output_file = folder / "mavproxy.txt"
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
    with output_file.open("w") as file:
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
            yield Terminal(process, flight, output_file)
        finally:
            process.kill()  # it does not end by SIGTERM, and nothing that it writes is used
            process.wait()
            process.stdin.close()
