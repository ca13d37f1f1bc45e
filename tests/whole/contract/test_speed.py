"""Speed benchmarks: what is measured, and the tables made of it."""

import importlib

import pytest
from places import ROOT

from testbed.plan.world import build
from testbed.scenario import load_scenario, set_duration


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module


def test_turn_measures_all_flights(benchmark):
    """At the own rate, at that of the bare loop, and without a log; the bare loop at 200 Hz."""
    ratio = benchmark("full_over_bare")
    scenario = set_duration(load_scenario("simulation-3"), 2.0)
    found = ratio.turn(scenario)
    costs = found.bare, found.full, found.at_bare_hz, found.no_log
    assert all(each.wall_s > 0.0 and each.processor_s > 0.0 for each in costs)
    assert found.build_s > 0.0
    quick = ratio.at_rate(scenario, 200, log=False)
    assert quick.rates.physics_hz == 200 and not quick.log.mcap
    lost = set_duration(load_scenario("simulation-3", ["limits.collision_m=20"]), 10.0)
    with pytest.raises(SystemExit, match="a lost aircraft costs nothing"):
        ratio.full(lost)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_vee_has_the_requested_flight_models(benchmark, count):
    fleets = benchmark("fleets")
    scenario = fleets.vee(count, 1.0)
    fleet = build(scenario).fleet
    assert benchmark("full_over_bare").flight_models(scenario) == len(fleet.trims) == count


def flight(error, rate_hz):
    """Return the numbers of a flight whose second follower is saturated."""
    return {
        "windows.laps.rms_m.uav1": error(rate_hz),
        "windows.laps.rms_m.uav2": error(rate_hz) + 1.0,
        "windows.laps.mean_rms_m": 1.0,
        "saturations.uav1.seconds": 1.0,
        "saturations.uav2.seconds": 50.0,
        "simulated_s": 100.0,
    }


def flights(convergence, error):
    return {
        (name, rate, 1): flight(error, rate)
        for name in convergence.DRAWN
        for rate in convergence.RATES
    }


def test_convergence_table_has_orders_and_worst_error(benchmark):
    """An error of 1 + (10/rate)² m is 3.98 % off at 50 Hz and 0.98 % at 100 Hz: order 2."""
    convergence = benchmark("convergence")
    flown = flights(convergence, lambda rate: 1.0 + (10.0 / rate) ** 2)
    head, _, first, *_ = convergence.rates_table(flown, calm=True)
    assert "50 Hz | 100 Hz | 200 Hz | 400 Hz | order 50–200" in head
    assert "**+3.98 %, +39.8 mm** | +0.98 %, +9.8 mm |" in first
    assert first.endswith("| 2.0 | 2.0 | 2.0 |")
    assert "meets the criterion: 100 Hz." in convergence.verdict(flown)
    others = list(convergence.rates_table(flown, calm=False))[2:]
    assert len(others) == len(convergence.DRAWN) and "2.00 to 2.00" in others[0]


def test_convergence_table_names_what_fails_at_default(benchmark):
    convergence = benchmark("convergence")
    flown = flights(convergence, lambda rate: 1.0 + 2.0 / rate)
    text = convergence.verdict(flown)
    assert "meets the criterion: 200 Hz." in text
    assert "simulation-1 (uav1, laps)" in text and "uav2" not in text


def test_convergence_figure_draws_distances(benchmark):
    convergence = benchmark("convergence")
    flown = flights(convergence, lambda rate: 1.0 + 1.0 / rate)
    ((panel,),) = convergence.figure(flown).rows
    assert len(panel.lines) == len(convergence.DRAWN) + 1
    drawn = panel.lines[0]
    expected = 100.0 * ((1.0 + 1.0 / drawn.x) / (1.0 + 1.0 / 800.0) - 1.0)
    assert drawn.y == pytest.approx(expected)
