"""Parameters of the formation and controller sections in the laws and middle loops."""

import numpy as np
import pytest
from places import TESTS

from testbed.flight.schedule import make_clock
from testbed.formation import leader_filter as leader
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1
from testbed.plan.control import build_control
from testbed.plan.measured_fleet import resolve
from testbed.scenario import ScenarioError, load_middle_loop, load_scenario

FULL = TESTS / "data" / "scenarios" / "everything.yaml"
HBH23 = ["controller.law=hbh23", "controller.options=null"]


def control_of(scenario, phases=None):
    rates = scenario.rates.model_dump(exclude={"synchronous"})
    clock = make_clock(**rates, aircraft=len(scenario.aircraft_names), phases=phases)
    return build_control(resolve(scenario), scenario.controller, clock)


def changed(*changes):
    return control_of(load_scenario(FULL, [*HBH23, *changes]))


def law_of(*changes):
    return changed(*changes).controllers["law"]


def test_agent_parameters_precede_the_formations():
    """uav1 has values of its own for everything; uav2 has the formation's."""
    control = changed()
    law = control.controllers["law"]
    expected = {
        "k": [2.0, 2.5],
        "a": [0.8, 0.9],
        "b": [0.15, 0.2],
        "c": [0.2, 0.05],
        "c_speed": [0.0, 0.0004],
        "speed_pole": [0.6, 0.5],
        "speed_min": [18.0, 17.0],
        "speed_max": [28.0, 29.0],
        "speed_desired_min": [19.0, 18.0],
        "speed_desired_max": [27.0, 28.0],
        "horizontal": [False, True],
        "row": [1, 2],
    }
    assert {name: law[name].tolist() for name in expected} == expected
    ours = example_1(40.0, 1.5, 0.75)
    for name in ours._fields:
        assert law["mu"][name].tolist() == [getattr(EXAMPLE_2, name), getattr(ours, name)], name
    assert law["barrier"]["example"].tolist() == [7, 6]
    assert law["barrier"]["nu"][1] == 2.0
    assert np.array_equal(control.neighbours["gain"][1, 1], [2.0, 3.0, 4.0])


def test_default_desired_speed_bounds_follow_fact_1():
    """ε = κ − k ρ̄ inside S, for each agent with its own κ, k, ρ̄ and S."""
    changes = ["formation.speed_desired_mps=null", "formation.agents.uav1.speed_desired_mps=null"]
    own = ["formation.agents.uav1.control_function={example: 3}", "formation.agents.uav1.k=2.5"]
    law = law_of(*changes, *own)
    kappa, k = np.array([3.0, 4.0]), np.array([2.5, 2.5])
    margin = kappa - k * np.array([EXAMPLE_3.bound, example_1(40.0, 1.5, 0.75).bound])
    assert (margin > 0.1).all()
    assert law["speed_desired_min"] == pytest.approx(law["speed_min"] + margin, abs=1e-14)
    assert law["speed_desired_max"] == pytest.approx(law["speed_max"] - margin, abs=1e-14)


@pytest.mark.parametrize(
    ("desired", "inside"),
    [("[21, 24]", True), ("[19, 24]", False), ("[21, 26]", False), ("[24, 21]", False)],
)
def test_desired_speeds_lie_in_the_speed_bounds(desired, inside):
    changes = ["formation.speed_mps=[20, 25]", f"formation.speed_desired_mps={desired}"]
    if inside:
        law = control_of(load_scenario("simulation-3", changes)).controllers["law"]
        assert law["speed_desired_min"].tolist() == [21.0] * 3
        assert law["speed_desired_max"].tolist() == [24.0] * 3
    else:
        with pytest.raises(ScenarioError, match="speed_desired_mps"):
            load_scenario("simulation-3", changes)


def test_controller_options_reach_the_law():
    law = law_of()
    assert law["from_timestamp"].all() and law["bounds_of_airspeed"].all()
    assert law["leader_timeout_s"].tolist() == [3.0, 3.0]
    assert law["acceleration_source"].tolist() == [leader.TURN] * 2
    assert np.array_equal(law["acceleration_blend"], [[0.5, 0.6, 0.1]] * 2)
    assert np.array_equal(law["difference_blend"], [[0.3, 0.2]] * 2)
    assert law["angular_acceleration_source"].tolist() == [leader.DIFFERENCE] * 2
    assert law["turn_rate_blend"].tolist() == [0.35] * 2
    assert law["with_acceleration"].all()
    # 25° to the left at the trim airspeed: g tan 25°/22
    assert law["lost_leader_airspeed"].tolist() == [22.0, 22.0]
    assert law["lost_leader_turn_rate"] == pytest.approx([-0.207931] * 2, abs=1e-6)
    straight = law_of("controller.on_leader_timeout=straight")
    assert straight["lost_leader_turn_rate"].tolist() == [0.0, 0.0]


def test_timeouts_reach_law_and_configuration():
    for changes, leader_timeout, neighbour_timeout, hold in (
        ([], 5.0, 5.0, False),
        (["controller.leader_timeout_s=4"], 4.0, 4.0, False),
        (["controller.neighbour_timeout_s=2.5"], 5.0, 2.5, False),
        (
            [
                "controller.leader_timeout_s=4",
                "controller.on_neighbour_timeout=hold-relative-position",
            ],
            4.0,
            4.0,
            True,
        ),
        (
            [
                "controller.neighbour_timeout_s=9",
                "controller.on_neighbour_timeout=hold-relative-position",
            ],
            5.0,
            9.0,
            True,
        ),
    ):
        control = control_of(load_scenario("simulation-3", changes))
        law, config, neighbours = control.controllers["law"], control.config, control.neighbours
        assert (config.leader_timeout_s, config.neighbour_timeout_s) == (
            leader_timeout,
            neighbour_timeout,
        )
        assert law["leader_timeout_s"].tolist() == [leader_timeout] * 3
        assert law["neighbour_timeout_s"].tolist() == [neighbour_timeout] * 3
        assert law["hold_stale_neighbours"].tolist() == [hold] * 3
        # the age of a message that is held is that of its content, however old
        limits = [leader_timeout, *[np.inf if hold else neighbour_timeout] * 3]
        assert neighbours["timeout_s"].tolist() == [limits] * 3
        assert np.isnan(neighbours["held_position"]).all()
        assert np.isnan(neighbours["held_time_s"]).all()


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("neighbour_timeout_s=0", "controller.neighbour_timeout_s"),
        ("on_neighbour_timeout=loiter", "controller.on_neighbour_timeout"),
    ],
)
def test_wrong_neighbour_timeout_is_refused(change, key):
    with pytest.raises(ScenarioError, match=key):
        load_scenario("simulation-3", [f"controller.{change}"])


def test_estimators_default_to_the_profile():
    law = law_of("controller.estimators=null")
    authors = load_middle_loop("rascal110", "authors").estimators
    assert np.array_equal(law["acceleration_blend"], [authors.leader_acceleration_blend] * 2)
    assert law["acceleration_source"].tolist() == [leader.BROADCAST] * 2
    assert law["angular_acceleration_source"].tolist() == [leader.NOTHING] * 2
    assert not law["with_acceleration"].any()


def test_one_estimator_change_keeps_the_others():
    changes = ["controller.profile=improved", "controller.estimators.extrapolation=velocity"]
    law = control_of(load_scenario("simulation-3", changes)).controllers["law"]
    improved = load_middle_loop("rascal110", "improved").estimators
    assert not law["with_acceleration"].any()
    assert law["angular_acceleration_source"].tolist() == [leader.ROLL_RATE] * 3
    assert law["acceleration_source"].tolist() == [leader.TURN] * 3
    assert np.array_equal(law["difference_blend"], [improved.leader_difference_blend] * 3)


def test_controller_options_reach_the_middle_loop():
    loop, authors = changed().controllers["loop"], load_middle_loop("rascal110", "authors")
    course = authors.course.model_copy(update={"i": 0.2})  # the scenario's own
    # every gain of a PID by one and a half, and no other
    for ours, section, parts in (
        ("gamma", authors.flight_path, "pid"),
        ("course", course, "pid"),
        ("speed", authors.speed, "pi"),
        ("altitude", authors.altitude, "pid"),
    ):
        for part in parts:
            expected = [1.5 * getattr(section, part)] * 2
            assert loop[f"{ours}_{part}"] == pytest.approx(expected, rel=1e-15)
    assert loop["eta_speed"].tolist() == [authors.eta_speed] * 2
    assert loop["rate_filter"].tolist() == [authors.rate_filter_s] * 2
    assert loop["incidence"].tolist() == [1.0, 1.0]
    assert loop["roll_limit"] == pytest.approx([np.radians(50.0)] * 2, rel=1e-15)
    assert loop["airspeed_error_as_printed"].all()
    assert np.array_equal(loop["altitude"], [np.nan, 115.0], equal_nan=True)
    assert loop["speed_min"].tolist() == [18.0, 17.0]
    assert loop["dt"].tolist() == [0.02, 0.02]
    none = changed("controller.pitch_feedforward=none").controllers["loop"]
    assert none["incidence"].tolist() == [0.0, 0.0]


def test_unsynchronised_followers_form_groups():
    scenario = load_scenario(FULL, HBH23)
    together = control_of(scenario)
    apart = control_of(scenario, phases=(0.0, 0.6, 0.1))
    assert [group.rows.tolist() for group in together.groups] == [[0, 1]]
    assert [group.rows.tolist() for group in apart.groups] == [[1], [0]]
    for group in apart.groups:
        (row,) = group.rows
        assert group.config.names == (scenario.fleet[row].name,)
        assert group.config.agents.tolist() == [row + 1]
        assert np.array_equal(group.config.gains[0], together.config.gains[row])
        assert np.array_equal(group.config.offsets, together.config.offsets)
    assert (apart.controllers["law"] == together.controllers["law"]).all()
    for name in apart.controllers["loop"].dtype.names:
        np.testing.assert_array_equal(
            apart.controllers["loop"][name], together.controllers["loop"][name], err_msg=name
        )


def test_gain_is_number_triple_or_diagonal_matrix():
    ways = ["2", "[2, 2, 2]", "[[2, 0, 0], [0, 2, 0], [0, 0, 2]]"]
    for way in ways:
        neighbours = changed(f"formation.leader_gains.uav1={way}").neighbours
        assert np.array_equal(neighbours["gain"][0, 0], [2.0, 2.0, 2.0])
    other = changed("formation.leader_gains.uav1=[[1, 0, 0], [0, 2, 0], [0, 0.0, 3.5]]")
    assert np.array_equal(other.neighbours["gain"][0, 0], [1.0, 2.0, 3.5])


def test_number_for_c_is_its_constant_part():
    for way in ("0.3", "{constant: 0.3}", "{constant: 0.3, per_speed_squared: 0}"):
        law = law_of(f"formation.agents.uav1.c={way}")
        assert (law["c"][0], law["c_speed"][0]) == (0.3, 0.0)
    law = law_of("formation.agents.uav1.c={per_speed_squared: 0.001}")
    assert (law["c"][0], law["c_speed"][0]) == (0.0, 0.001)


def test_own_law_is_built_with_its_options():
    control = control_of(load_scenario(FULL))
    assert not control.builtin
    (group,) = control.groups
    assert group.law.by_mps == 0.5
    assert group.law.rest == ((1.0, 2.5), False, "x")
    assert changed().builtin
    assert [group.law for group in changed().groups] == [None]
