"""Commands at the same moment, each a process of its own, forked from one that has all loaded."""

import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass

import pytest
from commands import environment
from patience import PATIENCE_S

# A pipe that closes is the shot at which all of a group begin.
_FORKING = """
import json, os, sys
import testbed
from testbed.cli import main
from testbed.scenario import load, shorten

testbed.run(shorten(load("simulation-3"), 0.1), write=False)  # loads what flights need
codes = []
for number, group in enumerate(json.loads(sys.argv[1])):
    ready, begin = os.pipe()
    children = []
    for k, (program, *arguments) in enumerate(group):
        children.append(os.fork())
        if not children[-1]:
            for stream in (1, 2):
                said = os.open(f"said-{number}-{k}-{stream}", os.O_WRONLY | os.O_CREAT)
                os.dup2(said, stream)
            os.close(begin)
            os.read(ready, 1)
            if program == "cd":
                folder, program, *arguments = arguments
                os.chdir(folder)
            if program != "testbed":
                os.execvp(program, [program, *arguments])
            sys.argv = [program, *arguments]
            main()
            sys.exit()
    os.close(begin)
    os.close(ready)
    codes.append([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children])
print(json.dumps(codes))
"""


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    code: int
    stdout: str
    stderr: str

    @property
    def error(self):
        """The one line it said of what went wrong."""
        assert "Traceback" not in self.stderr, self.stderr
        (line,) = [each for each in self.stderr.splitlines() if each.startswith("error: ")]
        return line


def together(folder, *groups, apart=False):
    """How the commands of each group ended; a group begins when the one before is over.

    With `apart`, what they mount is theirs alone and gone with them; where the system allows it.
    """
    mine = ["unshare", "--mount", *(["--user", "--map-root-user"] if os.geteuid() else [])]
    if apart:
        tried = [*mine, "mount", "-t", "tmpfs", "tmpfs", "/mnt"]
        if shutil.which("unshare") is None or subprocess.run(tried, capture_output=True).returncode:
            pytest.skip("nothing can be mounted here, neither as root nor in a user's namespace")
    plan = json.dumps([[list(map(str, command)) for command in group] for group in groups])
    with subprocess.Popen(
        [*(mine if apart else []), sys.executable, "-c", _FORKING, plan],
        cwd=folder,
        env=environment(500),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            told, said = process.communicate(timeout=PATIENCE_S)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 0, said
    return [
        [
            Ended(code, *((folder / f"said-{k}-{i}-{stream}").read_text() for stream in (1, 2)))
            for i, code in enumerate(codes)
        ]
        for k, codes in enumerate(json.loads(told.splitlines()[-1]))
    ]
