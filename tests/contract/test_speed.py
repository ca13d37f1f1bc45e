"""Speed benchmarks: bare and full make the same steps, and every part is timed."""

import importlib
import itertools
from pathlib import Path

import pytest

from testbed.scenario import load_scenario, set_duration
from testbed.sim.build import build

ROOT = Path(__file__).parents[2]


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module


def test_part_timer_counts_calls_of_each_part(benchmark):
    timer, ratio = benchmark("part_timer"), benchmark("full_over_bare")
    scenario = set_duration(load_scenario("simulation-3"), 4.0)
    # a clock that advances by one at each reading
    watch = timer.PartTimer(itertools.count().__next__)
    with watch.timing():
        ratio.full(scenario, watch)
    assert sum(watch.shares.values()) == pytest.approx(1.0)
    ticks, frames = 4 * scenario.rates.autopilot_hz + 1, 4 * scenario.rates.log_hz + 1
    # the log is called once per sample
    calls = {part: frames * share / watch.shares["log"] for part, share in watch.shares.items()}
    assert calls["physics"] == pytest.approx(ticks - 1)  # none after the last
    assert calls["autopilot"] == pytest.approx(ticks)
    assert calls["leader"] == calls["metrics"] == pytest.approx(frames)
    assert calls["control"] == pytest.approx(2 * frames)  # membership and step
    assert calls["sensing"] == 0.0  # exact estimates
    assert calls["air"] == 0.0  # still air
    assert min(calls[part] for part in ("properties", "network", "events")) >= frames
    assert max(calls, key=calls.__getitem__) == "loop"  # between any two parts


@pytest.mark.parametrize("count", [1, 2, 5])
def test_vee_has_the_requested_flight_models(benchmark, count):
    fleets = benchmark("fleets")
    scenario = fleets.vee(count, 1.0)
    fleet = build(scenario).fleet
    assert benchmark("full_over_bare").flight_models(scenario) == len(fleet.bare_runs()) == count


def test_convergence_figure_has_all_simulations(benchmark):
    """An error that is 1 + 1/rate is 7/8 of a percent farther off at 100 Hz than at 800 Hz."""
    convergence = benchmark("convergence")
    rows = {
        (name + case, 1): {
            f"windows.{of}.rms_m.{follower}": 1.0 + 1.0 / rate for of, follower in convergence.CELLS
        }
        for name in convergence.SIMULATIONS
        for ladder in convergence.LADDERS.values()
        for rate, case in ladder.items()
        if case
    }
    own = {
        f"windows.{of}.rms_m.{follower}": 1.0 + 1.0 / 200.0 for of, follower in convergence.CELLS
    }
    rows |= {(name, 1): own for name in convergence.SIMULATIONS}
    (panels,) = convergence.figure(rows).rows
    assert all(len(panel.lines) == len(convergence.SIMULATIONS) + 1 for panel in panels)
    physics = panels[0].lines[0]
    assert physics.x.tolist() == [100.0, 200.0, 400.0]
    expected = 100.0 * ((1.0 + 1.0 / physics.x) / (1.0 + 1.0 / 800.0) - 1.0)
    assert physics.y == pytest.approx(expected)
