"""Ideal vehicles in whole worlds: in wind, outside their speed set, beside aircraft."""

import numpy as np
import pytest
from run_flight import Collector

import testbed
from testbed.scenario import load, loads, shorten
from testbed.sim.world import build

IDEAL = "fleet.*.vehicle=ideal"
WIND = ("air.wind.speed_mps=8", "air.wind.from_deg=90")  # on the nose of simulation-3's first leg


def fly(name, *overrides, seconds=3.0):
    seen = Collector()
    flown = testbed.run(shorten(load(name, overrides), seconds), write=False, observers=[seen])
    return flown, seen


def ground_speeds(frame):
    return np.linalg.norm(frame.truth.velocity_ned, axis=1)


def test_everybody_starts_at_the_leaders_speed_over_the_ground():
    for name, overrides, expected in (
        ("simulation-3", (IDEAL, *WIND), 14.0),
        ("simulation-3", (IDEAL, "leader.vehicle=ideal", *WIND), 22.0),
        ("ideal-figure-eight", WIND, 22.0),
    ):
        _, seen = fly(name, *overrides, seconds=0.2)
        assert ground_speeds(seen.frames[0]) == pytest.approx(np.full(4, expected), abs=1e-3), name


PAGE = """
scenario: {schema: 1, name: fast, duration_s: 30}
leader:
  aircraft: rascal110
  start: {altitude_m: 150}
  path: {kind: virtual, speed_mps: SPEED, curve: {kind: straight}}
fleet:
  - {name: uav1, aircraft: rascal110, vehicle: ideal, start_m: [-10, 5, 0]}
formation: {offsets_m: {uav1: [-5, 5, 0]}, leader_gains: {uav1: 1}}
"""


@pytest.mark.parametrize("speed", [11.0, 34.0, 37.0])
def test_outside_its_speed_set_the_guard_on_u_stands_for_an_ideal_vehicle_too(speed):
    """Example 5's slope all but vanishes 4 m/s past a bound, and (14) divides by it."""
    seen = Collector()
    # who may not be as fast or as slow as its leader stays behind, or ahead
    page = loads(PAGE.replace("SPEED", str(speed)), ["limits.formation_m=null"])
    flown = testbed.run(page, write=False, observers=[seen])
    assert flown.outcome == "flown"
    speeds = np.array([ground_speeds(frame)[1] for frame in seen.frames])
    assert (abs(np.diff(speeds)) < 1.0).all()
    # entered S, and never left it
    inside = (speeds > 16.0) & (speeds < 30.0)
    assert inside[-1]
    assert inside[np.argmax(inside) :].all()


def test_nothing_is_said_of_a_middle_loop_that_is_not_there():
    flown, _ = fly("ideal-figure-eight", seconds=30.0)
    assert {each["seconds"] for each in flown.metrics["saturations"].values()} == {0.0}


def test_ideal_vehicles_and_aircraft_keep_their_rows():
    _, seen = fly("simulation-3", "fleet.uav2.vehicle=ideal", seconds=1.0)
    assert seen.info.wingspan_m == pytest.approx((2.795,) * 4, abs=0.001)
    first, last = seen.frames[0], seen.frames[-1]
    offsets = last.truth.position_ned - last.truth.position_ned[0]
    start = first.truth.position_ned - first.truth.position_ned[0]
    assert abs(offsets - start).max() < 3.0
    # no propeller, no elevator
    assert (last.air.propeller_rps > 0.0).tolist() == [True, True, False, True]
    assert (last.surfaces.elevator != 0.0).tolist() == [True, True, False, True]


def test_a_neighbour_that_holds_an_altitude_is_no_measure_of_height():
    """Its slot in the law's frame is not where it flies."""
    (group, *_) = build(load("experiment-3", ["formation.altitudes_m={uav1: 80}"])).groups
    whole = build(load("experiment-2")).groups
    gains = {name: g.team.gains[k] for g in whole for k, name in enumerate(g.team.names)}
    assert gains["uav2"][1, 2] > 0.0
    for each in build(load("experiment-3", ["formation.altitudes_m={uav1: 80}"])).groups:
        for k, name in enumerate(each.team.names):
            if name == "uav2":
                assert each.team.gains[k, 1].tolist() == [50.0, 50.0, 0.0]
                assert each.team.gains[k, 0, 2] > 0.0
