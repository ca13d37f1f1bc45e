"""Lockstep with an external program, played by a server without sockets."""

import math

import numpy as np
import pytest
from run_flight import Collector, short

from testbed.commands.tick_gate import TickGate
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.records import FbwaCommand
from testbed.flight.loop import fly
from testbed.plan.world import build
from testbed.runs.external_options import ExternalOptions, check_links
from testbed.runs.run import run

LOCKSTEP = "fleet.2.commanded_by={kind: external, lockstep: true, timeout_s: 0.3}"
SECONDS = 4.0


class Program:
    """Answers the latest sample with a roll command proportional to its time.

    Args:
        session: of the aircraft.
        silent_from_s: time from which it does not answer.
        lags: number of older samples that it answers before the latest.
    """

    def __init__(self, session, *, silent_from_s=math.inf, lags=0):
        self.session, self.silent_from_s, self.lags = session, silent_from_s, lags
        self.samples_s, self.answered, self.repeats, self.waits = [], [], 0, 0

    def begin(self, info):
        pass

    def observe(self, sample):
        self.samples_s.append(sample.time_s)

    def end(self, summary, events):
        pass

    def poll(self, now_s):
        pass

    def pop_events(self):
        return []

    def repeat(self, now_s):
        self.repeats += 1

    def wait(self, seconds, now_s):
        self.waits += 1
        if not self.samples_s or now_s >= self.silent_from_s:
            return
        for time_s in self.samples_s[-1 - self.lags :]:
            self.session.set_manual_command(
                FbwaCommand(roll=0.02 * time_s, pitch=0.0, throttle=0.3),
                attitude=True,
                answers_s=time_s,
            )
            self.answered.append(time_s)


def fly_lockstep(**options):
    world = build(short(LOCKSTEP, seconds=SECONDS))
    program = Program(world.external_control.vehicles[3], **options)
    collector = Collector()
    outcome = fly(
        world, [collector, program], TickGate(world.external_control, program, None, lambda: False)
    )
    return outcome, collector.frames, program


def test_lockstep_flies_answer_to_previous_sample():
    outcome, frames, program = fly_lockstep()
    assert outcome == "completed"
    at = np.array([frame.time_s for frame in frames])
    roll = np.array([frame.command.roll[3] for frame in frames])
    assert np.allclose(roll[1:], 0.02 * at[:-1], rtol=0, atol=1e-15)
    # each sample but the last is answered once, and none is repeated
    assert program.answered == pytest.approx(list(at[:-1]))
    assert program.repeats == 0


def test_lockstep_ignores_answers_to_older_samples():
    _, prompt, _ = fly_lockstep()
    _, late, _ = fly_lockstep(lags=2)
    for one, other in zip(prompt, late, strict=True):
        assert one.truth.position_ned.tobytes() == other.truth.position_ned.tobytes()
        assert one.command.roll.tobytes() == other.command.roll.tobytes()


def test_lockstep_timeout_names_aircraft_and_time():
    with pytest.raises(
        ExternalProgramLost, match=r"^uav3: no command came in 0.3 s of waiting at 2.02 s"
    ):
        fly_lockstep(silent_from_s=2.02)


def test_lockstep_without_link_is_an_input_error(tmp_path):
    scenario = short(LOCKSTEP)
    with pytest.raises(InputError, match="--mavlink"):
        run(scenario, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()
    world = build(short())
    assert check_links(ExternalOptions(), short(), world).initial_events == world.initial_events


def test_external_without_link_flies_failsafe(tmp_path):
    scenario = short("fleet.2.commanded_by=external", seconds=3.0)
    events = run(scenario, out=tmp_path / "run").metrics["events"]
    texts = [each["text"] for each in events if each["source"] == "uav3"]
    assert any("--mavlink" in text for text in texts)
    assert any("receives no commands for 1.5 s" in text for text in texts)


def test_lockstep_does_not_wait_for_frozen_autopilot():
    """The run continues without commands, and waits again when the autopilot resumes."""
    frozen = "fleet.2.faults=[{kind: autopilot-frozen, at_s: 1, duration_s: 1}]"
    world = build(short(LOCKSTEP, frozen, seconds=SECONDS))
    program = Program(world.external_control.vehicles[3])
    wait = program.wait

    def wait_unless_frozen(seconds, now_s):
        if not 1.02 <= now_s <= 2.0:
            wait(seconds, now_s)

    program.wait = wait_unless_frozen
    assert (
        fly(world, [program], TickGate(world.external_control, program, None, lambda: False))
        == "completed"
    )
    assert max(program.answered) > 3.9
