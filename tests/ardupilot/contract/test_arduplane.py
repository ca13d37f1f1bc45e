"""Flights with ArduPlane as the autopilot, played by a stand-in with the same packets."""

import hashlib
import io
import os
import re
import select
import signal
import socket
import subprocess
from contextlib import suppress
from functools import cache

import numpy as np
import pytest
from arduplanes import (
    FIRST,
    LEVEL,
    SCENARIO,
    SOON,
    ardupilot,
    binary,
    error_of,
    fly,
    fly_level,
    make_scenario,
    run_in_child,
    running,
)
from rich.console import Console
from run_flight import Collector
from together import together
from waiting import TIMEOUT_S, until

from testbed.ardupilot.sitl_parameters import defaults_text
from testbed.ardupilot.sitl_process import command_line
from testbed.core.records import NedOrigin
from testbed.metrics.printed_tables import render_table
from testbed.plan.world import build
from testbed.runs.external_options import ExternalOptions
from testbed.runs.run import run
from testbed.scenario import find_tune, load_scenario, loads, set_duration
from testbed.studies.sweep import sweep
from testbed.studies.table import read_table

assert binary  # a fixture
WHOLE = os.environ.get("TESTBED_ARDUPLANE_WHOLE")


def fingerprint(frames):
    digest = hashlib.sha256()
    for frame in frames:
        for array in (frame.truth.position_ned, frame.truth.euler, *frame.surfaces):
            digest.update(array.tobytes())
    return digest.hexdigest()


@cache
def mixed_flight():
    """Fly a second by an ArduPlane and a virtual autopilot, once."""
    return fly(make_scenario(1.0))


def test_mixed_flight_repeats_to_the_bit(binary, monkeypatch):
    """Also if an answer to ArduPlane is lost, which asks for it again."""
    first = mixed_flight()
    monkeypatch.setenv("ARDUPLANE_STAND_IN", f"resend@{SOON}")
    assert fingerprint(first) == fingerprint(fly(make_scenario(1.0)))
    # its servo pulses are whole µs: 500 are full deflection
    pulses = 500.0 * np.array([frame.surfaces.aileron for frame in first[1:]])
    assert np.abs(pulses[:, 0] - np.rint(pulses[:, 0])).max() < 1e-9
    assert np.abs(pulses[:, 1] - np.rint(pulses[:, 1])).max() > 0.1


def test_elevon_flight_has_the_arduplane_version(binary, tmp_path):
    """It flies level; metrics and table have the version, and a quiet run announces nothing."""
    lines, collector = [], Collector()
    quiet = ExternalOptions(announce=lines.append, quiet=True)
    scenario = make_scenario(2.0, "leader.aircraft=skywalker_x8")
    result = run(scenario, out=tmp_path / "run", external=quiet, observers=[collector])
    assert not lines
    last = collector.frames[-1].truth
    assert abs(last.euler[0, 0]) < np.radians(10)
    assert last.position_ned[0, 2] == pytest.approx(-100.0, abs=5.0)
    (name,) = result.metrics["arduplane"]
    assert result.metrics["arduplane"] == {name: "4.7.1 (stand-in)"}
    output = io.StringIO()
    render_table(result.metrics, Console(file=output, width=80))
    assert f" ArduPlane           4.7.1 (stand-in): {name}" in output.getvalue()


def test_virtual_autopilots_beside_it_are_unchanged(binary):
    """Estimator and GPS of the ArduPlane are off, of which it would tell."""
    events, mixed = fly_level(make_scenario(2.0))
    assert not [event.text for event in events if "EKF3" in event.text]
    events, virtual = fly_level(set_duration(loads(SCENARIO), 2.0))
    assert not events
    for one, other in zip(mixed, virtual, strict=True):
        assert one[1].tobytes() == other[1].tobytes()
    assert mixed.euler[0].tobytes() != virtual.euler[0].tobytes()


def test_arduplanes_hold_slots_like_virtual(binary):
    """Four fly all of Simulation 3 if TESTBED_ARDUPLANE_WHOLE is set; else two, 5 s from slots."""
    rate, sitl = "rates.physics_hz=200", "autopilot={kind: virtual, gyro_filter: sitl}"
    own = [rate, f"leader.{sitl}", f"fleet.*.{sitl}"]
    followers = (1, 2, 3) if WHOLE else (1,)
    planes = [*own, f"leader.autopilot={ardupilot()}"]
    planes += [f"fleet.uav{n}.autopilot={ardupilot(n)}" for n in followers]
    if WHOLE:
        windows = load_scenario("simulation-3").scenario.windows
        scenario, virtual = (
            load_scenario("simulation-3", planes),
            load_scenario("simulation-3", own),
        )
    else:
        slots = load_scenario("simulation-3").formation.offsets_m.items()
        there = [f"fleet.{name}.start_m={list(slot)}" for name, slot in slots]
        windows = {"on the way": (2.0, 5.0)}
        scenario, virtual = (
            set_duration(load_scenario("simulation-3", [*there, *o]), 5.0) for o in (planes, own)
        )
    real, ours = fly(scenario), fly(virtual)
    for begin, end in windows.values():
        theirs, own = rms(real, begin, end), rms(ours, begin, end)
        # 5 % or 0.1 m, whichever is larger; rounding of pulses and throttle has less effect
        assert np.all(np.abs(theirs - own) <= np.maximum(0.05 * own, 0.1)), (theirs, own)


def rms(frames, begin, end):
    errors = [f.formation.error_ned for f in frames if begin <= f.time_s <= end]
    return np.sqrt(np.mean(np.sum(np.square(errors), axis=2), axis=0))


def test_32_outputs_and_overrides_fly_the_same(binary, monkeypatch):
    plain = mixed_flight()[-1].truth
    monkeypatch.setenv("ARDUPLANE_STAND_IN", "outputs32 ignores-rc")
    frames = fly(make_scenario(1.0))
    events = [each.text for frame in frames for each in frame.events]
    assert any("RC_CHANNELS_OVERRIDE" in each for each in events)
    # overrides arrive an autopilot period or two later, at 22 m/s
    np.testing.assert_allclose(frames[-1].truth.position_ned, plain.position_ned, atol=0.5)


def test_faults_act_behind_the_servo_outputs(binary):
    """From 1 s on; from 1.5 s on the autopilot is frozen, and holds the others."""
    fault = "leader.faults=[{kind: surface-stuck, surface: aileron, position: 0.4, at_s: 1}, "
    fault += "{kind: engine-out, at_s: 1}, {kind: autopilot-frozen, at_s: 1.5}]"
    frames = fly(make_scenario(2.0, fault))
    time_s = np.array([f.time_s for f in frames])
    before, moving, held = time_s <= 0.9, (1.1 < time_s) & (time_s < 1.5), time_s > 1.6
    surfaces = np.array([[float(each[0]) for each in f.surfaces] for f in frames])
    ailerons = np.array([float(f.surfaces.aileron[0]) for f in frames])
    throttles = np.array([float(f.surfaces.throttle[0]) for f in frames])
    assert np.all(np.abs(ailerons[before]) < 0.3) and np.all(ailerons[held] == 0.4)
    assert np.all(throttles[before][1:] > 0.05) and np.all(throttles[held] == 0.0)
    assert len(np.unique(surfaces[held], axis=0)) == 1 < len(np.unique(surfaces[moving], axis=0))
    assert abs(frames[-1].truth.euler[0, 0]) > 0.2  # the model flies with the stuck aileron


def test_arduplane_computes_before_the_models_step(binary):
    world = build(make_scenario(1.0))
    (process,), (vehicles,), aircraft = world.external_processes, world.vehicles, world.aircraft
    aircraft["command"] = LEVEL
    try:
        process.start(lambda: None)
        (plane,) = process._all
        for _ in range(2):
            aircraft["estimate"] = aircraft["truth"]
            vehicles.autopilot_step()
            until(lambda: select.select([plane._udp], [], [], 0.0)[0])  # it has answered
            vehicles.step(4, None)
    finally:
        process.close()


def test_arduplane_of_lost_aircraft_is_stopped(binary):
    world = build(make_scenario(1.0, f"fleet.uav1.autopilot={ardupilot(1)}"))
    (process,), (vehicles,), aircraft = world.external_processes, world.vehicles, world.aircraft
    aircraft["command"] = LEVEL
    try:
        process.start(lambda: None)
        assert len(running()) == 2
        for period in range(20):
            aircraft["estimate"] = aircraft["truth"]
            vehicles.autopilot_step()
            if period == 10:
                vehicles.remove(np.array([True, False]))
                before = aircraft["truth"]["position_ned"].copy()
            vehicles.step(2, None)
        moved = np.linalg.norm(aircraft["truth"]["position_ned"] - before, axis=1)
        # 10 periods of 20 ms at 22 m/s
        assert moved[0] == 0.0 and moved[1] == pytest.approx(4.4, abs=0.2)
        assert len(running()) == 1
    finally:
        process.close()


def test_stopped_run_leaves_no_process_or_folder(binary, tmp_path):
    child = run_in_child(tmp_path)
    try:
        until(lambda: list((tmp_path / "logs").glob("*/*/run.mcap")))
        until(running)
        os.killpg(child.pid, signal.SIGINT)  # to the process group, as Ctrl-C does
        assert child.wait(TIMEOUT_S) == 130
    finally:
        child.kill()
        child.wait(TIMEOUT_S)


def test_killed_run_leaves_no_process_or_folder(binary, tmp_path):
    child = run_in_child(tmp_path)
    try:
        until(running)
    finally:
        child.kill()
        child.wait(TIMEOUT_S)
    until(lambda: not running() and not list((tmp_path / "folders").iterdir()))


STUDY = """
study: {schema: 1, name: planes, scenario: two.yaml, duration_s: 0.5, seeds: %s}
"""


def test_parallel_runs_take_free_instances(binary, tmp_path):
    """Two commands at once; 8 runs of a study on 2 jobs if TESTBED_ARDUPLANE_WHOLE is set."""
    (tmp_path / "two.yaml").write_text(SCENARIO.replace("path:", "autopilot: ardupilot\n  path:"))
    if not WHOLE:
        command = ["testbed", "run", "two.yaml", "--duration", "0.5", "--json"]
        [done] = together(tmp_path, [[*command, "--out", name] for name in ("a", "b")])
        assert [each.code for each in done] == [0, 0], done
        taken = [re.search(r"by instance (\d+)", each.stderr)[1] for each in done]
        assert taken[0] != taken[1]
        return
    (tmp_path / "planes.yaml").write_text(STUDY % [*range(1, 9)])
    sweep(tmp_path / "planes.yaml", tmp_path / "planes.parquet", jobs=2)
    outcomes = read_table(tmp_path / "planes.parquet").columns["outcome"]
    assert outcomes.tolist() == ["completed"] * 8


def test_announced_instance_is_a_free_one(binary, tmp_path):
    """Also that of another ArduPlane; one warning names both."""
    lines = []
    both = ["leader.autopilot=ardupilot", f"fleet.uav1.autopilot={ardupilot(1)}"]
    two = set_duration(loads(SCENARIO, both), 0.1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        with suppress(OSError):  # another test has it
            other.bind(("127.0.0.1", 9002))
        run(two, write=False, external=ExternalOptions(announce=lines.append))
    line, other_line, warning = lines
    instance = int(line.split("instance ")[1].split(",")[0])
    assert instance > 0
    ports = f"{9002 + 10 * instance}/udp and {5760 + 10 * instance}/tcp of 127.0.0.1"
    assert line == f"ArduPlane: leader by instance {instance}, {ports}"
    assert other_line.startswith(f"ArduPlane: uav1 by instance {FIRST + 1}, ")
    assert warning == (
        "warning: ArduPlane itself listens on 5501/udp and 5760, 5762, 5763/tcp, plus ten times "
        "its instance, of every address of this machine: any program that reaches it can command "
        "leader, uav1"
    )


def test_sitl_gyro_filter_is_named_before_flight(binary):
    """4 Hz with physics at 200 Hz, 2 Hz at 100, and that of an aircraft at 1000."""
    for rate, cutoff in ((200, "4 Hz"), (100, "2 Hz"), (1000, None)):
        own = [f"leader.autopilot={ardupilot()}", f"rates.physics_hz={rate}"]
        world = build(set_duration(loads(SCENARIO, own), 0.1))
        texts = [e.text for e in world.initial_events if "gyro filter" in e.text]
        begin = f"leader: SITL at rates.physics_hz {rate} has a gyro filter of {cutoff} in place"
        assert [text.startswith(begin) for text in texts] == [True] * (cutoff is not None)


def test_separately_started_arduplane_is_awaited(binary, tmp_path):
    scenario = make_scenario(1.0, start="false", timeout_s=TIMEOUT_S)
    text = error_of(make_scenario(1.0, start="false", timeout_s=0.3))
    assert f"start it with: arduplane --model JSON:127.0.0.1 --speedup 100 -I{FIRST} " in text
    defaults = tmp_path / "defaults.parm"
    tune = find_tune("rascal110", "autopilot")
    defaults.write_text(defaults_text(tune, physics_hz=200, autopilot_hz=50))
    command = command_line(binary, FIRST, NedOrigin(), 0.0, defaults)
    child = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL)
    try:
        assert fly(scenario)[-1].time_s == 1.0
        child.wait(timeout=TIMEOUT_S)  # it ends when we close the connection
    finally:
        child.kill()
        child.wait()
