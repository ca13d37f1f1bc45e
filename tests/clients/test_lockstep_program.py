"""An external program commands one aircraft in lockstep."""

import json
import math
import time

import pytest
from external_run import free_port, start_run
from mavlink_client import MavlinkClient
from waiting import TIMEOUT_S, until

LOCKSTEP = "--set=fleet.2.commanded_by={kind: external, lockstep: true, timeout_s: %s}"
SECONDS = 5.0
SYSTEM = 4  # uav3
WALL_CLOCK_KEYS = {"wall_s", "real_time_factor", "mavlink"}


def answer(client, flight, until_s=math.inf):
    """Answer each attitude until this time, s; return the wall-clock time of the last answer."""
    answered_s = time.monotonic()
    for message in client.messages_until_end(flight):
        if message.name != "ATTITUDE" or message.system != SYSTEM:
            continue
        boot_ms = int(message.number("time_boot_ms"))
        if boot_ms > 1e3 * until_s:
            break
        bank = 0.3 * math.sin(1e-3 * boot_ms)
        pitch = 0.05 - 0.2 * message.number("pitch")
        answered_s = time.monotonic()
        client.attitude(SYSTEM, bank, pitch, 0.5, boot_ms=boot_ms)
    return answered_s


def fly(folder, port, *, late):
    """Fly with such a program, which starts late if wanted."""
    arguments = (
        f"--mavlink=udpout:127.0.0.1:{port}",
        LOCKSTEP % TIMEOUT_S,
        f"--duration={SECONDS}",
    )
    with start_run(folder, *arguments) as flight:
        if late:
            until((flight.out / "scenario.resolved.yaml").exists)
            time.sleep(0.7)
            assert flight.process.poll() is None, flight.output
        with MavlinkClient(port) as client:
            answer(client, flight)
        metrics = flight.end()
    return metrics, flight.frames()


def test_lockstep_flights_are_bit_identical(tmp_path):
    port = free_port()
    one, frames = fly(tmp_path / "one", port, late=False)
    other, again = fly(tmp_path / "other", port, late=True)
    same = [{k: v for k, v in each.items() if k not in WALL_CLOCK_KEYS} for each in (one, other)]
    assert json.dumps(same[0], sort_keys=True) == json.dumps(same[1], sort_keys=True)
    assert len(frames) == len(again) > 100
    for left, right in zip(frames, again, strict=True):
        for a, b in zip((*left.truth, *left.command), (*right.truth, *right.command), strict=True):
            assert a.tobytes() == b.tobytes()
    # each command answers the sample before it, in single precision
    commanded = [float(frame.command.roll[3]) for frame in frames[2:]]
    sent = [0.3 * math.sin(frame.time_s) for frame in frames[1:-1]]
    assert commanded == pytest.approx(sent, abs=1e-6)
    assert all(frame.command.throttle[3] == 0.5 for frame in frames[2:])
    assert one["mavlink"]["frames_received"] == len(frames) - 1


def test_dead_lockstep_program_ends_the_run(tmp_path):
    with (
        MavlinkClient() as client,
        start_run(tmp_path / "flight", f"--mavlink={client.address}", LOCKSTEP % 2) as flight,
    ):
        last_answer_s = answer(client, flight, until_s=3.0)
        metrics = flight.end(5)
        waited = time.monotonic() - last_answer_s
    assert waited > 2.0  # the timeout
    # the sample of 3.04 s was not answered; the run waits at the next autopilot tick
    assert "error: uav3: no command came in 2 s of waiting at 3.06 s" in flight.output
    assert metrics["outcome"] == "failed"
    assert "uav3: no command" in metrics["events"][-1]["text"]
    log = flight.log()
    assert log.time_s[-1] == pytest.approx(3.04)
    assert log.events[-1].level == "error" and "uav3: no command" in log.events[-1].text
