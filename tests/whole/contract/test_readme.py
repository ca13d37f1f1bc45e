"""README and docs: snippets run, pasted output matches, links lead somewhere.

TESTBED_DOCS=1 also runs the snippets of pages that take long.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import pytest
from cases import ALL, some
from commands import environment
from places import ROOT
from shells import run_shell, write_program
from small_study import in_this_process

from testbed.scenario import find_scenario, list_scenarios, loads

PAGES = (
    "README.md",
    "SECURITY.md",
    *sorted(
        path.relative_to(ROOT).as_posix()
        for folder in ("docs", "paper")
        for path in (ROOT / folder).rglob("*.md")
    ),
)
CONDITIONAL = "network", "estimate", "estimated_error", "law"  # topics of some logs only
# Pages whose snippets fly, draw or step for long; tests of their commands cover much of the same.
LONG = (
    "docs/aircraft.md",
    "docs/air.md",
    "docs/autopilot.md",
    "docs/export.md",
    "docs/from-a-log.md",
    "docs/network.md",
    "docs/own-aircraft.md",
)
# Of these, which take half a second or more, some are run.
DRAWN = (
    *("docs/ci.md", "docs/from-python.md", "docs/large.md", "docs/link.md", "docs/own-law.md"),
    *("docs/rl.md", "docs/scenarios.md", "docs/tune.md"),
)
# Duration of flights in shell snippets, s; long where output of a flight is pasted.
SHORT_S, LONG_S = 15.0 if ALL else 4.0, 100.0
PAGES_WITH_FLIGHT_OUTPUT = (
    "docs/air.md",
    "docs/export.md",
    "docs/from-a-log.md",
    "docs/run.md",
)
BLOCK = re.compile(r'^```(\w+)(?: title="([\w./-]+)")?\n(.*?)^```$', re.M | re.S)

# A `testbed` that ends flights early, checks one seed and needs no viewer. Options added at the
# end override those of the snippet. `view` runs in its own process; every other command is passed
# to the test process, which has the testbed loaded.
WRAPPER = """#!/bin/sh
case "$*" in
  run*) set -- "$@" --duration "$TESTBED_RUN_S" ;;
  air*) [ "$TESTBED_RUN_S" = {long_s:g} ] || set -- "$@" --duration 20 ;;
  check*) set -- "$@" --seeds 1 ;;
  view*--rrd*) ;;
  view*) set -- "$@" --rrd "$(mktemp -u).rrd" ;;
esac
for word do
  shift
  [ "$word" = --view ] || set -- "$@" "$word"
done
[ "$1" = view ] && exec "{python}" -m testbed "$@"
exec "{client}" "$@"
"""


@dataclass(frozen=True)
class Snippet:
    page: str
    line: int
    kind: str
    file: str | None  # the file to save it as
    text: str
    output: str | None  # the text block that follows directly

    def __str__(self):
        return f"{self.page}:{self.line}"


def snippets(page: str) -> list[Snippet]:
    text = (ROOT / page).read_text(encoding="utf-8")
    found = list(BLOCK.finditer(text))
    return [
        Snippet(
            page,
            text[: block.start()].count("\n") + 1,
            *block.groups(),
            after[3] if after and after[1] == "text" and adjacent(text, block, after) else None,
        )
        for block, after in zip_longest(found, found[1:])
    ]


def adjacent(text, block, after):
    """Return whether no prose stands between two blocks."""
    return not text[block.end() : after.start()].strip()


ALL_SNIPPETS = [snippet for page in PAGES for snippet in snippets(page)]
SHELL = [s for s in ALL_SNIPPETS if s.kind == "sh" and not s.text.startswith("make ")]
PYTHON = [s for s in ALL_SNIPPETS if s.kind == "python" and not s.file]
FILES = [s for s in ALL_SNIPPETS if s.file]
PAGES_TO_RUN = [
    pytest.param(
        page,
        marks=pytest.mark.skipif(
            page in LONG and not os.environ.get("TESTBED_DOCS"),
            reason="a page that takes long: TESTBED_DOCS=1",
        ),
    )
    for page in PAGES
    if any(snippet.page == page for snippet in SHELL + PYTHON)
    if page not in DRAWN or page in some(DRAWN, 1)
    if page != "docs/margins.md" or ALL  # its commands are those of tests of linear systems
]
TOUR = ("## Simulation 3, key by key", "## Extend a scenario")  # a section and the next one
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def new_folder(tmp_path_factory):
    """Return a function that makes a folder like a checkout's, for the snippets of one page."""

    def make():
        folder = tmp_path_factory.mktemp("page")
        for name in ("tests", "aircraft"):
            (folder / name).symlink_to(ROOT / name)
        (folder / "bin").mkdir()
        client = folder / "bin" / "client.py"
        write_program(client)
        wrapper = WRAPPER.format(long_s=LONG_S, python=sys.executable, client=client)
        write_program(folder / "bin" / "testbed", wrapper)
        write_program(folder / "bin" / "python", f'#!/bin/sh\nexec "{sys.executable}" "$@"\n')
        return folder

    return make


def shell(folder, text, run_s=LONG_S):
    """Run a shell snippet, its `testbed` commands in this process; return what it prints."""
    variables = environment(80) | {
        "PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "TESTBED_RUN_S": f"{run_s:g}",
    }
    with in_this_process():
        code, printed = run_shell(("bash", "-euc", text), cwd=folder, env=variables)
    assert code == 0, printed
    return trimmed(printed)


def run_python(folder, text, namespace):
    """Run a Python snippet in this process after those before it; return what it prints."""
    output = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(output), in_this_process():
        exec(compile(text, "snippet", "exec"), namespace)
    return trimmed(output.getvalue())


def trimmed(text: str) -> str:
    return "\n".join(line.rstrip() for line in text.strip().splitlines())


@pytest.mark.parametrize("page", PAGES_TO_RUN)
def test_snippets_in_order_print_their_output(page, new_folder):
    folder = new_folder()
    on_page = [snippet for snippet in SHELL + PYTHON + FILES if snippet.page == page]
    run_s = LONG_S if page in PAGES_WITH_FLIGHT_OUTPUT else SHORT_S
    namespace = {"__name__": "__main__"}
    for snippet in sorted(on_page, key=lambda s: s.line):
        if snippet.file:
            (folder / snippet.file).parent.mkdir(exist_ok=True)
            (folder / snippet.file).write_text(snippet.text, encoding="utf-8")
            continue
        if snippet.kind == "sh":
            printed = shell(folder, snippet.text, run_s)
        else:
            printed = run_python(folder, snippet.text, namespace)
        if snippet.output is not None:
            assert printed == trimmed(snippet.output), snippet


@pytest.fixture(scope="module")
def simulation_3(new_folder):
    """The flight whose table the README shows: printed output and log."""
    folder = new_folder()
    printed = shell(folder, "testbed run simulation-3 --out shown")
    return printed, (folder / "shown" / "run.mcap").read_bytes()


def test_log_topics_named_in_docs_exist(simulation_3):
    _, log = simulation_3
    text = (ROOT / "docs/run.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(/(?:<name>/)?\w+)`", text))
    assert len(named) >= 5
    conditional = {"/events", *(f"/<name>/{each}" for each in CONDITIONAL)}
    for topic in named - conditional:
        assert topic.replace("<name>", "uav1").encode() in log, topic


def test_pages_have_snippets_with_output():
    assert len(SHELL) >= 6 and len(PYTHON) >= 2
    assert sum(s.output is not None for s in SHELL + PYTHON) >= 4


@pytest.mark.parametrize("page", PAGES)
def test_no_sentence_is_twice_in_a_page(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    prose = re.sub(r"```.*?```|<!--.*?-->", "", text, flags=re.S)
    parts = [" ".join(each.split()) for each in re.split(r"(?<=[.!?:])\s|\n\n|\|", prose)]
    long = [each for each in parts if len(each) > 60]
    assert sorted(set(long)) == sorted(long)


def test_make_commands_in_docs_exist():
    rules = "\n".join((ROOT / each).read_text() for each in ("Makefile", "paper/targets.mk"))
    targets = set(re.findall(r"^(\w[\w-]*):", rules, re.M))
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        for name in re.findall(r"(?:^(?:\$ )?|`)make (\w[\w-]*)", text, re.M):
            assert name in targets, (page, name)


def test_key_by_key_tour_quotes_the_scenario():
    page = "docs/own-scenario.md"
    scenario = find_scenario("simulation-3").read_text(encoding="utf-8")
    lines = [line.split(" # ")[0].strip() for line in scenario.splitlines()]
    text = (ROOT / page).read_text(encoding="utf-8")
    tour = range(*(text[: text.index(f"\n{title}")].count("\n") for title in TOUR))
    quoted = [s for s in snippets(page) if s.kind == "yaml" and s.line in tour]
    assert len(quoted) >= 4
    for snippet in quoted:
        for line in snippet.text.splitlines():
            assert line.strip() in lines, (snippet, line)


def test_pasted_table_has_the_printed_headings(simulation_3):
    printed, _ = simulation_3
    pasted = next(s.text for s in snippets("README.md") if " follower " in s.text)
    headings = [
        line
        for line in printed.splitlines()
        if line.startswith((" follower", " RMS", " saturated"))
    ]
    assert len(headings) == 3
    # columns are as wide as their numbers, which a short flight has smaller
    words = [line.split() for line in pasted.splitlines()]
    assert headings[1].split() in words and headings[2].split() in words
    assert headings[0].split()[:3] == ["RMS", "error,", "m"]


@pytest.mark.skipif(not os.environ.get("TESTBED_DOCS"), reason="a whole flight: TESTBED_DOCS=1")
def test_pasted_table_is_that_of_a_whole_flight(new_folder):
    """Every number but the time that it took."""
    printed = shell(new_folder(), "testbed run simulation-3 --out shown", run_s=1080.0)
    pasted = next(s.text for s in snippets("README.md") if " follower " in s.text)

    def words(text):
        lines = [line.split() for line in text.splitlines()]
        return [line for line in lines if line and line[0] not in ("simulation-3", "log")]

    assert words(printed) == words(pasted)


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as GitHub forms them."""
    titles = re.findall(r"^#+ (.*)$", BLOCK.sub("", page.read_text(encoding="utf-8")), re.M)
    return {re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings(page):
    text = BLOCK.sub("", (ROOT / page).read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if link.startswith("https://"):
            continue
        file, _, anchor = link.partition("#")
        target = (ROOT / page).parent / file if file else ROOT / page
        assert target.exists(), link
        assert not anchor or anchor in anchors(target), link


def test_readme_picture_is_a_short_loop():
    picture = (ROOT / "docs/images/formation.gif").read_bytes()
    assert picture.startswith(b"GIF89a") and b"NETSCAPE2.0" in picture[:2000]
    assert len(picture) < 2_000_000
    assert "docs/images/formation.gif" in README


def test_scenarios_in_docs_and_package_agree():
    """Named scenarios exist, and docs/scenarios.md names every one."""
    known = set(list_scenarios())
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        named = set(re.findall(r"(?<!#)\bsimulation-3(?:-[a-z0-9]+)*\b(?![./])", text))
        assert named <= known, (page, named - known)
    listed = (ROOT / "docs/scenarios.md").read_text(encoding="utf-8")
    assert known <= set(re.findall(r"`([\w-]+)`", listed))


def test_readme_example_loads_as_a_scenario():
    scenario = loads(next(s.text for s in FILES if s.file == "bad-radio.yaml"))
    assert scenario.network.delay_s == 0.25
    assert scenario.scenario.published is None
