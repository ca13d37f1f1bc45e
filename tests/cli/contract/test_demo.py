"""The command `demo` flies, films and reports in one."""

import pytest
from cases import ALL
from commands import call_command
from PIL import Image

from testbed.cli import demo
from testbed.reports import figures


@pytest.fixture
def short(monkeypatch):
    """Fly and film as little as shows an error."""
    for name, value in {
        "DURATION_S": 3.5,
        "JOINED_S": 2.0,
        "FILM_S": (2.4, 3.4 if ALL else 2.8),
        "FILM_PX": (320, 180),
        "FILM_FPS": 5,
        "PICTURE_PX": (640, 360),
        "PICTURE_S": 3.0,
    }.items():
        monkeypatch.setattr(demo, name, value)
    if not ALL:
        monkeypatch.setattr(figures, "MAKERS", figures.MAKERS[:1])  # drawing all takes seconds


def test_demo_writes_film_picture_and_report(short, tmp_path):
    done = call_command("demo", "--out", "it", cwd=tmp_path, code=0, columns=80)
    assert list(tmp_path.iterdir()) == [tmp_path / "it"]
    assert (tmp_path / "it/demo.mp4").read_bytes()[4:8] == b"ftyp"
    with Image.open(tmp_path / "it/demo.png") as picture:
        assert picture.size == (640, 360)
    assert "<svg" in (tmp_path / "it/report.html").read_text("utf-8")
    assert (tmp_path / "it/run.mcap").exists()
    lines = done.stdout.splitlines()
    assert lines[0].startswith(" error    ") and "m RMS from 2 s on (uav1 " in lines[0]
    assert any("testbed view it --web" in line for line in lines)
    assert " H.264    ffmpeg -i it/demo.mp4 -c:v libx264 " in done.stdout
    assert max(map(len, lines)) <= 80
    assert [each for each in done.stderr.splitlines() if each[1:3] == "/4"] == [
        "1/4 fly", "2/4 film", "3/4 picture", "4/4 report",
    ]  # fmt: skip
    again = call_command("demo", "--out", "it", cwd=tmp_path, code=2, columns=80)
    assert "it" in again.stderr and "fly" in again.stderr
    assert again.stdout == ""


def test_demo_without_window_has_no_error():
    """A flight that ends before the time from which errors count has no error."""
    assert demo._errors({"windows": {}}) == "none: the formation was not complete"
