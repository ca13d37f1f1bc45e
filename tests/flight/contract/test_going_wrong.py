"""Losses and exceeded limits are events, lines of the table, and exit codes."""

import json
import math

import numpy as np
import pytest
from run_flight import Collector
from typer.testing import CliRunner

from testbed.cli.main import app
from testbed.flight.loop import fly
from testbed.plan.world import build
from testbed.pool.flight_task import FlightTask, run_task
from testbed.scenario import find_aircraft, loads, set_duration
from testbed.tuning.tune_search import flight_cost
from testbed.vehicle.jsbsim_adapter import airframe

# uav1 is limited to 7 m/s, below the stall speed; uav2 flies beside the leader.
SLOW = """
scenario: {schema: 2, name: slow, duration_s: 12}
log: {mcap: false}
leader:
  aircraft: rascal110
  start: {altitude_m: 300}
  path:
    kind: mission
    airspeed_mps: 14
    legs: [{kind: waypoints, points_m: [[2000, 0, 300], [9000, 0, 300]]}]
fleet:
  - {name: uav1, aircraft: rascal110, start_m: [-10, 5, 0]}
  - {name: uav2, aircraft: rascal110, start_m: [-10, -5, 0]}
formation:
  offsets_m: {uav1: [-10, 5, 0], uav2: [-10, -5, 0]}
  leader_gains: {uav1: 1, uav2: 1}
  kappa_mps: 0.1
  speed_mps: [10, 20]
  agents: {uav1: {speed_mps: [3, 7]}}
"""
# Nose down until 450 m, then level.
DIVE = (
    "leader.path.airspeed_mps=22",
    "formation.speed_mps=[16, 40]",
    "formation.agents={}",
    "leader.start.altitude_m=600",
    "leader.path.legs=[{kind: waypoints, points_m: [[300, 0, 600], [900, 0, 450], [9e3, 0, 450]]}]",
    "scenario.duration_s=40",
)


def run_dive(tmp_path, *changes):
    """Exit code, output and metrics of a run."""
    path = tmp_path / "scenario.yaml"
    path.write_text(SLOW)
    sets = [word for change in changes for word in ("--set", change)]
    metrics = tmp_path / "metrics.json"
    words = ("run", path, *sets, "--json", metrics, "--out", tmp_path / "out")
    done = CliRunner().invoke(app, list(map(str, words)))
    return done.exit_code, done.output, json.loads(metrics.read_text())


def errors(metrics):
    return [
        (e["source"], e["text"].split(":")[0]) for e in metrics["events"] if e["level"] == "error"
    ]


def test_stall_is_an_error_and_others_fly_on(tmp_path):
    code, output, metrics = run_dive(tmp_path)
    assert (code, metrics["outcome"], metrics["simulated_s"]) == (1, "envelope_exceeded", 12.0)
    assert set(errors(metrics)) == {("uav1", "stalled")}
    assert "slow · envelope exceeded ·" in output
    assert "uav1: stalled" in output
    assert metrics["max_error_m"]["uav2"] < 5.0


def test_stall_with_stop_ends_the_run(tmp_path):
    code, output, metrics = run_dive(tmp_path, "limits.on_limit_exceeded=stop")
    assert (code, metrics["outcome"]) == (1, "envelope_exceeded")
    (stall,) = (each for each in metrics["events"] if each["level"] == "error")
    assert metrics["simulated_s"] == stall["time_s"] < 9.0
    assert "uav1: stalled" in output


def test_limit_not_reached_has_no_event(tmp_path):
    code, _, metrics = run_dive(tmp_path, "limits.stall_deg=30")
    assert (code, metrics["outcome"], errors(metrics)) == (0, "completed", [])


def test_dive_above_overspeed_is_an_error(tmp_path):
    code, _, metrics = run_dive(tmp_path, *DIVE, "limits.overspeed_mps=26")
    assert (code, metrics["outcome"]) == (1, "envelope_exceeded")
    assert {what for _, what in errors(metrics)} == {"overspeed"}
    assert [e for e in metrics["events"] if e["text"].startswith("no longer overspeed")]
    code, _, metrics = run_dive(tmp_path / "..", *DIVE)  # up to 1.5 times AIRSPEED_MAX
    assert (code, metrics["outcome"]) == (0, "completed")


def test_follower_far_from_slot_is_an_error(tmp_path):
    changes = ("limits.stall_deg=30", "limits.formation_lost_m=20", "scenario.duration_s=30")
    code, output, metrics = run_dive(tmp_path, *changes)
    assert (code, metrics["outcome"]) == (1, "formation_lost")
    assert errors(metrics) == [("uav1", "lost its formation")]
    assert "uav1: lost its formation" in output


def test_stall_after_a_fault_is_a_warning(tmp_path):
    fault = "fleet.uav1.faults=[{kind: transmitter-off, at_s: 0}]"
    code, _, metrics = run_dive(tmp_path, fault)
    assert (code, metrics["outcome"], errors(metrics)) == (0, "completed", [])
    stalls = [e for e in metrics["events"] if e["text"].startswith("stalled")]
    assert {(e["level"], e["source"]) for e in stalls} == {("warning", "uav1")}


@pytest.mark.parametrize("engine", ["jsbsim", "compiled"])
def test_nan_motion_is_a_loss_with_its_cause(engine):
    changes = [f"scenario.engine={engine}", "formation.agents={}", "limits.on_loss=continue"]
    world, seen = build(loads(SLOW, changes)), Collector()

    def insert_nan(now, due):
        if now == 3.0 and engine == "jsbsim":
            world.fleet._models[1].winds[0].set_double_value(math.nan)
        elif now == 3.0:
            (kind,) = world.fleet._kinds
            kind.state[1, kind.aircraft.columns["atmosphere/wind-north-fps"]] = math.nan
        return False

    assert fly(world, [seen], insert_nan) == "lost"
    events = [event for frame in seen.frames for event in frame.events]
    (lost,) = (event for event in events if event.level == "error")
    assert (lost.source, lost.time_s < 3.2) == ("uav1", True)
    assert lost.text.startswith("lost: its motion is not finite")
    last = seen.frames[-1]
    assert (last.time_s, last.lost.tolist()) == (12.0, [False, True, False])
    assert np.isfinite(last.truth.position_ned).all()


def test_nan_motion_is_the_same_in_two_processes():
    """That of uav2, which the second process steps, from the first step on."""
    results = []
    changes = ["scenario.engine=jsbsim", "formation.agents={}", "limits.on_loss=continue"]
    for processes in (1, 2):
        scenario = loads(SLOW, changes)
        world, seen = build(set_duration(scenario, 3.0), processes=processes), Collector()
        world.fleet._models[2].winds[0].set_double_value(math.nan)
        assert fly(world, [seen], lambda now, due: False) == "lost"
        results.append([(f.truth, f.air, f.lost) for f in seen.frames])
        if processes == 2:
            world.fleet.close()
    assert results[0][-1][2].tolist() == [False, False, True]
    for (*serial, _), (*parallel, _) in zip(*results, strict=True):
        for ours, theirs in zip(serial, parallel, strict=True):
            for name, one, two in zip(ours._fields, ours, theirs, strict=True):
                np.testing.assert_array_equal(two, one, err_msg=name)


def test_stall_angle_is_that_of_largest_lift():
    """The peak of a table for the Rascal, of the published lift curve for the X8."""
    rascal, x8 = (airframe(find_aircraft(name)) for name in ("rascal110", "skywalker_x8"))
    assert rascal.stall_angle == pytest.approx(0.23, abs=math.radians(0.06))
    alpha = np.linspace(0.0, 0.6, 60001)
    # [GRY12]: linear up to the stall, a flat plate beyond, and a sigmoid between
    low, high = np.exp(-50.0 * (alpha - 0.28798)), np.exp(50.0 * (alpha + 0.28798))
    sigma = (1.0 + low + high) / (1.0 + low) / (1.0 + high)
    linear = 0.0867 + 4.0203 * alpha
    lift = (1.0 - sigma) * linear + sigma * 2.0 * np.sin(alpha) ** 2 * np.cos(alpha)
    assert x8.stall_angle == pytest.approx(alpha[lift.argmax()], abs=math.radians(0.06))


def test_table_counts_stalls_of_an_aircraft(tmp_path):
    _, output, metrics = run_dive(tmp_path, "scenario.duration_s=24")
    times = [e["time_s"] for e in metrics["events"] if e["text"].startswith("stalled")]
    assert len(times) > 2
    assert f"limit exceeded      uav1 stalled at {times[0]:.1f} s, {len(times)} times" in output


def test_study_row_and_cost_of_a_stall():
    """The cost exceeds that of any completed flight, and falls the later the stall begins."""
    row = run_task(FlightTask(7, loads(SLOW)))
    assert (row.number, row.outcome) == (7, "envelope_exceeded")
    assert row.error.startswith("envelope_exceeded: uav1 stalled at ")
    at = next(e["time_s"] for e in row.metrics["events"] if e["level"] == "error")
    found = flight_cost(row.metrics, "max_error_m.uav2", duration_s=12.0, saturation=5.0)
    assert found == pytest.approx(5.0 * (3.0 - at / 12.0))
