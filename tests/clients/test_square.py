"""The example of an external program in examples/."""

import re

import numpy as np
from external_run import ROOT, clients, event_texts, free_port, run_client, start_run
from waiting import TIMEOUT_S

SIDE_M, PASSED_M = 350.0, 30.0


def test_example_flies_its_square(tmp_path):
    port = free_port()
    with start_run(
        tmp_path / "flight",
        f"--mavlink=udpout:127.0.0.1:{port}",
        f"--set=fleet.2.commanded_by={{kind: external, lockstep: true, timeout_s: {TIMEOUT_S}}}",
        scenario=ROOT / "examples" / "square.yaml",
    ) as flight:
        script = ROOT / "examples" / "square.py"
        url = f"udpin:127.0.0.1:{port}"
        output = run_client(flight, clients() / "python", "-u", script, url)
        metrics = flight.end(0)
    places = re.findall(r"corner at (-?\d+) m north, (-?\d+) m east", output)
    corners = np.array(places, dtype=float)
    assert corners.shape == (4, 2)
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    assert np.allclose(sides, SIDE_M, atol=1.5)  # they are printed in whole metres

    frames = flight.frames()
    position = np.array([frame.truth.position_ned[3] for frame in frames])
    away = np.hypot(*(position[:, None, :2] - corners).transpose(2, 0, 1))
    reached = 0  # in order; the last corner is the start
    for distance in away.T:
        near = np.flatnonzero(distance[reached:] < PASSED_M)
        assert near.size
        reached += int(near[0])
    assert np.abs(position[:reached, 2] - position[0, 2]).max() < 10.0
    speed = np.array([frame.truth.airspeed[3] for frame in frames])
    assert 17.0 < speed.min() and speed.max() < 27.0
    assert event_texts(metrics, "uav3") == ["mode LOITER"]
    assert metrics["lost_at_s"]["uav3"] is None


def test_example_has_at_most_sixty_lines():
    assert len((ROOT / "examples" / "square.py").read_text(encoding="utf-8").splitlines()) <= 60
