"""Speed benchmarks: bare and full make the same steps, and every part is timed."""

import importlib
import itertools
from pathlib import Path

import pytest

from testbed.plan.world import build
from testbed.scenario import load_scenario, set_duration

ROOT = Path(__file__).parents[2]


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module


def test_part_timer_counts_calls_of_each_part(benchmark):
    timer, ratio = benchmark("part_timer"), benchmark("full_over_bare")
    scenario = set_duration(load_scenario("simulation-3"), 8.0)
    # a clock that advances by one at each reading
    watch = timer.PartTimer(itertools.count().__next__)
    with watch.timing():
        ratio.full(scenario, watch)
    assert sum(watch.shares.values()) == pytest.approx(1.0)
    ticks, frames = 8 * scenario.rates.autopilot_hz + 1, 8 * scenario.rates.log_hz + 1
    # the log is called twice per sample, to append it and to write a full block, and goes on after
    # the metrics have taken that block
    readings = 2 * frames + 1
    calls = {part: readings * share / watch.shares["log"] for part, share in watch.shares.items()}
    assert calls["physics"] == pytest.approx(ticks - 1)  # none after the last
    assert calls["autopilot"] == pytest.approx(ticks)
    assert calls["leader"] == pytest.approx(frames)
    assert calls["metrics"] == pytest.approx(2)  # a full block, and the rest for the summary
    assert calls["control"] == pytest.approx(frames)
    assert calls["sensing"] == 0.0  # exact estimates
    assert calls["air"] == 0.0  # still air
    assert min(calls[part] for part in ("properties", "network", "events")) >= frames
    assert max(calls, key=calls.__getitem__) == "loop"  # between any two parts


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
