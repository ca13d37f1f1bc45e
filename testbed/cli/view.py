"""The commands that show runs: view, shot, and the overlay of compare."""

from __future__ import annotations

import re
import shlex
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import RrdFile, RunName, output_option
from testbed.cli.output import describe_file, is_stdout, message_console
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors

if TYPE_CHECKING:
    from testbed.logs.read import Log


def view_command(
    run: RunName,
    at: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Stop the viewer's cursor at this time of the run."),
    ] = None,
    rrd: RrdFile = None,
) -> None:
    """Replay a run in a Rerun viewer."""
    if rrd and at is not None:
        raise InputError(
            f"--at {at:g}: a recording has no cursor. Leave out --at and move the cursor in the "
            f"viewer, or save a picture: testbed shot {run} --at {at:g} --out FILE.png"
        )
    log = _read_log(run)
    _show("view", [run], [log], rrd, None if at is None else _check_time(at, log))


def shot_command(
    run: RunName,
    other: Annotated[
        str | None, typer.Argument(metavar="[RUN]", help="A second run, drawn over the first.")
    ] = None,
    *,
    out: Annotated[
        Path, output_option(metavar="FILE.png", help="The picture.", suffixes=(".png",))
    ],
    at: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Time of the run.  \\[default: its end]"),
    ] = None,
    size: Annotated[
        str, typer.Option(metavar="WIDTHxHEIGHT", help="Size of the viewer's window, pixels.")
    ] = "1600x900",
) -> None:
    """Save a picture of one run, or of two runs overlaid; needs no screen.

    Needs a Vulkan driver; a software driver is enough: on Debian and Ubuntu, the package
    mesa-vulkan-drivers.
    """
    from testbed.views import screenshot

    match = re.fullmatch(r"([1-9]\d{2,3})x([1-9]\d{2,3})", size)
    if match is None:
        raise InputError(f"--size {size}: write WIDTHxHEIGHT in pixels, such as 1600x900")
    logs = [_read_log(name) for name in (run, other) if name is not None]
    with sigterm_interrupts():
        at_s = _check_time(at, *logs)
        with report_write_errors(f"--out {out}"):
            screenshot(out, at_s, *logs, size=(int(match[1]), int(match[2])))
    message_console().write_line(describe_file(out))


def overlay_runs(first: str, second: str, *, rrd: Path | None) -> None:
    """Show two runs overlaid in a Rerun viewer, or save the recording.

    Raises:
        InputError: there is no such run, no viewer can open, or the file cannot be written.
    """
    names = [first, second]
    _show("compare", names, [_read_log(name) for name in names], rrd, None)


@contextmanager
def sigterm_interrupts() -> Iterator[None]:
    """Let SIGTERM in the block act as Ctrl-C, so that child processes are ended too."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _read_log(name: str) -> Log:
    """Read a log that has samples."""
    from testbed.logs.read import read_log
    from testbed.logs.run_directory import find_run

    path = find_run(name)
    log = read_log(path)
    if not log.time_s.size:
        raise InputError(f"{path}: there is no sample in this log")
    return log


def _check_time(at_s: float | None, *logs: Log) -> float:
    """Check that all runs have this time; without one, take the last that they have, s."""
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
    from testbed.views import LiveViewer, RrdFile, replay
    from testbed.views.viewer import unavailable_reason

    messages = message_console()
    if rrd is None:
        viewer = LiveViewer(lossless=True, at_s=at_s)
        if reason := unavailable_reason(viewer.port):
            raise InputError(f"{reason}. {_alternatives(command, names)}")
        messages.write_line(f"view: {viewer.address}")
        replay(viewer, *logs)
        return
    if is_stdout(rrd):
        raise InputError("--rrd -: a recording goes to a file; write its name")
    with report_write_errors(f"--rrd {rrd}"):
        replay(RrdFile(rrd), *logs)
    messages.write_line(describe_file(rrd, f"a recording for `rerun {rrd}`"))


def _alternatives(command: str, names: Sequence[str]) -> str:
    """Commands that show runs where no viewer can open."""
    runs = shlex.join(names)
    ways = [
        f"`testbed shot {runs} --out FILE.png` for a picture",
        f"`testbed {command} {runs} --rrd FILE.rrd` for a recording, to open on another machine "
        "with `rerun FILE.rrd`",
    ]
    if command == "compare":
        ways.append(f"`testbed compare {runs} --numbers` for a table")
    return f"Write {', '.join(ways[:-1])} or {ways[-1]}."
