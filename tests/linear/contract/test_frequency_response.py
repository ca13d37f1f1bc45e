"""`testbed frequency-response`: its table, JSON, figure and errors."""

import json

import pytest
from cases import ALL
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from commands import call_command, refuse_all
from figure_texts import write_texts
from slow_control import RATES
from small_study import in_this_process

from testbed.linear import straight_formation


def test_frequency_response_writes_json_and_figure(tmp_path, monkeypatch):
    """Predicted only; the gain per hop is the amplitude over that of the follower ahead."""
    if not ALL:  # the integral of the course settles for longer, but hardly moves here
        monkeypatch.setattr(straight_formation, "SETTLED_S", 45.0)
    write_texts(monkeypatch)
    words = ("frequency-response", "simulation-3", "--plot", "figure.png", "--json", "out.json")
    words += tuple(word for each in RATES for word in ("--set", each))
    with in_this_process():
        text = call_command(*words, "--jobs", "1", cwd=tmp_path, code=0, columns=120).stdout
    assert "leader-speed · slot-error" in text and "uav3" in text
    kind, *texts = (tmp_path / "figure.png").read_text("utf-8").splitlines()
    assert kind.startswith("png") and "uav3" in texts
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["schema"] == 1 and "flown" not in found
    followers = found["predicted"]["followers"]
    assert len(found["predicted"]["frequency_hz"]) == len(followers["uav1"]["amplitude"])
    first, second = followers["uav1"], followers["uav2"]
    assert second["ahead"] == "uav1" and set(first["per_hop"]) == {None}
    for hop, own, other in zip(
        second["per_hop"], second["amplitude"], first["amplitude"], strict=True
    ):
        assert hop == pytest.approx(own / other)
    assert found["passed_on"]["uav1"] is None
    # half of the gains are those for the leader
    assert found["passed_on"]["uav2"]["gain"] == pytest.approx(0.5, abs=0.01)


def test_frequency_response_refuses(tmp_path):
    with in_this_process():
        refuse_all("frequency_response", tmp_path)
