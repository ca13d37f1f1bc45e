"""Scenarios of the experiments as flown, and the studies of their differences from simulation."""

import csv
import math

import numpy as np
import pytest
from cases import some

from testbed.commissioning.replay_commands import respond
from testbed.runs.run import run
from testbed.scenario import library, load_scenario, set_duration
from testbed.studies.plan import Plan, load_study

EXPERIMENTS = (1, 2, 3)
STUDIES = library() / "scenarios" / "studies"
X8 = library() / "aircraft" / "skywalker_x8"
IDEAL, FLOWN = "ideal", "as-flown"
AS_FLOWN = str(STUDIES / "gap-budget" / "experiment-{}-as-flown.yaml")


def plain(scenario):
    """Return a scenario as nested dicts, without its name, texts, duration and windows."""
    data = scenario.model_dump(mode="json", by_alias=True)
    for key in ("name", "question", "expectation", "published", "duration_s", "windows"):
        del data["scenario"][key]
    return data


def parameters_of(aircraft):
    return aircraft.aircraft, aircraft.tune, aircraft.battery, aircraft.sensors


# scenarios


def test_experiments_have_one_set_of_parameters():
    scenarios = [load_scenario(AS_FLOWN.format(number)) for number in EXPERIMENTS]
    used = {repr(parameters_of(each)) for scenario in scenarios for each in scenario.aircraft}
    assert len(used) == 1
    for part in ("rates", "controller", "network"):
        assert len({repr(getattr(scenario, part)) for scenario in scenarios}) == 1
    assert len({repr(scenario.air.turbulence) for scenario in scenarios}) == 1
    assert {scenario.formation.k for scenario in scenarios} == {3.0}


@pytest.mark.parametrize("number", EXPERIMENTS)
def test_experiment_as_flown_changes_nothing_else(number):
    """Path, wind, offsets, graph, law and windows are those of experiment-N."""
    as_flown, bare = load_scenario(AS_FLOWN.format(number)), load_scenario(f"experiment-{number}")
    assert (as_flown.formation, as_flown.limits, as_flown.rates) == (
        bare.formation,
        bare.limits,
        bare.rates,
    )
    assert as_flown.air.wind == bare.air.wind
    assert (as_flown.leader.path, as_flown.leader.start) == (bare.leader.path, bare.leader.start)
    assert [each.start_m for each in as_flown.fleet] == [each.start_m for each in bare.fleet]
    header = ("duration_s", "seed", "windows", "published", "origin")
    for key in header:
        assert getattr(as_flown.scenario, key) == getattr(bare.scenario, key)


# the budget


@pytest.mark.parametrize("number", EXPERIMENTS)
def test_budget_factors_add_up_to_the_whole_change(number):
    study = load_study(f"gap-budget-{number}")
    plan = Plan(study)
    runs = {run.case: run for run in plan if run.seed == 1}
    ideal, as_flown = (plain(plan.scenario(runs[case])) for case in (IDEAL, FLOWN))
    assert ideal != as_flown
    factors = [case.removeprefix("with-") for case in runs if case.startswith("with-")]
    assert len(factors) == 11
    for way, start, end in (("with", IDEAL, as_flown), ("without", FLOWN, ideal)):
        changes = [
            change
            for factor in factors
            for change in runs[f"{way}-{factor}"].overrides
            if change not in runs[start].overrides
        ]
        scenario = load_scenario(runs[start].scenario, [*runs[start].overrides, *changes])
        assert plain(scenario) == end
        for factor in factors:
            one = plain(plan.scenario(runs[f"{way}-{factor}"]))
            assert one not in (ideal, as_flown), f"{way}-{factor} changes nothing, or all"


def test_ideal_flights_have_a_third_of_the_offsets():
    for number in EXPERIMENTS:
        ideal = load_scenario(STUDIES / "gap-budget" / f"experiment-{number}-ideal.yaml").formation
        as_flown = load_scenario(AS_FLOWN.format(number)).formation
        for name, offset in as_flown.offsets_m.items():
            np.testing.assert_allclose(ideal.offsets_m[name], np.array(offset) / 3, atol=1e-3)
        for name, altitude in as_flown.altitudes_m.items():
            assert ideal.altitudes_m[name] - 100 == pytest.approx((altitude - 100) / 3, abs=1e-3)


# the joint fit


def test_joint_fit_recovers_its_own_numbers(script):
    """Errors made by the formula itself, which are the paper's at one set and along its ridge."""
    joint_fit = script("joint_fit")
    as_flown = {f"experiment-{n}": load_scenario(AS_FLOWN.format(n)) for n in EXPERIMENTS}
    cells = joint_fit.table_2(as_flown)
    assert [cell.printed for cell in cells] == [7.7, 8.2, 8.6, 8.8, 6.7, 8.1]
    study = Plan(load_study("joint-fit"))
    assert (study.keys, len(study)) == (joint_fit.KEYS, 72)
    points = np.array([list(study.point(k).values()) for k in range(study.point_count)])
    known, made_at = np.array([2.0, 2.5, 0.4, 0.07, -0.9]), points[3]
    terms = joint_fit.features(points)
    rows = [
        {
            "case": cell.experiment,
            **{f"set.{key}": value for key, value in zip(joint_fit.KEYS, point, strict=True)},
            **{
                f"metrics.windows.{each.window}.rms_m.{each.follower}": each.printed
                * np.exp((term - terms[3]) @ known)
                for each in cells
                if each.experiment == cell.experiment
            },
        }
        for point, term in zip(points, terms, strict=True)
        for cell in cells
    ]
    found = joint_fit.fit(cells, rows)
    np.testing.assert_allclose(found.coefficients[1:], np.tile(known[1:, None], 6), rtol=1e-8)
    assert found.left_out.max() < 1e-9
    assert found.worst(made_at[None])[0] < 1e-6
    # along the ridge: a later own state, and messages later by b1 / (b1 + b2) of it
    along = made_at + [0.01 * known[1] / (known[1] + known[2]), 0.01, 0.0, 0.0]
    assert found.worst(along[None])[0] < 1e-6


# sentences beside the tables


def test_sentences_of_table_2_follow_the_rows(script):
    """Order of the followers and comparison of Experiments 2 and 3, from made rows."""
    gap = script("gap_budget")

    def rows(first, second, mean):
        head = "windows.rectangles"
        three = {f"{head}.rms_m.uav1": first, f"{head}.rms_m.uav2": second}
        return {
            ("experiment-2", 1): {f"{head}.mean_rms_m": 8.0},
            ("experiment-3", 1): {**three, f"{head}.mean_rms_m": mean},
        }

    papers, other = rows(6.0, 7.0, 6.5), rows(8.0, 7.0, 8.5)
    assert gap.order_sentence(papers) == (
        "Experiment 3's followers come out in the paper's order: uav1 6.0, uav2 7.0 m here "
        "(medians), uav1 6.7, uav2 8.1 m there."
    )
    assert "in another order than the paper's: uav1 8.0" in gap.order_sentence(other)
    assert gap.comparison_sentence(papers) == (
        "Mean over the followers, median of 1 seeds: Experiment 2 8.0 m, Experiment 3 6.5 m "
        "(the paper: 8.7 and 7.4 m); with 1 of the 1 seeds Experiment 3 has the smaller error."
    )
    assert "with 0 of the 1 seeds" in gap.comparison_sentence(other)


# flights


@pytest.mark.parametrize("number", some(EXPERIMENTS, 1))
def test_as_flown_flight_has_errors_and_a_bad_radio(number):
    scenario = set_duration(load_scenario(AS_FLOWN.format(number), ["log.mcap=false"]), 10.0)
    metrics = run(scenario, write=False).metrics
    assert metrics["outcome"] == "completed"
    radio = metrics["network"]["all"]
    assert 0.5 < radio["delivered_share"] < 1.0
    delay = scenario.network.delay_s
    assert radio["delay_s"]["mean"] == pytest.approx(delay, abs=0.02)
    assert all(age["mean"] > delay for age in metrics["age_of_information_s"].values())
    assert all(each["horizontal_m"] > 0.0 for each in metrics["estimate_error"].values())


def test_stock_tune_is_slower_than_the_optimised_one(tmp_path):
    """[HBH23]: the aircraft of the experiments had slower attitude dynamics."""
    names = ("t_s", "theta_cmd_rad", "phi_cmd_rad", "throttle_cmd", "airspeed_mps", "altitude_m")
    lines = [(0.04 * k, 0.03, math.radians(20) * (k >= 75), 0.7, 18, 100) for k in range(130)]
    commands, out = tmp_path / "steps.csv", tmp_path / "out.csv"
    with commands.open("w", newline="") as file:
        csv.writer(file).writerows([(*names, "psi_rad"), *((*line, 0) for line in lines)])
    rise_s = {}
    for tune in ("autopilot", "stock"):
        param = X8 / f"{tune}.param"
        respond(X8, commands, out.with_stem(tune), param=param)
        with out.with_stem(tune).open() as file:
            rolls = np.array([float(line["phi_rad"]) for line in csv.DictReader(file)])
        rise_s[tune] = 0.04 * int(np.argmax(rolls[75:] > 0.63 * math.radians(20)))
    assert rise_s["autopilot"] < 0.35 < 0.45 < rise_s["stock"] < 0.7
