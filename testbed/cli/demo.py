"""The command that flies, films and reports a short flight: demo."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from testbed.cli.exit_codes import ExitCode
from testbed.cli.options import value_option
from testbed.cli.output import describe_file, message_console, result_console
from testbed.cli.progress import activity
from testbed.core.files import report_write_errors

if TYPE_CHECKING:
    from testbed.cli.output import PipeSafeConsole
    from testbed.logs.read import RunLog
    from testbed.metrics.model import Metrics
    from testbed.runs.run import Run
    from testbed.scenario import Scenario

SCENARIO, DURATION_S = "bursty-wifi", 90.0
SHOWN_AS = "demo"  # name of the run, by which other commands find it
WINDOW = "rectangles"  # of the scenario, here of all the time in which the formation is complete
JOINED_S = 15.0
FILM_S = (18.0, 42.0)  # of the flight: the leader's first corner
FILM_SPEED, FILM_FPS = 2.0, 20
FILM_PX, PICTURE_PX = (960, 540), (1280, 720)
PICTURE_S = 30.0
PHASES = 4


def demo_command(
    out: Annotated[
        Path | None, value_option("DIR", "Folder to create.  \\[default: logs/demo/UTC-ID]")
    ] = None,
) -> None:
    """Fly, film and report a short flight: four aircraft whose radio loses a fifth of all packets.

    Takes less than a minute, and half a minute more the first time, which compiles kernels. Writes
    the files of a run, demo.mp4, demo.png and report.html to the folder.
    """
    # what is not installed is named before the flight
    import testbed.views.matplotlib_backend
    import testbed.views.pillow_backend  # noqa: F401
    from testbed.cli.report import REPORT_NAME
    from testbed.cli.video import h264_command
    from testbed.logs.file_record import record_files
    from testbed.logs.read import read_log
    from testbed.logs.run_directory import LOG_NAME
    from testbed.reports import read_run, run_page, write_page
    from testbed.views import software_picture

    messages, console = message_console(), result_console()
    messages.write_line(f"demo: {DURATION_S:g} s of {SCENARIO}, four aircraft on a crowded channel")
    with _phase(1, "fly", messages):
        run = _fly(_scenario(), out)
    folder = run.directory
    if folder is None or run.exit_code == ExitCode.INTERRUPTED:
        raise typer.Exit(run.exit_code)
    film, picture, report = (folder / each for each in ("demo.mp4", "demo.png", REPORT_NAME))
    log = read_log(folder / LOG_NAME)
    with _phase(2, "film", messages):
        _film(log, film)
    with _phase(3, "picture", messages), report_write_errors(picture):
        software_picture(picture, PICTURE_S, log, size=PICTURE_PX)
    with _phase(4, "report", messages), activity("report") as doing:
        doing("drawing figures")
        page = run_page(read_run(str(folder)))
        with report_write_errors(report):
            write_page(page, report)
    record_files(folder, film.name, picture.name, report.name)
    console.write_line(f" error    {_errors(run.metrics)}")
    for name, path in (("film", film), ("picture", picture), ("report", report)):
        console.write_line(f" {name:<8} {describe_file(path)}")
        if path == film:
            console.write_line(f" {'H.264':<8} {h264_command(film)}")
    console.write_line(f" log      {describe_file(folder / LOG_NAME)}")
    shown = SHOWN_AS if out is None else shlex.quote(str(folder))
    ways = (
        f"testbed view {shown} --web    the flight in 3D, in a browser",
        "testbed run simulation-3     the paper's flight, with a perfect radio",
        "testbed list                 other scenarios: network, wind, faults",
    )
    for k, each in enumerate(ways):
        console.write_line(f" {'' if k else 'next':<8} {each}")
    raise typer.Exit(run.exit_code)


def _scenario() -> Scenario:
    from testbed.scenario import load_scenario, set_duration

    window = f"scenario.windows.{WINDOW}=[{JOINED_S}, {DURATION_S}]"
    return set_duration(load_scenario(SCENARIO, [f"scenario.name={SHOWN_AS}", window]), DURATION_S)


def _fly(scenario: Scenario, out: Path | None) -> Run:
    from testbed.runs.run import run

    return run(scenario, out=out, progress=True)


def _film(log: RunLog, path: Path) -> None:
    from testbed.cli.video import choose_frames, draw_video
    from testbed.views.recorded_runs import scene_and_batch
    from testbed.views.video import FlightVideo

    scene, batch = scene_and_batch(log)
    frames = choose_frames(batch.time, *FILM_S, FILM_SPEED, FILM_FPS)
    film = FlightVideo(scene, batch, frames, FILM_PX)
    with report_write_errors(path):
        draw_video(film, path, len(frames), FILM_FPS, "film")


@contextmanager
def _phase(number: int, name: str, messages: PipeSafeConsole) -> Iterator[None]:
    """Print the name of a part of the work, and how long the block takes."""
    begin = time.monotonic()
    messages.write_line(f"{number}/{PHASES} {name}")
    yield
    messages.write_line(f"    {time.monotonic() - begin:.1f} s")


def _errors(metrics: Metrics) -> str:
    window = metrics["windows"].get(WINDOW)
    if window is None:
        return "none: the formation was not complete"
    each = ", ".join(f"{name} {rms:.2f}" for name, rms in window["rms_m"].items())
    return f"{window['mean_rms_m']:.2f} m RMS from {JOINED_S:g} s on ({each})"
