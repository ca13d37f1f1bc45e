"""Process that feeds mutated files to the testbed; a crash or an endless loop ends only it.

    python mutation_worker.py KIND FOLDER

reads numbers of mutations, one per line, and answers each with a line of JSON. FOLDER is empty.
Files written outside of a run's directory, processes, connections and foreign code are faults.
"""

import json
import os
import random
import re
import sys
import time
import traceback
import warnings
from pathlib import Path

from mutation_kinds import KINDS
from mutations import mutate

import testbed
from testbed.core.errors import InputError

SEED = 20261122
MAX_ERROR = 20_000  # characters
MAX_MEMORY = 10**9  # bytes
LINE = re.compile(r"\S+\.(yaml|py):\d+:")
# Errors of building name a key or an aircraft of the scenario.
KEY = re.compile(r"(scenario|leader|fleet|formation|controller|air|network|rates|limits|uav\d)\b")
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CHANGES = ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.symlink", "os.link", "os.truncate")
PROGRAMS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn")
EVIL = "evil.py"  # code that no input may run
SOCKETS = ("socket.bind", "socket.connect", "socket.sendto", "socket.getaddrinfo")


class AuditGuard:
    """Records what this process does beside reading, while armed."""

    def __init__(self, folder):
        self.armed = False
        self.seen = []
        # the cache of compiled code, and the run whose log is recovered
        self.allowed = [
            os.environ.get("NUMBA_CACHE_DIR", "nowhere"),
            Path(testbed.__file__).parent / "__pycache__" / "kernels-",
            os.devnull,
            folder / "home/run",
        ]
        sys.addaudithook(self.record)

    def record(self, event, args):
        if not self.armed:
            return
        if event == "open":
            path, mode, flags = args
            writes = flags & WRITING if isinstance(flags, int) else set(mode or "") & set("wax+")
            if writes and isinstance(path, str | bytes | os.PathLike):
                self.record_path(event, path)
        elif event in CHANGES:
            fd = args[-1] if isinstance(args[-1], int) else -1
            folder = os.readlink(f"/proc/self/fd/{fd}") if fd >= 0 else "."
            self.record_path(event, os.path.join(folder, os.fsdecode(args[0])))
        elif event in PROGRAMS or event in SOCKETS:
            self.seen.append(f"{event} {args!r:.200}")
        elif event == "exec" and Path(args[0].co_filename).name == EVIL:
            self.seen.append(f"ran {args[0].co_filename}")

    def record_path(self, event, path):
        path = os.path.abspath(os.fsdecode(path))
        if not any(path.startswith(str(each)) for each in self.allowed):
            self.seen.append(f"{event} {path}")


def fault_of(error, path):
    """Return what is unclear about an error, or ""."""
    text = str(error)
    if len(text) > MAX_ERROR:
        return f"an error of {len(text)} characters"
    if not all(each.isprintable() or each == "\n" for each in text):
        return "an error that is not printable"
    first = text.partition("\n")[0]
    folder = next((p for p in path.parents if (p / f"{p.name}.xml").is_file()), path)
    if path.suffix == ".yaml" and (LINE.match(first) or KEY.match(first)):
        return ""  # the line may be in a file that it extends, or in its law
    names = (path.name, f"{folder.name}/", f"{folder.name}:")
    if not any(each in first for each in names):
        return "an error that does not name the file"
    return ""


def try_file(kind, path):
    """Return the outcome, good, refused or fault, and a text."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            if "own-law" in path.name:  # floating-point warnings of an own law
                warnings.simplefilter("ignore", RuntimeWarning)
            kind.feed(path)
    except InputError as error:
        fault = fault_of(error, path)
        return ("fault", f"{fault}: {error}") if fault else ("refused", str(error))
    except Exception:
        return "fault", traceback.format_exc()
    return "good", ""


def largest_memory():
    """Largest resident size of this process up to now, bytes; 0 where it is not known."""
    status = Path("/proc/self/status")
    lines = status.read_text().splitlines() if status.exists() else []
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM")), 0)


def listing(folder):
    return {str(p): p.stat().st_size for p in folder.rglob("*") if p.is_file()}


def choose(name, files, number):
    """Return the file of a number, its mutated bytes and the mutation; below 0 unchanged."""
    if number < 0:
        path = files[(-number - 1) % len(files)]
        return path, path.read_bytes(), "whole"
    rng = random.Random(f"{SEED}/{name}/{number}")
    path = rng.choice(files)
    return path, *mutate(path.read_bytes(), path.suffix, rng)


def main(name, folder):
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    output = os.open(folder / "output", os.O_RDWR | os.O_CREAT)
    os.dup2(output, 1)
    os.dup2(output, 2)
    kind, home, here = KINDS[name], folder / "home", folder / "here"
    home.mkdir()
    here.mkdir()
    os.chdir(here)
    files = kind.put(home)
    for place in (here, home, folder):
        (place / EVIL).write_text("class Law: pass\n")
    sys.dont_write_bytecode = True  # of modules that are loaded when a file is tried
    guard = AuditGuard(folder)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        before = listing(here)
    for line in sys.stdin:
        path, data, way = choose(name, files, int(line))
        whole = path.read_bytes()
        path.write_bytes(data)
        at = os.lseek(output, 0, os.SEEK_END)
        guard.seen.clear()
        guard.armed, began = True, time.monotonic()
        outcome, text = try_file(kind, path)
        guard.armed, took_s = False, time.monotonic() - began
        memory = largest_memory()
        if guard.seen:
            outcome, text = "fault", f"unexpected: {guard.seen}; {text}"
        elif listing(here) != before:
            outcome, text = "fault", f"left files: {listing(here)}; {text}"
        elif os.lseek(output, 0, os.SEEK_END) > at:
            printed = os.pread(output, 500, at).decode(errors="replace")
            outcome, text = "fault", f"printed: {printed}; {text}"
        elif memory > MAX_MEMORY:
            outcome, text = "fault", f"took {memory / 1e9:.2f} GB of memory; {text}"
        path.write_bytes(whole)
        file = str(path.relative_to(home))
        answers.write(json.dumps([outcome, text, way, file, took_s, memory]) + "\n")


def work():
    main(sys.argv[1], Path(sys.argv[2]).resolve())


if __name__ == "__main__":
    work()
