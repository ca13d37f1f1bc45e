"""The experiments as they were flown: one set of parameters for all three, and its factors."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from testbed.scenario import dump, library, load, shorten
from testbed.sim.run import run
from testbed.study.plan import load_study, plan
from testbed.vehicle.respond import respond

EXPERIMENTS = (1, 2, 3)
STUDIES = library() / "scenarios" / "studies"
X8 = library() / "aircraft" / "skywalker_x8"
IDEAL, FLOWN = "ideal", "as-flown"
AS_FLOWN = str(STUDIES / "gap-budget" / "experiment-{}-as-flown.yaml")


def plain(page):
    """A page as nested dicts, without what it is called."""
    data = page.model_dump(mode="json", by_alias=True)
    for key in ("name", "question", "expectation", "published", "duration_s", "portions"):
        del data["scenario"][key]
    return data


def of_aircraft(craft):
    return craft.aircraft, craft.tune, craft.battery, craft.sensors


# pages


def test_all_three_fly_with_one_set_of_parameters():
    pages = [load(AS_FLOWN.format(number)) for number in EXPERIMENTS]
    crafts = {repr(of_aircraft(each)) for page in pages for each in page.aircraft}
    assert len(crafts) == 1
    for part in ("rates", "controller", "network"):
        assert len({repr(getattr(page, part)) for page in pages}) == 1
    assert len({repr(page.air.turbulence) for page in pages}) == 1
    assert {page.formation.k for page in pages} == {3.0}


def test_the_pages_say_it_in_the_same_words():
    line = "# the same on all three pages from here on\n"
    texts = [Path(AS_FLOWN.format(n)).read_text() for n in EXPERIMENTS]
    assert len({text.partition(line)[2] for text in texts}) == 1
    assert all(text.count(line) == 1 for text in texts)


@pytest.mark.parametrize("number", EXPERIMENTS)
def test_nothing_else_differs_from_the_experiment(number):
    """Path, wind, offsets, graph, law and windows are those of experiment-N."""
    flown, bare = load(AS_FLOWN.format(number)), load(f"experiment-{number}")
    assert (flown.formation, flown.limits, flown.rates) == (bare.formation, bare.limits, bare.rates)
    assert flown.air.wind == bare.air.wind
    assert (flown.leader.path, flown.leader.start) == (bare.leader.path, bare.leader.start)
    assert [each.start_m for each in flown.fleet] == [each.start_m for each in bare.fleet]
    header = ("duration_s", "seed", "portions", "published", "origin")
    for key in header:
        assert getattr(flown.scenario, key) == getattr(bare.scenario, key)


# the budget


@pytest.mark.parametrize("number", EXPERIMENTS)
def test_all_factors_together_lead_from_the_ideal_flight_to_the_flown_one_and_back(number):
    study = load_study(f"gap-budget-{number}")
    ours = plan(study)
    runs = {run.case: run for run in ours if run.seed == 1}
    ideal, flown = (plain(ours.page(runs[case])) for case in (IDEAL, FLOWN))
    assert ideal != flown
    factors = [case.removeprefix("with-") for case in runs if case.startswith("with-")]
    assert len(factors) == 8
    for way, start, end in (("with", IDEAL, flown), ("without", FLOWN, ideal)):
        together = [
            change
            for factor in factors
            for change in runs[f"{way}-{factor}"].overrides
            if change not in runs[start].overrides
        ]
        page = load(runs[start].scenario, [*runs[start].overrides, *together])
        assert plain(page) == end
        for factor in factors:
            one = plain(ours.page(runs[f"{way}-{factor}"]))
            assert one not in (ideal, flown), f"{way}-{factor} changes nothing, or all"


def test_the_studies_page_for_the_paper_has_all_three_experiments_and_20_seeds():
    study = load_study("as-flown")
    ours = plan(study)
    assert len(ours) == 60
    flown = {run.case: dump(ours.page(run)) for run in ours if run.seed == 20}
    for number in EXPERIMENTS:
        page = load(AS_FLOWN.format(number), ["scenario.seed=20"])
        assert flown[f"experiment-{number}"] == dump(page)


def test_offsets_of_the_ideal_flights_are_a_third():
    for number in EXPERIMENTS:
        ideal = load(STUDIES / "gap-budget" / f"experiment-{number}-ideal.yaml").formation
        flown = load(AS_FLOWN.format(number)).formation
        for name, offset in flown.offsets_m.items():
            np.testing.assert_allclose(ideal.offsets_m[name], np.array(offset) / 3, atol=1e-3)
        for name, altitude in flown.altitudes_m.items():
            assert ideal.altitudes_m[name] - 100 == pytest.approx((altitude - 100) / 3, abs=1e-3)


# flights


@pytest.mark.parametrize("number", EXPERIMENTS)
def test_a_flight_has_all_that_a_simulation_leaves_out(number):
    page = shorten(load(AS_FLOWN.format(number), ["log.mcap=false"]), 10.0)
    metrics = run(page, write=False).metrics
    assert metrics["outcome"] == "flown"
    radio = metrics["network"]["all"]
    assert 0.5 < radio["delivered_share"] < 1.0
    delay = page.network.delay_s
    assert radio["delay_s"]["mean"] == pytest.approx(delay, abs=0.02)
    assert all(age["mean"] > delay for age in metrics["age_of_information_s"].values())
    assert all(each["horizontal_m"] > 0.0 for each in metrics["estimate_error"].values())


def test_the_stock_tune_is_slower_than_the_one_found_by_optimisation(tmp_path):
    """[HBH23]: the aircraft of the experiments had slower attitude dynamics."""
    names = ("t_s", "theta_cmd_rad", "phi_cmd_rad", "throttle_cmd", "airspeed_mps", "altitude_m")
    lines = [(0.04 * k, 0.03, math.radians(20) * (k >= 75), 0.7, 18, 100) for k in range(130)]
    commands, out = tmp_path / "steps.csv", tmp_path / "out.csv"
    with commands.open("w", newline="") as file:
        csv.writer(file).writerows([(*names, "psi_rad"), *((*line, 0) for line in lines)])
    took = {}
    for tune in ("autopilot", "stock"):
        param = X8 / f"{tune}.param"
        respond(X8, commands, out.with_stem(tune), param=param)
        with out.with_stem(tune).open() as file:
            rolls = np.array([float(line["phi_rad"]) for line in csv.DictReader(file)])
        took[tune] = 0.04 * int(np.argmax(rolls[75:] > 0.63 * math.radians(20)))
    assert took["autopilot"] < 0.35 < 0.45 < took["stock"] < 0.7
