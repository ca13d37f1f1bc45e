"""A video shows every aircraft, in a file that other programs play."""

import copy
import dataclasses
import functools
import io
import shutil
import struct
import subprocess

import numpy as np
import pytest
import views_flight
from cases import in_full
from commands import call_command, refuse_all
from PIL import Image, ImageSequence
from record_flight import record, run_info, run_samples

from testbed.cli.video import choose_frames
from testbed.core.errors import InputError
from testbed.views.annotations import LOST, Canvas
from testbed.views.cameras import BEHIND, FormationCameras
from testbed.views.flight_map import FlightMap
from testbed.views.landscape import eye_of, grid_lines, grid_step
from testbed.views.pillow_backend import FINER, Drawing, mp4_from_avif, save_video
from testbed.views.recorded_runs import scene_and_batch
from testbed.views.video import RED, FlightVideo, short_length
from testbed.views.video_view import VideoView


def boxes(data, start=0, end=None):
    """Read the boxes of an MP4 file as pairs of path and content."""
    end = len(data) if end is None else end
    while start < end:
        size, kind = struct.unpack_from(">I4s", data, start)
        yield kind.decode(), data[start + 8 : start + size]
        if kind in (b"moov", b"trak", b"mdia"):
            for path, content in boxes(data, start + 8, start + size):
                yield f"{kind.decode()}/{path}", content
        start += size


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown")
    record(folder / "run.mcap", run_samples(60), run_info())  # 0 to 2.36 s
    return folder


def test_mp4_has_the_frames_of_the_avif_as_video():
    content = io.BytesIO()
    shades = [Image.new("RGB", (64, 48), (40 * k, 90, 200 - 40 * k)) for k in range(5)]
    shades[0].save(content, "AVIF", save_all=True, append_images=shades[1:], duration=40)
    avif = content.getvalue()
    mp4 = mp4_from_avif(avif)
    assert len(mp4) == len(avif)
    before, after = dict(boxes(avif)), dict(boxes(mp4))
    assert after["mdat"] == before["mdat"], "the pictures are the same bytes"
    assert after["ftyp"].startswith(b"isom") and b"av01" in after["ftyp"]
    assert "meta" not in after and "moov/trak/edts" not in after
    assert after["moov/trak/mdia/hdlr"][8:12] == b"vide"
    timescale, duration = struct.unpack_from(">IQ", after["moov/trak/mdia/mdhd"], 20)
    assert duration / timescale == pytest.approx(0.2)
    assert struct.unpack_from(">Q", after["moov/mvhd"], 24) == (duration,)
    assert struct.unpack_from(">Q", after["moov/trak/tkhd"], 28) == (duration,)


@pytest.mark.parametrize("suffix", [".mp4", ".gif", ".png"])
def test_video_command_writes_frames(flown, tmp_path, suffix):
    path = tmp_path / f"it{suffix}"
    options = ("--from", "1", "--to", "1.4", "--speed", "0.5", "--fps", "5", "--size", "240x160")
    done = call_command("video", "run.mcap", "--out", path, *options, cwd=flown, code=0, columns=99)
    assert f"{path}: " in done.stderr and "1.0 s of" in done.stderr
    assert list(tmp_path.iterdir()) == [path]
    assert ("-c:v libx264" in done.stderr) is (suffix == ".mp4")
    if suffix != ".mp4":
        with Image.open(path) as video:
            frames = [frame.copy() for frame in ImageSequence.Iterator(video)]
            assert video.size == (240, 160)
        assert sum(frame.info["duration"] for frame in frames) == pytest.approx(5 * 200)
        assert len(frames) > 3, "it moves"
        return
    assert dict(boxes(path.read_bytes()))["ftyp"].startswith(b"isom")
    if probe := shutil.which("ffprobe"):
        entries = "stream=codec_name,width,height,nb_frames:format=duration"
        command = [probe, "-v", "error", "-show_entries", entries, "-of", "csv=p=0", str(path)]
        shown = subprocess.run(command, capture_output=True, text=True, check=True)
        assert shown.stderr == "" and shown.stdout.split() == ["av1,240,160,5", "1.000000"]


def test_video_command_refuses_bad_input(flown):
    refuse_all("video", flown)


def test_too_long_gif_is_refused():
    class Picture:
        def finish(self):
            return Image.new("RGB", (1920, 1080))

    with pytest.raises(InputError, match="write a .mp4"):
        save_video(io.BytesIO(), ".gif", lambda number: Picture(), 1000, 40, [])


@functools.cache
def flight_of(aircraft):
    return scene_and_batch(views_flight.log(aircraft, 8.0))


@pytest.fixture
def flight():
    """Scene and samples of four aircraft, which a test may change."""
    return copy.deepcopy(flight_of(4))


@pytest.mark.parametrize("aircraft", [4, pytest.param(20, marks=in_full)])
def test_frame_shows_every_aircraft_twice(aircraft):
    scene, batch = flight_of(aircraft)
    video = FlightVideo(scene, batch, np.array([150]), (960, 540))
    picture = np.asarray(video.frame(0).finish()).astype(int)
    assert picture.shape == (540, 960, 3)
    left = round(0.68 * 960)
    for k, colour in enumerate(scene.colours):
        for part in (picture[:, :left], picture[:, left:]):
            shades = [
                np.abs(part - np.multiply(colour, tone)).max(axis=-1) for tone in (1, 0.9, 0.8)
            ]
            assert (np.min(shades, axis=0) < 14).sum() > 5, f"aircraft {k} is not in the picture"
    assert len(video.colours) <= 256


def drawn(scene, batch, row=150):
    return np.asarray(FlightVideo(scene, batch, np.array([row]), (960, 540)).frame(0).finish())


def test_aircraft_in_slot_is_drawn_over_slot(flight):
    scene, batch = flight
    batch.slot[:] = np.nan
    without = drawn(scene, batch)
    batch.slot[:] = batch.position[:, 1:]
    batch.slot[..., 1] += 1e-3  # m nearer to a camera, whose sorting by depth hid the aircraft
    batch.slot[..., 2] -= 1e-3
    behind = drawn(scene, batch)
    for colour in scene.colours[1:]:
        seen = [(np.abs(each.astype(int) - colour).max(axis=-1) < 30).sum()
                for each in (without, behind)]  # fmt: skip
        assert seen[1] > 0.9 * seen[0] > 50


def test_frame_names_lost_aircraft_twice(flight):
    """Both marks and the line above the pictures name the lost aircraft."""
    scene, batch = flight
    lost = batch.lost.copy()
    lost[150:, 2] = 1.0
    texts = []
    video = FlightVideo(scene, dataclasses.replace(batch, lost=lost), np.array([150]), (960, 540))
    original = Drawing.text

    def record_text(self, middle, text, colour, **options):
        texts.append((text, colour))
        original(self, middle, text, colour, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Drawing, "text", record_text)
        video.frame(0)
    assert texts.count(("uav2 lost", RED)) == 3, "by both marks, and above"
    assert "uav2" not in [text for text, _ in texts]


def test_horizon_is_where_level_ground_ends(flight):
    scene, batch = flight
    track = FormationCameras(scene, (BEHIND,), 1.0).track(batch)[0]
    view = VideoView.of(track, Canvas(640.0, 480.0))
    eye, ahead = eye_of(track.rows(slice(0, 1))), track.heading[0]
    far = eye + 1e7 * np.array([np.cos(ahead), np.sin(ahead), 0.0])
    row = FINER * view.pixels(0, far[None])[0][0, 1]
    assert 0.1 < row / len(view.rows) < 0.3
    red, _, blue = view.rows[: int(row) - 1].astype(int).T
    assert (blue > red + 10).all(), "sky"
    red, green, blue = view.rows[int(row) + 1 :].astype(int).T
    assert (green > red).all() and (blue < green + 5).all(), "ground"


def test_lines_on_ground_stand_still():
    eyes = np.array([[0.0, 0.0, -100.0], [13.0, -7.0, -100.0]])
    at = [grid_lines(eye, 20.0) for eye in eyes]
    for each, eye in zip(at, eyes, strict=True):
        assert (each.ends[..., :2] % 20.0 == 0.0).all() and (each.ends[..., 2] == 0.0).all()
        assert (each.ends[each.broad][..., :2] % 100.0 == 0.0).all()
        away = np.linalg.norm(each.ends.mean(axis=1)[:, :2] - eye[:2], axis=-1)
        assert each.strength[away.argmin()] > 3.0 * each.strength[away.argmax()]
    assert [grid_step(height) for height in (100.0, 30.0, 1000.0, 0.0)] == [20.0, 5.0, 200.0, 0.2]


@pytest.mark.parametrize(("lost_at", "red"), [(100, False), (148, True)])
def test_only_recent_losses_are_red(flight, lost_at, red):
    """In the first frame, too, which is in the middle of the flight."""
    scene, batch = flight
    sent = batch.sent.copy()
    sent[lost_at:, 0, 0] = 1.0
    video = FlightVideo(scene, dataclasses.replace(batch, sent=sent), np.array([150]), (960, 540))
    assert (video._lines.colours == LOST).all(axis=-1).any() == red


@pytest.mark.parametrize("path", [True, False], ids=["commanded path", "no path"])
def test_map_shows_where_and_how_high_aircraft_are(flight, path):
    scene, batch = flight
    if not path:
        scene = dataclasses.replace(scene, paths=())
    lost = dataclasses.replace(batch, lost=np.ones_like(batch.lost))
    joined = []
    for each in (batch, lost):
        drawing = FlightMap(scene, each, np.array([150]), Canvas(400.0, 300.0))
        picture = np.asarray(drawing.draw(0).finish()).astype(int)
        at = each.position[150, 0]
        pixels, _ = drawing._view.pixels(0, np.stack([at, at * [1.0, 1.0, 0.0]]))
        assert pixels[1, 1] > pixels[0, 1] + 10.0, "the ground is below"
        x, y = pixels[0].round().astype(int)
        colour = LOST if each is lost else scene.colours[0]
        assert np.abs(picture[y, x] - colour).max() < 40
        share = np.linspace(0.3, 0.7, 20)[:, None]
        x, y = ((1.0 - share) * pixels[0] + share * pixels[1]).round().astype(int).T
        near = [picture[y, x + aside].max(axis=-1) for aside in (-1, 0, 1)]
        joined.append((np.max(near, axis=0) > 80).mean())
    assert joined[0] == 1.0 and joined[1] < 0.8, "a line joins aircraft in flight with the ground"


def test_short_length_has_three_or_four_digits():
    assert [short_length(each) for each in (0.123, 9.99, 10.26, 99.9, 1068.38)] == [
        "0.12", "9.99", "10.3", "99.9", "1068",
    ]  # fmt: skip


def test_default_speed_makes_video_of_thirty_seconds():
    time = np.arange(0.0, 1080.0, 0.04)
    rows = choose_frames(time, None, None, None, 25)
    assert len(rows) == 751 and rows[0] == 0 and time[rows[-1]] == pytest.approx(1079.96, abs=0.04)
    assert np.array_equal(choose_frames(time, 10.0, 12.0, None, 25), np.arange(250, 301))
