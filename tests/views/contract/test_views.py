"""Views show what was flown, cost little, and never disturb a run, whatever the viewer does."""

import contextlib
import ctypes.util
import dataclasses
import functools
import itertools
import json
import logging
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import views_flight
from cases import ALL, some
from fresh import run_fresh
from full_disk import full_disk
from places import ROOT
from process_time import ProcessTime
from waiting import TIMEOUT_S, until

from testbed import run
from testbed.core.records import Event
from testbed.golden.compare_runs import compare_runs
from testbed.logs.read import read_log
from testbed.scenario import load_scenario, set_duration
from testbed.views import (
    FAST_HZ,
    InMemory,
    LiveViewer,
    RerunView,
    RrdFile,
    layout,
    recorded_runs,
    replay,
    scene,
    screenshot,
    viewer,
)
from testbed.views.airframes import draw_airframe
from testbed.views.meshes import vertex_normals
from testbed.views.recorded_runs import SIZE, ViewComplaintError
from testbed.views.rerun_backend import RerunRecording
from testbed.views.sample_columns import Collector, batch_of

HERE = ROOT
BATCH_SAMPLES = 40


@pytest.fixture(autouse=True)
def long_timeouts(monkeypatch):
    """Allow for a busy machine, where programs start late and draw slowly."""
    monkeypatch.setattr(viewer, "START_S", TIMEOUT_S)
    monkeypatch.setattr(recorded_runs, "LIMIT_S", TIMEOUT_S)
    monkeypatch.setattr(recorded_runs, "LOADED_S", TIMEOUT_S)


@contextlib.contextmanager
def saving_viewer(path: Path):
    """Run a viewer that saves what it receives; yields the process and its port."""
    with viewer.guarded_viewer(viewer.rerun_program(), "--save", str(path)) as (process, port):
        assert process.poll() is None, "the viewer did not start"
        yield process, port


def fly(view: RerunView, samples, info) -> None:
    """Show samples."""
    view.begin(info)
    for sample in samples:
        view.observe(sample)


def rows_of(path: Path) -> int:
    """Count the rows in an .rrd file."""
    checked = subprocess.run(
        [viewer.rerun_program(), "rrd", "stats", str(path)],
        capture_output=True,
        text=True,
        check=True,
    )
    line = next(line for line in checked.stdout.splitlines() if line.startswith("num_rows ="))
    return int("".join(filter(str.isdigit, line)))  # the program groups digits with thin spaces


def warnings_of(caplog) -> list[str]:
    return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]


COUNT = """
stream = rerun.RecordingStream("x")
memory = stream.memory_recording()
stream.log("a", rerun.TextLog("b"))
stream.flush()
count = memory.num_msgs()
"""
FRESH = f"""
import json, sys
for name in [each for each in sys.modules if each.startswith(("scipy", "pydantic"))]:  # of `fresh`
    del sys.modules[name]
import testbed.views as v
v.RerunView(v.LiveViewer())
v.RrdFile("x")
loaded = sorted({{name.partition(".")[0] for name in sys.modules}})
import testbed.views.rerun_backend, rerun
{COUNT}
print(json.dumps([loaded, count]))
"""


@pytest.fixture(scope="module")
def fresh():
    """Packages that views load before one is opened, and messages of a recording.

    By a process with settings of the user: RERUN=off disables all recordings of a process.
    """
    user = os.environ | {"RERUN": "off", "RERUN_LOG_TICK": "1"}
    code, output, errors = run_fresh(FRESH, folder=HERE, paths=[HERE], env=user)
    assert code == 0, errors
    return json.loads(output)


def test_importing_views_does_not_import_rerun(fresh):
    """Nor SciPy and Pydantic, which take longer than all else that the process of a view loads."""
    loaded, _ = fresh
    assert "testbed" in loaded
    assert not {each for each in loaded if each.startswith(("rerun", "scipy", "pydantic"))}


def test_settings_of_the_user_empty_no_recording(fresh):
    found = {"rerun": pytest.importorskip("rerun")}
    exec(COUNT, found)
    assert fresh[1] == found["count"] > 0


def test_calls_per_batch_independent_of_samples():
    calls = []
    for duration_s in (3.0, 5.0):
        recording = RerunRecording(scene.scene_of(views_flight.info(4, duration_s)), live=True)
        recording.open(None)
        run = batch_of(views_flight.log(4, duration_s), ())
        recording.send(run.rows(slice(0, 50)))  # with the static part
        before = recording.calls
        recording.send(run.rows(slice(50, None)))
        calls.append(recording.calls - before)
    # poses, trails, control surfaces, slots; three frames, wind and links; names and scales of two
    # cameras, and a grid; plots with their limits
    assert calls[0] == calls[1] == 4 + 4 + 4 * 5 + 3 + 5 + 5 + 13 + 9


def test_view_sends_batch_when_full_or_period_over(monkeypatch):
    monkeypatch.setattr("testbed.views.view.BATCH_SAMPLES", BATCH_SAMPLES)
    sink = InMemory()
    view = RerunView(sink)
    sent = []
    view.begin(views_flight.info(2, 100.0))
    take = view._collector.take
    view._collector.take = lambda: sent.append(take()) or sent[-1]
    samples = [*itertools.islice(views_flight.samples(2, 2.0), BATCH_SAMPLES + 2)]
    view._next_send = np.inf
    for sample in samples[:BATCH_SAMPLES]:
        view.observe(sample)
    assert [len(batch) for batch in sent] == [BATCH_SAMPLES]
    view.observe(samples[BATCH_SAMPLES])
    view._next_send = 0.0
    view.observe(samples[BATCH_SAMPLES + 1])
    assert [len(batch) for batch in sent] == [BATCH_SAMPLES, 2]
    view.end({}, (Event(2.0, "warning", "run", "over"),))
    assert len(sent[2]) == 0 and sent[2].events[0].text == "over"


def test_max_hz_skips_samples_but_no_events():
    events = []

    def shown(max_hz):
        sink = InMemory()
        view = RerunView(sink, max_hz=max_hz)
        view.begin(views_flight.info(2, 10.0))
        view._next_send = np.inf  # one batch, however slow the machine is
        for k, sample in enumerate(views_flight.samples(2, 10.0)):
            if k in (3, 4):
                sample = sample._replace(events=(Event(sample.time_s, "info", "x", "y"),))
            view.observe(sample)
        batch = view._collector.take()
        events.append(batch.events)
        return batch.time, view._sink._scene.sample_rate_hz

    (every, rate), (some, lower) = shown(None), shown(FAST_HZ)
    assert rate == 25 and lower == 12.5
    assert np.array_equal(some, every[::2])
    assert len(events[0]) == 2 and events[0] == events[1]


def test_collector_copies_samples():
    samples = list(views_flight.samples(3, 1.0))
    collector = Collector(100)
    for sample in samples:
        for array in (sample.truth.position_ned, sample.formation.slot_ned, sample.truth.euler):
            array.setflags(write=False)
        collector.add(sample)
    samples[3].truth.position_ned.setflags(write=True)
    kept = samples[3].truth.position_ned.copy()
    samples[3].truth.position_ned[:] = np.nan
    batch = collector.take()
    np.testing.assert_array_equal(batch.position[3], kept)
    np.testing.assert_array_equal(batch.slot[5], samples[5].formation.slot_ned)
    assert len(collector.take()) == 0


@pytest.mark.parametrize("name", ["rascal110", "skywalker_x8", "an-unknown-airframe"])
def test_drawing_has_requested_wingspan(name):
    drawing = draw_airframe(name, 3.5)
    body = drawing.body
    assert np.ptp(body.vertices[:, 1]) == pytest.approx(3.5, rel=1e-3)
    assert body.vertices[:, 0].max() > 0.5 > -0.5 > body.vertices[:, 0].min()
    assert body.triangles.max() < len(body.vertices) == len(body.paint)
    np.testing.assert_allclose(np.linalg.norm(vertex_normals(body), axis=-1), 1.0, rtol=1e-9)


def test_drawing_has_right_wing_right_and_fin_up():
    vertices = draw_airframe("rascal110", 2.794).body.vertices
    tail = vertices[vertices[:, 0] < -0.8]
    assert -tail[:, 2].min() > 0.3  # z is down
    np.testing.assert_allclose(vertices[:, 1].max(), -vertices[:, 1].min(), rtol=1e-9)


def test_unwritable_rrd_file_raises_at_begin(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError, match="file"):
        RerunView(RrdFile(tmp_path / "file" / "run.rrd")).begin(views_flight.info(2, 1.0))


WHOLE_S = 60.0 if ALL else 6.0


@pytest.fixture(scope="module")
def whole_rows(tmp_path_factory):
    """Rows of a flight of four aircraft in a file."""
    path = tmp_path_factory.mktemp("whole") / "run.rrd"
    replay(RrdFile(path), views_flight.log(4, WHOLE_S))
    return rows_of(path)


def test_replay_to_rrd_has_every_sample(whole_rows):
    assert whole_rows > 25 * WHOLE_S * (4 + 3 + 1 + 4)  # poses and four plots of every sample


def test_no_display_gives_one_warning(monkeypatch, caplog):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    view = RerunView(LiveViewer(port=viewer.free_port()))
    fly(view, views_flight.samples(2, 1.0), views_flight.info(2, 1.0))
    view.end({}, ())
    assert len(warnings_of(caplog)) == 1 and "--rrd FILE" in warnings_of(caplog)[0]


def test_no_rerun_program_gives_one_warning(monkeypatch, caplog):
    monkeypatch.setattr(sys, "executable", "/nowhere/bin/python")
    view = RerunView(LiveViewer(port=viewer.free_port()))
    fly(view, views_flight.samples(2, 1.0), views_flight.info(2, 1.0))
    view.end({}, ())
    assert len(warnings_of(caplog)) == 1 and "no `rerun` program" in warnings_of(caplog)[0]


def test_viewer_not_starting_gives_one_warning(monkeypatch, caplog, tmp_path):
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setenv("DISPLAY", ":never")
    monkeypatch.setattr(viewer, "rerun_program", lambda: str(broken))
    port = viewer.free_port()
    # the feeding process looks beside its own interpreter: give it the broken program there
    patched = f"import testbed.views.viewer as v; v.rerun_program = lambda: {str(broken)!r}"
    (tmp_path / "sitecustomize.py").write_text(patched)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path) + os.pathsep + str(HERE))
    view = RerunView(LiveViewer(port=port))
    fly(view, views_flight.samples(2, 1.0), views_flight.info(2, 1.0))
    view._sink.process.wait(TIMEOUT_S)
    view.end({}, ())
    assert len(warnings_of(caplog)) == 1 and "did not start" in warnings_of(caplog)[0]


def test_live_viewer_gets_every_sample_ends_quickly(caplog, tmp_path, whole_rows):
    seen, rows = tmp_path / "seen.rrd", whole_rows
    info, samples = views_flight.info(4, WHOLE_S), list(views_flight.samples(4, WHOLE_S))
    with saving_viewer(seen) as (program, port), ProcessTime() as given:
        view = RerunView(LiveViewer(port=port))
        fly(view, samples, info)
        process = view._sink.process
        start = given.now_s
        view.end({}, ())
        assert given.now_s - start < 1.0
        assert process.wait(TIMEOUT_S) == 0
        # the viewer may save later what it received
        until(lambda: rows_of(seen) > rows - 50)
        os.killpg(program.pid, signal.SIGTERM)
        program.wait(TIMEOUT_S)
    assert warnings_of(caplog) == []
    # other batch sizes have a few more rows: the two ends of each limit
    assert rows - 50 < rows_of(seen) < rows + 50


class Watched(RerunView):
    """A view that measures what the run waited for it, and calls a function in flight."""

    def __init__(self, target, given, at_sample=None, action=None):
        super().__init__(target)
        self.given, self.at_sample, self.action = given, at_sample, action
        self.sample, self.waited = 0, 0.0

    def timed(self, method, *arguments):
        start = self.given.now_s
        method(*arguments)
        self.waited += self.given.now_s - start

    def begin(self, info):
        self.timed(super().begin, info)
        self.feeding = getattr(self._sink, "process", None)

    def observe(self, sample):
        if self.sample == self.at_sample:
            self.action()
        if self.sample + 1 == self.at_sample:
            self._next_send = 0.0  # something has been sent by then
        self.sample += 1
        self.timed(super().observe, sample)

    def end(self, summary, events):
        self.timed(super().end, summary, events)


def test_failing_viewers_do_not_change_or_delay_run(monkeypatch, tmp_path, caplog):
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    page = set_duration(load_scenario("simulation-3"), 6.0)

    def flight(name, *watching):
        run(page, out=tmp_path / name, observers=watching)
        return read_log(tmp_path / name / "run.mcap")

    def same(one, other):
        return compare_runs(one, other, tolerance=None).same  # every number, event and sample

    alone = flight("alone")
    with ProcessTime() as given, contextlib.ExitStack() as viewers:
        views = [Watched(LiveViewer(port=viewer.free_port()), given)]  # of a missing viewer
        for at, number in ((75, signal.SIGKILL), (100, signal.SIGSTOP)):
            seen = tmp_path / f"{number}.rrd"
            program, port = viewers.enter_context(saving_viewer(seen))
            action = functools.partial(strike, program, number, seen)
            views.append(Watched(LiveViewer(port=port), given, at, action))
        assert same(flight("watched", *views), alone)
    # the frozen viewer is killed by now, and the feeding processes end by themselves
    missing, killed, frozen = views
    for view in (killed, frozen):
        view.feeding.wait(TIMEOUT_S)
        assert view.sample == 151
    assert sum(each.waited for each in views) < 1.0
    texts = warnings_of(caplog)
    assert len([each for each in texts if "--rrd FILE" in each]) == 1
    assert len([each for each in texts if "closed" in each]) in (1, 2)
    assert len(texts) <= 3


def strike(program, number, seen):
    """Send a signal to a viewer that has started to show."""
    until(lambda: seen.exists() and seen.stat().st_size >= 50_000)
    os.killpg(program.pid, number)


def vulkan() -> bool:
    """Check whether the viewer can draw without a screen."""
    drivers = [
        Path(root).glob("*.json") for root in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")
    ]
    return ctypes.util.find_library("vulkan") is not None and any(any(d) for d in drivers)


needs_vulkan = pytest.mark.skipif(
    not vulkan(), reason="no Vulkan driver: apt-get install mesa-vulkan-drivers"
)


def flown(page, folder):
    """Fly a scenario and read its log back."""
    run(page, out=folder / "run")
    return read_log(folder / "run" / "run.mcap")


def flight_of(aircraft, folder):
    """Fly a formation; of one aircraft, use the artificial flight."""
    if aircraft == 1:
        return views_flight.log(1, 20.0)
    page = load_scenario("bursty-wifi") if aircraft == 4 else views_flight.vee_page(aircraft - 1)
    return flown(set_duration(page, 20.0), folder)


@needs_vulkan
@pytest.mark.parametrize("aircraft", some([1, 4, 20], 1))
def test_picture_shows_every_aircraft(aircraft, tmp_path, monkeypatch):
    from PIL import Image

    shown = os.environ.get("TESTBED_PICTURES") if aircraft > 1 else None  # 1: not in the docs
    folder = Path(shown or tmp_path)
    path = folder / f"view-{aircraft}.png"
    log = flight_of(aircraft, tmp_path)
    size = SIZE if folder != tmp_path else (960, 600)  # rendering in software is slow
    if folder == tmp_path:
        monkeypatch.setattr(recorded_runs, "GREETING_S", 0.0)
    screenshot(path, log.time_s[-1] - 6.5, log, size=size)
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    assert picture.shape == (*size[::-1], 3)
    chase = picture[: picture.shape[0] // 2, : picture.shape[1] // 2]
    for k in range(min(aircraft, 8)):
        # trails and wings keep the hue; the viewer's light only darkens it
        near = np.abs(chase - scene.fleet_colours(aircraft)[k]).max(axis=-1) < 30
        assert near.sum() > 20, f"aircraft {k} is not in the picture"


@needs_vulkan
def test_screenshot_on_a_full_disk_keeps_old_file(tmp_path, monkeypatch):
    started = recorded_runs.headless_viewer

    @contextlib.contextmanager
    def then_full(*arguments, **options):
        with started(*arguments, **options) as port:
            disk.enter_context(full_disk(100))  # for what this process writes from now on
            yield port

    monkeypatch.setattr(recorded_runs, "headless_viewer", then_full)
    monkeypatch.setattr(recorded_runs, "GREETING_S", 0.0)
    path = tmp_path / "flight.png"
    path.write_text("old")
    with contextlib.ExitStack() as disk, pytest.raises(OSError, match="File too large"):
        screenshot(path, 1.0, views_flight.log(2, 2.0), size=(320, 200))
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]


@needs_vulkan
def test_viewer_asks_no_other_machine(monkeypatch):
    """The viewer's only request, for a newer version, goes to the proxy, which does not exist."""
    assert not viewer.is_listening(int(viewer.PROXY.rpartition(":")[2]))
    with socket.create_server((viewer.HOST, 0)) as proxy:
        proxy.settimeout(TIMEOUT_S)
        monkeypatch.setattr(viewer, "PROXY", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        with viewer.headless_viewer((320, 200)):
            connection, _ = proxy.accept()
            with connection:
                request = b"CONNECT api.github.com:443 "  # may come in pieces
                assert connection.recv(len(request), socket.MSG_WAITALL) == request


@needs_vulkan
def test_screenshot_with_view_error_raises(tmp_path, monkeypatch):

    original = layout.views_3d

    def broken(*args):
        return tuple(dataclasses.replace(view, origin="nowhere") for view in original(*args))

    monkeypatch.setattr(layout, "views_3d", broken)
    monkeypatch.setattr(recorded_runs, "GREETING_S", 0.0)
    with pytest.raises(ViewComplaintError, match="Formation"):
        screenshot(tmp_path / "flight.png", 1.0, views_flight.log(2, 2.0), size=(640, 400))
