"""The commands that show runs: view, shot, and the overlay of compare."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.options import (
    Follow,
    Host,
    RrdFile,
    RunName,
    check_follow,
    output_option,
    parse_pixels,
    run_names,
    value_option,
)
from testbed.cli.output import describe_file, is_stdout, message_console
from testbed.core.errors import InputError, MissingExtraError
from testbed.core.files import report_write_errors

if TYPE_CHECKING:
    from testbed.logs.read import RunLog
    from testbed.views import LiveViewer


class Renderer(StrEnum):
    """What draws a picture."""

    RERUN = "rerun"
    SOFTWARE = "software"


OtherRun = Annotated[
    str | None,
    typer.Argument(
        metavar="[RUN]",
        help="A second run, drawn over the first; a recorded flight is translucent.",
        autocompletion=run_names,
    ),
]


def view_command(
    run: RunName,
    other: OtherRun = None,
    *,
    at: Annotated[
        float | None, value_option("SECONDS", "Stop the viewer's cursor at this time of the run.")
    ] = None,
    rrd: RrdFile = None,
    follow: Follow = None,
    web: Annotated[
        bool,
        typer.Option(
            "--web", help="Serve a web viewer until Ctrl-C, also for another machine through ssh."
        ),
    ] = False,
    host: Host = "127.0.0.1",
) -> None:
    """Replay a run in a Rerun viewer, or two runs overlaid."""
    names = [name for name in (run, other) if name is not None]
    if rrd and at is not None:
        raise InputError(
            f"--at {at:g}: a recording has no cursor. Leave out --at and move the cursor in the "
            f"viewer, or save a picture: testbed shot {shlex.join(names)} --at {at:g} --out "
            "FILE.png"
        )
    if web and (rrd or at is not None):
        other = "--rrd" if rrd else "--at"
        raise InputError(f"--web {other}: write one of them")
    logs = [read_shown_log(name) for name in names]
    check_follow(follow, logs[0].info.names)
    at_s = None if at is None else _check_time(at, *logs)
    if web:
        _serve(logs, host, follow)
    else:
        _show("view", names, logs, rrd, at_s, follow)


def shot_command(
    run: RunName,
    other: OtherRun = None,
    *,
    out: Annotated[
        Path, output_option(metavar="FILE.png", help="The picture.", suffixes=(".png",))
    ],
    at: Annotated[
        float | None, value_option("SECONDS", "Time of the run.  \\[default: its end]")
    ] = None,
    size: Annotated[
        str, value_option("WIDTHxHEIGHT", "Size of the picture, pixels.")
    ] = "1920x1080",
    follow: Follow = None,
    renderer: Annotated[
        Renderer | None,
        value_option(
            "rerun|software",
            "What draws it: the Rerun viewer, with plots and events, or the program itself, "
            "as in videos.  \\[default: rerun, or software where that cannot draw]",
        ),
    ] = None,
) -> None:
    """Save a picture of one run, or of two runs overlaid; needs no screen.

    The Rerun viewer needs a Vulkan driver; a software driver is enough: on Debian and Ubuntu, the
    package mesa-vulkan-drivers. The software renderer needs none.
    """
    pixels = parse_pixels(size)
    if pixels is None:
        raise InputError(f"--size {size}: write WIDTHxHEIGHT in pixels, such as 1920x1080")
    logs = [read_shown_log(name) for name in (run, other) if name is not None]
    check_follow(follow, logs[0].info.names)
    at_s = _check_time(at, *logs)
    with report_write_errors(f"--out {out}"):
        _draw(out, at_s, logs, pixels, follow, renderer)
    message_console().write_line(describe_file(out))


def _draw(
    out: Path,
    at_s: float,
    logs: Sequence[RunLog],
    size: tuple[int, int],
    follow: str | None,
    renderer: Renderer | None,
) -> None:
    """Draw a picture, by the program itself where no viewer can and none is asked for."""
    from testbed.cli.progress import activity
    from testbed.views import screenshot, software_picture
    from testbed.views.viewer import ViewerUnavailableError

    if renderer is not Renderer.SOFTWARE:
        try:
            with activity("shot") as progress:
                screenshot(out, at_s, *logs, size=size, follow=follow, progress=progress)
        except (ViewerUnavailableError, MissingExtraError) as error:
            if renderer is Renderer.RERUN:
                error.add_note("Without a viewer: --renderer software")
                raise
            message_console().write_line(f"note: {error}; drawn by the software renderer", "yellow")
        else:
            return
    with activity("shot") as progress:
        progress("drawing")
        software_picture(out, at_s, *logs, size=size, follow=follow)


def overlay_runs(first: str, second: str, *, rrd: Path | None) -> None:
    """Show two runs overlaid in a Rerun viewer, or save the recording.

    Raises:
        InputError: there is no such run, no viewer can open, or the file cannot be written.
    """
    names = [first, second]
    _show("compare", names, [read_shown_log(name) for name in names], rrd, None, None)


def read_shown_log(name: str) -> RunLog:
    """Read the log of a run, which must have samples.

    Raises:
        InputError: there is no such run, or no sample in its log.
    """
    from testbed.logs.read import read_log
    from testbed.logs.run_directory import find_run

    path = find_run(name)
    log = read_log(path)
    if not log.time_s.size:
        raise InputError(f"{path}: there is no sample in this log")
    return log


def _check_time(at_s: float | None, *logs: RunLog) -> float:
    """Check that all runs have this time, s; None: take their last."""
    first = max(float(log.time_s[0]) for log in logs)
    last = min(float(log.time_s[-1]) for log in logs)
    at_s = last if at_s is None else at_s
    if not first <= at_s <= last:
        raise InputError(f"--at {at_s:g}: write a time of the run, from {first:g} to {last:g} s")
    return at_s


def _show(
    command: str,
    names: Sequence[str],
    logs: Sequence[RunLog],
    rrd: Path | None,
    at_s: float | None,
    follow: str | None,
) -> None:
    from testbed.views import LiveViewer, replay
    from testbed.views.viewer import unavailable_reason

    messages = message_console()
    if rrd is None:
        viewer = LiveViewer(lossless=True, at_s=at_s)
        if reason := unavailable_reason(viewer.port):
            raise InputError(f"{reason}. {_alternatives(command, names)}")
        messages.write_line(f"view: {viewer.address}")
        replay(viewer, *logs, follow=follow)
        return
    refuse_stdout(rrd)
    save_rrd(rrd, logs, follow)


def refuse_stdout(rrd: Path) -> None:
    """Check that a recording does not go to standard output.

    Raises:
        InputError: it does.
    """
    if is_stdout(rrd):
        raise InputError("--rrd -: a recording goes to a file; write its name")


def save_rrd(rrd: Path, logs: Sequence[RunLog], follow: str | None) -> None:
    """Save a Rerun recording of one run, or of two overlaid, and print its size.

    Raises:
        InputError: the file cannot be written.
    """
    from testbed.views import RrdFile, replay

    with report_write_errors(f"--rrd {rrd}"):
        replay(RrdFile(rrd), *logs, follow=follow)
    message_console().write_line(describe_file(rrd, f"a recording for `rerun {rrd}`"))


@contextmanager
def open_viewer(host: str, *, web: bool) -> Iterator[LiveViewer]:
    """Open a viewer for the block: on this machine, or a web viewer.

    Raises:
        InputError: a web viewer cannot be served on this address.
    """
    from testbed.views import LiveViewer

    messages = message_console()
    if not web:
        viewer = LiveViewer()
        messages.write_line(f"view: {viewer.address}")
        yield viewer
        return
    from testbed.views.viewer import serve_web_viewer

    with serve_web_viewer(host) as served:
        for line in served.directions:
            messages.write_line(line)
        yield LiveViewer(port=served.port)


def _serve(logs: Sequence[RunLog], host: str, follow: str | None) -> None:
    """Serve one run, or two overlaid, in a web viewer until Ctrl-C."""
    from testbed.views import replay

    with open_viewer(host, web=True) as viewer:
        replay(replace(viewer, lossless=True), *logs, follow=follow)
        wait_for_interrupt()


def wait_for_interrupt() -> None:
    """Keep a web viewer until Ctrl-C."""
    with suppress(KeyboardInterrupt):
        message_console().write_line("view: the flight stays in the browser until Ctrl-C")
        while True:
            time.sleep(3600.0)


def _alternatives(command: str, names: Sequence[str]) -> str:
    """Commands that show runs where no viewer can open."""
    runs = shlex.join(names)
    ways = [
        f"`testbed shot {runs} --out FILE.png` for a picture",
        f"`testbed {command} {runs} --rrd FILE.rrd` for a recording, to open on another machine "
        "with `rerun FILE.rrd`",
    ]
    if command == "view":
        ways.append(f"`testbed view {runs} --web` for a browser, also on another machine")
    if command == "compare":
        ways.append(f"`testbed compare {runs} --numbers` for a table")
    return f"Write {', '.join(ways[:-1])} or {ways[-1]}."
