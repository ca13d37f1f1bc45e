"""What goes wrong in flight is an event, a line of the table, and an exit code."""

import json
import math

import numpy as np
import pytest
from run_flight import Collector
from typer.testing import CliRunner

from testbed.cli import app
from testbed.scenario import find_aircraft, loads, shorten
from testbed.sim.loop import fly
from testbed.sim.world import build
from testbed.study.crew import Task
from testbed.study.crew import fly as fly_task
from testbed.study.tune_cost import cost
from testbed.vehicle.jsbsim_door import airframe

# UAV 1 may never be faster than 7 m/s, at which no Rascal flies; UAV 2 flies beside the leader.
SLOW = """
scenario: {schema: 1, name: slow, duration_s: 12}
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


def flown(tmp_path, *changes):
    """Exit code, what was printed, and the metrics."""
    path = tmp_path / "page.yaml"
    path.write_text(SLOW)
    sets = [word for change in changes for word in ("--set", change)]
    where = tmp_path / "metrics.json"
    words = ("run", path, *sets, "--json", where, "--out", tmp_path / "out")
    done = CliRunner().invoke(app, list(map(str, words)))
    return done.exit_code, done.output, json.loads(where.read_text())


def errors(metrics):
    return [
        (e["source"], e["text"].split(":")[0]) for e in metrics["events"] if e["level"] == "error"
    ]


def test_a_stall_is_loud_and_the_others_fly_on(tmp_path):
    code, output, metrics = flown(tmp_path)
    assert (code, metrics["outcome"], metrics["simulated_s"]) == (1, "upset", 12.0)
    assert set(errors(metrics)) == {("uav1", "stalled")}
    assert "slow · upset ·" in output
    assert "uav1: stalled" in output
    assert metrics["max_error_m"]["uav2"] < 5.0


def test_a_run_stops_with_an_upset_where_the_page_says_so(tmp_path):
    code, output, metrics = flown(tmp_path, "limits.when_upset=stop")
    assert (code, metrics["outcome"]) == (1, "upset")
    (stall,) = (each for each in metrics["events"] if each["level"] == "error")
    assert metrics["simulated_s"] == stall["time_s"] < 9.0
    assert "uav1: stalled" in output


def test_a_limit_that_is_not_reached_is_not_mentioned(tmp_path):
    code, _, metrics = flown(tmp_path, "limits.stall_deg=30")
    assert (code, metrics["outcome"], errors(metrics)) == (0, "flown", [])


def test_overspeed_in_a_dive(tmp_path):
    code, _, metrics = flown(tmp_path, *DIVE, "limits.overspeed_mps=26")
    assert (code, metrics["outcome"]) == (1, "upset")
    assert {what for _, what in errors(metrics)} == {"overspeed"}
    assert [e for e in metrics["events"] if e["text"].startswith("no longer overspeed")]
    code, _, metrics = flown(tmp_path / "..", *DIVE)  # up to 1.5 times AIRSPEED_MAX
    assert (code, metrics["outcome"]) == (0, "flown")


def test_a_formation_is_lost(tmp_path):
    left_behind = ("limits.stall_deg=30", "limits.formation_m=20", "scenario.duration_s=30")
    code, output, metrics = flown(tmp_path, *left_behind)
    assert (code, metrics["outcome"]) == (1, "upset")
    assert errors(metrics) == [("uav1", "lost its formation")]
    assert "uav1: lost its formation" in output


def test_what_a_fault_of_the_page_explains_is_told_and_is_no_failure(tmp_path):
    fault = "fleet.uav1.faults=[{kind: radio-mute, at_s: 0}]"
    code, _, metrics = flown(tmp_path, fault)
    assert (code, metrics["outcome"], errors(metrics)) == (0, "flown", [])
    stalls = [e for e in metrics["events"] if e["text"].startswith("stalled")]
    assert {(e["level"], e["source"]) for e in stalls} == {("warning", "uav1")}


def test_a_motion_that_is_no_number_is_a_loss_with_its_cause():
    world = build(loads(SLOW, ["formation.agents={}", "limits.when_lost=fly-on"]))
    seen = Collector()

    def breaks(now, due):
        if now == 3.0:
            world.fleet._models[1].winds[0].set_double_value(math.nan)
        return False

    assert fly(world, [seen], breaks) == "lost"
    events = [event for frame in seen.frames for event in frame.events]
    (lost,) = (event for event in events if event.level == "error")
    assert (lost.source, lost.time_s < 3.2) == ("uav1", True)
    assert lost.text.startswith("lost: its motion was no longer a number")
    last = seen.frames[-1]
    assert (last.time_s, last.lost.tolist()) == (12.0, [False, True, False])
    assert np.isfinite(last.truth.position_ned).all()


def test_a_motion_that_is_no_number_is_the_same_in_another_process():
    """UAV 2's, from the first step on, which the second of two processes steps."""
    kept = []
    for processes in (1, 2):
        page = loads(SLOW, ["formation.agents={}", "limits.when_lost=fly-on"])
        world, seen = build(shorten(page, 3.0), processes=processes), Collector()
        world.fleet._models[2].winds[0].set_double_value(math.nan)
        assert fly(world, [seen], lambda now, due: False) == "lost"
        kept.append([(f.truth, f.air, f.lost) for f in seen.frames])
        if processes == 2:
            world.fleet.close()
    assert kept[0][-1][2].tolist() == [False, False, True]
    for (*alone, _), (*shared, _) in zip(*kept, strict=True):
        for ours, theirs in zip(alone, shared, strict=True):
            for name, one, two in zip(ours._fields, ours, theirs, strict=True):
                np.testing.assert_array_equal(two, one, err_msg=name)


def test_an_aircraft_stalls_where_its_lift_is_largest():
    """Of the Rascal a table's peak; of the X8 the largest of its published lift curve."""
    rascal, x8 = (airframe(find_aircraft(name)) for name in ("rascal110", "skywalker_x8"))
    assert rascal.stall_angle == pytest.approx(0.23, abs=math.radians(0.06))
    alpha = np.linspace(0.0, 0.6, 60001)
    # [GRY12]: linear up to the stall, a flat plate beyond, and a sigmoid between
    low, high = np.exp(-50.0 * (alpha - 0.28798)), np.exp(50.0 * (alpha + 0.28798))
    sigma = (1.0 + low + high) / (1.0 + low) / (1.0 + high)
    linear = 0.0867 + 4.0203 * alpha
    lift = (1.0 - sigma) * linear + sigma * 2.0 * np.sin(alpha) ** 2 * np.cos(alpha)
    assert x8.stall_angle == pytest.approx(alpha[lift.argmax()], abs=math.radians(0.06))


def test_the_table_says_once_who_was_upset_and_how_often(tmp_path):
    _, output, metrics = flown(tmp_path, "scenario.duration_s=24")
    times = [e["time_s"] for e in metrics["events"] if e["text"].startswith("stalled")]
    assert len(times) > 2
    assert f"upset               uav1 stalled at {times[0]:.1f} s, {len(times)} × in all" in output


def test_a_study_says_who_was_upset_and_a_search_pays_for_it():
    """More than for any flight without one, and less the later it began."""
    row = fly_task(Task(7, loads(SLOW)))
    assert (row.number, row.outcome) == (7, "upset")
    assert row.error.startswith("upset: uav1 stalled at ")
    at = next(e["time_s"] for e in row.metrics["events"] if e["level"] == "error")
    paid = cost(row.metrics, "max_error_m.uav2", duration_s=12.0, bound=5.0)
    assert paid == pytest.approx(5.0 * (3.0 - at / 12.0))
