"""The commands that look at flown runs: view, shot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from testbed.options import RunName


def view(
    run: RunName,
    at: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="Stop the viewer's cursor at this time of the run."),
    ] = None,
    rrd: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Save a Rerun recording instead of opening a viewer."),
    ] = None,
) -> None:
    """Replay a flown run in a Rerun viewer."""
    from testbed.view_console import replay_run

    raise typer.Exit(replay_run(run, rrd=rrd, at_s=at))


def shot(
    run: RunName,
    other: Annotated[
        str | None, typer.Argument(metavar="[RUN]", help="A run to lay over it.")
    ] = None,
    *,
    out: Annotated[Path, typer.Option(metavar="FILE.png", help="The picture.")],
    at: Annotated[
        float | None,
        typer.Option(metavar="SECONDS", help="A time of the run.  \\[default: its end]"),
    ] = None,
    size: Annotated[
        str, typer.Option(metavar="WIDTHxHEIGHT", help="Of the viewer's window, pixels.")
    ] = "1600x900",
) -> None:
    """Save a picture of one run, or of two laid over one another, without a screen.

    Needs a Vulkan driver; one in software will do: on Debian and Ubuntu, the package
    mesa-vulkan-drivers.
    """
    from testbed.view_console import picture_runs

    names = [run] if other is None else [run, other]
    raise typer.Exit(picture_runs(names, at_s=at, out=out, size=size))
