"""The commands `view`, `shot` and `compare`: results, and refusals that change no file."""

import subprocess

import pytest
from commands import call_command, refuse_all
from PIL import Image
from record_flight import record, run_info, run_samples

from testbed.cli.output import format_size
from testbed.views import LiveViewer, viewer


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown")
    record(folder / "run.mcap", run_samples(60), run_info())  # 0 to 2.36 s
    record(folder / "short.mcap", run_samples(20), run_info())
    record(folder / "empty.mcap", [], run_info())
    return folder


@pytest.fixture
def command(flown, tmp_path):
    def call(*arguments, code=2):
        done = call_command(*arguments, cwd=flown, code=code, columns=200)
        return done.stderr + done.stdout

    before = sorted(flown.iterdir())
    yield call
    assert sorted(flown.iterdir()) == before


def test_view_commands_refuse_bad_input(flown):
    refuse_all("view", flown)


@pytest.mark.parametrize(
    ("name", "runs", "ways"),
    [
        ("view", ("run.mcap",), ("testbed shot run.mcap --out", "testbed view run.mcap --rrd")),
        (
            "compare",
            ("run.mcap", "short.mcap"),
            (
                "testbed shot run.mcap short.mcap --out",
                "testbed compare run.mcap short.mcap --rrd",
                "testbed compare run.mcap short.mcap --numbers",
            ),
        ),
    ],
)
def test_view_without_display_is_bad_input(command, monkeypatch, name, runs, ways):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    monkeypatch.setattr(viewer, "is_listening", lambda port: False)
    output = command(name, *runs)
    assert all(way in output for way in ways)


@pytest.mark.parametrize(
    ("program", "remedy"),
    [("#!/bin/sh\nexit 1\n", "mesa-vulkan-drivers"), (None, 'install "formation-testbed[view]"')],
    ids=["no driver", "no viewer"],
)
def test_shot_without_viewer_is_drawn_anyway(command, monkeypatch, tmp_path, program, remedy):
    broken = tmp_path / "rerun"
    if program is not None:
        broken.write_text(program)
        broken.chmod(0o755)
    monkeypatch.setattr(viewer, "rerun_program", lambda: str(broken) if program else None)
    shot = ("shot", "run.mcap", "--at", "2", "--size", "640x360", "--out", tmp_path / "it.png")
    output = command(*shot, code=0)
    assert (
        remedy in output
        and "drawn by the software renderer" in output
        and "transport" not in output
    )
    with Image.open(tmp_path / "it.png") as picture:
        assert picture.size == (640, 360)
    (tmp_path / "it.png").unlink()
    output = command(*shot, "--renderer", "rerun", code=2)
    assert remedy in output and "--renderer software" in output
    assert not (tmp_path / "it.png").exists()


def test_shot_of_two_runs_needs_no_viewer(command, monkeypatch, tmp_path):
    monkeypatch.setattr(viewer, "rerun_program", None)  # calling it would fail
    path = tmp_path / "it.png"
    command("shot", "run.mcap", "short.mcap", "--renderer", "software", "--out", path, code=0)
    with Image.open(path) as picture:
        assert picture.size == (1920, 1080)


def test_unwritable_picture_names_the_file(command, monkeypatch, tmp_path):
    """A failure of the file is not one of the viewer, and the other way round."""

    def full(path, *_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("testbed.views.screenshot", full)
    output = command("shot", "run.mcap", "--out", str(tmp_path / "it.png"))
    assert f"--out {tmp_path / 'it.png'}: cannot be written: No space left on device" in output


def test_view_at_time_sets_cursor(command, monkeypatch):
    seen = []
    monkeypatch.setattr("testbed.views.viewer.unavailable_reason", lambda port: None)
    monkeypatch.setattr(LiveViewer, "open", lambda self, scene: seen.append(self))
    command("view", "run.mcap", "--at", "1.5", code=0)
    assert seen == [LiveViewer(lossless=True, at_s=1.5)]


def test_view_rrd_has_every_sample(command, tmp_path):
    output = command("view", "run.mcap", "--rrd", str(tmp_path / "it.rrd"), code=0)
    assert output.startswith(f"{tmp_path / 'it.rrd'}: {format_size(tmp_path / 'it.rrd')}, ")
    stats = subprocess.run(
        [viewer.rerun_program(), "rrd", "stats", str(tmp_path / "it.rrd")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    rows = next(line for line in stats.splitlines() if line.startswith("num_rows ="))
    # poses of the aircraft, slots, the camera, and more than ten plots of 60 samples
    assert int("".join(filter(str.isdigit, rows))) > 60 * (4 + 3 + 1 + 10)


def test_shot_prints_file_size(command, monkeypatch, tmp_path):
    monkeypatch.setattr(
        "testbed.views.screenshot",
        lambda path, *_, **__: path.write_bytes(bytes(12_345)),
    )
    output = command("shot", "run.mcap", "--out", str(tmp_path / "it.png"), code=0)
    assert output.strip() == f"{tmp_path / 'it.png'}: 12 kB"


@pytest.mark.parametrize(
    ("size", "text"),
    [
        (0, "0 bytes"),
        (999, "999 bytes"),
        (1000, "1.0 kB"),
        (9_960, "10 kB"),
        (999_600, "1.0 MB"),
        (45_314_786, "45 MB"),
        (4_100_000_000, "4.1 GB"),
    ],
)
def test_format_size(tmp_path, size, text):
    with (tmp_path / "it").open("wb") as file:
        file.truncate(size)
    assert format_size(tmp_path / "it") == text
