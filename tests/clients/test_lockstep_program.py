"""A program outside flies one aircraft, and the run waits for its answer to every frame."""

import json
import math
import time

import pytest
from outside_run import flying, free_port
from patience import PATIENCE_S, until
from speaker import Speaker

LOCKSTEP = "--set=fleet.2.commanded_by={kind: external, lockstep: true, patience_s: %s}"
SECONDS = 8.0
SYSTEM = 4  # uav3
OF_THE_DAY = {"wall_s", "real_time_factor", "mavlink"}


def answer(speaker, flight, until_s=math.inf):
    """Fly it by its own clock and attitude until then; when it said its last word, s."""
    said_s = time.monotonic()
    for message in speaker.hear_while(flight):
        if message.name != "ATTITUDE" or message.system != SYSTEM:
            continue
        boot_ms = int(message.number("time_boot_ms"))
        if boot_ms > 1e3 * until_s:
            break
        bank = 0.3 * math.sin(1e-3 * boot_ms)
        pitch = 0.05 - 0.2 * message.number("pitch")
        said_s = time.monotonic()
        speaker.attitude(SYSTEM, bank, pitch, 0.5, boot_ms=boot_ms)
    return said_s


def flown(folder, port, *, late):
    """A flight with such a program; one that is late is not there when the flight begins."""
    arguments = (
        f"--mavlink=udpout:127.0.0.1:{port}",
        LOCKSTEP % PATIENCE_S,
        f"--duration={SECONDS}",
    )
    with flying(folder, *arguments) as flight:
        if late:
            until((flight.out / "scenario.resolved.yaml").exists)
            time.sleep(1.5)
            assert flight.process.poll() is None, flight.said
        with Speaker(port) as speaker:
            answer(speaker, flight)
        metrics = flight.end()
    return metrics, flight.frames()


def test_two_flights_with_a_program_in_lockstep_are_the_same_to_the_bit(tmp_path):
    port = free_port()
    one, frames = flown(tmp_path / "one", port, late=False)
    other, again = flown(tmp_path / "other", port, late=True)
    same = [{k: v for k, v in each.items() if k not in OF_THE_DAY} for each in (one, other)]
    assert json.dumps(same[0], sort_keys=True) == json.dumps(same[1], sort_keys=True)
    assert len(frames) == len(again) > 100
    for left, right in zip(frames, again, strict=True):
        for a, b in zip((*left.truth, *left.command), (*right.truth, *right.command), strict=True):
            assert a.tobytes() == b.tobytes()
    # what was flown is what the program said of the frame before, to the digits of its quaternion
    told = [float(frame.command.roll[3]) for frame in frames[2:]]
    said = [0.3 * math.sin(frame.time_s) for frame in frames[1:-1]]
    assert told == pytest.approx(said, abs=1e-6)
    assert all(frame.command.throttle[3] == 0.5 for frame in frames[2:])
    assert one["mavlink"]["frames_heard"] == len(frames) - 1


def test_a_program_that_dies_ends_the_run_and_is_named(tmp_path):
    with (
        Speaker() as speaker,
        flying(tmp_path / "flight", f"--mavlink={speaker.address}", LOCKSTEP % 5) as flight,
    ):
        died = answer(speaker, flight, until_s=3.0)
        metrics = flight.end(5)
        waited = time.monotonic() - died
    assert waited > 5.0  # its patience; how long a busy machine takes to end is not the point
    # the frame of 3.04 s was not answered, which is asked at the next tick of the autopilot
    assert "error: uav3: no command came in 5 s of waiting at 3.06 s" in flight.said
    assert metrics["outcome"] == "failed"
    assert "uav3: no command" in metrics["events"][-1]["text"]
    log = flight.log()
    assert log.time_s[-1] == pytest.approx(3.04)
    assert log.events[-1].level == "error" and "uav3: no command" in log.events[-1].text
