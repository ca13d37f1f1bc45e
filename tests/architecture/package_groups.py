"""The packages of the testbed in groups: what each is for, and what it may import."""

from __future__ import annotations

import ast
from html import escape
from typing import NamedTuple

from places import ROOT

PACKAGE = ROOT / "testbed"
PAGE = ROOT / "docs" / "contributing" / "architecture.md"
PICTURE = ROOT / "docs" / "images" / "packages.svg"
BEGIN, END = "<!-- packages -->", "<!-- end of packages -->"


class Group(NamedTuple):
    """Packages of one kind."""

    name: str
    subject: str  # one sentence
    packages: dict[str, str]  # by name: the other packages that it imports, `core` included for all
    imports: str  # groups whose packages it may import, beside its own; "all": every one above it


OF_A_FLIGHT = (
    "atmosphere formation guidance network sensors autopilot vehicle ardupilot mavlink scenario"
)
GROUPS = (
    Group("core", "What every other package uses.", {"core": ""}, ""),
    Group("scenario", "The file that a user writes.", {"scenario": ""}, "core"),
    Group(
        "models",
        "Equations of the air, the formation, the radio, the sensors and the aircraft; no flight.",
        {
            "atmosphere": "",
            "formation": "",
            "guidance": "",
            "network": "scenario",
            "sensors": "scenario",
            "autopilot": "",
            "airframes": "",
            "vehicle": "airframes",
            "compiled": "airframes vehicle",
        },
        "core scenario",
    ),
    Group(
        "links",
        "Programs outside: ground stations, the real ArduPlane, a bad link between any two, and "
        "other co-simulations.",
        {
            "mavlink": "guidance",
            "ardupilot": "autopilot mavlink",
            "link": "mavlink network scenario",
            "fmi": "autopilot compiled formation scenario vehicle",
        },
        "core scenario models",
    ),
    Group(
        "record",
        "The log of a run and its numbers.",
        {"metrics": "formation", "logs": "scenario metrics"},
        "core scenario models",
    ),
    Group(
        "show",
        "Views and reports, made from a log without a flight.",
        {"views": "formation logs", "reports": "formation logs metrics scenario views"},
        "core scenario models record",
    ),
    Group(
        "flight",
        "A scenario becomes a flight, one or many at once.",
        {
            "flight": f"{OF_A_FLIGHT} metrics",
            "commands": "autopilot flight guidance mavlink scenario",
            "plan": f"{OF_A_FLIGHT} compiled commands flight fmi",
            "runs": "commands flight logs mavlink metrics plan scenario vehicle",
            "pool": "autopilot mavlink metrics plan runs scenario",
            "companion": "airframes flight formation link logs mavlink metrics plan pool scenario",
        },
        "core scenario models links record",
    ),
    Group(
        "analysis",
        "What is found out beside flights: probes, margins, aircraft and logs from elsewhere.",
        {
            "probes": "atmosphere flight network plan scenario vehicle",
            "linear": "airframes compiled flight formation network plan pool scenario",
            "commissioning": "airframes autopilot compiled flight formation plan scenario vehicle",
            "flight_logs": "formation guidance logs mavlink metrics plan scenario",
        },
        "core scenario models links record flight",
    ),
    Group(
        "campaigns",
        "Many flights with one question.",
        {
            "golden": "logs metrics plan pool runs scenario",
            "studies": "linear logs metrics plan pool runs scenario",
            "tuning": "linear logs metrics pool scenario studies",
            "assessment": "autopilot flight linear metrics plan pool runs scenario",
            "benchmark": "guidance linear metrics plan pool runs scenario tuning",
        },
        "core scenario models links record flight analysis",
    ),
    Group(
        "programs",
        "What users start.",
        {"rl": "commands flight runs scenario", "cli": "all"},
        "core scenario models links record show flight analysis campaigns",
    ),
)
PACKAGES = {name: group for group in GROUPS for name in group.packages}


def allowed(name: str) -> set[str]:
    """Return the packages that a package may import; of `core` and itself too."""
    words = PACKAGES[name].packages[name]
    found = set(PACKAGES) if words == "all" else set(words.split())
    return found | {"core", name}


def reachable(name: str) -> set[str]:
    """Return the packages that come with a package: those that it imports, and so on."""
    found, new = set(), {name}
    while new:
        found |= new
        new = {other for each in new for other in allowed(each)} - found
    return found


def subject(name: str) -> str:
    """Return what a package is for: the first sentence of its docstring."""
    text = (PACKAGE / name / "__init__.py").read_text("utf-8")
    return (ast.get_docstring(ast.parse(text)) or "").split("\n")[0].rstrip(".")


def table() -> str:
    """Return the table of the page."""
    lines = []
    for group in GROUPS:
        groups = f" Imports {', '.join(group.imports.split())}." if group.imports else ""
        lines += [f"**{group.name}**: {group.subject}{groups}", ""]
        lines += ["| package | subject | may import, beside core |", "|---|---|---|"]
        for name, words in group.packages.items():
            imports = {"": "–", "all": "everything"}.get(words, ", ".join(sorted(words.split())))
            place = f"../../testbed/{name}"
            what = subject(name)
            if (PACKAGE / name / "README.md").is_file():
                what = f"[{what}]({place}/README.md)"
            lines.append(f"| [{name}]({place}) | {what} | {imports} |")
        lines.append("")
    return "\n".join(lines).strip()


def page(text: str) -> str:
    """Return the page with the table."""
    begin, end = text.index(BEGIN) + len(BEGIN), text.index(END)
    return f"{text[:begin]}\n\n{table()}\n\n{text[end:]}"


def picture() -> str:
    """Return the groups as an SVG: each imports only groups below it."""
    width, row, left = 1080, 58, 132
    height = row * len(GROUPS) + 12
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" '
        'font-family="system-ui, sans-serif">',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for number, group in enumerate(reversed(GROUPS)):
        y = 8 + number * row
        parts.append(
            f'<rect x="6" y="{y}" width="{width - 12}" height="{row - 8}" rx="6" fill="#eef2f6"/>'
            f'<text x="18" y="{y + 31}" font-size="17" font-weight="600" fill="#1b2a3a">'
            f"{escape(group.name)}</text>"
        )
        x = left
        for name in group.packages:
            wide = 24 + 7.9 * len(name)
            parts.append(
                f'<rect x="{x:.0f}" y="{y + 9}" width="{wide:.0f}" height="32" rx="5" '
                'fill="#ffffff" stroke="#4a6078"/>'
                f'<text x="{x + wide / 2:.0f}" y="{y + 30}" font-size="15" text-anchor="middle" '
                f'fill="#1b2a3a">{escape(name)}</text>'
            )
            x += wide + 8
        assert x < width, group.name
    return "\n".join([*parts, "</svg>"]) + "\n"
