"""A view shows what was flown, costs little, and never disturbs a run, whatever its viewer does."""

import contextlib
import ctypes.util
import dataclasses
import functools
import logging
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import views_flight
from given_time import GivenTime
from patience import PATIENCE_S, until

from testbed import run
from testbed.record.read import read_log
from testbed.scenario import load, shorten
from testbed.state import Event
from testbed.study.two_runs import compare_runs
from testbed.views import (
    FAST_HZ,
    InMemory,
    LiveViewer,
    RerunView,
    RrdFile,
    layout,
    replay,
    scene,
    shoot,
    shot,
    viewer,
)
from testbed.views.airframes import airframe
from testbed.views.batch import Collector, whole
from testbed.views.meshes import normals
from testbed.views.rerun_door import Recording
from testbed.views.shot import SIZE, ViewTroubleError
from testbed.views.view import BATCH_FRAMES

HERE = Path(__file__).parents[2]


@pytest.fixture(autouse=True)
def patient(monkeypatch):
    """On a busy machine programs may begin late, and draw slowly."""
    monkeypatch.setattr(viewer, "START_S", PATIENCE_S)
    monkeypatch.setattr(shot, "LIMIT_S", PATIENCE_S)
    monkeypatch.setattr(shot, "LOADED_S", PATIENCE_S)


@contextlib.contextmanager
def saving_viewer(path: Path):
    """A viewer that saves what it is sent, and its port; it ends with the test."""
    with viewer.tethered(viewer.program(), "--save", str(path)) as (process, port):
        assert process.poll() is None, "it did not start"
        yield process, port


def fly(view: RerunView, frames, info) -> None:
    """Show frames."""
    view.begin(info)
    for frame in frames:
        view.observe(frame)


def rows_of(path: Path) -> int:
    """The number of rows in an .rrd file."""
    checked = subprocess.run(
        [viewer.program(), "rrd", "stats", str(path)], capture_output=True, text=True, check=True
    )
    line = next(line for line in checked.stdout.splitlines() if line.startswith("num_rows ="))
    return int("".join(filter(str.isdigit, line)))  # the program groups digits with thin spaces


def warnings_of(caplog) -> list[str]:
    return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]


def test_importing_and_making_a_view_leaves_rerun_alone():
    code = (
        "import sys, testbed.views as v; v.RerunView(v.LiveViewer()); v.RrdFile('x');"
        "sys.exit(any(m.split('.')[0].startswith('rerun') for m in sys.modules))"
    )
    assert subprocess.run([sys.executable, "-c", code], cwd=HERE, check=False).returncode == 0


def test_calls_per_batch_do_not_grow_with_frames():
    calls = []
    for duration_s in (4.0, 30.0):
        recording = Recording(scene.scene_of(views_flight.info(4, duration_s)), live=True)
        recording.open(None)
        run = whole(views_flight.log(4, duration_s), ())
        recording.send(run.rows(slice(0, 50)))  # brings the still part
        before = recording.calls
        recording.send(run.rows(slice(50, None)))
        calls.append(recording.calls - before)
    # poses, trails, control surfaces, slots; the camera, wind and links; plots with their limits
    assert calls[0] == calls[1] == 4 + 4 + 4 * 5 + 3 + 3 + 13 + 9


def test_a_batch_ends_at_its_size_and_at_its_half_second():
    sink = InMemory()
    view = RerunView(sink)
    sent = []
    view.begin(views_flight.info(2, 100.0))
    take = view._collector.take
    view._collector.take = lambda: sent.append(take()) or sent[-1]
    frames = list(views_flight.frames(2, 60.0))
    view._due = np.inf
    for frame in frames[:BATCH_FRAMES]:
        view.observe(frame)
    assert [len(batch) for batch in sent] == [BATCH_FRAMES]
    view.observe(frames[BATCH_FRAMES])
    view._due = 0.0
    view.observe(frames[BATCH_FRAMES + 1])
    assert [len(batch) for batch in sent] == [BATCH_FRAMES, 2]
    view.end({}, (Event(60.0, "warning", "run", "over"),))
    assert len(sent[2]) == 0 and sent[2].events[0].text == "over"


def test_of_a_fast_flight_every_event_is_shown_and_not_every_frame():
    events = []

    def shown(most_hz):
        sink = InMemory()
        view = RerunView(sink, most_hz=most_hz)
        view.begin(views_flight.info(2, 10.0))
        view._due = np.inf  # one batch, however slow the machine is
        for k, frame in enumerate(views_flight.frames(2, 10.0)):
            if k in (3, 4):
                frame = frame._replace(events=(Event(frame.time_s, "info", "x", "y"),))
            view.observe(frame)
        batch = view._collector.take()
        events.append(batch.events)
        return batch.time, view._outlet._scene.frame_rate_hz

    (every, rate), (some, lower) = shown(None), shown(FAST_HZ)
    assert rate == 25 and lower == 12.5
    assert np.array_equal(some, every[::2])
    assert len(events[0]) == 2 and events[0] == events[1]


def test_a_frame_is_copied_and_not_written_to():
    frames = list(views_flight.frames(3, 1.0))
    collector = Collector(100)
    for frame in frames:
        for array in (frame.truth.position_ned, frame.formation.slot_ned, frame.truth.euler):
            array.setflags(write=False)
        collector.add(frame)
    frames[3].truth.position_ned.setflags(write=True)
    kept = frames[3].truth.position_ned.copy()
    frames[3].truth.position_ned[:] = np.nan
    batch = collector.take()
    np.testing.assert_array_equal(batch.position[3], kept)
    np.testing.assert_array_equal(batch.slot[5], frames[5].formation.slot_ned)
    assert len(collector.take()) == 0


@pytest.mark.parametrize("name", ["rascal110", "skywalker_x8", "an-airframe-nobody-drew"])
def test_a_drawing_has_the_wingspan_it_was_asked_for(name):
    drawing = airframe(name, 3.5)
    body = drawing.body
    assert np.ptp(body.vertices[:, 1]) == pytest.approx(3.5, rel=1e-3)
    assert body.vertices[:, 0].max() > 0.5 > -0.5 > body.vertices[:, 0].min()
    assert body.triangles.max() < len(body.vertices) == len(body.paint)
    np.testing.assert_allclose(np.linalg.norm(normals(body), axis=-1), 1.0, rtol=1e-9)


def test_the_right_wing_is_on_the_right_and_the_fin_is_up():
    vertices = airframe("rascal110", 2.794).body.vertices
    tail = vertices[vertices[:, 0] < -0.8]
    assert -tail[:, 2].min() > 0.3  # z is down
    np.testing.assert_allclose(vertices[:, 1].max(), -vertices[:, 1].min(), rtol=1e-9)


def test_an_rrd_file_that_cannot_be_written_is_said_before_the_flight(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        RerunView(RrdFile(tmp_path / "file" / "run.rrd")).begin(views_flight.info(2, 1.0))


def test_a_replay_writes_the_whole_flight(tmp_path):
    path = tmp_path / "run.rrd"
    replay(RrdFile(path), views_flight.log(4, 60.0))
    assert rows_of(path) > 1500 * (4 + 3 + 1 + 4)  # poses and four plots of every frame


def test_no_display_is_one_warning(monkeypatch, caplog):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    view = RerunView(LiveViewer(port=viewer.free_port()))
    fly(view, views_flight.frames(2, 1.0), views_flight.info(2, 1.0))
    view.end({}, ())
    assert len(warnings_of(caplog)) == 1 and "--rrd FILE" in warnings_of(caplog)[0]


def test_no_program_is_one_warning(monkeypatch, caplog):
    monkeypatch.setattr(sys, "executable", "/nowhere/bin/python")
    view = RerunView(LiveViewer(port=viewer.free_port()))
    fly(view, views_flight.frames(2, 1.0), views_flight.info(2, 1.0))
    view.end({}, ())
    assert len(warnings_of(caplog)) == 1 and "no `rerun` program" in warnings_of(caplog)[0]


def test_a_viewer_that_does_not_start_is_one_warning(monkeypatch, caplog, tmp_path):
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("DISPLAY", ":never")
    monkeypatch.setattr(viewer, "program", lambda: str(broken))
    port = viewer.free_port()
    # The feeding process looks beside its own interpreter: give it the broken program there.
    patched = f"import testbed.views.viewer as v; v.program = lambda: {str(broken)!r}"
    (tmp_path / "sitecustomize.py").write_text(patched)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path) + os.pathsep + str(HERE))
    view = RerunView(LiveViewer(port=port))
    fly(view, views_flight.frames(2, 1.0), views_flight.info(2, 1.0))
    view._outlet.process.wait(PATIENCE_S)
    view.end({}, ())
    assert len(warnings_of(caplog)) == 1 and "did not start" in warnings_of(caplog)[0]


def test_a_live_viewer_gets_everything_and_the_end_is_quick(caplog, tmp_path):
    seen, complete = tmp_path / "seen.rrd", tmp_path / "whole.rrd"
    info, frames = views_flight.info(4, 60.0), list(views_flight.frames(4, 60.0))
    replay(RrdFile(complete), views_flight.log(4, 60.0))
    rows = rows_of(complete)
    with saving_viewer(seen) as (program, port), GivenTime() as given:
        view = RerunView(LiveViewer(port=port))
        fly(view, frames, info)
        process = view._outlet.process
        start = given.now_s
        view.end({}, ())
        assert given.now_s - start < 1.0
        assert process.wait(PATIENCE_S) == 0
        # the viewer saves what it was sent in its own time
        until(lambda: rows_of(seen) > rows - 50)
        os.killpg(program.pid, signal.SIGTERM)
        program.wait(PATIENCE_S)
    assert warnings_of(caplog) == []
    # Batches of another size have a few more rows: the two ends of each limit.
    assert rows - 50 < rows_of(seen) < rows + 50


class Watched(RerunView):
    """A view that tells what the run waited for it, and does a deed in mid-flight."""

    def __init__(self, sink, given, at_frame=None, deed=None):
        super().__init__(sink)
        self.given, self.at_frame, self.deed = given, at_frame, deed
        self.frame, self.waited = 0, 0.0

    def timed(self, method, *told):
        start = self.given.now_s
        method(*told)
        self.waited += self.given.now_s - start

    def begin(self, info):
        self.timed(super().begin, info)
        self.feeding = getattr(self._outlet, "process", None)

    def observe(self, frame):
        if self.frame == self.at_frame:
            self.deed()
        if self.frame + 1 == self.at_frame:
            self._due = 0.0  # however soon that is, something has been passed on by then
        self.frame += 1
        self.timed(super().observe, frame)

    def end(self, summary, events):
        self.timed(super().end, summary, events)


def test_no_viewer_changes_a_run_or_its_log_or_costs_it_a_second(monkeypatch, tmp_path, caplog):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    page = shorten(load("simulation-3"), 20.0)

    def flight(name, *watching):
        run(page, out=tmp_path / name, observers=watching)
        return read_log(tmp_path / name / "run.mcap")

    def same(one, other):
        return compare_runs(one, other, within=None).same  # every number, event and frame

    alone = flight("alone")
    with GivenTime() as given:
        missing = Watched(LiveViewer(port=viewer.free_port()), given)
        assert same(flight("missing", missing), alone)
    assert missing.waited < 1.0
    assert len(warnings_of(caplog)) == 1
    for name, deed in (("killed", signal.SIGKILL), ("frozen", signal.SIGSTOP)):
        caplog.clear()
        seen = tmp_path / f"{name}.rrd"
        with saving_viewer(seen) as (program, port), GivenTime() as given:
            view = Watched(
                LiveViewer(port=port), given, 250, functools.partial(strike, program, deed, seen)
            )
            assert same(flight(name, view), alone)
            process = view.feeding
        # a frozen viewer is killed by now: the feeding process ends by itself
        process.wait(PATIENCE_S)
        assert view.frame == 501 and view.waited < 1.0
        assert len(warnings_of(caplog)) <= 1
        if name == "killed":
            assert "closed" in warnings_of(caplog)[0]


def strike(program, deed, seen):
    """What befalls a viewer that has begun to show."""
    until(lambda: seen.exists() and seen.stat().st_size >= 50_000)
    os.killpg(program.pid, deed)


def vulkan() -> bool:
    """Whether the viewer can draw without a screen."""
    drivers = [
        Path(root).glob("*.json") for root in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")
    ]
    return ctypes.util.find_library("vulkan") is not None and any(any(d) for d in drivers)


needs_vulkan = pytest.mark.skipif(
    not vulkan(), reason="no Vulkan driver: apt-get install mesa-vulkan-drivers"
)


def flown(page, folder):
    """A page flown for a while, read back from its log."""
    run(page, out=folder / "run")
    return read_log(folder / "run" / "run.mcap")


def flight_of(aircraft, folder):
    """Nobody flies a formation of one: its flight is made up."""
    if aircraft == 1:
        return views_flight.log(1, 20.0)
    page = load("bursty-wifi") if aircraft == 4 else views_flight.vee_page(aircraft - 1)
    return flown(shorten(page, 20.0), folder)


@needs_vulkan
@pytest.mark.parametrize("aircraft", [1, 4, 20])
def test_a_picture_shows_every_aircraft_and_no_view_complains(aircraft, tmp_path, monkeypatch):
    from PIL import Image

    folder = Path(os.environ.get("TESTBED_PICTURES", tmp_path))
    path = folder / f"view-{aircraft}.png"
    log = flight_of(aircraft, tmp_path)
    size = SIZE if folder != tmp_path else (960, 600)  # drawn in software: small is quick
    if folder == tmp_path:
        monkeypatch.setattr(shot, "GREETED_S", 0.0)
    shoot(path, log.time_s[-1] - 6.5, log, size=size)
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert picture.shape == (*size[::-1], 3)
    chase = picture[: picture.shape[0] // 2, : picture.shape[1] // 2]
    for k in range(min(aircraft, 8)):
        # Trails and wings keep the hue; the viewer's light only darkens it.
        near = np.abs(chase - scene.colour(k)).max(axis=-1) < 30
        assert near.sum() > 20, f"aircraft {k} is not in the picture"


@needs_vulkan
def test_a_view_that_complains_is_an_error(tmp_path, monkeypatch):

    real = layout.pictures

    def astray(*given, **named):
        return tuple(dataclasses.replace(one, origin="nowhere") for one in real(*given, **named))

    monkeypatch.setattr(layout, "pictures", astray)
    monkeypatch.setattr(shot, "GREETED_S", 0.0)
    with pytest.raises(ViewTroubleError, match="Formation"):
        shoot(tmp_path / "flight.png", 1.0, views_flight.log(2, 2.0), size=(640, 400))
