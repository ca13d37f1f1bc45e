"""Studies of set-ups that may have given the paper's Table 1, and the script of their tables."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from testbed.scenario import load_scenario
from testbed.studies.plan import Plan, load_study

ROOT = Path(__file__).parents[2]
SET_UPS = 7  # three simulations with two kinds of corner, and the recorded leader


@pytest.fixture
def tables(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    return importlib.import_module("leader_acceleration")


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
    assert {len(points) for points in by_case.values()} == {24}
    assert by_case["simulation-1"] == by_case["simulation-2"] == by_case["simulation-3"]


def test_factor_between_cells_by_hand(tables):
    printed = tables.published_cells()
    assert printed[2].rms.tolist() == [[1.2, 2.5, 3.6], [1.3, 2.5, 3.4]]
    twice = {n: tables.Cells(2.0 * each.rms, each.percent) for n, each in printed.items()}
    ratio = tables.ratios(twice, printed)
    assert ratio.shape == (3, 2, 3)
    assert tables.factor(ratio) == tables.factor(1.0 / ratio) == pytest.approx(2.0)
    assert tables.near(ratio) == "0 of 18"
    assert tables.near(np.array([0.79, 0.81, 1.19, 1.21])) == "2 of 4"


def test_freedoms_change_one_choice_each(tables):
    freedoms = importlib.import_module("freedoms")
    plain = load_scenario("simulation-2").model_dump(exclude={"scenario"})
    for *names, overrides in freedoms.FREEDOMS:
        changed = load_scenario("simulation-2", overrides)
        assert (
            changed.formation.neighbour_gains
            == load_scenario("simulation-2").formation.neighbour_gains
        )
        assert (changed.model_dump(exclude={"scenario"}) != plain) == bool(overrides), names
