"""`testbed delay`: its table, JSON, figure and errors."""

import json
from dataclasses import replace

import numpy as np
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from commands import call_command, refuse_all
from figure_texts import write_texts
from small_study import in_this_process

from testbed.views.delay_figure import FollowerOffsets, delay_figure


def test_delay_command_predicts(tmp_path, monkeypatch):
    """Both origins of the extrapolation, for each follower; a figure where there is no flight."""
    write_texts(monkeypatch)
    words = ("delay", "simulation-2", "--delays", "0.1,0.4", "--bank", "20")
    with in_this_process():
        done = call_command(
            *words, "--json", "offsets.json", "--plot", "f.svg", cwd=tmp_path, code=0, columns=80
        )
    assert "uav3" in done.stdout and max(map(len, done.stdout.splitlines())) <= 80
    found = json.loads((tmp_path / "offsets.json").read_text("utf-8"))["offsets"]
    origins = [(each["delay_s"], each["extrapolate_from"]) for each in found]
    assert origins == [
        *((0.1, "receipt"), (0.1, "timestamp"), (0.4, "receipt"), (0.4, "timestamp"))
    ]
    forward = [each["predicted"]["offset_m"]["uav1"]["forward"] for each in found]
    assert -2.4 < forward[0] < -2.0 < forward[1] < 0.0 and forward[2] < -8.0
    assert all(each["flown"] is None for each in found)
    assert "extrapolated from receipt" in (tmp_path / "f.svg").read_text("utf-8")


def test_delay_command_refuses(tmp_path):
    refuse_all("delay", tmp_path)


def test_figure_has_no_curve_without_numbers():
    """Nor a panel that shows rounding: a law of one's own has no prediction, and flies straight."""
    delays, unknown = np.array([0.1, 0.3]), np.full((2, 3), np.nan)
    flown = np.array([[-2.0, 4e-9, 0.0], [-6.0, -8e-9, 0.0]])
    offsets = FollowerOffsets("uav1", delays, {"law": unknown}, {"law": flown})
    ((forward,),) = delay_figure("title", "", [offsets]).rows
    assert [each.label for each in forward.lines] == ["uav1, flown"]
    turned = replace(offsets, flown={"law": flown + np.array([0.0, 0.5, 0.0])})
    assert len(delay_figure("title", "", [turned]).rows) == 2
