"""Unicycles in runs: in wind, outside their speed set, beside aircraft."""

import numpy as np
import pytest
from run_flight import Collector

import testbed
from testbed.plan.world import build
from testbed.scenario import load_scenario, loads, set_duration

IDEAL = "fleet.*.vehicle=unicycle"
WIND = ("air.wind.speed_mps=8", "air.wind.from_deg=90")  # on the nose of simulation-3's first leg


def fly(name, *overrides, seconds=3.0):
    seen = Collector()
    flown = testbed.run(
        set_duration(load_scenario(name, overrides), seconds), write=False, observers=[seen]
    )
    return flown, seen


def ground_speeds(frame):
    return np.linalg.norm(frame.truth.velocity_ned, axis=1)


def test_start_speed_is_the_leaders_ground_speed():
    for name, overrides, expected in (
        ("simulation-3", (IDEAL, *WIND), 14.0),
        ("simulation-3", (IDEAL, "leader.vehicle=unicycle", *WIND), 22.0),
        ("ideal-figure-eight", WIND, 22.0),
    ):
        _, seen = fly(name, *overrides, seconds=0.2)
        assert ground_speeds(seen.frames[0]) == pytest.approx(np.full(4, expected), abs=1e-3), name


PAGE = """
scenario: {schema: 2, name: fast, duration_s: 30}
leader:
  aircraft: rascal110
  start: {altitude_m: 150}
  path: {kind: virtual, speed_mps: SPEED, curve: {kind: straight}}
fleet:
  - {name: uav1, aircraft: rascal110, vehicle: unicycle, start_m: [-10, 5, 0]}
formation: {offsets_m: {uav1: [-5, 5, 0]}, leader_gains: {uav1: 1}}
"""


@pytest.mark.parametrize("speed", [11.0, 34.0, 37.0])
def test_unicycle_outside_its_speed_set_is_limited(speed):
    """4 m/s beyond a bound the slope of example 5 is nearly zero, and (14) divides by it."""
    seen = Collector()
    # a follower that cannot reach its leader's speed leaves its slot
    page = loads(PAGE.replace("SPEED", str(speed)), ["limits.formation_lost_m=null"])
    flown = testbed.run(page, write=False, observers=[seen])
    assert flown.outcome == "completed"
    speeds = np.array([ground_speeds(frame)[1] for frame in seen.frames])
    assert (abs(np.diff(speeds)) < 1.0).all()
    # entered S, and never left it
    inside = (speeds > 16.0) & (speeds < 30.0)
    assert inside[-1]
    assert inside[np.argmax(inside) :].all()


def test_unicycle_reports_no_saturation():
    flown, _ = fly("ideal-figure-eight", seconds=30.0)
    assert {each["seconds"] for each in flown.metrics["saturations"].values()} == {0.0}


def test_unicycles_and_aircraft_keep_their_rows():
    _, seen = fly("simulation-3", "fleet.uav2.vehicle=unicycle", seconds=1.0)
    assert seen.info.wingspan_m == pytest.approx((2.795,) * 4, abs=0.001)
    first, last = seen.frames[0], seen.frames[-1]
    offsets = last.truth.position_ned - last.truth.position_ned[0]
    start = first.truth.position_ned - first.truth.position_ned[0]
    assert abs(offsets - start).max() < 3.0
    # no propeller, no elevator
    assert (last.air.propeller_rps > 0.0).tolist() == [True, True, False, True]
    assert (last.surfaces.elevator != 0.0).tolist() == [True, True, False, True]


def test_altitude_hold_neighbour_has_no_vertical_gain():
    """Its altitude is not that of its slot."""
    assert leader_and_uav1_gains("experiment-2")[1, 2] > 0.0
    leader, uav1 = leader_and_uav1_gains("experiment-3", "formation.altitudes_m={uav1: 80}")
    assert uav1.tolist() == [50.0, 50.0, 0.0]
    assert leader[2] > 0.0


def leader_and_uav1_gains(name, *overrides):
    """Return the gains (2, 3) that uav2 has for the leader and for uav1."""
    world = build(load_scenario(name, overrides))
    return world.formation.built_control.neighbours["gain"][
        world.formation.built_control.config.names.index("uav2"), :2
    ]
