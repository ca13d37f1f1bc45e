"""The pages for people: their snippets run, what they paste is what comes out, their links lead.

TESTBED_DOCS=1: the snippets of pages that take long, too.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import socket
import stat
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

import pytest
from commands import call, environment
from patience import PATIENCE_S

from testbed.scenario import find_scenario, list_scenarios, loads

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    "docs/simulations.md",
    "docs/experiments.md",
    "docs/gap.md",
    "docs/speed.md",
    "docs/autopilot.md",
    "docs/aircraft.md",
    "docs/air.md",
    "docs/network.md",
    "docs/sensors.md",
    "docs/faults.md",
    "docs/mavlink.md",
    "docs/arduplane.md",
    "docs/formation.md",
    "docs/own-law.md",
    "docs/check.md",
    "docs/studies.md",
    "docs/study-report.md",
    "docs/tune.md",
    "docs/export.md",
    "docs/report.md",
    "docs/view.md",
    "docs/index.md",
    "docs/tutorial.md",
    "docs/own-scenario.md",
    "docs/large.md",
    "docs/own-aircraft.md",
    "docs/run.md",
    "docs/ci.md",
    "docs/supply-chain.md",
    "SECURITY.md",
    "docs/physics.md",
    "docs/reference/commands.md",
    "docs/reference/scenario.md",
    "docs/reference/python.md",
    "docs/reference/equations.md",
)
# Their snippets fly, draw or step for long, and tests of their commands show much of the same.
LONG = (
    "docs/aircraft.md",
    "docs/air.md",
    "docs/autopilot.md",
    "docs/export.md",
    "docs/network.md",
    "docs/own-aircraft.md",
)
UAVS = ("uav1", "uav2", "uav3")
# Where flights of the shell snippets end: what is pasted of a flight needs the laps to have begun.
GLANCE_S, SHOWN_S = 15.0, 100.0
PASTED_FROM_FLIGHTS = ("docs/air.md", "docs/export.md", "docs/run.md")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.M | re.S)

# A `testbed` that ends flights early, checks with one seed and needs no viewer. The last of two
# options counts, so what it adds wins over what a snippet says. The viewer gets a process of its
# own; all else is handed, one at a time, to the one that runs the tests, which has it loaded.
STAND_IN = """#!/bin/sh
case "$*" in
  run*) set -- "$@" --duration "$TESTBED_SHOWN_S" ;;
  air*) [ "$TESTBED_SHOWN_S" = {shown_s:g} ] || set -- "$@" --duration 20 ;;
  check*) set -- "$@" --seeds 1 ;;
  view*--rrd*) ;;
  view*) set -- "$@" --rrd "$(mktemp -u).rrd" ;;
esac
for word do
  shift
  [ "$word" = --view ] || set -- "$@" "$word"
done
[ "$1" = view ] && exec "{python}" -m testbed "$@"
exec "{python}" -IS "{hand_over}" "$@"
"""
HAND_OVER = """
import json, os, socket, sys
line = socket.socket(fileno=int(os.environ["TESTBED_LINE"]))
socket.send_fds(line, [json.dumps([os.getcwd(), sys.argv[1:]]).encode()], [1, 2])
sys.exit(int(line.recv(16)))
"""


@dataclass(frozen=True)
class Snippet:
    page: str
    line: int
    kind: str
    text: str
    output: str | None  # the text block that follows, if it is the next thing but one paragraph

    def __str__(self):
        return f"{self.page}:{self.line}"


def snippets(page: str) -> list[Snippet]:
    text = (ROOT / page).read_text(encoding="utf-8")
    found = list(BLOCK.finditer(text))
    return [
        Snippet(
            page,
            text[: block.start()].count("\n") + 1,
            block[1],
            block[2],
            after[2] if after and after[1] == "text" and not gap(text, block, after) else None,
        )
        for block, after in zip_longest(found, found[1:])
    ]


def gap(text, block, after):
    """Whether there is prose between two blocks."""
    return text[block.end() : after.start()].strip()


EVERY = [snippet for page in PAGES for snippet in snippets(page)]
SHELL = [s for s in EVERY if s.kind == "sh" and not s.text.startswith("make ")]
PYTHON = [s for s in EVERY if s.kind == "python"]
RUN = [
    pytest.param(
        page,
        marks=pytest.mark.skipif(
            page in LONG and not os.environ.get("TESTBED_DOCS"),
            reason="a page that takes long: TESTBED_DOCS=1",
        ),
    )
    for page in PAGES
    if any(snippet.page == page for snippet in SHELL + PYTHON)
]
TOUR = ("The first scenario, key by key", "Your own scenario")  # the part, and the next
README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def new_desk(tmp_path_factory):
    """Makes folders like a fresh checkout's, in which snippets run one after the other."""

    def make():
        folder = tmp_path_factory.mktemp("desk")
        for name in ("tests", "aircraft"):
            (folder / name).symlink_to(ROOT / name)
        (folder / "bin").mkdir()
        hand_over = folder / "bin" / "hand_over.py"
        hand_over.write_text(HAND_OVER)
        command = folder / "bin" / "testbed"
        command.write_text(
            STAND_IN.format(shown_s=SHOWN_S, python=sys.executable, hand_over=hand_over)
        )
        command.chmod(command.stat().st_mode | stat.S_IXUSR)
        return folder

    return make


def in_a_shell(folder, text, shown_s=SHOWN_S):
    """What a snippet prints whose commands this process carries out, and bash all else."""
    ours, theirs = socket.socketpair()
    with ours, tempfile.TemporaryFile("w+") as paper:
        ours.settimeout(PATIENCE_S)
        surroundings = environment(80) | {
            "PATH": f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}",
            "TESTBED_LINE": str(theirs.fileno()),
            "TESTBED_SHOWN_S": f"{shown_s:g}",
        }
        shell = subprocess.Popen(
            ("bash", "-euc", text),
            cwd=folder,
            env=surroundings,
            stdout=paper,
            stderr=paper,
            pass_fds=[theirs.fileno()],
        )
        try:
            theirs.close()
            while True:  # until everybody at the other end has gone
                asked, papers, *_ = socket.recv_fds(ours, 65536, 2)
                if not asked:
                    break
                cwd, arguments = json.loads(asked)
                with open(papers[0], "w") as out, open(papers[1], "w") as err:
                    code = call(arguments, cwd=cwd, columns=80, out=out, err=err)
                ours.sendall(str(code).encode())
            shell.wait(timeout=PATIENCE_S)
        finally:
            shell.kill()
            shell.wait()
        paper.seek(0)
        printed = paper.read()
    assert shell.returncode == 0, printed
    return trimmed(printed)


def in_python(folder, text):
    """What a snippet prints in this process, as a module of its own."""
    paper = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(paper):
        exec(compile(text, "snippet", "exec"), {"__name__": "__main__"})
    return trimmed(paper.getvalue())


def trimmed(text: str) -> str:
    return "\n".join(line.rstrip() for line in text.strip().splitlines())


@pytest.mark.parametrize("page", RUN)
def test_every_snippet_runs_in_reading_order_and_prints_what_is_pasted(page, new_desk):
    desk = new_desk()
    ours = [snippet for snippet in SHELL + PYTHON if snippet.page == page]
    shown_s = SHOWN_S if page in PASTED_FROM_FLIGHTS else GLANCE_S
    for snippet in sorted(ours, key=lambda s: s.line):
        if snippet.kind == "sh":
            printed = in_a_shell(desk, snippet.text, shown_s)
        else:
            printed = in_python(desk, snippet.text)
        if snippet.output is not None:
            assert printed == trimmed(snippet.output), snippet


@pytest.fixture(scope="module")
def shown(new_desk):
    """The flight the README shows: what is printed, and its log."""
    desk = new_desk()
    printed = in_a_shell(desk, "testbed run simulation-3 --out shown")
    return printed, (desk / "shown" / "run.mcap").read_bytes()


def test_the_topics_named_are_logged(shown):
    _, log = shown
    named = set(re.findall(r"`(/(?:<name>/)?\w+)`", README))
    assert len(named) >= 5
    later = {"/events", "/<name>/network", "/<name>/estimate", "/<name>/believed"}
    for topic in named - later:  # there once something has happened, or nothing is exact
        assert topic.replace("<name>", "uav1").encode() in log, topic


def test_there_is_something_to_run():
    assert len(SHELL) >= 6 and len(PYTHON) >= 2
    assert sum(s.output is not None for s in SHELL + PYTHON) >= 4


def test_commands_of_make_exist():
    targets = set(re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(), re.M))
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        named = {name for name in re.findall(r"^make (\w+)|`make (\w+)`", text, re.M)}
        for name in {first or second for first, second in named}:
            assert name in targets, (page, name)


def test_the_pages_parts_are_parts_of_the_scenario():
    page = find_scenario("simulation-3").read_text(encoding="utf-8")
    lines = [line.split(" # ")[0].strip() for line in page.splitlines()]
    tour = range(*(README[: README.index(f"\n## {part}")].count("\n") for part in TOUR))
    quoted = [s for s in snippets("README.md") if s.kind == "yaml" and s.line in tour]
    assert len(quoted) >= 4
    for snippet in quoted:
        for line in snippet.text.splitlines():
            assert line.strip() in lines, (snippet, line)


def rows(text: str) -> dict[str, list[float]]:
    """The numbers of a printed or Markdown table by the first cell of their row."""
    table = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.split("|") if cell.strip()]
        words = line.split()
        if len(cells) > 6:
            table.setdefault(cells[0], cells[1:])
        elif words and re.fullmatch(r"uav\d", words[0]):
            table.setdefault(words[0], words[1:])
    return table


def test_the_pasted_errors_are_the_golden_ones():
    table = json.loads((ROOT / "scenarios/golden/simulation-3.json").read_text())["rows"]
    golden = {
        portion: [f"{table[f'rms_m/{portion}/{name}']['by_seed'][0]:.2f}" for name in UAVS]
        for portion in ("rectangles", "circles")
    }
    pasted = rows(README)
    for index, name in enumerate(UAVS):
        ours = [golden[portion][index] for portion in golden]
        assert [pasted[name][0], pasted[name][3]] == ours
    lines = (ROOT / "docs/simulations.md").read_text(encoding="utf-8").splitlines()
    third = next(k for k, line in enumerate(lines) if line.startswith("| Simulation 3 |"))
    results = rows("\n".join(lines[third:]))["profile `paper`"]
    assert results[:3] == golden["rectangles"]
    assert results[4:7] == golden["circles"]


def test_the_table_pasted_has_the_headings_that_are_printed(shown):
    printed, _ = shown
    pasted = next(s.text for s in snippets("README.md") if "engaged" in s.text)
    headings = [line for line in printed.splitlines() if line.startswith((" follower", " RMS"))]
    assert len(headings) == 2
    assert headings[1] in trimmed(pasted)
    assert headings[0].split()[:3] == ["RMS", "error,", "m"]


@pytest.mark.parametrize("page", PAGES)
def test_links_and_pictures_lead_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    assert links
    anchors = {
        re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-")
        for title in re.findall(r"^#+ (.*)$", text, re.M)
    }
    for link in links:
        if link.startswith("#"):
            assert link[1:] in anchors, link
        elif not link.startswith("https://"):
            assert ((ROOT / page).parent / link.partition("#")[0]).exists(), link


def test_the_picture_is_a_picture_of_a_sensible_size():
    picture = (ROOT / "docs/images/formation.png").read_bytes()
    assert picture.startswith(b"\x89PNG\r\n\x1a\n")
    assert len(picture) < 400_000
    assert "docs/images/formation.png" in README


def test_scenarios_named_in_the_pages_exist():
    known = set(list_scenarios())
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        named = set(re.findall(r"\bsimulation-3(?:-[a-z]+)*\b(?![./])", text))
        assert named <= known, (page, named - known)
    assert known <= set(re.findall(r"[\w-]+", README))


def test_the_page_of_ones_own_is_a_page():
    text = next(s.text for s in SHELL if "extends" in s.text)
    page = loads(text.split("<<'END'\n")[1].split("END\n")[0])
    assert page.network.delay_s == 0.25
    assert page.scenario.published is None
