"""The air section: defaults, settings, files and the editor's schema."""

import pytest
from places import TESTS

from testbed.scenario import dump, find_data, load_scenario, loads

FOLDER = TESTS / "data" / "scenarios"
MINIMAL = (FOLDER / "minimal.yaml").read_text()


def read(air):
    return loads(f"{MINIMAL}air: {{{air}}}\n")


@pytest.mark.parametrize("model", ["dryden", "von-karman", "coherent"])
@pytest.mark.parametrize(
    "keys", ["w20_mps: 9", "probability: 0.01", "sigma_mps: [1, 1, 1]", "length_m: [9, 9, 9]"]
)
def test_turbulence_strength_is_for_every_model(model, keys):
    assert read(f"turbulence: {{model: {model}, {keys}}}").air.turbulence.model == model


def test_profile_of_other_kind_replaces_the_old():
    full = load_scenario(FOLDER / "everything.yaml", ["air.wind.profile={kind: power}"])
    assert full.air.wind.profile.height_m == 10.0
    assert full.air.wind.from_deg == 250.0


def test_gust_is_set_by_its_name():
    changes = ["air.gusts.front.length_m=55", "air.gusts.shear.shape=pulse"]
    shear, front = load_scenario(FOLDER / "everything.yaml", changes).air.gusts
    assert (front.length_m, front.speed_mps, shear.shape) == (55.0, 4.0, "pulse")
    assert load_scenario(FOLDER / "everything.yaml", ["air.gusts=null"]).air.gusts == ()
    assert load_scenario(FOLDER / "everything.yaml", ["air.wake=null"]).air.wake is None


def test_recorded_wind_is_found_by_path_and_name(tmp_path, monkeypatch):
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "mine.csv").write_text("t_s,north_mps,east_mps\n")
    (tmp_path / "below" / "mine.yaml").write_text(f"{MINIMAL}air: {{wind: {{file: mine.csv}}}}\n")
    mine = load_scenario(tmp_path / "below" / "mine.yaml")
    assert mine.air.wind.file == str(tmp_path / "below" / "mine.csv")
    monkeypatch.chdir(tmp_path)
    assert loads(dump(mine)) == mine
    by_name = read("wind: {file: gusty-wind.csv}")
    assert by_name.air.wind.file == "gusty-wind.csv"
    assert read(f"wind: {{file: {find_data('gusty-wind.csv')}}}") == by_name
