"""A run that waits for a program outside, played here by a station without sockets."""

import math

import numpy as np
import pytest
from run_flight import Collector, short

from testbed.errors import InputError, PartnerLost
from testbed.sim.gate import Gate
from testbed.sim.loop import fly
from testbed.sim.outside import Outside, checked
from testbed.sim.run import run
from testbed.sim.world import build

LOCKSTEP = "fleet.2.commanded_by={kind: external, lockstep: true, patience_s: 0.3}"
SECONDS = 4.0


class Program:
    """Answers the frame it has seen last: a roll that grows with its time."""

    def __init__(self, cockpit, *, deaf_from_s=math.inf, lags=0):
        self.cockpit, self.deaf_from_s, self.lags = cockpit, deaf_from_s, lags
        self.seen, self.answered, self.repeats, self.waits = [], [], 0, 0

    def begin(self, info):
        pass

    def observe(self, frame):
        self.seen.append(frame.time_s)

    def end(self, summary, events):
        pass

    def poll(self, now_s):
        pass

    def news(self):
        return []

    def repeat(self, now_s):
        self.repeats += 1

    def wait(self, seconds, now_s):
        self.waits += 1
        if not self.seen or now_s >= self.deaf_from_s:
            return
        # one that answers late answers an older frame first
        for time_s in self.seen[-1 - self.lags :]:
            self.cockpit.sticks(0.02 * time_s, 0.0, 0.3, attitude=True, answers_s=time_s)
            self.answered.append(time_s)


def flown(**habits):
    world = build(short(LOCKSTEP, seconds=SECONDS))
    program = Program(world.deck.cockpits[3], **habits)
    collector = Collector()
    outcome = fly(world, [collector, program], Gate(world.deck, program, None, lambda: False))
    return outcome, collector.frames, program


def test_every_control_period_flies_the_answer_to_the_frame_before_it():
    outcome, frames, program = flown()
    assert outcome == "flown"
    at = np.array([frame.time_s for frame in frames])
    roll = np.array([frame.command.roll[3] for frame in frames])
    assert np.allclose(roll[1:], 0.02 * at[:-1], rtol=0, atol=1e-15)
    # each frame but the last is answered once, and nothing is asked again
    assert program.answered == pytest.approx(list(at[:-1]))
    assert program.repeats == 0


def test_answers_to_older_frames_are_left_aside():
    _, prompt, _ = flown()
    _, late, _ = flown(lags=2)
    for one, other in zip(prompt, late, strict=True):
        assert one.truth.position_ned.tobytes() == other.truth.position_ned.tobytes()
        assert one.command.roll.tobytes() == other.command.roll.tobytes()


def test_a_program_that_falls_silent_is_an_error_that_names_the_aircraft_and_the_time():
    with pytest.raises(PartnerLost, match=r"^uav3: no command came in 0.3 s of waiting at 2.02 s"):
        flown(deaf_from_s=2.02)


def test_lockstep_without_a_link_is_refused_before_anything_is_written(tmp_path):
    page = short(LOCKSTEP)
    with pytest.raises(InputError, match="--mavlink"):
        run(page, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    world = build(short())
    assert checked(Outside(), short(), world).notes == world.notes


def test_an_external_whom_nobody_can_reach_flies_its_failsafe(tmp_path):
    page = short("fleet.2.commanded_by=external", seconds=3.0)
    events = run(page, out=tmp_path / "run").metrics["events"]
    texts = [each["text"] for each in events if each["source"] == "uav3"]
    assert any("--mavlink" in text for text in texts)
    assert any("hears no commands for 1.5 s" in text for text in texts)


def test_nobody_waits_for_an_autopilot_that_hangs():
    """It hears nothing: the run goes on, and asks again when it is back."""
    hang = "fleet.2.faults=[{kind: autopilot-frozen, at_s: 1, lasts_s: 1}]"
    world = build(short(LOCKSTEP, hang, seconds=SECONDS))
    program = Program(world.deck.cockpits[3])
    deaf = {"from": 1.02, "to": 2.0}
    wait = program.wait

    def hear(seconds, now_s):
        if not deaf["from"] <= now_s <= deaf["to"]:
            wait(seconds, now_s)

    program.wait = hear
    assert fly(world, [program], Gate(world.deck, program, None, lambda: False)) == "flown"
    assert max(program.answered) > 3.9
