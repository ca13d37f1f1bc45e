"""Show recorded runs: one, or two over one another, in a view or as a picture.

Pictures are drawn by a Rerun viewer, or by the program itself as the frames of videos are.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from testbed.core.errors import InputError
from testbed.core.files import write_file
from testbed.core.records import Event
from testbed.views.layout import PLOT_AHEAD_S, PLOT_WINDOW_S, fit_formation
from testbed.views.sample_columns import ViewBatch, batch_of, overlay, split
from testbed.views.scene import Scene, overlay_scenes, scene_of
from testbed.views.view import ViewSink, ViewTarget
from testbed.views.viewer import headless_viewer

if TYPE_CHECKING:  # reading logs loads scenarios, which the process of a live view does not need
    from testbed.logs.read import RunLog

BATCH_SAMPLES = 1000
LABELS = ("A", "B")  # of two runs
SIZE = (1920, 1080)  # pixels
LOADED_S = 40.0  # on a slow machine
LIMIT_S = 60.0  # of the whole picture
SETTLED_S = 5.0  # before what is shown, in which the cameras find their places
DRAWN_S = 1.0  # the viewer draws several times, without a signal when it is done
GREETING_S = 6.0  # after its first drawing the viewer shows a notice of its address for so long


class ViewComplaintError(RuntimeError):
    """A view of the viewer reports an error in what it was sent: a bug of the testbed."""


def replay(
    target: ViewTarget,
    first: RunLog,
    second: RunLog | None = None,
    *,
    follow: str | None = None,
) -> None:
    """Show one run, or two over one another, as fast as the target takes them.

    Args:
        target: where they are shown.
        first: a log.
        second: another one.
        follow: name of an aircraft of the first run that the first camera stays near.

    Raises:
        InputError: Two runs have no time in common.
        OSError: An .rrd file cannot be written.
    """
    scene, batch = scene_and_batch(first, second, follow=follow)
    sink = target.open(scene)
    if sink is not None:
        _send(sink, batch)
        sink.close()


def screenshot(
    path: Path,
    at_s: float,
    first: RunLog,
    second: RunLog | None = None,
    *,
    size: tuple[int, int] = SIZE,
    follow: str | None = None,
    progress: Callable[[str], None] = lambda doing: None,
) -> None:
    """Save a picture of one run, or of two over one another, drawn by a viewer without a screen.

    Args:
        path: of the PNG.
        at_s: a time that the runs have, s.
        first: a log.
        second: another one.
        size: width and height of the viewer's window, pixels.
        follow: name of an aircraft of the first run that the first camera stays near.
        progress: called with what is done next, in words.

    Raises:
        InputError: Two runs have no time in common.
        ViewerUnavailableError: No viewer can draw without a screen, or none answers in time.
        OSError: The picture cannot be written.
        ViewComplaintError: A view reports an error; the picture is saved all the same.
    """
    from testbed.views.rerun_backend import RemoteViewer, RerunRecording

    scene, batch = scene_and_batch(first, second, follow=follow)
    framing = fit_formation(scene, batch)
    shown = _visible_at(batch, at_s)
    progress("starting the Rerun viewer")
    with headless_viewer(size, limit_s=LIMIT_S) as port:
        viewer = RemoteViewer(port, scene.recording_id)
        viewer.wait_until_drawn(LIMIT_S)
        greeting_ends = time.monotonic() + GREETING_S
        progress("sending the flight to the Rerun viewer")
        recording = RerunRecording(scene, live=False, at_s=at_s, framing=framing)
        recording.open(port)
        _send(recording, shown)
        recording.flush(LOADED_S)
        viewer.pause_at(at_s, LOADED_S)
        viewer.hide_menu()
        progress("the Rerun viewer draws")
        time.sleep(max(DRAWN_S, greeting_ends - time.monotonic()))
        picture, complaints = viewer.screenshot(LIMIT_S)
        recording.close()
    with write_file(path) as file:
        file.write(picture)
    if complaints:
        raise ViewComplaintError(f"{path}: the viewer reports: {'; '.join(complaints)}")


def software_picture(
    path: Path,
    at_s: float,
    first: RunLog,
    second: RunLog | None = None,
    *,
    size: tuple[int, int] = SIZE,
    follow: str | None = None,
) -> None:
    """Save a picture of one run, or of two over one another: a frame of `testbed video`.

    Needs no viewer, display or graphics driver.

    Args:
        path: of the PNG.
        at_s: a time that the runs have, s.
        first: a log.
        second: another one.
        size: width and height of the picture, pixels.
        follow: name of an aircraft of the first run that the first camera stays near.

    Raises:
        InputError: Two runs have no time in common, or Pillow is not installed.
        OSError: The picture cannot be written.
    """
    from testbed.views.pillow_backend import save_picture
    from testbed.views.video import FlightVideo

    scene, batch = scene_and_batch(first, second, follow=follow)
    nearest = int(np.abs(batch.time - at_s).argmin())
    drawing = FlightVideo(scene, batch, np.array([nearest]), size).frame(0)
    with write_file(path) as file:
        save_picture(file, drawing)


def scene_and_batch(
    first: RunLog, second: RunLog | None = None, *, follow: str | None = None
) -> tuple[Scene, ViewBatch]:
    """Prepare one run, or two at the times that both have.

    Raises:
        InputError: Two runs have no time in common.
    """
    scene, batch = _prepare(first, follow)
    if second is None:
        return scene, batch
    second_scene, second_batch = _prepare(second)
    batch = overlay(batch, second_batch, LABELS)
    if len(batch) < 2:
        raise InputError("the two runs have no samples at the same times: nothing to overlay")
    begin, step = float(batch.time[0]), float(np.median(np.diff(batch.time)))
    real = _is_recorded(first), _is_recorded(second)
    both = overlay_scenes(scene, second_scene, LABELS, real)
    both = replace(both, sample_rate_hz=1.0 / step)
    titles = [
        Event(begin, "info", label, f"is {each.title}")
        for label, each in zip(LABELS, (scene, second_scene), strict=True)
    ]
    return both, replace(batch, events=(*titles, *batch.events))


def _prepare(run: RunLog, follow: str | None = None) -> tuple[Scene, ViewBatch]:
    batch = batch_of(run, run.events)
    estimated = not np.array_equal(batch.estimated_position, batch.position, equal_nan=True)
    return replace(scene_of(run.info, follow), estimated=estimated), batch


def _visible_at(batch: ViewBatch, at_s: float) -> ViewBatch:
    """Select the samples that a picture at a time, s, shows: to send all of a run takes long."""
    begin = at_s - PLOT_WINDOW_S - SETTLED_S
    rows = slice(*np.searchsorted(batch.time, [begin, at_s + PLOT_AHEAD_S + 1e-6]).tolist())
    return replace(batch.rows(rows), events=batch.events)


def _is_recorded(run: RunLog) -> bool:
    """Return whether a run is a recorded flight of real aircraft."""
    return bool(run.metrics and run.metrics.get("recorded"))


def _send(sink: ViewSink, batch: ViewBatch) -> None:
    for piece in split(batch, BATCH_SAMPLES):
        sink.send(piece)
