"""MAVProxy, ArduPilot's ground station for terminals, on a listening link."""

import re
import time
from collections import Counter

import numpy as np
from cases import ALL
from external_run import event_texts, free_port, start_run
from mavlink_client import COMPONENT, SYSTEM, MavlinkClient
from mavproxy import start_mavproxy

from testbed.mavlink.codec import Codec
from testbed.mavlink.signing import Signing, signing_time
from testbed.mavlink.tlog import Tlog

KEY = "correct-horse-battery-staple"
DO_SET_MODE, AUTO, LOITER = 176, 10, 12
MISSION = """QGC WPL 110
0 1 0 16 0 0 0 0 38.0 0.0 300 1
1 0 3 16 0 0 0 0 38.0036037 0.00364332 100 1
2 0 3 16 0 0 0 0 38.002 0.0045 120 1
3 0 3 17 0 0 100 0 38.002 0.0 110 1
"""
NORTH_M, EAST_M = 400.0, 320.0  # of item 1, away from the scenario's mission
RADIUS_M = 90.0  # waypoint radius of the scenario


def test_mavproxy_parameters_mission_and_modes(tmp_path):
    way, port = tmp_path / "way.txt", free_port()
    way.write_text(MISSION.replace(" ", "\t").replace("QGC\tWPL\t", "QGC WPL "))
    with (
        start_run(
            tmp_path / "flight", f"--mavlink=udpin:127.0.0.1:{port}", "--pace=4", "--tlog"
        ) as flight,
        start_mavproxy(tmp_path / "ground", flight, f"udpout:127.0.0.1:{port}") as ground,
    ):
        ground.see("Received ")
        ground.type("param show RLL_RATE_P")
        ground.see("RLL_RATE_P       0.944")
        ground.type("param set RLL_RATE_P 0.12")
        ground.see("RLL_RATE_P 0.12 (was 0.944)")
        ground.type("param show RLL_RATE_P")
        ground.see("RLL_RATE_P       0.1199999")
        if ALL:  # it tries for 3 s; tests/mavlink has what a vehicle answers
            ground.type("param set AIRSPEED_MIN 99")
            ground.see("AP: AIRSPEED_MAX (30) must be greater than AIRSPEED_MIN (99)")
            ground.see("Failed to set AIRSPEED_MIN to 99")
        ground.type(f"wp load {way}")
        ground.see("Got MISSION_ACK: TYPE_MISSION: ACCEPTED")
        ground.type("wp list")
        ground.see("17 3 38.0020000000 0.0000000000 110.000000 p1=0.0 p2=0.0 p3=100.0")
        ground.see("Saved 4 waypoints")
        ground.see("waypoint 2")
        ground.type("mode LOITER")
        ground.see("Got COMMAND_ACK: DO_SET_MODE: ACCEPTED")
        ground.see("Mode LOITER")
        ground.type("mode RTL")
        ground.see("Got COMMAND_ACK: DO_SET_MODE: DENIED")
        ground.type("mode AUTO")
        if ALL:  # shown 2 s later; that it was entered is asserted below
            ground.see("Mode AUTO")
        ground.type("disarm")
        ground.see("Got COMMAND_ACK: COMPONENT_ARM_DISARM: FAILED")
        ground.type("status ATTITUDE")
        ground.see("ATTITUDE {time_boot_ms")
        ground.type("link")
        ground.see("0 lost, 0.0% loss")
        metrics = flight.stop()

    received = re.search(r"Received (\d+) parameters", ground.output)
    assert received and int(received[1]) > 40
    for number in (1, 2, 3, 4):
        assert f"Detected vehicle {number}:1 on link 0" in ground.output
    assert not re.search("Traceback|Exception|[Bb]ad|[Nn]o response", ground.output)
    assert event_texts(metrics, "leader") == [
        "RLL_RATE_P 0.12 (was 0.944)",
        "mission of 3 items",
        "mode LOITER",
        "mode AUTO",
    ]
    assert metrics["mavlink"]["clients"] == ["245.230"]
    assert metrics["mavlink"]["skipped_bytes"] == 0 and metrics["mavlink"]["rejected"] == {}
    log = Tlog(flight.out / "run.tlog")
    kept = Counter((message.system, message.name) for _, message in log)
    assert (log.cut, log.damaged, log.unread) == (0, 0, 0)
    link = metrics["mavlink"]
    # the log starts with the parameters of all four
    begin = 4 * int(received[1])
    assert kept.total() == begin + link["frames_sent"] + link["frames_received"]
    assert kept[245, "MISSION_ITEM_INT"] == 4

    started = {each["text"]: each["time_s"] for each in metrics["events"]}
    position = np.array(
        [
            frame.truth.position_ned[0]
            for frame in flight.frames()
            if started["mission of 3 items"] < frame.time_s < started["mode LOITER"]
        ]
    )
    missed = np.hypot(position[:, 0] - NORTH_M, position[:, 1] - EAST_M)
    assert missed[0] > 2.0 * RADIUS_M and missed.min() < RADIUS_M


def test_mavproxy_needs_the_key(tmp_path):
    key, port = tmp_path / "key.txt", free_port()
    key.write_text(KEY)
    forger = Signing(bytes(32), time=signing_time(time.time()))
    with (
        MavlinkClient() as intruder,
        start_run(
            tmp_path / "flight",
            f"--mavlink=udpin:127.0.0.1:{port}",
            f"--mavlink={intruder.address}",
            f"--mavlink-key={key}",
            "--pace=4",
        ) as flight,
    ):
        intruder.wait_for(flight, "HEARTBEAT")
        for signing in (None, forger):
            intruder.codec = Codec(SYSTEM, COMPONENT, signing)
            for _ in range(3):
                intruder.command(1, DO_SET_MODE, 1.0, LOITER)
        begin = intruder.wait_for(flight, "ATTITUDE").number("time_boot_ms")
        # telemetry is sent to it, and shows that the mission is still flown 2 s later
        intruder.wait_for(
            flight, "ATTITUDE", lambda message: message.number("time_boot_ms") > begin + 2000.0
        )
        mode = intruder.wait_for(flight, "HEARTBEAT", lambda message: message.system == 1)
        assert mode.fields["custom_mode"] == AUTO
        with start_mavproxy(
            tmp_path / "ground",
            flight,
            f"udpout:127.0.0.1:{port}",
            f"--cmd=signing key {KEY}",
        ) as ground:
            ground.see("Received ")
            ground.type("mode LOITER")
            ground.see("Got COMMAND_ACK: DO_SET_MODE: ACCEPTED")
            ground.see("Mode LOITER")  # flown
        metrics = flight.stop()
    assert metrics["mavlink"]["rejected"] == {"forged": 3, "unsigned": 3}
    assert metrics["mavlink"]["clients"] == ["245.230"]
    assert event_texts(metrics, "leader") == ["mode LOITER"]
    warnings = [each for each in metrics["events"] if each["level"] == "warning"]
    assert [each["text"] for each in warnings] == [
        "MAVLink messages were ignored: not signed with this run's key, received before, or "
        "signed before the run began"
    ]
