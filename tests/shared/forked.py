"""Processes forked from one that has imported everything and flown, as starting Python takes long.

Only for claims about what a process does, not about how it starts.
"""

import atexit
import gc
import importlib
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from functools import cache

from commands import environment
from places import SHARED
from waiting import TIMEOUT_S

STARTER = "import forked, sys; forked.serve(int(sys.argv[1]))"
MOST_BYTES = 1 << 20  # of a request
STEP_S = 0.005


def load():
    """Import the commands, and fly, which loads what flights need.

    A process that ends collects none of it: that took several times as long as a command.
    """
    from testbed.cli.main import main  # noqa: F401 - for the processes
    from testbed.runs.run import run
    from testbed.scenario import load_scenario, set_duration

    run(set_duration(load_scenario("simulation-3"), 0.1), write=False)
    gc.collect()
    gc.freeze()


def serve(number):
    """Fork a process for each request that arrives at a socket, until it is closed.

    Args:
        number: of the socket's file.
    """
    load()
    line = socket.socket(fileno=number)
    while True:
        data, files, *_ = socket.recv_fds(line, MOST_BYTES, 3)
        if not data:
            return
        process, *request = json.loads(data)
        if request and not (process := os.fork()):
            line.close()
            _become(*request, files)
        for each in files:
            os.close(each)
        ended = None
        if not request:
            found, status = os.waitpid(process, os.WNOHANG)
            ended = os.waitstatus_to_exitcode(status) if found else None
        line.send(json.dumps([process, ended]).encode())


def _become(function, arguments, folder, variables, files):
    """Call a function, with exit code and error output of a Python process, and end."""
    os.setsid()
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(variables)
    for to, file in enumerate(files):
        os.dup2(file, to)
        os.close(file)
    module, _, name = function.partition(":")
    sys.argv = ["testbed", *arguments]
    getattr(importlib.import_module(module), name)()
    sys.exit()


def execute():
    """Execute the program that is the first argument, as the main module."""
    exec(sys.argv[1], sys.modules["__main__"].__dict__)


def run_program(text, *arguments, folder):
    """Execute a program in a process of its own; return its exit code, output and errors."""
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        process = Forked(
            *("forked:execute", text, *arguments),
            cwd=folder,
            env=environment(80),
            stdout=out,
            stderr=err,
        )
        code = process.wait(TIMEOUT_S)
        for each in (out, err):
            each.seek(0)
        return code, out.read(), err.read()


@cache
def _starter():
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", STARTER, str(theirs.fileno())],
        env=environment(80, SHARED),
        stdin=subprocess.DEVNULL,
        pass_fds=[theirs.fileno()],
    )
    theirs.close()

    def end():
        ours.close()
        process.wait()

    atexit.register(end)
    return ours


class Forked:
    """A process in a session of its own that calls a function; in part as `subprocess.Popen`.

    Attributes:
        pid: of the process.
        returncode: its exit code as far as it is known; below 0: the signal that ended it.
    """

    def __init__(self, function, *arguments, cwd, env, stdin=None, stdout=None, stderr=None):
        """Start it.

        Args:
            function: `module:name`, without arguments.
            arguments: of the process, which the function finds in sys.argv.
            cwd: its folder.
            env: its environment.
            stdin: file; None: an empty one.
            stdout: file; None: the output is not kept.
            stderr: file; None: the output is not kept.
        """
        request = [0, function, [*map(str, arguments)], str(cwd), env]
        with open(os.devnull, "r+b") as nothing:
            files = [(each or nothing).fileno() for each in (stdin, stdout, stderr)]
            socket.send_fds(_starter(), [json.dumps(request).encode()], files)
            self.pid, _ = json.loads(_starter().recv(100))
        self.returncode = None

    def poll(self):
        """Return the exit code; None: it runs."""
        if self.returncode is None:
            _starter().send(json.dumps([self.pid]).encode())
            _, self.returncode = json.loads(_starter().recv(100))
        return self.returncode

    def wait(self, timeout):
        """Return the exit code."""
        stop = time.monotonic() + timeout
        while self.poll() is None:
            if time.monotonic() > stop:
                raise TimeoutError(f"process {self.pid} has not ended in {timeout:g} s")
            time.sleep(STEP_S)
        return self.returncode

    def send_signal(self, number):
        """Send it a signal, if it runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def kill(self):
        """Kill it, if it runs."""
        self.send_signal(signal.SIGKILL)
