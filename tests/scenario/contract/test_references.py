"""What a scenario names: one walk finds it, and a study is not resumed after an edit of it."""

import os
import shutil
import sys
import types
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, Union, get_args, get_origin

import pytest
import small_study
from cases import ALL, some
from pydantic import BaseModel

import testbed
from testbed.core.errors import InputError
from testbed.plan.code_files import code_files
from testbed.plan.scenario_files import file_digests, referenced_files
from testbed.scenario import Scenario, SingleAircraft, find_scenario, library, load_scenario
from testbed.scenario.fields import Section
from testbed.scenario.pattern import Pattern
from testbed.scenario.reference_fields import (
    DataReference,
    RefersTo,
    kinds_of_keys,
    references,
    sections_of,
)
from testbed.studies.plan import Plan, load_study
from testbed.studies.plan_check import check_plan
from testbed.studies.sweep import sweep
from testbed.studies.table import read_table

# Texts of scenarios that name nothing outside of them.
PLAIN_TEXTS = {
    *("Header.question", "Header.expectation", "Published.source", "Published.differs"),
    "Controller.options",  # arguments of a law; docs/studies.md has that they are not seen
    "Controller.map",  # names of variables in an FMU
    "Log.start_time",
}


def free_texts(annotation, *, bound=False):
    """Yield the marks of the texts in a type that may be any text; None: it has no mark."""
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        marks = [each for each in args[1:] if isinstance(each, RefersTo)]
        named = any(getattr(each, "pattern", None) for each in metadata_of(args[1:]))
        for found in free_texts(args[0], bound=bound or named):
            yield marks[0] if marks else found
    elif annotation is str and not bound:
        yield None
    elif origin in (Union, types.UnionType, tuple):
        for each in args:
            yield from free_texts(each, bound=bound)
    elif origin is not None and origin is not Literal:  # of a map, the values
        yield from free_texts(args[-1], bound=bound)


def metadata_of(annotations):
    for each in annotations:
        yield each
        yield from getattr(each, "metadata", ())


def texts_of_sections(*models):
    """Yield the name and the mark of every free text of a section."""
    for model in models:
        for section in sections_of(model):
            for name, field in section.model_fields.items():
                marks = [each for each in field.metadata if isinstance(each, RefersTo)]
                bound = any(getattr(each, "pattern", None) for each in field.metadata)
                for mark in free_texts(field.annotation, bound=bound):
                    yield f"{section.__name__}.{name}", marks[0] if marks else mark


def test_each_text_is_a_reference_or_known_to_be_none():
    """A new key with a file has a type with a mark, or its text is in the list of this test."""
    found = list(texts_of_sections(Scenario, SingleAircraft, Pattern))
    assert {name for name, mark in found if mark is None} <= PLAIN_TEXTS
    assert {mark.kind for _, mark in found if mark} == {
        *("aircraft", "tune", "scenario", "data", "gains", "code")
    }


def test_reference_of_a_new_section_is_found():
    class Table(Section):
        parts: dict[str, tuple[DataReference, ...]]
        name: str = "a.csv"

    class Holder(Section):
        table: Table | None
        other: DataReference | None = None

    held = Holder(table={"parts": {"x": ("b.csv", "c.csv")}}, other="d.csv")
    assert [(each.loc, each.name) for each in references(held)] == [
        (("table", "parts", "x", 0), "b.csv"),
        (("table", "parts", "x", 1), "c.csv"),
        (("other",), "d.csv"),
    ]
    assert kinds_of_keys(Holder) == {"parts": "data", "other": "data"}
    assert issubclass(Table, BaseModel) and None in dict(texts_of_sections(Holder)).values()


# a scenario for each kind of reference, and a study that flies them

BASE = """
scenario: {name: base, duration_s: 1, windows: {approach: [0, 1], settled: null}}
rates: {physics_hz: 50, autopilot_hz: 50, control_hz: 25, broadcast_hz: 25, log_hz: 25}
leader: {aircraft: plane}
network: {jitter: {distribution: empirical, file: delays.dat}}
"""
FILES = {
    "loops.yaml": """
extends: base.yaml
scenario: {name: loops}
leader: {tune: slow}
fleet:
  - {name: uav1, aircraft: plane, tune: tunes/mine.txt, start_m: [-40, 30, 0]}
  - {name: uav2, aircraft: plane, start_m: [-40, -30, -20]}
  - {name: uav3, aircraft: plane, start_m: [-65, -10, 15]}
controller: {middle_loop: gains.txt}
""",
    "recorded.yaml": """
extends: base.yaml
scenario: {name: recorded}
leader: {path: {kind: replay, file: leader.csv}}
air: {wind: {file: wind.csv}}
network: {links: {uav1: {uav2: {trace: {file: measured}}}}}
""",
    "functions.yaml": """
extends: base.yaml
scenario: {name: functions}
formation:
  speed_model: {f: "speed:f", g: "speed:g"}
  control_function: {example: own, function: "gentle:mu"}
  barrier: {example: own, function: "gentle:h"}
  agents: {uav2: {control_function: {example: own, function: "agents:mu"}}}
""",
    "law.yaml": 'extends: base.yaml\nscenario: {name: law}\ncontroller: {law: "laws:Law"}\n',
    "later.yaml": """
extends: base.yaml
scenario: {name: later, windows: {approach: [0.4, 1]}, begin: {scenario: first.yaml, at_s: 0.4}}
""",
    "first.yaml": """
extends: below.yaml
scenario: {name: first, windows: null, begin: {scenario: zeroth.yaml, at_s: 0.2}}
network: {jitter: {file: first.csv}}
""",
    "below.yaml": "extends: base.yaml\nscenario: {question: Why?}\n",
    "zeroth.yaml": """
extends: base.yaml
scenario: {name: zeroth}
network: {jitter: {file: zeroth.csv}}
""",
    "laws.py": """
import os, sys

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "lib"))
import importlib
import numpy
import gains_of_law
from parts_of_law import turn

importlib.import_module("loaded_by_law")


class Law:
    def __init__(self, config):
        self.builtin = config.hbh23

    def start(self, own):
        return self.builtin.start(own)

    def step(self, now, own, inbox, memory):
        from lazy_of_law import nothing

        return self.builtin.step(now, own, inbox, memory)
""",
    "lib/gains_of_law.py": "import numpy\nimport deep_of_law\nK = 1.0\n",
    "lib/deep_of_law.py": "",
    "lib/loaded_by_law.py": "",
    "lib/lazy_of_law.py": "nothing = None\n",
    "lib/parts_of_law/__init__.py": "from . import turn\n",
    "lib/parts_of_law/turn.py": "from .angle import right\n",
    "lib/parts_of_law/angle.py": "right = 1.0\n",
    "lib/not_of_law.py": "",
    **dict.fromkeys(
        ("delays.dat", "more/delays.txt", "first.csv", "zeroth.csv"), "delay_s\n0.01\n0.02\n"
    ),
    "measured": "sent_s,received_s\n0,0.02\n0.5,0.53\n1,1.04\n",
    "wind.csv": "t_s,speed_mps,from_deg\n0,5,260\n10,6,250\n",
    "study.yaml": """
study: {schema: 1, name: all, scenario: base.yaml, seeds: 1}
vary: {network.jitter.file: [delays.dat, more/delays.txt]}
cases:
  loops: {scenario: loops.yaml}
  recorded: {scenario: recorded.yaml}
  functions: {scenario: functions.yaml}
  law: {scenario: law.yaml}
  later: {scenario: later.yaml}
""",
}
NOT_NAMED = {"study.yaml", "lib/not_of_law.py", "plane/SOURCE.md"}  # files that change no number
OF_SCENARIOS = {f"{name}.yaml" for name in ("loops", "recorded", "functions", "law", "later")}


OPENED: set[str] | None = None  # files, while they are recorded


def record_opened(event, arguments):
    if event == "open" and OPENED is not None and isinstance(arguments[0], str | os.PathLike):
        OPENED.add(os.path.realpath(arguments[0]))


@cache
def record():
    """Record from now on; an audit hook stays to the end of the process, and takes its time."""
    sys.addaudithook(record_opened)


@contextmanager
def opened():
    """Yield the set of the files that are opened in the block, by Python."""
    global OPENED
    record()
    OPENED = found = set()
    try:
        yield found
    finally:
        OPENED = None


@pytest.fixture(scope="module")
def read_files():
    """The files that the whole study opens."""
    return set()


@pytest.fixture(scope="module")
def folder(tmp_path_factory, read_files):
    """A folder with all files of the study, its whole result, and one that was stopped."""
    folder = tmp_path_factory.mktemp("named")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    plane = folder / "plane"
    shutil.copytree(library() / "aircraft" / "rascal110", plane)
    (plane / "rascal110.xml").rename(plane / "plane.xml")
    shutil.copy(plane / "autopilot.param", plane / "slow.param")
    (folder / "tunes").mkdir()
    shutil.copy(plane / "autopilot.param", folder / "tunes" / "mine.txt")
    shutil.copy(plane / "middle_loop.yaml", folder / "gains.txt")
    whole = find_scenario("ideal-figure-eight").read_text()
    (folder / "ideal.yaml").write_text(whole.replace("aircraft: rascal110", "aircraft: plane"))
    (folder / "base.yaml").write_text(f"extends: ideal.yaml\n{BASE}")
    data = (library() / "scenarios/data/arduplane-auto-leader-rascal.csv").read_text()
    (folder / "leader.csv").write_text("".join(data.splitlines(keepends=True)[:40]))
    scenarios = library() / "scenarios"
    shutil.copy(scenarios / "drag_and_propeller.py", folder / "speed.py")
    for name in ("gentle.py", "agents.py"):
        shutil.copy(scenarios / "gentle_functions.py", folder / name)

    def keep_part(done, total):  # as if the study ended here
        if done == 3:
            for suffix in (".parquet", ".journal"):
                shutil.copy(folder / f"whole{suffix}", folder / f"part{suffix}")

    with pytest.MonkeyPatch.context() as patch:
        small_study.use(patch, small_study.FlownOnce())
        patch.setattr(sys, "path", list(sys.path))
        with opened() as found:
            sweep(folder / "study.yaml", folder / "whole.parquet", progress=keep_part)
        read_files |= found
        yield folder


def referents_of(folder):
    """Return what the study's scenarios name."""
    return check_plan(Plan(load_study(folder / "study.yaml"))).referents


@pytest.fixture(scope="module")
def referents(folder):
    return referents_of(folder)


def test_walk_finds_all_files_that_change_numbers(folder, referents):
    """Found independently: all files of the folder, all of which have a part in the study."""
    files = {path for path in folder.rglob("*") if path.is_file() and "parquet" not in path.name}
    files = {path for path in files if not {"__pycache__", "part.journal"} & set(path.parts)}
    expected = {path.relative_to(folder).as_posix() for path in files} - NOT_NAMED - OF_SCENARIOS
    found = {path.relative_to(folder).as_posix() for path in referenced_files(referents).values()}
    assert found == expected
    assert len(found) > 30


def test_study_reads_no_file_beyond_the_walk(folder, referents, read_files):
    """Flights, their checks and all that is imported for them."""
    inside = {path for path in map(Path, read_files) if path.is_relative_to(folder)}
    read = {path.relative_to(folder).as_posix() for path in inside}
    found = {path.relative_to(folder).as_posix() for path in referenced_files(referents).values()}
    results = (".", "whole", "part")
    others = {each for each in read if each.startswith(results) or "__pycache__" in each}
    assert read - found - others == OF_SCENARIOS | {"study.yaml"}
    assert {"measured", "wind.csv", "lib/parts_of_law/angle.py", "lib/loaded_by_law.py"} <= read


def test_each_kind_of_reference_is_in_the_study(folder):
    used = set()
    for name in FILES:
        if name.endswith(".yaml") and name not in ("below.yaml", "study.yaml"):
            used |= {str(each.loc[-1]) for each in references(load_scenario(folder / name))}
    assert used == kinds_of_keys(Scenario).keys()


# by whole resumes: of some kinds one, the second level of a key, and what is named at second hand
RESUMED = ("more/delays.txt", "measured", "tunes/mine.txt", "below.yaml", "lib/deep_of_law.py")


def test_edit_of_any_named_file_refuses_a_resume(folder, referents):
    """A byte more in any of them is enough. Without one the study is resumed to the bit.

    That all of them are found is the claim of the test of the walk.
    """
    study, part = folder / "study.yaml", folder / "part.parquet"
    before = file_digests(referents)
    resumed = some(RESUMED, 1)
    whole = [name for name in before if any(name.endswith(f"/{each}") for each in resumed)]
    whole += [name for name in before if name in resumed]
    assert len(whole) == len(resumed)
    files = referenced_files(referents)
    for name in {*some(files, 5), *whole}:
        file = files[name]
        content = file.read_bytes()
        file.write_bytes(content + b"\n")
        try:
            now = file_digests(referents)
            assert {each for each in now if now[each] != before.get(each)} == {name}
            if name in whole:
                with pytest.raises(InputError) as refused:
                    sweep(study, part, resume=True)
                assert f"changed since the study was started: {name} from " in str(refused.value)
        finally:
            file.write_bytes(content)
    (folder / "lib/not_of_law.py").write_text("edited = True\n")
    result = sweep(study, part, resume=True)
    assert result.new_runs == 7 and result.completed
    assert small_study.content(read_table(part)) == small_study.content(
        read_table(folder / "whole.parquet")
    )


def test_files_of_one_name_are_told_apart(tmp_path):
    text = "extends: simulation-3\nnetwork: {jitter: {distribution: empirical, file: a/x/d.csv}}\n"
    for name in ("a", "b"):
        (tmp_path / name / "x").mkdir(parents=True)
        (tmp_path / name / "x" / "d.csv").write_text("delay_s\n0.01\n")
    links = "links: {uav1: {uav2: {jitter: {distribution: empirical, file: b/x/d.csv}}}}"
    (tmp_path / "two.yaml").write_text(text.replace("}}\n", f"}}, {links}}}\n"))
    named = references(load_scenario(tmp_path / "two.yaml"))
    found = referenced_files(named)
    assert {"a/x/d.csv", "b/x/d.csv"} <= set(found)
    assert found["b/x/d.csv"] == tmp_path / "b/x/d.csv"


def test_code_of_the_testbed_has_no_installed_modules():
    """NumPy and the testbed's own modules, which it imports, have versions of their own."""
    assert code_files("repulsion:Repulsion") == (library() / "scenarios" / "repulsion.py",)
    # installed packages, what they import, and a module of theirs
    others = {"mcap.writer:Writer": ("zstandard", "opcode.py")}
    if ALL:  # all files of the testbed, which is one more
        others["testbed.formation.hbh23:anything"] = ("numpy", "frames.py")
    for code, (imported, own) in others.items():
        first, *more = code_files(code)
        assert f"{first.with_suffix('')}".endswith(code.partition(":")[0].replace(".", os.sep))
        assert own in {each.name for each in more}
        assert not any(imported in str(each) for each in more)


def test_chain_of_begins_goes_on_to_the_bit(tmp_path):
    """Equal to the bit to the flight that is flown from 0 s on."""
    for name, begin in (("a", ""), ("b", "a.yaml, at_s: 0.4"), ("c", "b.yaml, at_s: 0.8")):
        begins = f", begin: {{scenario: {begin}}}" if begin else ""
        header = f"{{name: {name}, duration_s: 2, windows: null{begins}}}"
        text = f"extends: ideal-figure-eight\nscenario: {header}\n"
        (tmp_path / f"{name}.yaml").write_text(text)
    states = [testbed.Simulation(tmp_path / f"{each}.yaml").step(until=1.2) for each in "abc"]
    a, b, c = (b"".join(each.tobytes() for each in (*s.truth, *s.command)) for s in states)
    assert a == b == c
    short = testbed.Simulation(tmp_path / "a.yaml").step(until=1.0)
    assert a != b"".join(each.tobytes() for each in (*short.truth, *short.command))


JITTERED = """
extends: ideal-figure-eight
scenario: {name: jittered, duration_s: 2, windows: null}
network: {jitter: {distribution: empirical, file: delays.csv}}
"""


def test_flight_that_others_begin_with_is_of_its_files(tmp_path):
    """It is kept in the process until a file changes that it names."""
    (tmp_path / "jittered.yaml").write_text(JITTERED)
    begin = "{scenario: jittered.yaml, at_s: 1}"
    header = f"{{name: later, duration_s: 2, windows: null, begin: {begin}}}"
    (tmp_path / "later.yaml").write_text(f"extends: ideal-figure-eight\nscenario: {header}\n")

    def fly(delay_s):
        (tmp_path / "delays.csv").write_text(f"delay_s\n{delay_s}\n")
        state = testbed.Simulation(tmp_path / "later.yaml").step(until=1.2)
        return b"".join(each.tobytes() for each in state.truth)

    assert fly(0.01) != fly(0.5)
    assert fly(0.01) == fly(0.01)


@pytest.mark.parametrize("design", ["{design: monte-carlo, samples: 30}", "{design: factorial}"])
def test_files_of_all_levels_are_found(tmp_path, monkeypatch, design):
    """Also of a study with more points than are read before its first flight."""
    monkeypatch.setattr("testbed.studies.plan_check.MAX_CHECKED", 1)
    (tmp_path / "jittered.yaml").write_text(JITTERED)
    names = [f"{each}.csv" for each in ("delays", "a", "b", "c")]
    for name in names:
        (tmp_path / name).write_text("delay_s\n0.01\n")
    keys = f"network.delay_s: [0, 0.1], network.jitter.file: [{', '.join(names[1:])}]"
    settings = f"{{schema: 1, name: s, scenario: jittered.yaml, seeds: 1, {design[1:]}"
    (tmp_path / "study.yaml").write_text(f"study: {settings}\nvary: {{{keys}}}\n")
    found = {path.name for path in referenced_files(referents_of(tmp_path)).values()}
    assert set(names) <= found


@small_study.in_this_process()
def test_file_changed_during_a_study_is_named(tmp_path):
    (tmp_path / "jittered.yaml").write_text(JITTERED)
    (tmp_path / "delays.csv").write_text("delay_s\n0.01\n")
    study = tmp_path / "study.yaml"
    study.write_text(
        "study: {schema: 1, name: s, scenario: jittered.yaml, duration_s: 0.1, seeds: 1}\n"
    )
    lines = []
    sweep(study, tmp_path / "one.parquet", report=lines.append)
    assert not any("changed while" in line for line in lines)

    def edit(done, total):
        (tmp_path / "delays.csv").write_text("delay_s\n0.02\n")

    sweep(study, tmp_path / "two.parquet", report=lines.append, progress=edit)
    (line,) = [line for line in lines if "changed while" in line]
    assert line.startswith("warning: a file of a scenario changed while the study was flown: ")
    assert "/delays.csv from " in line and "(start again without --resume)" in line
    with pytest.raises(InputError, match=r"a file of a scenario changed .*/delays.csv from "):
        sweep(study, tmp_path / "two.parquet", resume=True)
