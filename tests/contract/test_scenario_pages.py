"""Pages that are right: they load, they mean what they say, and they survive a round trip."""

from pathlib import Path

import jsonschema
import pytest

from testbed.scenario import Scenario, dump, json_schema, list_scenarios, load, loads, shorten

PAGES = Path(__file__).parents[1] / "data" / "scenarios"
FIXTURES = sorted(PAGES.glob("*.yaml"))
EVERY_PAGE = [*list_scenarios(), *map(str, FIXTURES)]


@pytest.mark.parametrize("page", EVERY_PAGE)
def test_a_page_loads_and_its_dump_loads_to_an_equal_object(page, monkeypatch, tmp_path):
    scenario = load(page)
    monkeypatch.chdir(tmp_path)  # what a dump means must not depend on where it is read
    assert loads(dump(scenario)) == scenario


@pytest.mark.parametrize("name", list_scenarios())
def test_a_scenario_has_its_files_name_a_question_and_an_answer(name):
    header = load(name).scenario
    assert header.name == name
    assert header.question and header.expectation


def test_there_are_scenarios():
    assert "simulation-3" in list_scenarios()


def test_simulation_3_has_the_papers_parameters():
    formation = load("simulation-3").formation
    assert (formation.k, formation.a, formation.b, formation.c) == (3.0, 1.0, 0.1, 0.1)
    assert (formation.kappa_mps, formation.speed_mps) == (3.6, (16.0, 30.0))
    assert formation.offsets_m == {
        "uav1": (-5.0, 5.0, 0.0),
        "uav2": (-5.0, -5.0, -4.0),
        "uav3": (-5.0, -5.0, 4.0),
    }
    one = (1.0, 1.0, 1.0)
    assert formation.leader_gains == {"uav1": one, "uav2": one, "uav3": one}
    assert formation.neighbour_gains == {"uav2": {"uav1": one}, "uav3": {"uav2": one}}


def test_defaults_are_the_ones_the_page_documents():
    page = load(PAGES / "minimal.yaml")
    rates = page.rates
    assert (rates.physics_hz, rates.autopilot_hz, rates.control_hz) == (200, 50, 25)
    assert (rates.broadcast_hz, rates.log_hz) == (25, 25)
    assert page.leader.sensors.exact and page.fleet[0].sensors.exact
    assert page.leader.path.bank_limit_deg == 30.0
    assert page.leader.start.altitude_m == 100.0
    assert page.formation.leader_gains == {}
    assert page.scenario.origin.latitude_deg == 38.0
    assert page.log.mcap is True


def _leaves(data, path=()):
    if isinstance(data, dict):
        for key, value in data.items():
            yield from _leaves(value, (*path, key))
    else:
        yield path, data


def test_the_full_page_says_every_key_and_the_page_keeps_what_it_says():
    full = load(PAGES / "everything.yaml")
    assert not _unset(full), "keys of the schema that everything.yaml does not use"
    assert full.fleet[0].sensors.position.sigma_m == 0.3
    assert full.fleet[1].sensors.velocity.sigma_mps == 0.0
    assert full.formation.leader_gains["uav1"] == (1.0, 1.0, 0.5)
    assert full.formation.neighbour_gains["uav2"]["uav1"] == (2.0, 2.0, 2.0)
    assert full.controller.extrapolate_from == "timestamp"
    assert full.leader.path.legs[1].levels[0].turns == 1.5
    # Loading settles references, after which pydantic counts every field as set: compare values.
    minimal = dict(_leaves(load(PAGES / "minimal.yaml").model_dump(exclude={"leader", "fleet"})))
    same = {path for path, value in _leaves(full.model_dump()) if minimal.get(path) == value}
    fixed = {("scenario", "schema_version"), ("controller", "law")}
    names_its_kind = {("formation", "control_function", "example")}
    assert same <= fixed | names_its_kind


def _unset(page: Scenario):
    text = (PAGES / "everything.yaml").read_text()
    return [
        key
        for definition in json_schema()["$defs"].values()
        for key in definition.get("properties", {})
        if f"{key}:" not in text and key != "file"  # the other kind of path
    ]


@pytest.mark.parametrize("page", EVERY_PAGE)
def test_the_editors_schema_accepts_the_resolved_page(page):
    data = load(page).model_dump(mode="json", by_alias=True)
    jsonschema.Draft202012Validator(json_schema()).validate(data)


@pytest.mark.parametrize(
    "wrong",
    [
        {"rates": {"physic_hz": 200}},
        {"rates": {"physics_hz": "fast"}},
        {"fleet": [{"sensors": "gps-inz"}]},
        {"leader": {"path": {"kind": "mission", "legs": [{"kind": "waypoint"}]}}},
        {"formation": {"leader_gains": {"uav1": [1, 2]}}},
    ],
)
def test_the_editors_schema_refuses_what_reading_refuses(wrong):
    validator = jsonschema.Draft202012Validator(json_schema())
    assert not validator.is_valid(wrong)
    assert validator.is_valid({"extends": "simulation-3"})


def test_every_field_is_described_and_a_key_with_a_unit_says_it():
    schema = json_schema()
    units = {"_m": "m", "_s": "s", "_hz": "Hz", "_deg": "degrees", "_mps": "m/s", "_per_s": "1/s"}
    sections = [schema, *schema["$defs"].values()]
    # A section with alternatives keeps its fields one level further down.
    sections += [choice for section in sections for choice in section.get("anyOf", ())]
    fields = [item for section in sections for item in section.get("properties", {}).items()]
    assert len(fields) > 60
    for key, field in fields:
        section = schema["$defs"][field["$ref"].rsplit("/", 1)[1]] if "$ref" in field else {}
        assert field.get("description") or section.get("description"), key
        suffix = max((s for s in units if key.endswith(s)), key=len, default=None)
        if suffix and "$ref" not in field:
            assert units[suffix] in field["description"], (key, field["description"])


def test_a_page_is_frozen():
    page = load(PAGES / "minimal.yaml")
    with pytest.raises(ValueError, match="frozen"):
        page.formation.k = 4.0


def test_a_shortened_flight_keeps_what_fits():
    short = shorten(load(PAGES / "everything.yaml"), 14.0)
    assert short.scenario.duration_s == 14.0
    assert short.scenario.portions == {"straight": (5.0, 10.0), "turn": (12.5, 14.0)}
    assert set(short.scenario.published.rms_m) == {"straight"}
    shorter = shorten(short, 5.0)
    assert shorter.scenario.portions == {}
    assert shorter.scenario.published.mean_rms_m == {}
    assert loads(dump(shorter)) == shorter


@pytest.mark.parametrize(
    "text", ["no", "1e-2", "08", "1_000", "12:30", "null", "~", "", "- x", "é: #"]
)
def test_text_that_looks_like_something_else_survives_the_round_trip(text):
    page = load(PAGES / "minimal.yaml")
    data = page.model_dump(by_alias=True)
    data["scenario"]["question"] = text
    page = Scenario.model_validate(data)
    assert loads(dump(page)).scenario.question == text
