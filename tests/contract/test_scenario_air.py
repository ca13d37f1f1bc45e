"""The air on the page: what it means when it is left out, and how a wrong one is refused."""

from pathlib import Path

import jsonschema
import pytest

from testbed.scenario import ScenarioError, dump, find_data, json_schema, load, loads

PAGES = Path(__file__).parents[1] / "data" / "scenarios"
MINIMAL = (PAGES / "minimal.yaml").read_text()
TIMED = "kind: time, name: a, velocity_mps: [1, 0, 0], at_s: 5, ramp_s: 2"
PLACED = "kind: place, name: b, velocity_mps: [1, 0, 0], at_m: [0, 9], towards_deg: 9, length_m: 20"


def page(air):
    return loads(f"{MINIMAL}air: {{{air}}}\n", source="page.yaml")


def complaint(air):
    with pytest.raises(ScenarioError) as caught:
        page(air)
    return str(caught.value)


def test_left_out_the_air_is_calm():
    air = loads(MINIMAL).air
    assert (air.wind.speed_mps, air.wind.profile.kind, air.wind.file) == (0.0, "uniform", None)
    assert air.wind.longest_gap_s == 10.0
    assert (air.turbulence.model, air.turbulence.intensity) == ("none", "moderate")
    rest = air.turbulence.model_dump(exclude={"model", "intensity"})
    assert set(rest.values()) == {None}
    assert air.gusts == ()
    assert air.wake is None


def test_profiles_and_gusts_have_the_defaults_they_document():
    air = page(
        f"wind: {{profile: {{kind: log}}}}, gusts: [{{{TIMED}}}, {{{PLACED}}}], wake: {{}}"
    ).air
    assert (air.wind.profile.height_m, air.wind.profile.roughness_m) == (10.0, 0.03)
    power = page("wind: {profile: {kind: power}}").air.wind.profile
    assert (power.height_m, power.exponent) == (10.0, 0.143)
    timed, placed = air.gusts
    assert timed.shape == placed.shape == "pulse"
    assert (placed.at_s, placed.speed_mps) == (0.0, None)
    assert (air.wake.core_spans, air.wake.decay_s, air.wake.memory_s) == (0.05, None, 10.0)


TURBULENT = "turbulence: {{model: dryden, {}}}"
COHERENT = "turbulence: {{model: coherent, {}}}"
WRONG = [
    # wind
    ("wind: {speed_mps: -1}", "air.wind.speed_mps: is -1 (write a number at least 0)"),
    ("wind: {from: 240}", "wind.from: is not a key of this part: did you mean 'from_deg'? (write"),
    (
        "wind: {profile: {kind: logarithm}}",
        "page.yaml:10:30: air.wind.profile.kind: is 'logarithm' (write one of uniform, log, power)",
    ),
    ("wind: {profile: log}", "air.wind.profile: is 'log' (write"),
    (
        "wind: {profile: {height_m: 10}}",
        "air.wind.profile.kind: is missing (write one of log, powe",
    ),
    (
        "wind: {profile: {kind: log, exponent: 1}}",
        "profile.exponent: is not a key of this part (write one of kind, height_m, roughness_m)",
    ),
    (
        "wind: {profile: {kind: log, roughness_m: 0}}",
        "air.wind.profile.roughness_m: is 0 (write a number above 0)",
    ),
    (
        "wind: {profile: {kind: log, height_m: 2, roughness_m: 2}}",
        "page.yaml:10:61: air.wind.profile.roughness_m: 2 m is not below height_m, 2 m (write the "
        "roughness length, about a tenth of the height of what grows there, or another height_m)",
    ),
    (
        "wind: {profile: {kind: log, height_m: 0.02}}",
        "air.wind.profile.roughness_m: 0.03 m is not below height_m, 0.02 m (write",
    ),
    ("wind: {profile: {kind: power, exponent: 2}}", "exponent: is 2 (write a number at most 1)"),
    (
        "wind: {file: gusty-wind.csv, speed_mps: 3}",
        "page.yaml:10:47: air.wind.speed_mps: is 3, but the wind is that of 'gusty-wind.csv' "
        "(leave out this, or file)",
    ),
    ("wind: {file: gusty-wind.csv, from_deg: 9}", "air.wind.from_deg: is 9, but the wind is that"),
    (
        "wind: {file: gustywind.csv}",
        "page.yaml:10:20: air.wind.file: there is no data file 'gustywind.csv': did you mean "
        "'gusty-wind.csv'? (write one of: ",
    ),
    ("wind: {file: 5}", "air.wind.file: is 5 (write text; CSV of a recorded wind in place of"),
    ("wind: {longest_gap_s: 0}", "air.wind.longest_gap_s: is 0 (write a number above 0)"),
    # turbulence
    (
        "turbulence: {model: drydn}",
        "air.turbulence.model: is 'drydn': did you mean 'dryden'? (write none, dryden, von-karman "
        "or coherent)",
    ),
    ("turbulence: {intensity: strong}", "is 'strong' (write light, moderate or severe)"),
    (TURBULENT.format("w20_mps: -3"), "air.turbulence.w20_mps: is -3 (write a number at least 0)"),
    (TURBULENT.format("probability: 0.3"), "probability: is 0.3 (write a number at most 0.2)"),
    (TURBULENT.format("probability: 0"), "probability: is 0 (write a number at least 1e-06)"),
    (
        TURBULENT.format("sigma_mps: [1, 2]"),
        "air.turbulence.sigma_mps: has 2 elements (write 3; Standard deviations [longitudinal, "
        "lateral, vertical]",
    ),
    (TURBULENT.format("sigma_mps: 2"), "air.turbulence.sigma_mps: is 2 (write a list; Standard"),
    (
        TURBULENT.format("sigma_mps: [1, 1, 99]"),
        "sigma_mps.2: is 99 (write a number at most 30)",
    ),
    (TURBULENT.format("length_m: [9, 9, 0.1]"), "length_m.2: is 0.1 (write a number at least 1)"),
    (TURBULENT.format("sigma_mps: [1, -1, 1]"), "sigma_mps.1: is -1 (write a number at least 0)"),
    (TURBULENT.format("length_m: [9, 9, 0]"), "length_m.2: is 0 (write a number at least 1)"),
    (
        TURBULENT.format("height_m: 90"),
        "air.turbulence.height_m: belongs to model: coherent, and the model is dryden (leave this "
        "out: each aircraft's own height counts)",
    ),
    (
        COHERENT.format("sigma_mps: [1, 1.5, 1]"),
        "air.turbulence.sigma_mps: 1 and 1.5 differ, and one field for all has no longitudinal "
        "direction (write the same number for the first two)",
    ),
    (
        COHERENT.format("length_m: [200, 100, 50]"),
        "air.turbulence.length_m: 200 and 100 differ, and one field for all has no",
    ),
    (COHERENT.format("height_m: 0"), "air.turbulence.height_m: is 0 (write a number above 0)"),
    # gusts
    ("gusts: {kind: time}", "air.gusts: is a map (write a list; Discrete gusts"),
    (f"gusts: [{{{TIMED[12:]}}}]", "air.gusts.0.kind: is missing (write one of place, time)"),
    (
        f"gusts: [{{{TIMED.replace('time', 'tyme', 1)}}}]",
        "air.gusts.0.kind: is 'tyme': did you mean 'time'? (write one of time, place)",
    ),
    (
        f"gusts: [{{{TIMED}}}, {{{PLACED.replace('name: b', 'name: a')}}}]",
        "air.gusts.1.name: 'a' is already the name of gusts.0 (write another)",
    ),
    (f"gusts: [{{{TIMED.replace('ramp_s: 2', 'ramp_s: 0')}}}]", "gusts.0.ramp_s: is 0 (write a"),
    (f"gusts: [{{{TIMED.replace('at_s: 5', 'at_s: -5')}}}]", "gusts.0.at_s: is -5 (write a numb"),
    (f"gusts: [{{{TIMED}, length_m: 5}}]", "air.gusts.0.length_m: is not a key of this part (wr"),
    (f"gusts: [{{{TIMED}, shape: step}}]", "air.gusts.0.shape: is 'step' (write pulse or ramp)"),
    (
        f"gusts: [{{{TIMED.replace('at_s: 5, ', '')}}}]",
        "air.gusts.0.at_s: is missing (write at_s: ...; When it begins, s)",
    ),
    (
        f"gusts: [{{{PLACED.replace('length_m: 20', 'length_m: 0')}}}]",
        "air.gusts.0.length_m: is 0 (write a number above 0)",
    ),
    (
        f"gusts: [{{{PLACED.replace('[0, 9]', '[0, 9, 5]')}}}]",
        "air.gusts.0.at_m: has 3 elements (write 2; A point of the front at at_s [north, east], m",
    ),
    (f"gusts: [{{{PLACED}, speed_mps: -2}}]", "gusts.0.speed_mps: is -2 (write a number at leas"),
    # wake
    ("wake: true", "air.wake: is true (write a map of keys and values; The wakes of the aircraft"),
    ("wake: {core_spans: 0}", "air.wake.core_spans: is 0 (write a number above 0)"),
    ("wake: {decay_s: 0}", "air.wake.decay_s: is 0 (write a number above 0)"),
    ("wake: {core: 1}", "air.wake.core: is not a key of this part"),
]


@pytest.mark.parametrize(("air", "message"), WRONG, ids=[air for air, _ in WRONG])
def test_a_wrong_air_is_named_with_its_place_and_its_cure(air, message):
    text = complaint(air)
    assert text.startswith("page.yaml:10:")
    assert message in text
    assert "\n" not in text


@pytest.mark.parametrize(
    "given", ["w20_mps: 9", "probability: 0.01", "sigma_mps: [1, 1, 1]", "length_m: [9, 9, 9]"]
)
def test_strength_without_a_model_is_refused(given):
    key = given.partition(":")[0]
    assert complaint(f"turbulence: {{{given}}}").endswith(
        f"air.turbulence.{key}: says how strong the turbulence is, and there is none (write "
        "model: dryden, von-karman or coherent, or leave this out)"
    )
    for model in ("dryden", "von-karman", "coherent"):
        assert page(f"turbulence: {{model: {model}, {given}}}").air.turbulence.model == model


def test_a_profile_of_another_kind_keeps_nothing_of_the_old():
    full = load(PAGES / "everything.yaml", ["air.wind.profile={kind: power}"])
    assert full.air.wind.profile.height_m == 10.0
    assert full.air.wind.from_deg == 250.0


def test_a_gust_is_changed_by_its_name_and_taken_away_with_all():
    changes = ["air.gusts.front.length_m=55", "air.gusts.shear.shape=pulse"]
    shear, front = load(PAGES / "everything.yaml", changes).air.gusts
    assert (front.length_m, front.speed_mps, shear.shape) == (55.0, 4.0, "pulse")
    assert load(PAGES / "everything.yaml", ["air.gusts=null"]).air.gusts == ()
    assert load(PAGES / "everything.yaml", ["air.wake=null"]).air.wake is None


def test_a_recorded_wind_is_found_beside_the_page_and_by_name(tmp_path, monkeypatch):
    (tmp_path / "pages").mkdir()
    (tmp_path / "pages" / "mine.csv").write_text("t_s,north_mps,east_mps\n")
    (tmp_path / "pages" / "mine.yaml").write_text(f"{MINIMAL}air: {{wind: {{file: mine.csv}}}}\n")
    mine = load(tmp_path / "pages" / "mine.yaml")
    assert mine.air.wind.file == str(tmp_path / "pages" / "mine.csv")
    monkeypatch.chdir(tmp_path)
    assert loads(dump(mine)) == mine
    kept = page("wind: {file: gusty-wind.csv}")
    assert kept.air.wind.file == "gusty-wind.csv"
    assert page(f"wind: {{file: {find_data('gusty-wind.csv')}}}") == kept


@pytest.mark.parametrize(
    ("air", "valid"),
    [
        ({"gusts": [{"kind": "time", "name": "a", "velocity_mps": [1, 0, 0]}]}, True),
        ({"gusts": [{"kind": "tyme"}]}, False),
        ({"gusts": [{"kind": "time", "towards_deg": 9}]}, False),
        ({"wake": None}, True),
        ({"wake": {}}, True),
        ({"wake": {"decay_s": 0}}, False),
        ({"turbulence": {"length_m": [1, 2]}}, False),
        ({"turbulence": {"length_m": None}}, True),
        ({"wind": {"profile": {"kind": "log", "exponent": 0.1}}}, False),
    ],
)
def test_the_editors_schema_knows_the_air(air, valid):
    validator = jsonschema.Draft202012Validator(json_schema())
    assert validator.is_valid({"air": air}) is valid
