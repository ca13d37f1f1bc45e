"""MAVSDK 4, a library for ground programs, commands the leader and a follower."""

import json
import math

import numpy as np
import pytest
from external_run import clients, event_texts, free_port, run_client, start_run

from testbed import __version__

RADIUS_M = 90.0  # waypoint radius of the scenario


def test_mavsdk_commands_a_formation(tmp_path):
    python, port = clients() / "python", free_port()
    script = __file__.replace("test_mavsdk", "fly_with_mavsdk")
    with start_run(
        tmp_path / "flight",
        f"--mavlink=udpout:127.0.0.1:{port}",
        "--pace=4",
        "--set=fleet.2.commanded_by=external",
        "--set=fleet.0.battery={state_of_charge: 0.8}",
        scenario="mixed-fleet",
    ) as flight:
        url = f"udpin://127.0.0.1:{port}"
        lines = run_client(flight, python, "-u", script, url).splitlines()
        metrics = flight.stop()
    seen = [json.loads(line) for line in lines if line.startswith("{")]
    first = {step["step"]: step for step in reversed(seen)}

    assert first["systems"]["ids"] == [1, 2, 3, 4]
    health = {name: value for name, value in first["health"].items() if name != "step"}
    assert len(health) == 7 and all(health.values())
    assert first["in air"]["value"] and first["armed"]["value"]
    assert first["home"]["altitude_m"] == 300.0
    assert first["battery"]["remaining_percent"] == pytest.approx(80.0, abs=1.0)
    assert 15.0 < first["battery"]["voltage_v"] < 60.0
    assert first["version"]["numbers"] == [int(part) for part in __version__.split(".")[:3]]
    assert int(first["version"]["uid"], 16) != 0

    # in single precision
    assert first["parameter"]["before"] == float(np.float32(0.944))
    assert first["parameter"]["after"] == float(np.float32(0.11))
    assert first["parameter"]["count"] > 40
    assert first["mission"]["same"] == [True] * 3
    assert [step["name"] for step in seen if step["step"] == "mode"] == ["HOLD", "MISSION"]
    assert first["progress"]["current"] == 2
    assert first["offboard"]["roll_deg"] > 20.0
    assert first["manual"]["roll_deg"] < -18.0

    # on a busy machine MAVSDK may send nothing for the failsafe's 0.4 s at this pace
    texts = [text for text in event_texts(metrics, "leader") if "receives" not in text]
    assert texts[:5] == [
        "RLL_RATE_P 0.11 (was 0.944)",
        "mission of 3 items",
        "mode LOITER",
        "mode AUTO",
        "mode GUIDED",
    ]
    assert "130 m up" in texts[5] and texts[6:] == ["mode LOITER"]
    assert set(texts) <= set(first["texts"]["texts"])
    assert "receives commands again" in event_texts(metrics, "uav3")
    assert metrics["mavlink"]["clients"] == ["245.190"]
    assert metrics["mavlink"]["skipped_bytes"] == 0 and metrics["mavlink"]["rejected"] == {}
    assert metrics["pace"]["requested"] == 4.0

    # in the log, the leader reached its mission's waypoint
    frames = flight.frames()
    at = np.array([frame.time_s for frame in frames])
    started = {each["text"]: each["time_s"] for each in metrics["events"]}
    auto = (at > started["mode AUTO"]) & (at < started["mode GUIDED"])
    north, east = first["mission"]["begun_at_m"]
    position = np.array([frame.truth.position_ned[0] for frame in frames])[auto]
    missed = np.hypot(position[:, 0] - north, position[:, 1] - east - 200.0)
    assert missed[0] > 150.0 and missed.min() < RADIUS_M
    held = (at > started["mode GUIDED"]) & (at < started["receives commands again"])
    roll = np.array([frame.command.roll[0] for frame in frames])[held]
    assert np.isclose(roll, math.radians(25.0), atol=1e-5).any()
