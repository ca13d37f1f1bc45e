"""Studies of set-ups that may have given the paper's Table 1, and the script of their tables."""

import numpy as np
import pytest

from testbed.scenario import load_scenario
from testbed.studies.plan import Plan, load_study

SET_UPS = 7  # three simulations with two kinds of corner, and the recorded leader


@pytest.fixture
def tables(script):
    return script("leader_acceleration")


@pytest.mark.parametrize(
    ("name", "sources", "turns"),
    [
        ("leader-acceleration", ("none", "broadcast", "coordinated_turn"), None),
        ("leader-turn-acceleration", ("broadcast",), "difference"),
    ],
)
def test_acceleration_studies_fly_every_set_up(name, sources, turns):
    plan = Plan(load_study(name))
    assert len(plan) == SET_UPS * 2 * len(sources)
    set_ups = set()
    for run in plan:
        scenario = plan.scenario(run)
        controller = scenario.controller
        assert controller.estimators.leader_angular_acceleration == turns
        set_ups.add((run.case, controller.profile, controller.estimators.leader_acceleration))
        _, number, corner = run.case.split("-")
        graph = load_scenario(f"simulation-{number}").formation
        assert scenario.formation == graph, run.case
        if corner != "recorded":
            assert scenario.leader.path.bank_limit_deg == int(corner)
    assert set_ups == {
        (case, profile, source)
        for case in plan.cases
        for profile in ("tuned", "authors")
        for source in sources
    }


def test_fit_flies_each_point_with_each_simulation():
    plan = Plan(load_study("table-1"))
    by_case = {case: [run.point for run in plan if run.case == case] for case in plan.cases}
    assert {len(points) for points in by_case.values()} == {40}
    assert by_case["simulation-1"] == by_case["simulation-2"] == by_case["simulation-3"]


def test_fit_varies_both_ages_gains_corners_and_source(tables):
    plan = Plan(load_study("table-1"))
    assert list(plan.keys) == list(tables.FITTED)
    scenarios = [plan.scenario(run) for run in plan if run.case == "simulation-3"]
    assert {each.controller.companion.state_latency_s for each in scenarios} == {0, 0.02, 0.04}
    assert {each.network.delay_s for each in scenarios} == {0, 0.04, 0.08, 0.12, 0.16}
    sources = {each.controller.estimators.leader_acceleration for each in scenarios}
    assert sources == {"broadcast", "coordinated_turn", "none"}


def test_causes_are_flown_by_each_simulation(tables):
    """Two ages that are equal cancel with extrapolation from receipt only."""
    plan = Plan(load_study("table-1-causes"))
    assert {run.case.rpartition("-")[0] for run in plan} == set(tables.SET_UPS)
    flown = {run.case: plan.scenario(run) for run in plan}
    assert len(flown) == 3 * len(tables.SET_UPS)
    for case, scenario in flown.items():
        graph = load_scenario(f"simulation-{case[-1]}").formation
        assert scenario.formation == graph, case
        assert scenario.leader.path.bank_limit_deg == 30
    late = flown["both-late-receipt-3"]
    assert late.network.delay_s == late.controller.companion.state_latency_s == 0.08
    assert late.controller.extrapolate_from == "receipt"


def test_rectangle_of_the_laps_changes_nothing_else():
    plan = Plan(load_study("table-1-laps"))
    flown = {run.case: plan.scenario(run) for run in plan}
    square, rectangle = (flown[case].model_dump() for case in ("bank-30", "rectangle-800-by-450"))
    legs = [each["leader"]["path"].pop("legs") for each in (square, rectangle)]
    for each in (square, rectangle):
        del each["leader"]["start"]
    assert square == rectangle
    slopes = []
    for each in legs:
        corners = each[2]["points_m"]
        side = abs(corners[1][1] - corners[0][1])
        slopes.append((corners[1][2] - corners[0][2]) / side)
    assert slopes[0] == pytest.approx(slopes[1], rel=0.01)
    assert {**legs[0][3], "centre_m": None} == {**legs[1][3], "centre_m": None}


def test_factor_between_cells_by_hand(tables):
    printed = tables.published_cells()
    assert printed[2].rms.tolist() == [[1.2, 2.5, 3.6], [1.3, 2.5, 3.4]]
    twice = {n: tables.Cells(2.0 * each.rms, each.percent) for n, each in printed.items()}
    ratio = tables.ratios(twice, printed)
    assert ratio.shape == (3, 2, 3)
    assert tables.factor(ratio) == tables.factor(1.0 / ratio) == pytest.approx(2.0)
    assert tables.near(ratio) == "0 of 18"
    assert tables.near(np.array([0.79, 0.81, 1.19, 1.21])) == "2 of 4"


def test_freedoms_change_one_choice_each(script):
    freedoms = script("freedoms")
    plain = load_scenario("simulation-2").model_dump(exclude={"scenario"})
    for *names, overrides in freedoms.FREEDOMS:
        changed = load_scenario("simulation-2", overrides)
        assert (
            changed.formation.neighbour_gains
            == load_scenario("simulation-2").formation.neighbour_gains
        )
        assert (changed.model_dump(exclude={"scenario"}) != plain) == bool(overrides), names


def test_freedoms_are_ranked_by_what_they_change(script):
    """From made errors; a lost formation is marked, and what the paper prints is left out."""
    freedoms = script("freedoms")

    def flight(mean, outcome="completed"):
        windows = {name: {"mean_rms_m": mean} for name in ("rectangles", "circles")}
        return {"windows": windows, "outcome": outcome}

    made = {freedoms.case(3, keys): flight(1.0) for *_, keys in freedoms.FREEDOMS}
    made[freedoms.case(3, freedoms.RECORDED_TUNE)] = flight(9.0, "formation_lost")
    for name, _, _, keys in freedoms.FREEDOMS:
        if name in ("wind", "age of the own state"):
            made[freedoms.case(3, keys)] = flight(3.0)
    _, _, *lines = freedoms.smaller(made)
    assert [line.rpartition(": ")[2] for line in lines] == ["9.0†, 9.0†", "3.0, 3.0"]
    assert lines[1].startswith("- age of the own state (none) against 0.04 s")
