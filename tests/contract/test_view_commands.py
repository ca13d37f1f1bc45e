"""The commands that look at runs: what they refuse, and that nothing is opened or written then."""

import subprocess

import pytest
from commands import call_command
from record_flight import record, run_frames, run_info

from testbed.outputs import size_of
from testbed.views import LiveViewer, viewer


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    folder = tmp_path_factory.mktemp("flown")
    record(folder / "run.mcap", run_frames(60), run_info())  # 0 to 2.36 s
    record(folder / "short.mcap", run_frames(20), run_info())
    record(folder / "empty.mcap", [], run_info())
    return folder


@pytest.fixture
def command(flown, tmp_path):
    def call(*arguments, code=2):
        said = call_command(*arguments, cwd=flown, code=code, columns=200)
        return said.stderr + said.stdout

    before = sorted(flown.iterdir())
    yield call
    assert sorted(flown.iterdir()) == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("view", "nowhere"), "nowhere"),
        (("view", "empty.mcap", "--rrd", "it.rrd"), "no frame"),
        (("view", "run.mcap", "--at", "1", "--rrd", "it.rrd"), "testbed shot run.mcap --at 1"),
        (("view", "run.mcap", "--at", "2.4"), "from 0 to 2.36 s"),
        (("view", "run.mcap", "--at", "nan"), "from 0 to 2.36 s"),
        (("view", "run.mcap", "--rrd", "run.mcap/it.rrd"), "--rrd run.mcap/it.rrd: "),
        (("view", "run.mcap", "--rrd", "no/it.rrd"), "no folder"),
        (("view", "run.mcap", "--rrd", "-"), "goes to a file"),
        (("compare", "run.mcap", "short.mcap", "--rrd", "no/it.rrd"), "no folder"),
        (("shot", "run.mcap", "--out", "it.jpg"), "ends in .png"),
        (("shot", "run.mcap", "--out", "no/it.png"), "no folder"),
        (("shot", "run.mcap", "--out", "it.png", "--size", "10x10"), "1600x900"),
        (("shot", "run.mcap", "--out", "it.png", "--at", "-1"), "from 0 to 2.36 s"),
        (("shot", "run.mcap", "short.mcap", "--out", "it.png", "--at", "2"), "from 0 to 0.76 s"),
    ],
)
def test_what_cannot_be_shown_is_refused_with_what_to_write(command, arguments, message):
    assert message in command(*arguments)


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
def test_a_view_that_nobody_can_see_is_bad_input(command, monkeypatch, name, runs, ways):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(viewer.sys, "platform", "linux")
    monkeypatch.setattr(viewer, "listening", lambda port: False)
    said = command(name, *runs)
    assert all(way in said for way in ways)


def test_a_picture_without_a_driver_says_what_to_install(command, monkeypatch, tmp_path):
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(viewer, "program", lambda: str(broken))
    assert "mesa-vulkan-drivers" in command("shot", "run.mcap", "--out", str(tmp_path / "it.png"))
    monkeypatch.setattr(viewer, "program", lambda: None)
    assert "install rerun-sdk" in command("shot", "run.mcap", "--out", str(tmp_path / "it.png"))


def test_a_replay_at_a_time_leaves_the_cursor_there(command, monkeypatch):
    seen = []
    monkeypatch.setattr("testbed.view_console.obstacle", lambda port: None)
    monkeypatch.setattr(LiveViewer, "open", lambda self, still: seen.append(self))
    command("view", "run.mcap", "--at", "1.5", code=0)
    assert seen == [LiveViewer(patient=True, at_s=1.5)]


def test_a_recording_has_every_frame_of_the_run(command, tmp_path):
    told = command("view", "run.mcap", "--rrd", str(tmp_path / "it.rrd"), code=0)
    assert told.startswith(f"{tmp_path / 'it.rrd'}: {size_of(tmp_path / 'it.rrd')}, ")
    said = subprocess.run(
        [viewer.program(), "rrd", "stats", str(tmp_path / "it.rrd")],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    rows = next(line for line in said.splitlines() if line.startswith("num_rows ="))
    # poses of the aircraft, slots, the camera, and more than ten plots of 60 frames
    assert int("".join(filter(str.isdigit, rows))) > 60 * (4 + 3 + 1 + 10)


def test_a_picture_is_said_with_its_size(command, monkeypatch, tmp_path):
    monkeypatch.setattr(
        "testbed.view_console.shoot", lambda path, *_, **__: path.write_bytes(bytes(12_345))
    )
    said = command("shot", "run.mcap", "--out", str(tmp_path / "it.png"), code=0)
    assert said.strip() == f"{tmp_path / 'it.png'}: 12 kB"


@pytest.mark.parametrize(
    ("size", "said"),
    [
        (0, "0 bytes"),
        (999, "999 bytes"),
        (1000, "1.0 kB"),
        (9_960, "10 kB"),
        (999_600, "1.0 MB"),
        (45_314_786, "45 MB"),
        (4_100_000_000, "4,100 MB"),
    ],
)
def test_sizes_are_said_in_words(tmp_path, size, said):
    with (tmp_path / "it").open("wb") as file:
        file.truncate(size)
    assert size_of(tmp_path / "it") == said
