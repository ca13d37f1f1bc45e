"""Commands that start at the same time, forked from a process that has imported everything."""

import json
import os
import signal
import sys
import tempfile
from dataclasses import dataclass

import pytest
from commands import environment
from forked import Forked
from fresh import NOT_MOUNTED, leave_mounts
from waiting import TIMEOUT_S


def work():
    """Run the groups of commands of this process's first argument, and print their exit codes.

    With a second argument, other processes do not see what the commands mount.
    """
    from testbed.cli.main import main

    plan, *apart = sys.argv[1:]
    if apart and leave_mounts():
        sys.exit(NOT_MOUNTED)
    codes = []
    for number, group in enumerate(json.loads(plan)):
        ready, begin = os.pipe()
        children = []
        for k, (program, *arguments) in enumerate(group):
            children.append(os.fork())
            if not children[-1]:
                for stream in (1, 2):
                    output = os.open(f"output-{number}-{k}-{stream}", os.O_WRONLY | os.O_CREAT)
                    os.dup2(output, stream)
                os.close(begin)  # the commands of a group start when the pipe is closed
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
    print(json.dumps(codes), flush=True)


@dataclass(frozen=True)
class Ended:
    """Exit code and output of a command."""

    code: int
    stdout: str
    stderr: str

    @property
    def error(self):
        """The one line that begins with `error: `."""
        assert "Traceback" not in self.stderr, self.stderr
        (line,) = [each for each in self.stderr.splitlines() if each.startswith("error: ")]
        return line


def together(folder, *groups, apart=False):
    """Results of the commands of each group; a group starts when the previous one has ended.

    With `apart`, file systems that they mount are invisible to other processes and end with them.
    """
    plan = json.dumps([[list(map(str, command)) for command in group] for group in groups])
    with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
        process = Forked(
            *("together:work", plan, *(["apart"] if apart else [])),
            cwd=folder,
            env=environment(500),
            stdout=output,
            stderr=errors,
        )
        try:
            code = process.wait(TIMEOUT_S)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
        for each in (output, errors):
            each.seek(0)
        if code == NOT_MOUNTED:
            pytest.skip("nothing can be mounted here, neither as root nor in a user namespace")
        return _ended(folder, code, output.read(), errors.read())


def _ended(folder, code, stdout, stderr):
    assert code == 0, stderr
    return [
        [
            Ended(code, *((folder / f"output-{k}-{i}-{stream}").read_text() for stream in (1, 2)))
            for i, code in enumerate(codes)
        ]
        for k, codes in enumerate(json.loads(stdout.splitlines()[-1]))
    ]
