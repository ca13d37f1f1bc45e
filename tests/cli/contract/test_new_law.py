"""`testbed new law` and `new study`: what they write flies, and is not written over anything."""

import json

import matplotlib
import pytest
from cases import ALL
from commands import call_command

from testbed.benchmark.entry import open_entries
from testbed.plan.world import build
from testbed.scenario import find_law, load_scenario
from testbed.studies.plan import load_study


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("new")
    call_command("new", "law", "mine", cwd=folder, code=0, columns=200)
    return folder


def test_new_law_has_files_that_load(folder):
    files = {each.name for each in (folder / "mine").iterdir()}
    assert files == {"mine.py", "mine.yaml", "mine-study.yaml", "mine-entry.yaml", "mine.ipynb"}
    study = load_study(folder / "mine" / "mine-study.yaml").config
    assert len(study.study.seeds) == 20 and set(study.cases) == {"paper", "mine"}
    [entry] = open_entries([f"{folder}/mine/mine.py:mine"], [folder / "mine" / "mine-entry.yaml"])
    assert entry.name == "mine" and len(entry.tune) == 2
    for file in files:
        assert "NAME" not in (folder / "mine" / file).read_text()


def test_new_law_begins_with_one_of_the_library(tmp_path):
    """Its file with another name of the function, and a scenario without options of another law."""
    words = "new", "law", "mine", "--from", "virtual-structure"
    call_command(*words, cwd=tmp_path, code=0, columns=200)
    text = (tmp_path / "mine" / "mine.py").read_text("utf-8")
    assert text.replace("def mine(", "def virtual_structure(") == find_law(words[4]).read_text(
        "utf-8"
    )
    scenario = load_scenario(tmp_path / "mine" / "mine.yaml")
    assert scenario.controller.law.endswith("mine.py:mine") and not scenario.controller.options
    if ALL:  # otherwise the text is compared: tests of the library compile its laws
        build(scenario)
    law = f"{tmp_path}/mine/mine.py:mine"
    [entry] = open_entries([law], [tmp_path / "mine" / "mine-entry.yaml"])
    assert entry.name == "mine" and "controller.options.consensus_per_s" in entry.tune


def test_new_notebook_runs_from_law_to_figure(folder, monkeypatch, capsys):
    """Its cells, in this process: the law flies, better than 1 m, and has margins."""
    matplotlib.use("Agg")
    monkeypatch.chdir(folder / "mine")
    if not ALL:
        scenario = folder / "mine" / "mine.yaml"
        text = scenario.read_text()
        assert text.count("330") == 3 and text.count("[95, ") == 1
        text = text.replace("330", "45").replace("[95, ", "[30, ")
        scenario.write_text(f"{text}\nrates: {{control_hz: 10, broadcast_hz: 10}}\n")
    notebook = json.loads((folder / "mine" / "mine.ipynb").read_text())
    names: dict[str, object] = {}
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert names["ours"].metrics["windows"]["laps"]["mean_rms_m"] < 1.0
    assert names["margins"]["roll"].gain > 2.0
    assert names["logged"] == ["law_error_ahead_m"]
    assert (folder / "mine" / "mine.pdf").stat().st_size > 10_000


@pytest.mark.parametrize(
    "words",
    [
        *("law mine", "law 3x", "law hbh23", "law class", "study a/b"),
        *("law yours --from mine", "law solve --from mpc"),
    ],
)
def test_wrong_names_are_refused(folder, words):
    before = sorted(folder.rglob("*"))
    done = call_command("new", *words.split(), cwd=folder, code=2, columns=200)
    assert done.stderr.startswith("error: ") and "write" in done.stderr
    assert sorted(folder.rglob("*")) == before


@pytest.mark.parametrize("scenario", ["simulation-2", "ideal-figure-eight"])
def test_new_study_is_one_of_its_scenario(tmp_path, scenario):
    words = "new", "study", "radio", "--scenario", scenario
    call_command(*words, cwd=tmp_path, code=0, columns=200)
    study = load_study(tmp_path / "radio.yaml").config
    assert study.study.scenario == scenario and len(study.study.metrics) == 2
    windows = load_scenario(scenario).scenario.windows
    assert study.study.metrics[0].split(".")[1] in {*windows, "uav1"}
    assert "exists" in call_command(*words, cwd=tmp_path, code=2, columns=200).stderr
