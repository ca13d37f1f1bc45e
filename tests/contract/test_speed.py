"""Speed benchmarks: bare and full make the same steps, and every part is timed."""

import importlib
import itertools
from pathlib import Path

import pytest

from testbed.scenario import load_scenario, set_duration
from testbed.sim.build import build
from testbed.studies.plan import load_study

ROOT = Path(__file__).parents[2]


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module


def test_timed_methods_cover_every_part(benchmark):
    timer = benchmark("part_timer")
    assert {*timer.TIMED_METHODS, "loop"} == set(timer.PARTS)


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


def test_numbers_are_medians_of_turns(benchmark):
    ratio, speed = benchmark("full_over_bare"), benchmark("speed")
    cost = ratio.Cost
    scenario = set_duration(load_scenario("simulation-3"), 10.0)  # 40 aircraft-seconds
    turns = [
        ratio.Turn(
            cost(1.0, 0.8), cost(2.0, 2.0), cost(2.1, 2.1), 0.1, cost(1.1, 1.0), cost(1.5, 1.0)
        ),
        ratio.Turn(
            cost(0.9, 0.8), cost(2.7, 2.4), cost(3.0, 2.4), 0.2, cost(1.1, 1.2), cost(1.62, 1.0)
        ),
        ratio.Turn(
            cost(2.0, 1.6), cost(5.0, 4.0), cost(5.0, 4.0), 0.3, cost(2.0, 2.0), cost(3.2, 1.0)
        ),
    ]
    result = speed.numbers(scenario, turns, {"physics": 0.5, "log": 0.5})
    assert result["full_over_bare"] == 2.5
    assert result["full_over_bare_spread"] == pytest.approx([2.0, 3.0])
    assert result["full_over_bare_processor_spread"] == pytest.approx([2.5, 3.0])
    assert result["least_full_over_least_bare"] == pytest.approx(2.0 / 0.9)
    assert result["real_time_factor"] == pytest.approx(10.0 / 2.7)
    each = result["us_per_aircraft_second"]
    assert each["full"] == pytest.approx(2.4e6 / 40.0) and each["bare"] == pytest.approx(0.8e6 / 40)
    assert each["physics"] == pytest.approx(each["full"] / 2.0)
    assert result["timing_cost"] == 1.0 and result["build_s"] == 0.2
    assert result["io_over_bare_processor"] == pytest.approx(1.25)
    # medians of 1.5, 1.8 and 1.6 bare loops, and of 1.5, 1.62 and 3.2 s
    parallel = result["parallel"]
    assert parallel["full_over_bare"] == 1.6
    assert parallel["full_over_bare_spread"] == pytest.approx([1.5, 1.8])
    assert parallel["real_time_factor"] == pytest.approx(10.0 / 1.62)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_vee_has_the_requested_flight_models(benchmark, count):
    fleets = benchmark("fleets")
    scenario = fleets.vee(count, 1.0)
    fleet = build(scenario).fleet
    assert benchmark("full_over_bare").flight_models(scenario) == len(fleet.bare_runs()) == count


def test_all_effects_come_from_their_scenarios(benchmark):
    scenario, radio, air = (
        benchmark("fleets").all_effects(),
        load_scenario("bursty-wifi"),
        load_scenario("turbulence-moderate"),
    )
    assert (scenario.network, scenario.rates) == (radio.network, radio.rates)
    assert (
        scenario.air == air.air
        and scenario.controller.bounded_speed == air.controller.bounded_speed
    )
    pixhawk = load_scenario("simulation-3-pixhawk").leader.sensors
    assert {each.sensors for each in scenario.aircraft} == {pixhawk}


def test_convergence_study_has_every_case_of_table(benchmark):
    convergence = benchmark("convergence")
    config = load_study(convergence.STUDY).config
    steps = {
        convergence.TWICE,
        *(c for each in convergence.LADDERS.values() for c in each.values()),
    }
    assert set(config.cases) == {name + step for name in convergence.SIMULATIONS for step in steps}
    base = load_scenario("simulation-3").rates
    own = {"physics": base.physics_hz, "autopilot": base.autopilot_hz, "samples": base.log_hz}
    own["control and messages"] = base.control_hz
    for what, ladder in convergence.LADDERS.items():
        assert [rate for rate, case in ladder.items() if not case] == [own[what]]
        for rate, case in ladder.items():
            assert not case or case.endswith(f"-{rate}")


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
