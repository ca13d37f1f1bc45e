"""The scenario that is assessed: its criteria, seeds and commands."""

import shlex

import pytest

from testbed.assessment.assessed import Assessed
from testbed.assessment.conditions import CONDITIONS
from testbed.scenario import open_scenario


def assessed(*overrides, name="simulation-3", **options):
    return Assessed(name, open_scenario(name), overrides, **options)


def test_default_criteria_are_bounds_of_each_window():
    one = assessed(duration_s=550.0)
    expect = one.scenario(one.criteria()).expect
    assert expect.rms_m.max == 2.0
    assert expect.min_separation_m.min == pytest.approx(2.795, abs=1e-3)
    assert expect.left_speed_set.max == 0.0
    assert list(one.scenario(one.criteria()).scenario.windows) == ["rectangles"]


NO_WINDOWS = "scenario.published=null", "scenario.windows=null"


@pytest.mark.parametrize("overrides", [(), NO_WINDOWS])
def test_a_flight_before_all_windows_has_its_bound(overrides):
    one = assessed(*overrides, duration_s=40.0)
    flown = one.scenario(one.criteria())
    assert flown.scenario.windows == {"second_half": (20.0, 40.0)}
    assert flown.expect.rms_m.max == 2.0


def test_own_bounds_are_the_criteria():
    one = assessed("expect.mean_rms_m.max=1")
    assert one.criteria() == ()
    one = assessed("limits.min_separation_m=0")
    assert any("min_separation_m.min=2.795" in each for each in one.criteria())


def test_commands_have_all_that_a_flight_has():
    one = assessed("network.delay_s=0.01", duration_s=40.0, flights=7)
    assert list(one.seeds) == list(range(1, 8))
    words = shlex.split(one.run_command(["air.wind.speed_mps=3"], 5))
    assert words[:3] == ["testbed", "run", "simulation-3"]
    assert words[3:] == [
        *("--set", "network.delay_s=0.01", "--set", "air.wind.speed_mps=3"),
        *("--duration", "40", "--seed", "5"),
    ]
    assert one.command("loss").endswith("--only loss --flights 7")


SENSED = "fleet.*.sensors=pixhawk", "leader.sensors=pixhawk"


@pytest.mark.parametrize("overrides", [(), SENSED, ("fleet.*.sensors=gps-ins",)])
@pytest.mark.parametrize("name", CONDITIONS)
def test_each_level_can_be_flown(name, overrides):
    """The settings are those of a valid scenario, and the smallest value is the scenario's own."""
    one, condition = assessed(*overrides, duration_s=550.0), CONDITIONS[name]
    scenario = one.scenario()
    levels = condition.levels(scenario)
    assert levels == sorted(set(levels))
    assert levels[0] == condition.own(scenario)
    for value in (levels[0], levels[1], levels[-1]):
        flown = one.scenario(condition.flight(scenario, value, 3))
        if value > levels[0]:
            assert flown != scenario
        elif not condition.nominal(scenario):
            assert flown == scenario


def test_conditions_begin_at_the_scenarios_own_values():
    own = (
        *("network.loss=0.2", "network.delay_s=0.03", "air.wind.speed_mps=5"),
        *("air.turbulence={model: dryden, intensity: light}",),
    )
    scenario = assessed(*own).scenario()
    found = {name: CONDITIONS[name].levels(scenario)[0] for name in CONDITIONS}
    assert found["loss"], found["delay"] == (0.2, 0.03)
    assert found["wind"] == 0.0
    assert found["turbulence"] == pytest.approx(7.717, abs=1e-3)
    settings = CONDITIONS["gps"].flight(assessed(*SENSED).scenario(), 2.0, 1)
    assert "leader.sensors.gps.own_drift_m=[0.5, 1.0]" in settings


def test_the_wind_of_a_seed_has_one_direction():
    scenario, wind = assessed().scenario(), CONDITIONS["wind"]
    directions = {wind.flight(scenario, 5.0, seed)[-1] for seed in range(1, 60)}
    assert len(directions) > 50
    assert wind.flight(scenario, 5.0, 3)[-1] == wind.flight(scenario, 9.0, 3)[-1]
