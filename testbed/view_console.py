"""What the commands that look at runs do on the terminal."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from testbed.errors import InputError
from testbed.outputs import refuse_files
from testbed.record.read import Log, read_log
from testbed.record.rundir import find_run
from testbed.views import LiveViewer, RrdFile, Sink, overlay, replay, shoot
from testbed.views.viewer import obstacle


def replay_run(name: str, *, rrd: Path | None, at_s: float | None) -> int:
    """Send a flown run to a Rerun viewer, or to a file."""
    if rrd and at_s is not None:
        raise InputError(
            f"--at {at_s:g}: a file has no cursor. Leave --at out and move it in the viewer, or "
            f"save a picture: testbed shot {name} --at {at_s:g} --out FILE.png"
        )
    log = _read(name)
    at_s = None if at_s is None else _within(log, at_s)
    _show(lambda sink: replay(log, sink), rrd, at_s)
    return 0


def lay_over(first: str, second: str, *, rrd: Path | None) -> int:
    """Send two flown runs to a Rerun viewer, or to a file, one over the other."""
    logs = _read(first), _read(second)
    _show(lambda sink: overlay(*logs, sink), rrd, None)
    return 0


def picture_run(name: str, *, at_s: float | None, out: Path, size: str) -> int:
    """Save a picture of a flown run."""
    match = re.fullmatch(r"([1-9]\d{2,3})x([1-9]\d{2,3})", size)
    if match is None:
        raise InputError(f"--size {size}: write WIDTHxHEIGHT in pixels, such as 1600x900")
    if out.suffix.lower() != ".png":
        raise InputError(f"--out {out}: pictures are PNG; write a name that ends in .png")
    refuse_files(out=out)
    log = _read(name)
    shoot(log, _within(log, at_s), out, size=(int(match[1]), int(match[2])))
    return 0


def _read(name: str) -> Log:
    """A log with frames."""
    path = find_run(name)
    log = read_log(path)
    if not log.time_s.size:
        raise InputError(f"{path}: there is no frame in this log")
    return log


def _within(log: Log, at_s: float | None) -> float:
    """A time of the run, s; its end if none is asked for."""
    first, last = float(log.time_s[0]), float(log.time_s[-1])
    at_s = last if at_s is None else at_s
    if not first <= at_s <= last:
        raise InputError(f"--at {at_s:g}: write a time of the run, from {first:g} to {last:g} s")
    return at_s


def _show(show: Callable[[Sink], None], rrd: Path | None, at_s: float | None) -> None:
    if rrd is None:
        viewer = LiveViewer(patient=True, at_s=at_s)
        if trouble := obstacle(viewer.port):
            raise InputError(trouble)
        show(viewer)
        return
    try:
        show(RrdFile(rrd))
    except OSError as error:
        raise InputError(f"--rrd {rrd}: {error.strerror or error}") from error
