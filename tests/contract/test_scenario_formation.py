"""What the page says of the formation is what its laws and middle loops are given."""

from pathlib import Path

import numpy as np
import pytest

from testbed.formation import leader
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1
from testbed.scenario import ScenarioError, find_aircraft, load, load_middle_loop
from testbed.sim.clock import make_clock
from testbed.sim.formations import make_groups
from testbed.sim.world import build

FULL = Path(__file__).parents[1] / "data" / "scenarios" / "everything.yaml"
PAPERS = ["controller.law=paper", "controller.options=null"]


def groups_of(page, phases=None):
    rates = page.rates.model_dump(exclude={"synchronous"})
    clock = make_clock(**rates, aircraft=len(page.aircraft_names), phases=phases)
    folders = [find_aircraft(each.aircraft) for each in page.fleet]
    groups, _ = make_groups(page, folders, clock)
    return groups


def only_group(*changes):
    (group,) = groups_of(load(FULL, [*PAPERS, *changes]))
    return group


def test_an_agents_own_values_stand_before_those_of_all():
    """uav1 has values of its own for everything; uav2 has the formation's."""
    law = only_group().law
    assert law.k.tolist() == [2.0, 2.5]
    assert law.a.tolist() == [0.8, 0.9]
    assert law.b.tolist() == [0.15, 0.2]
    assert law.c.tolist() == [0.2, 0.05]
    assert law.c_speed.tolist() == [0.0, 0.0004]
    assert law.pole.tolist() == [0.6, 0.5]
    assert law.speeds.low.tolist() == [18.0, 17.0]
    assert law.speeds.high.tolist() == [28.0, 29.0]
    assert law.speeds.desired_low.tolist() == [19.0, 18.0]
    assert law.speeds.desired_high.tolist() == [27.0, 28.0]
    ours = example_1(40.0, 1.5, 0.75)
    for name in ours._fields:
        expected = [getattr(EXAMPLE_2, name), getattr(ours, name)]
        assert getattr(law.control_function, name).tolist() == expected, name
    assert law.barrier.example.tolist() == [7, 6]
    assert law.barrier.nu[1] == 2.0
    assert law.horizontal.tolist() == [False, True]
    assert law.agents.tolist() == [1, 2]
    assert np.array_equal(law.gains[1, 1], [2.0, 3.0, 4.0])


def test_without_bounds_of_its_own_the_desired_speed_has_those_of_fact_1():
    """ε = κ − k ρ̄ inside S, for each agent with its own κ, k, ρ̄ and S."""
    changes = ["formation.speed_desired_mps=null", "formation.agents.uav1.speed_desired_mps=null"]
    own = ["formation.agents.uav1.control_function={example: 3}", "formation.agents.uav1.k=2.5"]
    speeds = only_group(*changes, *own).law.speeds
    kappa, k = np.array([3.0, 4.0]), np.array([2.5, 2.5])
    margin = kappa - k * np.array([EXAMPLE_3.bound, example_1(40.0, 1.5, 0.75).bound])
    assert (margin > 0.1).all()
    assert speeds.desired_low == pytest.approx(speeds.low + margin, abs=1e-14)
    assert speeds.desired_high == pytest.approx(speeds.high - margin, abs=1e-14)


def test_options_of_the_controller_reach_the_law():
    law = only_group().law
    assert (law.from_timestamp, law.bounds_of_airspeed, law.silent_after) == (True, True, 3.0)
    assert law.acceleration_source.tolist() == [leader.TURN] * 2
    assert np.array_equal(law.acceleration_blend, [[0.5, 0.6, 0.1]] * 2)
    assert np.array_equal(law.difference_blend, [[0.3, 0.2]] * 2)
    assert law.turn_acceleration.all() and law.with_acceleration.all()
    # 25° to the left at the trim airspeed: g tan 25°/22
    assert law.silent_airspeed.tolist() == [22.0, 22.0]
    assert law.silent_turn == pytest.approx([-0.207931] * 2, abs=1e-6)
    straight = only_group("controller.silence.then=straight").law
    assert straight.silent_turn.tolist() == [0.0, 0.0]


def test_what_is_too_old_is_said_of_the_leader_and_of_neighbours():
    (group,) = groups_of(load("simulation-3"))
    assert (group.law.silent_after, group.law.stale_after, group.law.hold) == (5.0, 5.0, False)
    for changes, silent, stale, hold in (
        (["controller.silence.after_s=4"], 4.0, 4.0, False),
        (["controller.staleness.after_s=2.5"], 5.0, 2.5, False),
        (["controller.silence.after_s=4", "controller.staleness.then=hold"], 4.0, 4.0, True),
        (["controller.staleness={after_s: 9, then: hold}"], 5.0, 9.0, True),
    ):
        (group,) = groups_of(load("simulation-3", changes))
        law, team = group.law, group.team
        assert (team.silent_after, team.stale_after) == (silent, stale)
        assert (law.silent_after, law.stale_after, law.hold) == (silent, stale, hold)
        memory = law.start(None)
        assert (memory.place.shape, memory.place_time_s.shape) == ((3, 4, 3), (3, 4))
    apart = groups_of(load(FULL, [*PAPERS, *changes]), phases=(0.0, 0.6, 0.1))
    assert [(each.team.stale_after, each.law.hold) for each in apart] == [(9.0, True)] * 2


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("after_s=0", "controller.staleness.after_s"),
        ("then=loiter", "controller.staleness.then"),
        ("bank_deg=20", "controller.staleness.bank_deg"),
    ],
)
def test_what_staleness_cannot_be_is_refused_by_its_key(change, says):
    with pytest.raises(ScenarioError, match=says):
        load("simulation-3", [f"controller.staleness.{change}"])


def test_the_profile_says_what_the_page_does_not():
    law = only_group("controller.estimators=null").law
    authors = load_middle_loop("rascal110", "authors").estimators
    assert np.array_equal(law.acceleration_blend, [authors.leader_acceleration_blend] * 2)
    assert law.acceleration_source.tolist() == [leader.BROADCAST] * 2
    assert not law.turn_acceleration.any() and not law.with_acceleration.any()


def test_a_page_that_chooses_one_estimator_leaves_the_profile_the_others():
    law = (
        build(
            load(
                "simulation-3",
                ["controller.profile=improved", "controller.estimators.extrapolation=velocity"],
            )
        )
        .groups[0]
        .law
    )
    improved = load_middle_loop("rascal110", "improved").estimators
    assert not law.with_acceleration.any()
    assert law.turn_acceleration.all()
    assert law.acceleration_source.tolist() == [leader.TURN] * 3
    assert np.array_equal(law.difference_blend, [improved.leader_difference_blend] * 3)


def test_options_of_the_controller_reach_the_middle_loop():
    middle = only_group().middle
    gains, authors = middle.gains, load_middle_loop("rascal110", "authors")
    course = authors.course.model_copy(update={"i": 0.2})  # the page's own
    # every gain of a PID by one and a half, and no other
    for ours, section, parts in (
        ("climb", authors.flight_path, "pid"),
        ("course", course, "pid"),
        ("speed", authors.speed, "pi"),
        ("altitude", authors.altitude, "pid"),
    ):
        for part in parts:
            expected = [1.5 * getattr(section, part)] * 2
            assert getattr(gains, f"{ours}_{part}") == pytest.approx(expected, rel=1e-15)
    assert gains.eta_speed.tolist() == [authors.eta_speed] * 2
    assert gains.rate_filter.tolist() == [authors.rate_filter_s] * 2
    assert gains.incidence.tolist() == [1.0, 1.0]
    assert gains.roll_limit == pytest.approx([np.radians(50.0)] * 2, rel=1e-15)
    assert middle.airspeed_error_as_printed
    assert np.array_equal(middle.altitude, [np.nan, 115.0], equal_nan=True)
    assert middle.speed_low.tolist() == [18.0, 17.0]
    assert middle.dt == 0.02
    none = only_group("controller.pitch_feedforward=none").middle
    assert none.gains.incidence.tolist() == [0.0, 0.0]


def test_aircraft_at_phases_of_their_own_are_groups_that_know_everybody():
    page = load(FULL, PAPERS)
    together, apart = groups_of(page), groups_of(page, phases=(0.0, 0.6, 0.1))
    assert [group.rows.tolist() for group in apart] == [[1], [0]]
    for group in apart:
        (row,) = group.rows
        assert group.team.names == (page.fleet[row].name,)
        assert group.law.agents.tolist() == [row + 1]
        assert np.array_equal(group.law.gains[0], together[0].law.gains[row])
        assert np.array_equal(group.law.offsets, together[0].law.offsets)
        assert group.law.k[0] == together[0].law.k[row]
        assert group.law.table[0] == together[0].law.table[row]
        assert group.middle.table[0].tobytes() == together[0].middle.table[row].tobytes()


def test_gains_may_be_numbers_directions_or_diagonal_matrices():
    ways = ["2", "[2, 2, 2]", "[[2, 0, 0], [0, 2, 0], [0, 0, 2]]"]
    laws = [only_group(f"formation.leader_gains.uav1={way}").law for way in ways]
    for law in laws:
        assert np.array_equal(law.gains[0, 0], [2.0, 2.0, 2.0])
    other = only_group("formation.leader_gains.uav1=[[1, 0, 0], [0, 2, 0], [0, 0.0, 3.5]]").law
    assert np.array_equal(other.gains[0, 0], [1.0, 2.0, 3.5])


def test_a_number_for_c_stands_for_its_constant_part():
    for way in ("0.3", "{constant: 0.3}", "{constant: 0.3, per_speed_squared: 0}"):
        law = only_group(f"formation.agents.uav1.c={way}").law
        assert (law.c[0], law.c_speed[0]) == (0.3, 0.0)
    law = only_group("formation.agents.uav1.c={per_speed_squared: 0.001}").law
    assert (law.c[0], law.c_speed[0]) == (0.0, 0.001)


def test_a_law_of_ones_own_is_built_with_its_options_and_trusted_with_nothing():
    (group,) = groups_of(load(FULL))
    assert not group.trusted
    assert group.law.by_mps == 0.5
    assert group.law.rest == ((1.0, 2.5), False, "x")
    assert only_group().trusted
