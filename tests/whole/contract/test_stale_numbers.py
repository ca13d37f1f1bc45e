"""Numbers of the pages that are older than their inputs: found, named, and refused in a release."""

from __future__ import annotations

import argparse
import importlib
import re
import shutil
import sys

import pytest
from cases import ALL, some
from places import ROOT

from testbed.scenario import references

PROFILE = "rascal110/middle_loop.yaml"
# Pictures that are not between markers: of formulas; drawn with a table beside them; made by hand.
FORMULAS = {"barriers.png", "control-functions.png"}
BESIDE = {"arduplane.png", "many-flights.png"}
OF_THE_TESTS = {"packages.svg"}  # made of tests/architecture/package_groups.py
BY_HAND = {"check-trend.png", "real-and-simulated.png", "shot-software.png"}


@pytest.fixture
def stale(monkeypatch):
    """Return `benchmarks/stale.py`, without what another test has loaded."""
    for folder in ("paper", "benchmarks"):
        monkeypatch.syspath_prepend(str(ROOT / folder))
    module = importlib.import_module("stale")
    yield module
    forget(module)


def forget(stale):
    """Let inputs be read again."""
    inputs = sys.modules["inputs"]
    for cached in (stale._digests, inputs._content, inputs._loaded, inputs._study_digests):
        cached.cache_clear()


@pytest.fixture
def library(stale, monkeypatch, tmp_path):
    """Return a copy of aircraft and scenarios that flights would use."""
    for name in ("aircraft", "scenarios"):
        shutil.copytree(ROOT / name, tmp_path / name)
    monkeypatch.setattr(references, "library", lambda: tmp_path)
    forget(stale)
    return tmp_path


def change(file, old, new):
    text = file.read_text(encoding="utf-8")
    assert text.count(old) == 1
    file.write_text(text.replace(old, new), encoding="utf-8")


def reasons(found):
    """Return the changed inputs by page and marker."""
    return {(each.page, each.mark): " ".join(each.reasons) for each in found}


def test_no_number_is_older_than_its_inputs(stale, monkeypatch):
    """`make numbers` makes those again that are; `python benchmarks/stale.py` has the commands.

    In `make test` markers of all pages and digests of some; a release refuses those of any page.
    """
    found = stale.find_stale(None if ALL else some(stale.pages(), 12))
    with monkeypatch.context() as patch:
        patch.setattr(stale, "_digests", lambda inputs: {})
        patch.setattr(stale, "changed", lambda *digests: ())
        found += [] if ALL else stale.find_stale()
    assert not found, "\n".join(map(str, found))


FAULTS, OWN_LAW, AIR = "docs/faults.md", "docs/own-law.md", "docs/air.md"
PAGES = (FAULTS, OWN_LAW, AIR)


def test_changed_gain_names_the_pages_that_use_it(stale, library):
    gains = library / "aircraft" / PROFILE
    change(gains, "course: {p: 3.48, i: 0.02, d: 0.196}", "course: {p: 3.49, i: 0.02, d: 0.196}")
    found = stale.find_stale(PAGES)
    assert {each.page for each in found} == set(PAGES)
    assert all(each.reasons == (f"{PROFILE} tuned changed",) for each in found)
    line = next(str(each) for each in found if each.mark.endswith("repulsion"))
    page = (ROOT / OWN_LAW).read_text(encoding="utf-8").split("\n")
    number = page.index("<!-- begin: make results, repulsion -->") + 1
    assert line == f"{OWN_LAW}:{number}: make results, repulsion: {PROFILE} tuned changed"
    commands = [command for command, _ in stale.commands(found, 2)]
    assert ["python", "benchmarks/faults.py", "--into", FAULTS, "--jobs", "2"] in commands


def test_unused_gain_and_comment_name_no_page(stale, library):
    """And copied inputs none at all."""
    assert stale.find_stale((AIR,)) == []
    forget(stale)
    gains = library / "aircraft" / PROFILE
    change(gains, "d: 0.14}", "d: 0.1485}")  # of `improved`
    change(library / "scenarios" / "engine-out-uav2.yaml", "# Simulation 3's", "# The simulation's")
    assert {each.page for each in stale.find_stale(PAGES)} == {AIR}


def test_changed_scenario_model_and_law_are_named(stale, library):
    change(
        library / "scenarios" / "engine-out-uav2.yaml", "bank_limit_deg: 30", "bank_limit_deg: 31"
    )
    law = library / "scenarios" / "repulsion.py"
    law.write_text(law.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    found = reasons(stale.find_stale((FAULTS, OWN_LAW)))
    assert found[FAULTS, "make results, engine out"] == "engine-out-uav2 changed"
    assert (FAULTS, "make results, pitot tube") not in found
    assert found[OWN_LAW, "make results, repulsion"] == "scenarios/repulsion.py changed"


def test_changed_pin_names_all_pages(stale, monkeypatch, tmp_path):
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    pinned = re.search(r"^jsbsim==(\S+)", lock, re.M)[1]
    other = tmp_path / "requirements.lock"
    other.write_text(lock.replace(f"jsbsim=={pinned}", "jsbsim==9.9"), encoding="utf-8")
    inputs = sys.modules["inputs"]
    monkeypatch.setattr(inputs, "LOCKS", (str(other),))
    forget(stale)
    found = stale.find_stale((FAULTS, "docs/physics.md"))
    assert {each.page for each in found} == {FAULTS, "docs/physics.md"}
    assert all(each.reasons == (f"jsbsim {pinned} is now 9.9",) for each in found)


def test_unknown_marker_and_missing_digests_are_named(stale, monkeypatch, tmp_path):
    page = tmp_path / "docs" / "faults.md"
    page.parent.mkdir()
    text = (ROOT / FAULTS).read_text(encoding="utf-8")
    text = re.sub(r"<!-- inputs:.*?-->\n", "", text, count=1, flags=re.S)
    page.write_text(f"{text}<!-- begin: by hand -->\n1\n<!-- end: by hand -->\n", encoding="utf-8")
    monkeypatch.setattr(stale, "ROOT", tmp_path)
    assert reasons(stale.find_stale((FAULTS,))) == {
        (FAULTS, "make results, engine out"): "has no digests of its inputs",
        (FAULTS, "by hand"): "no script of benchmarks/stale.py writes it",
    }


def test_every_picture_is_between_markers(stale):
    tables = sys.modules["tables"]
    marked = {
        name
        for page in stale.pages()
        for block in tables.blocks((ROOT / page).read_text(encoding="utf-8"))
        for name in re.findall(r"images/([\w.-]+)\)", block.text)
    }
    files = {each.name for each in (ROOT / "docs" / "images").glob("[!.]*")}
    assert files - marked == FORMULAS | BESIDE | OF_THE_TESTS | BY_HAND


PAGE = """text
<!-- begin: make it -->
<!-- inputs: simulation-3 12345678;
     numpy 2.4.6 -->

| a | 1.23 |
| b | 4.56 |

Flown with testbed 1.2.3, JSBSim 1.3.3.

<!-- end: make it -->
"""
NEW = "| a | 1.23 |\n| b | 4.57 |\n\nFlown with testbed 1.3.0, JSBSim 1.3.3."


def test_check_names_a_line_that_differs(stale):
    tables = sys.modules["tables"]
    (block,) = tables.blocks(PAGE)
    assert sys.modules["inputs"].parse(block.comment) == {
        "simulation-3": "12345678",
        "numpy": "2.4.6",
    }
    (line,) = tables.compare(block, NEW)
    assert line == "7: make it\n  page | b | 4.56 |\n  now  | b | 4.57 |"
    assert PAGE.split("\n")[7 - 1] == "| b | 4.56 |"
    assert not list(tables.compare(block, NEW.replace("4.57", "4.56")))


def test_written_text_has_digests_and_stays(stale, tmp_path):
    tables, inputs = sys.modules["tables"], sys.modules["inputs"]
    of = inputs.Inputs((inputs.Case("simulation-3"),))
    page = tables.insert(PAGE, "make it", NEW, of)
    (block,) = tables.blocks(page)
    assert block.text == NEW and inputs.parse(block.comment) == inputs.digests(of)
    assert tables.insert(page, "make it", NEW, of) == page
    file = tmp_path / "page.md"
    file.write_text(PAGE, encoding="utf-8")
    options = argparse.Namespace(into=[file], check=False)
    with pytest.raises(SystemExit, match="begin: another --> is in none of"):
        tables.publish(options, {"another": NEW}, {"another": of})


def test_release_refuses_stale_numbers(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(ROOT / "release"))
    make_release = importlib.import_module("make_release")
    script = tmp_path / "stale.py"
    script.write_text("print('docs/faults.md:1: changed'); raise SystemExit(3)", encoding="utf-8")
    with pytest.raises(make_release.UnfitError, match=r"docs/faults\.md:1: changed"):
        make_release.check_numbers(script)
    script.write_text("", encoding="utf-8")
    make_release.check_numbers(script)
