"""ArduPlane as an autopilot, by a stand-in that speaks the same packets: its flights."""

import hashlib
import io
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from arduplanes import FIRST, PAGE, SOON, ardupilot, binary, complaint, fly, level, page, running
from patience import PATIENCE_S, until
from rich.console import Console

from testbed.ardupilot.defaults import defaults_text
from testbed.ardupilot.process import command_line
from testbed.metrics.table import render_table
from testbed.scenario import find_tune, load, loads, shorten
from testbed.sim.run import run
from testbed.sim.world import build
from testbed.state import FbwaCommand, Origin

assert binary  # a fixture
WHOLE = os.environ.get("TESTBED_ARDUPLANE_WHOLE")


def fingerprint(frames):
    digest = hashlib.sha256()
    for frame in frames:
        for array in (frame.truth.position_ned, frame.truth.euler, *frame.surfaces):
            digest.update(array.tobytes())
    return digest.hexdigest()


def test_a_mixed_flight_repeats_to_the_bit_and_leaves_the_virtual_autopilots_theirs(binary):
    mixed = shorten(load("simulation-3", [f"leader.autopilot={ardupilot()}"]), 8.0)
    first, second = fly(mixed), fly(mixed)
    assert fingerprint(first) == fingerprint(second)
    # its servos are told in whole µs: 500 of them are a full deflection
    pulses = 500.0 * np.array([frame.surfaces.aileron for frame in first[1:]])
    assert np.abs(pulses[:, 0] - np.rint(pulses[:, 0])).max() < 1e-9
    assert np.abs(pulses[:, 1] - np.rint(pulses[:, 1])).max() > 0.1


def test_the_metrics_and_the_table_say_which_arduplane_flew_whom(binary, tmp_path):
    flown = run(page(1.0), out=tmp_path / "run")
    (name,) = flown.metrics["arduplane"]
    assert flown.metrics["arduplane"] == {name: "4.7.1 (stand-in)"}
    paper = io.StringIO()
    render_table(flown.metrics, Console(file=paper, width=80))
    assert f" ArduPlane           4.7.1 (stand-in): {name}" in paper.getvalue()


def test_who_flies_beside_one_keeps_the_bits(binary):
    _, beside = level(page(2.0))
    said, alone = level(shorten(loads(PAGE), 2.0))
    assert not said
    for theirs, own in zip(beside, alone, strict=True):
        assert theirs[1].tobytes() == own[1].tobytes()
    assert beside.euler[0].tobytes() != alone.euler[0].tobytes()


def test_four_of_them_hold_the_slots_as_the_virtual_autopilots_do(binary):
    """The whole flight where TESTBED_ARDUPLANE_WHOLE is set; else some seconds from the slots."""
    four = [f"leader.autopilot={ardupilot()}"]
    four += [f"fleet.uav{n}.autopilot={ardupilot(n)}" for n in (1, 2, 3)]
    if WHOLE:
        windows = load("simulation-3").scenario.portions
        scenario, virtual = load("simulation-3", four), load("simulation-3")
    else:
        slots = load("simulation-3").formation.offsets_m.items()
        there = [f"fleet.{name}.start_m={list(slot)}" for name, slot in slots]
        windows = {"on the way": (2.0, 12.0)}
        scenario, virtual = (shorten(load("simulation-3", [*there, *o]), 12.0) for o in (four, ()))
    real, ours = fly(scenario), fly(virtual)
    for begin, end in windows.values():
        theirs, own = rms(real, begin, end), rms(ours, begin, end)
        # 5 % or 0.1 m, whichever is more: pulses and the throttle's whole percent cost less
        assert np.all(np.abs(theirs - own) <= np.maximum(0.05 * own, 0.1)), (theirs, own)


def rms(frames, begin, end):
    errors = [f.formation.error_ned for f in frames if begin <= f.time_s <= end]
    return np.sqrt(np.mean(np.sum(np.square(errors), axis=2), axis=0))


def test_an_elevon_aircraft_flies_too(binary):
    frames = fly(page(4.0, "leader.aircraft=skywalker_x8"))
    assert abs(frames[-1].truth.euler[0, 0]) < np.radians(10)
    assert frames[-1].truth.position_ned[0, 2] == pytest.approx(-100.0, abs=5.0)


def test_thirty_two_outputs_and_no_rc_in_the_link_fly_the_same_way(binary, monkeypatch):
    plain = fly(page(3.0))[-1].truth
    monkeypatch.setenv("STAND_IN", "outputs32 deaf")
    said = [event.text for event in level(page(1.0))[0]]
    assert any("RC_CHANNELS_OVERRIDE" in text for text in said)
    other = fly(page(3.0))[-1].truth
    # overrides come when they come: a period of the autopilot or two later, at 22 m/s
    np.testing.assert_allclose(other.position_ned, plain.position_ned, atol=0.5)


def test_an_answer_that_is_lost_is_given_again_and_nothing_moves_twice(binary, monkeypatch):
    plain = fingerprint(fly(page(2.0)))
    monkeypatch.setenv("STAND_IN", f"resend@{SOON}")
    assert fingerprint(fly(page(2.0))) == plain


def test_what_breaks_breaks_behind_its_servos(binary):
    fault = "leader.faults=[{kind: surface-stuck, surface: aileron, position: 0.4, at_s: 1}, "
    frames = fly(page(2.0, fault + "{kind: engine-out, at_s: 1}]"))
    before, after = (np.array([f.time_s for f in frames]) <= 0.9, slice(-20, None))
    ailerons = np.array([frame.surfaces.aileron[0] for frame in frames])
    throttles = np.array([frame.surfaces.throttle[0] for frame in frames])
    assert np.all(np.abs(ailerons[before]) < 0.3) and np.all(ailerons[after] == 0.4)
    assert np.all(throttles[before][1:] > 0.05) and np.all(throttles[after] == 0.0)


def test_an_autopilot_that_hangs_holds_its_servos(binary):
    frames = fly(page(2.0, "leader.faults=[{kind: autopilot-frozen, at_s: 1}]"))
    held = {tuple(float(each[0]) for each in f.surfaces) for f in frames if f.time_s > 1.1}
    assert len(held) == 1


def test_the_autopilot_of_an_aircraft_that_is_lost_is_ended_and_the_others_fly_on(binary):
    world = build(page(1.0, f"fleet.uav1.autopilot={ardupilot(1)}"))
    (partner,) = world.partners
    level_command = FbwaCommand(*np.array([[0.0, 0.0], [0.0, 0.0], [0.3, 0.3]]))
    try:
        partner.begin(lambda: None)
        assert len(running()) == 2
        for tick in range(20):
            world.vehicles.act(world.vehicles.read(), level_command)
            if tick == 10:
                world.vehicles.remove(np.array([True, False]))
                there = world.vehicles.read().position_ned.copy()
            world.vehicles.step(4)
        moved = np.linalg.norm(world.vehicles.read().position_ned - there, axis=1)
        # 10 periods of 20 ms at 22 m/s
        assert moved[0] == 0.0 and moved[1] == pytest.approx(4.4, abs=0.2)
        assert len(running()) == 1
    finally:
        partner.close()


def test_a_run_that_is_stopped_leaves_nothing(binary, tmp_path):
    code = "import sys, testbed; sys.exit(testbed.run(sys.argv[1], sys.argv[2:]).exit_code)"
    asked = f"leader.autopilot={ardupilot()}"
    (tmp_path / "page.yaml").write_text(PAGE)
    words = [sys.executable, "-c", code, "page.yaml", asked]
    child = subprocess.Popen(words, cwd=tmp_path, start_new_session=True)
    try:
        until(lambda: list((tmp_path / "logs").glob("*/*/run.mcap")))
        until(running)
        os.killpg(child.pid, signal.SIGINT)  # as Ctrl-C does, to whoever is in the group
        assert child.wait(timeout=PATIENCE_S) == 130
    finally:
        child.kill()
        child.wait()


def test_one_that_somebody_else_starts_is_waited_for(binary, tmp_path):
    scenario = page(1.0, start="false", patience_s=PATIENCE_S)
    said = complaint(page(1.0, start="false", patience_s=0.3))
    assert f"start it with: arduplane --model JSON:127.0.0.1 --speedup 100 -I{FIRST} " in said
    defaults = tmp_path / "defaults.parm"
    tune = find_tune("rascal110", "autopilot")
    defaults.write_text(defaults_text(tune, physics_hz=200, autopilot_hz=50))
    words = command_line(binary, FIRST, Origin(), 0.0, defaults)
    child = subprocess.Popen(words, cwd=tmp_path, stdout=subprocess.DEVNULL)
    try:
        assert fly(scenario)[-1].time_s == 1.0
        child.wait(timeout=PATIENCE_S)  # it ends when we hang up: it is not ours to end
    finally:
        child.kill()
        child.wait()
