"""Hints of errors and warnings: a file beside, ends that were given, one line for a model."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from testbed.autopilot.parameters import unusual_values
from testbed.commissioning.first_gains import LevelFlight, first_params
from testbed.commissioning.step_responses import StepResponses
from testbed.flight_logs.flight_sections import _no_interval
from testbed.plan.vehicles import gust_input_warnings
from testbed.scenario import ScenarioError, find_aircraft, find_scenario


def test_scenario_beside_is_suggested_with_its_ending(tmp_path):
    """The suggested name is found; without such a file there is the nearest known name."""
    with pytest.raises(ScenarioError) as caught:
        find_scenario("three", folder=tmp_path)
    assert "three.yaml" not in str(caught.value)
    (tmp_path / "three.yaml").write_text("extends: simulation-3\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match="there is no scenario 'three': did you mean 'three.ya"):
        find_scenario("three", folder=tmp_path)
    assert find_scenario("three.yaml", folder=tmp_path) == tmp_path / "three.yaml"


@pytest.mark.parametrize(("begin", "end"), [(-np.inf, np.inf), (1.0, np.inf), (-np.inf, 9.0)])
def test_ends_are_named_only_where_they_are_given(begin, end):
    log = SimpleNamespace(modes=(), path=Path("a.bin"))
    text = _no_interval(log, np.arange(10.0), "FBWA", begin, end)
    assert ("between --from and --to" in text) == bool(np.isfinite([begin, end]).any())
    assert text.startswith("a.bin: nothing in FBWA")


def test_warning_of_a_model_names_its_aircraft_once():
    folder = find_aircraft("rascal110")
    fleet = SimpleNamespace(
        model_rows=(0, 1, 2),
        aircraft=[SimpleNamespace(folder=each) for each in (folder, Path("gbs3"), Path("gbs3"))],
        names=("leader", "uav1", "uav2"),
    )
    models = SimpleNamespace(no_gust_inputs=np.array([False, True, True]))
    (event,) = gust_input_warnings(fleet, models, steady_air=False)
    assert event.source == "uav1" and "no effect on uav1, uav2: gbs3 lacks" in event.text
    assert [*gust_input_warnings(fleet, models, steady_air=True)] == []


def test_derived_parameters_are_usual():
    """A small fast-rolling aircraft has no warning at each flight, as of 384°/s and 4.9 m/s."""
    steps = StepResponses(
        airspeed=12.0,
        equivalent_airspeed=11.8,
        roll_rate=11.2,
        roll_s=0.05,
        rudder_mix=0.0,
        sideslip=0.0,
        pitch_rate=2.0,
        pitch_s=0.1,
        pitch_acceleration=20.0,
        throttle_acceleration=5.0,
        throttle_s=0.2,
    )
    level = LevelFlight(12.0, 4.15, 20.0, 0.05, 0.4, 0.01, 0.5, 0.1, 0.05, 0.2)
    params = first_params(steps, level)
    assert params.rll2srv_rmax == 180.0 and params.airspeed_min == 5.0
    found = [text for text in unusual_values(params) if "RMAX is" in text or "AIRSPEED" in text]
    assert found == []
    slow = replace(steps, roll_rate=1.0)
    assert first_params(slow, replace(level, lowest=8.0)).rll2srv_rmax == pytest.approx(34.38)
