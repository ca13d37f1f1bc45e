"""Flight models that several processes step: in rows of shared records, the same to the bit."""

import math
import sys
from functools import cache

import numpy as np
import pytest
from cases import ALL

from testbed.core.records import (
    AIRCRAFT,
    ActuatorCommand,
    NedOrigin,
    WindInput,
    allocate,
)
from testbed.scenario import find_aircraft
from testbed.vehicle.fleet import JsbsimFleet, write_fields_at
from testbed.vehicle.trim import InitialState
from testbed.vehicle.workers import ParallelFleet, make_fleet

KINDS = ("rascal110", "skywalker_x8", "rascal110", "skywalker_x8", "rascal110")
N = len(KINDS)
PERIODS, TICKS = 30, 4
each_count = pytest.mark.parametrize(
    "processes",
    [
        2,
        *([3] if ALL else []),
        pytest.param(50, id="more processes than aircraft"),
    ],
)
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked on Linux")


def aloft(processes):
    starts = [
        InitialState(
            (0.0, 40.0 * row, -300.0), airspeed=20.0, state_of_charge=0.9 if row == 1 else 1.0
        )
        for row in range(N)
    ]
    folders = [find_aircraft(kind) for kind in KINDS]
    return make_fleet(folders, starts, NedOrigin(), 200, processes=processes)


def flown(processes, *, lose=None, rows=None):
    """All that is read of aircraft that are pushed about, every period.

    Args:
        processes: that step them.
        lose: period at which the numbers of the second and last are lost, and the first is removed.
        rows: of the records of a run that they are bound to; None: their own.
    """
    rng, fleet, out = np.random.default_rng(9), aloft(processes), []
    if rows is not None:
        fleet.bind(allocate(AIRCRAFT, 2 * N), np.array(rows))
    trim = fleet.trimmed
    for period in range(PERIODS):
        wind, turning = rng.normal(0.0, 3.0, (N, 3)), rng.normal(0.0, 0.05, (N, 3))
        if period == lose:
            wind[[1, N - 1], 0] = math.nan
        if lose is None or period <= lose:
            fleet.set_wind(WindInput(wind, turning, np.zeros(N)))
        elif period == lose + 1:
            fleet.set_wind(WindInput(np.zeros((N, 3)), np.zeros((N, 3)), np.zeros(N)))
        charge = np.full(N, np.nan)
        if period == 5:
            charge[[1, 3]] = 0.3, 0.2
        fleet.discharge(charge)
        fleet.step(ActuatorCommand(*(each + rng.normal(0.0, 0.02, N) for each in trim)), TICKS)
        state, air = fleet.read(), fleet.air()
        if period == lose:
            # what is no number is stopped, as the loss monitor does it
            gone = fleet.lost(state)
            gone[0] = True
            fleet.remove(gone)
        out.append([np.array(each).ravel() for record in (state, air) for each in record])
        stopped = fleet.aircraft["stopped"][fleet.rows]
        out[-1].append(stopped.astype(float))
    if hasattr(fleet, "close"):
        fleet.close()
    return [np.concatenate(each) for each in zip(*out, strict=True)], fleet


@cache
def flown_alone(lose=None):
    return flown(1, lose=lose)


@each_count
@pytest.mark.parametrize("lose", [None, 10])
def test_who_steps_an_aircraft_changes_nothing(processes, lose):
    alone, one = flown_alone(lose)
    several, many = flown(processes, lose=lose)
    assert type(one) is JsbsimFleet
    assert type(many) is not JsbsimFleet
    for ours, theirs in zip(alone, several, strict=True):
        np.testing.assert_array_equal(theirs, ours)
    stopped = alone[-1].reshape(PERIODS, N)[-1]
    assert stopped.tolist() == ([0.0] * N if lose is None else [1.0, 1.0, 0.0, 0.0, 1.0])
    if lose is not None:
        for each in (one.read(), many.read()):
            assert all(np.isfinite(array).all() for array in each)


@pytest.mark.parametrize("input_", ["write_wind", "discharge", "write_surfaces"])
def test_input_lost_between_processes_is_found(monkeypatch, input_):
    bind = ParallelFleet.bind

    def bind_others(fleet, *records):
        bind(fleet, *records)
        setattr(fleet, input_, lambda *_: None)

    monkeypatch.setattr(ParallelFleet, "bind", bind_others)
    with pytest.raises(AssertionError):
        test_who_steps_an_aircraft_changes_nothing(2, None)


@pytest.mark.parametrize("processes", [1, 2])
def test_fleet_writes_only_its_rows_of_a_run(processes):
    rows = [7, 2, 9, 0, 4]
    own, fleet = flown_alone()[0], flown(processes, rows=rows)
    for ours, theirs in zip(own, fleet[0], strict=True):
        np.testing.assert_array_equal(theirs, ours)
    others = np.setdiff1d(np.arange(2 * N), rows)
    untouched = fleet[1].aircraft[others]
    for name in ("truth", "wind", "air"):
        assert not any(np.any(untouched[name][field]) for field in untouched.dtype[name].names)


def test_only_the_motion_that_is_asked_for_is_read():
    rng, fleet, apart = np.random.default_rng(4), aloft(1), aloft(1)
    before = fleet.read().position_ned
    for _ in range(20):
        ticks, which = int(rng.integers(1, 4)), np.flatnonzero(rng.random(N) < 0.5)
        fleet.run(ticks, which)
        apart.step(None, ticks)
        before[which] = apart.read().position_ned[which]
        np.testing.assert_array_equal(fleet.read().position_ned, before)


def test_what_is_read_and_set_is_what_jsbsim_says():
    """By JSBSim's own properties, in its units: feet, and elevator and rudder the other way."""
    fleet = aloft(1)
    wind = WindInput(np.full((N, 3), 1.5), np.full((N, 3), 0.02), np.full(N, 0.01))
    write_fields_at(fleet.aircraft, fleet.rows, "wind", wind)
    fleet.write_wind(0.0)
    fleet.step(ActuatorCommand(*(np.full(N, value) for value in (0.1, 0.2, 0.3, 0.4))), 1)
    state, air = fleet.read(), fleet.air()
    for row, run in enumerate(fleet.bare_runs()):
        fdm = run.__self__
        assert fdm["atmosphere/wind-north-fps"] * 0.3048 == pytest.approx(1.5, rel=1e-14)
        assert fdm["fcs/elevator-cmd-norm"] == -0.2
        assert fdm["fcs/aileron-cmd-norm"] == 0.1
        assert fdm["fcs/throttle-cmd-norm"] == 0.4
        assert state.airspeed[row] == pytest.approx(fdm["velocities/vt-fps"] * 0.3048, rel=1e-14)
        assert state.euler[row, 1] == fdm["attitude/theta-rad"]
        assert state.velocity_ned[row, 2] == pytest.approx(
            fdm["velocities/v-down-fps"] * 0.3048, rel=1e-14
        )
        assert air.alpha[row] == fdm["aero/alpha-rad"]
        assert air.propeller_rps[row] == fdm["propulsion/engine/propeller-rpm"] / 60.0
        battery = KINDS[row] == "skywalker_x8"
        assert np.isfinite(air.battery_voltage[row]) == battery
        if battery:
            assert air.state_of_charge[row] == fdm["battery/state-of-charge"]
    np.testing.assert_array_equal(air.wind_gradient_rates, wind.wind_gradient_rates)
