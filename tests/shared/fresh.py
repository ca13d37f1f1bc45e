"""Processes forked from one with libraries of others, and nothing of the testbed or the tests.

Only for claims about the testbed's code: Python and numba take most of the time of a new process.
"""

import atexit
import ctypes
import gc
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from functools import cache

LIBRARIES = (
    *("foxglove", "joblib", "jsbsim", "numba", "numpy", "pydantic", "yaml"),
    *("scipy.integrate", "scipy.linalg", "scipy.optimize", "scipy.special"),
)
LONGEST_S = 300
NOT_MOUNTED = 9  # exit code
NEW_MOUNTS, NEW_USER = 0x00020000, 0x10000000  # of Linux


def run_fresh(code, *, folder, paths, env, mount=""):
    """Run Python code as a new process does; return its exit code, output and errors.

    Args:
        code: text of Python.
        folder: in which it works.
        paths: folders of modules that it imports.
        env: its environment.
        mount: commands of a shell before it; other processes do not see what they mount.
    """
    request = [code, str(folder), [*map(str, paths)], env, mount]
    print(json.dumps(request), file=_starter().stdin, flush=True)
    return json.loads(_starter().stdout.readline())


@cache
def _starter():
    process = subprocess.Popen(
        [sys.executable, "-I", __file__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )

    def end():
        process.stdin.close()
        process.wait()
        process.stdout.close()

    atexit.register(end)
    return process


def serve():
    """Fork a process for each line of standard input."""
    for library in LIBRARIES:
        importlib.import_module(library)
    numba = sys.modules["numba"]
    numba.njit(lambda x: x + 1.0)(1.0)  # which loads most of numba
    assert not [each for each in sys.modules if each.partition(".")[0] == "testbed"]
    gc.collect()
    gc.freeze()  # a process that ends collects none of it
    for line in sys.stdin:
        with tempfile.TemporaryFile("w+") as output, tempfile.TemporaryFile("w+") as errors:
            if not (process := os.fork()):
                os.dup2(output.fileno(), 1)
                os.dup2(errors.fileno(), 2)
                signal.alarm(LONGEST_S)
                _become(*json.loads(line))
                return
            code = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
            for each in (output, errors):
                each.seek(0)
            print(json.dumps([code, output.read(), errors.read()]), flush=True)


def _become(code, folder, paths, variables, mount):
    os.environ.clear()
    os.environ.update(variables)
    if mount and (leave_mounts() or subprocess.run(["sh", "-ec", mount]).returncode):
        sys.exit(NOT_MOUNTED)
    os.chdir(folder)
    sys.path[:0] = paths
    sys.dont_write_bytecode = bool(variables.get("PYTHONDONTWRITEBYTECODE"))
    importlib.import_module("numba.core.config").reload_config()  # of the variables
    exec(compile(code, "<string>", "exec"), {"__name__": "__main__"})


def leave_mounts():
    """Let other processes not see what is mounted from here on; return whether that failed."""
    user, group = os.geteuid(), os.getegid()
    if ctypes.CDLL(None).unshare(NEW_MOUNTS | (NEW_USER if user else 0)):
        return True
    if user:
        for file, line in (
            ("setgroups", "deny"),
            ("uid_map", f"0 {user} 1"),
            ("gid_map", f"0 {group} 1"),
        ):
            with open(f"/proc/self/{file}", "w") as written:
                written.write(line)
    return bool(subprocess.run(["mount", "--make-rprivate", "/"]).returncode)


if __name__ == "__main__":
    serve()
