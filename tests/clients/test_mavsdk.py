"""MAVSDK 4 flies the leader: a library that people write ground programs with."""

import json
import math

import numpy as np
import pytest
from outside_run import clients, flying, free_port, run_client, said_events

from testbed import __version__

RADIUS_M = 90.0  # of the page's waypoints: a turn begins no farther from them


def test_mavsdk_finds_a_healthy_formation_and_flies_it(tmp_path):
    python, port = clients() / "python", free_port()
    script = __file__.replace("test_mavsdk", "fly_with_mavsdk")
    with flying(
        tmp_path / "flight",
        f"--mavlink=udpout:127.0.0.1:{port}",
        "--pace=4",
        "--set=fleet.2.commanded_by=external",
        "--set=fleet.0.battery={state_of_charge: 0.8}",
        page="mixed-fleet",
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

    # what single precision makes of them
    assert first["parameter"]["before"] == float(np.float32(0.34))
    assert first["parameter"]["after"] == float(np.float32(0.11))
    assert first["parameter"]["count"] > 40
    assert first["mission"]["same"] == [True] * 3
    assert [step["name"] for step in seen if step["step"] == "mode"] == ["HOLD", "MISSION"]
    assert first["progress"]["current"] == 2
    assert first["offboard"]["roll_deg"] > 20.0
    assert first["manual"]["roll_deg"] < -18.0

    # a busy machine may silence MAVSDK for the 0.4 s, at this pace, of the failsafe
    said = [text for text in said_events(metrics, "leader") if "hears" not in text]
    assert said[:5] == [
        "RLL_RATE_P 0.11 (was 0.34)",
        "mission of 3 items",
        "mode LOITER",
        "mode AUTO",
        "mode GUIDED",
    ]
    assert "130 m up" in said[5] and said[6:] == ["mode LOITER"]
    assert set(said) <= set(first["texts"]["texts"])
    assert "hears commands again" in said_events(metrics, "uav3")
    assert metrics["mavlink"]["clients"] == ["245.190"]
    assert metrics["mavlink"]["skipped_bytes"] == 0 and metrics["mavlink"]["refused"] == {}
    assert metrics["pace"]["asked"] == 4.0

    # the flight itself: the leader was where the mission sent it, and the formation went with it
    frames = flight.frames()
    at = np.array([frame.time_s for frame in frames])
    begun = {each["text"]: each["time_s"] for each in metrics["events"]}
    auto = (at > begun["mode AUTO"]) & (at < begun["mode GUIDED"])
    north, east = first["mission"]["begun_at_m"]
    position = np.array([frame.truth.position_ned[0] for frame in frames])[auto]
    missed = np.hypot(position[:, 0] - north, position[:, 1] - east - 300.0)
    assert missed[0] > 150.0 and missed.min() < RADIUS_M
    held = (at > begun["mode GUIDED"]) & (at < begun["hears commands again"])
    told = np.array([frame.command.roll[0] for frame in frames])[held]
    assert np.isclose(told, math.radians(25.0), atol=1e-5).any()
