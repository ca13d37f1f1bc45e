"""What the commands that look at runs do on the terminal."""

from __future__ import annotations

import re
import shlex
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from testbed.errors import InputError
from testbed.outputs import is_stdout, refuse_files, said
from testbed.record.read import Log, read_log
from testbed.record.rundir import find_run
from testbed.views import LiveViewer, RrdFile, replay, shoot
from testbed.views.viewer import obstacle


def replay_run(name: str, *, rrd: Path | None, at_s: float | None) -> int:
    """Send a flown run to a Rerun viewer, or to a file."""
    if rrd and at_s is not None:
        raise InputError(
            f"--at {at_s:g}: a file has no cursor. Leave --at out and move it in the viewer, or "
            f"save a picture: testbed shot {name} --at {at_s:g} --out FILE.png"
        )
    refuse_files(rrd=rrd)
    log = _read(name)
    _show("view", [name], [log], rrd, None if at_s is None else _within(at_s, log))
    return 0


def lay_over(first: str, second: str, *, rrd: Path | None) -> int:
    """Send two flown runs to a Rerun viewer, or to a file, one over the other."""
    refuse_files(rrd=rrd)
    names = [first, second]
    _show("compare", names, [_read(name) for name in names], rrd, None)
    return 0


def picture_runs(names: Sequence[str], *, at_s: float | None, out: Path, size: str) -> int:
    """Save a picture of a flown run, or of two over one another."""
    match = re.fullmatch(r"([1-9]\d{2,3})x([1-9]\d{2,3})", size)
    if match is None:
        raise InputError(f"--size {size}: write WIDTHxHEIGHT in pixels, such as 1600x900")
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}: pictures are PNG; write a name that ends in .png")
    refuse_files(out=out)
    logs = [_read(name) for name in names]
    with terminable():
        shoot(out, _within(at_s, *logs), *logs, size=(int(match[1]), int(match[2])))
    _say(said(out))
    return 0


@contextmanager
def terminable() -> Iterator[None]:
    """SIGTERM ends what runs in here as Ctrl-C does, with everything that it has started."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _read(name: str) -> Log:
    """A log with frames."""
    path = find_run(name)
    log = read_log(path)
    if not log.time_s.size:
        raise InputError(f"{path}: there is no frame in this log")
    return log


def _within(at_s: float | None, *logs: Log) -> float:
    """A time that runs have, s; the last one if none is asked for."""
    first = max(float(log.time_s[0]) for log in logs)
    last = min(float(log.time_s[-1]) for log in logs)
    at_s = last if at_s is None else at_s
    if not first <= at_s <= last:
        raise InputError(f"--at {at_s:g}: write a time of the run, from {first:g} to {last:g} s")
    return at_s


def _show(
    command: str,
    names: Sequence[str],
    logs: Sequence[Log],
    rrd: Path | None,
    at_s: float | None,
) -> None:
    if rrd is None:
        viewer = LiveViewer(patient=True, at_s=at_s)
        if trouble := obstacle(viewer.port):
            raise InputError(f"{trouble}. {_instead(command, names)}")
        _say(f"view: {viewer.address}")
        replay(viewer, *logs)
        return
    if is_stdout(rrd):
        raise InputError("--rrd -: a recording goes to a file; write its name")
    try:
        replay(RrdFile(rrd), *logs)
    except OSError as error:
        raise InputError(f"--rrd {rrd}: {error.strerror or error}") from error
    _say(said(rrd, f"a recording for `rerun {rrd}`"))


def _instead(command: str, names: Sequence[str]) -> str:
    """What shows runs where no viewer opens."""
    runs = shlex.join(names)
    ways = [
        f"`testbed shot {runs} --out FILE.png` for a picture",
        f"`testbed {command} {runs} --rrd FILE.rrd` for a recording that `rerun FILE.rrd` opens "
        "elsewhere",
    ]
    if command == "compare":
        ways.append(f"`testbed compare {runs} --numbers` for a table")
    return f"Write {', '.join(ways[:-1])} or {ways[-1]}."


def _say(text: str) -> None:
    print(text, file=sys.stderr)
