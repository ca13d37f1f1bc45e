"""The page of an assessment, made of its document."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from testbed.reports.html import (
    Page,
    PageSection,
    download_link,
    rows_to_html,
    text_table_to_html,
)

Row = Mapping[str, Any]
MISSING = "–"
TITLES = {
    "nominal": "as in the scenario",
    "margins": "margins",
    "loss": "lost messages",
    "delay": "delay of messages",
    "wind": "wind",
    "turbulence": "turbulence, wind at 20 ft",
    "gps": "errors of GPS",
    "airspeed": "errors of airspeed",
    "engine-out": "engine out",
    "gps-lost": "GPS lost",
    "airspeed-blocked": "pitot tube blocked",
    "surface-stuck": "aileron or left elevon stuck",
    "leader-silent": "leader silent",
    "radio-cut": "no messages at all",
}
CONDITIONS = ("loss", "delay", "wind", "turbulence", "gps", "airspeed")
FAULTS = ("engine-out", "gps-lost", "airspeed-blocked", "surface-stuck")
OUTAGES = ("leader-silent", "radio-cut")
_UNITS = {"loss": " %", "delay": " s", "wind": " m/s", "turbulence": " m/s"}
_SHORT_STYLE = ' class="red bold"'
_LONGEST_LINE, _ONE_LINE, _WIDE = 30, "white-space: nowrap", "min-width: 15rem"


def assessment_page(found: Row) -> Page:
    """Make the page of an assessment.

    Args:
        found: its document.
    """
    rows = found["rows"]
    return Page(
        title=f"{found['scenario']}: {found['verdict']}",
        head=_head(found),
        sections=(
            PageSection("nominal", "As in the scenario", _nominal(rows)),
            PageSection("margins", "Margins", _margins(found)),
            PageSection("conditions", "What it bears", _conditions(found)),
            PageSection("faults", "Faults and outages", _faults(rows)),
            PageSection("energy", "Battery and time", _energy(found)),
            PageSection("limits", "Limits reached first", _limits(rows)),
            PageSection("parameters", "Parameters and gains of these flights", _parameters(found)),
            PageSection("unsaid", "What no simulation here says", _not_said(found)),
            PageSection("repeat", "To repeat", _repeat(found)),
        ),
        footer=f"Made by {found['code']}.",
    )


def row_lines(found: Row) -> Iterator[str]:
    """Yield a line for each row, for a terminal."""
    rows = found["rows"]
    if "nominal" in rows:
        yield f"{TITLES['nominal']:<28}{_kept(rows['nominal'])}"
    for case, each in _margin_followers(rows):
        cells = (f"{_case(case)}, {each['name']}", _factor(each), _phase(each))
        yield f"{cells[0]:<28}{', '.join(cells[1:])}"
    for name in CONDITIONS:
        if name in rows:
            row = rows[name]
            median = f", median flight breaks at {_breaks(name, row)}" if row.get("breaks") else ""
            other = f", other seeds {_others(name, row)}" if row.get("others") else ""
            yield f"{TITLES[name]:<28}{_value(name, row)}{other}{median}"
    for name in (*FAULTS, *OUTAGES):
        for flight in rows.get(name, {}).get("flights", ()):
            of = f" of {flight['failed']}" if flight["failed"] else ""
            does = flight.get("does", {})
            text = "; ".join(f"{one}: {what}" for one, what in does.items())
            yield f"{TITLES[name] + of:<27} {flight['problem'] or text}"


def _head(found: Row) -> str:
    verdict = found["verdict"]
    style = {"go": "completed", "no-go": "lost"}.get(verdict, "")
    out = [f"<h1>{escape(found['scenario'])}</h1>"]
    if found["question"]:
        out.append(f'<p class="question">{escape(found["question"])}</p>')
    flown = " · ".join(map(escape, found["flown"]))
    out.append(f'<p class="meta"><span class="outcome {style}">{verdict}</span> {flown}</p>')
    seeds = f"{found['first_seed']} to {found['first_seed'] + found['flights'] - 1}"
    out.append(
        f"<p>Flights with {found['flights']} seeds, {seeds}, keep the criteria where nothing else "
        "is said:</p>"
    )
    out.append(f"<ul>{''.join(f'<li>{escape(each)}</li>' for each in found['criteria'])}</ul>")
    if found["short"]:
        items = "".join(
            f"<li><b>{escape(TITLES.get(each['row'], each['row']))}</b>: "
            f"{escape(_plain(each['text']))}</li>"
            for each in found["short"]
        )
        out.append(f"<p><b>Short:</b></p><ul>{items}</ul>")
    elif verdict == "go":
        out.append("<p>Nothing is short.</p>")
    if harmful := list(_harmful(found["rows"])):
        out.append(
            f"<p><b>Faults that harm aircraft without a fault:</b> {escape(', '.join(harmful))}; "
            '<a href="#faults">below</a>.</p>'
        )
    return "".join(out)


def _harmful(rows: Row) -> Iterator[str]:
    """Name the faults and outages after which aircraft without a fault are lost, or too far."""
    for name in (*FAULTS, *OUTAGES):
        for flight in rows.get(name, {}).get("flights", ()):
            if flight.get("what"):
                yield f"{TITLES[name]} of {flight['failed']}" if flight["failed"] else TITLES[name]


def _kept(row: Row) -> str:
    if row.get("problem"):
        return str(row["problem"])
    if row["flights"] == 1:
        return "kept; no seed changes it" if row["kept"] else "not kept; no seed changes it"
    return f"{row['kept']} of {row['flights']} flights"


def _nominal(rows: Row) -> str:
    row = rows.get("nominal")
    if row is None:
        return ""
    facts = [("criteria kept", _kept(row))]
    if not row.get("problem"):
        facts += [
            ("smallest separation", _number(row["separation_m"], " m, seed ") + _seed(row)),
            *(
                (f"largest error, {name}", f"{value:.2f} m RMS")
                for name, value in row["largest_rms_m"].items()
            ),
            ("largest bank of the leader", _number(row["bank_deg"], "°", 0)),
            ("climb and descent", f"{row['climb_mps']:.1f} and {row['sink_mps']:.1f} m/s"),
        ]
    for each in row.get("broken", ()):
        facts.append((f"seed {each['seed']}", _plain(each["why"])))
    command = row["broken"][0]["command"] if row.get("broken") else row["command"]
    return rows_to_html(facts) + _command(command)


def _seed(row: Row) -> str:
    return str(row["separation_seed"]) if row["separation_m"] is not None else ""


def _number(value: float | None, unit: str, digits: int = 2) -> str:
    return MISSING if value is None else f"{value:.{digits}f}{unit}"


def _case(case: Row) -> str:
    if case["bank_deg"]:
        return f"turn, {case['bank_deg']:.0f}°"
    if case["climb_mps"]:
        kind = "climb" if case["climb_mps"] > 0 else "descent"
        return f"{kind}, {abs(case['climb_mps']):.1f} m/s"
    return "straight"


def _margin_followers(rows: Row) -> Iterator[tuple[Row, Row]]:
    for case in rows.get("margins", {}).get("cases", ()):
        for each in case.get("followers", ()):
            yield case, each


def _factor(each: Row) -> str:
    return f"{_limited(each['factor'], 10, 2)} on {each['factor_of']}"


def _phase(each: Row) -> str:
    return f"{_limited(each['phase_deg'], 180, 0)}° on {each['phase_of']}"


def _limited(value: float | None, largest: float, digits: int) -> str:
    return f"> {largest:g}" if value is None else f"{value:.{digits}f}"


def _margins(found: Row) -> str:
    row, least = found["rows"].get("margins"), found["least_margins"]
    if row is None:
        return ""
    headings = ("flight", "follower", "damping ratio", "factor", "phase", "latency")
    body, notes = [], dict[str, None]()
    for case in row["cases"]:
        problem = case.get("not_predicted") or case.get("problem")
        if problem:
            text = f"not predicted: {problem}"
            is_short = bool(case.get("problem"))
            body.append(_cells(_case(case)) + _cells(text, short=is_short) + _cells("", "", "", ""))
        if case.get("flown_with"):
            notes[case["flown_with"]] = None
        for each in case.get("followers", ()):
            known = {name: each[name] for name in least if each[name] is not None}
            short = {name: value < least[name] for name, value in known.items()}
            short["damping"] = known.get("damping", 1.0) <= least["damping"]
            body.append(
                _cells(_case(case), each["name"])
                + _cells(_limited(each["damping"], 1, 3), short=short["damping"])
                + _cells(_factor(each), short=short.get("factor", False))
                + _cells(_phase(each), short=short.get("phase_deg", False))
                + _cells(f"{_limited(each['latency_s'], 1, 2)} s")
            )
    text = (
        "Of each follower the least factor, phase and additional latency of pitch, roll and "
        "throttle at which its oscillations no longer decay, predicted. Short are a damping ratio "
        f"of 0 or less, a factor below {least['factor']:g} and a phase below "
        f"{least['phase_deg']:g}°."
    )
    note = "".join(f" Flown {escape(each)}." for each in notes)
    commands = "\n".join(case["command"] for case in row["cases"] if case.get("command"))
    return f"<p>{text}{note}</p>{text_table_to_html(headings, body)}" + _command(commands)


def _cells(*texts: str, short: bool = False) -> str:
    """Make cells; short texts stay on one line, so that a narrow screen scrolls."""
    style = _SHORT_STYLE if short else ""
    widths = [_ONE_LINE if len(text) <= _LONGEST_LINE else _WIDE for text in texts]
    return "".join(
        f'<td{style} style="{width}">{escape(text)}</td>'
        for text, width in zip(texts, widths, strict=True)
    )


def _value(name: str, row: Row) -> str:
    if row.get("problem"):
        return f"not flown: {row['problem']}"
    if row["value"] is None:
        return "no value"
    at_least = "≥ " if row["largest_tried"] else ""
    return f"{at_least}{_in_unit(name, row['value'])}{_UNITS.get(name, ' ×')}"


def _others(name: str, row: Row) -> str:
    if row.get("others") is None:
        return MISSING
    return " to ".join(_in_unit(name, each) for each in row["others"])


def _breaks(name: str, row: Row) -> str:
    if row.get("breaks") is None:
        return MISSING
    return f"{_in_unit(name, row['breaks'])}{_UNITS.get(name, ' ×')}"


def _in_unit(name: str, value: float) -> str:
    return f"{100.0 * value:.3g}" if name == "loss" else f"{value:.3g}"


def _conditions(found: Row) -> str:
    rows = {name: found["rows"][name] for name in CONDITIONS if name in found["rows"]}
    if not rows:
        return ""
    body, commands = [], []
    for name, row in rows.items():
        weakest, why = row.get("weakest"), row.get("skipped", "")
        if weakest:
            at = f"{_in_unit(name, weakest['value'])}{_UNITS.get(name, ' ×')}"
            seed = f"seed {weakest['seed']} " if row["seeds"] > 1 else ""
            why = f"{seed}at {at}: {_plain(weakest['why'])}"
            commands.append(f"# {TITLES[name]}, {seed}at {at}\n{weakest['command']}")
        flights = f"{row['flights']} of {_seeds(row)}" if row.get("flights") else "none"
        body.append(
            _cells(TITLES[name])
            + _cells(_value(name, row), short=row.get("value") is None)
            + _cells(_others(name, row), _breaks(name, row), why)
            + _cells(row.get("flown_with", ""), flights)
        )
        commands.append(row["command"])
    headings = (
        *("condition", "largest with all seeds", "other seeds", "median flight breaks at"),
        *("what breaks first", "flown with", "flights"),
    )
    count = found["flights"]
    share = 100.0 * 0.05 ** (1.0 / count)
    text = (
        f"The largest value of each condition alone at which the flights of all {count} seeds keep "
        f"the criteria: {share:.0f} % of all flights do, with 95 % confidence. Other seeds: "
        "between which values that of another set of seeds is, at least a step of the search "
        "either way. Where no seed changes a flight, one is flown."
    )
    return f"<p>{text}</p>{text_table_to_html(headings, body)}" + _command("\n".join(commands))


_KEY = re.compile(r"expect\.(\w+)[\w.-]*: ")  # of a violated bound


def _plain(why: str) -> str:
    """Return why a flight does not keep its criteria, of bounds with the quantity alone."""
    return _KEY.sub(r"\1: ", why)


def _seeds(row: Row) -> str:
    return f"{row['seeds']} seed{'s' * (row['seeds'] != 1)}"


def _faults(rows: Row) -> str:
    found = [(name, rows[name]) for name in (*FAULTS, *OUTAGES) if name in rows]
    if not found:
        return ""
    flights = [flight for _, row in found for flight in row.get("flights", ())]
    names = next((list(each["does"]) for each in flights if "does" in each), [])
    body, commands, notes = [], [], []
    for name, row in found:
        if row.get("problem"):
            body.append(_cells(TITLES[name], "", f"not flown: {row['problem']}"))
        if row.get("flown_with"):
            notes.append(f"{TITLES[name]}: {row['flown_with']}.")
        for flight in row.get("flights", ()):
            if flight["problem"]:
                body.append(
                    _cells(TITLES[name], flight["failed"], f"not flown: {flight['problem']}")
                )
                continue
            does = [flight["does"].get(each, "") for each in names]
            between = " and ".join(flight["between"] or ())
            separation = _number(flight["separation_m"], f" m, {between}", 1)
            body.append(
                _cells(TITLES[name], flight["failed"])
                + "".join(_cells(each, short="lost" in each) for each in does)
                + _cells(separation)
                + _cells(flight["what"], short=True)
            )
            commands.append(flight["command"])
    headings = ("fault", "of", *names, "smallest separation", "aircraft without a fault")
    at_s = next((row["at_s"] for _, row in found if "at_s" in row), 0.0)
    text = (
        f"Each fault and each outage alone, from {at_s:g} s to the end, one flight. They do not "
        "decide the verdict. Metres are the largest distance from the slot after the beginning; "
        "back: within 5 m of it again."
    )
    note = escape(" ".join(["", *notes]))
    return f"<p>{text}{note}</p>{text_table_to_html(headings, body)}" + _command(
        "\n".join(commands)
    )


def _energy(found: Row) -> str:
    rows = [(each["aircraft"], each["text"]) for each in found["energy"]]
    return rows_to_html(rows) if rows else ""


def _limits(rows: Row) -> str:
    limits = rows.get("nominal", {}).get("limits", ())
    if not limits:
        return ""
    body = (
        _cells(
            each["limit"],
            each["aircraft"],
            f"{each['value']:.3g} {each['unit']}",
            f"{each['bound']:.3g} {each['unit']}",
            f"{100.0 * each['used']:.0f} %",
        )
        for each in limits
    )
    headings = ("limit", "aircraft", "in this flight", "limit is", "used")
    return "<p>Of one flight as in the scenario.</p>" + text_table_to_html(headings, body)


def _parameters(found: Row) -> str:
    out = []
    for each in found["parameters"]:
        names = ", ".join(each["aircraft"][:6])
        out.append(f"<h3>{escape(each['file'])}: {escape(names)}</h3>")
        link = download_link(each["file"].rpartition("/")[2], "text/plain", each["text"].encode())
        out.append(f'<p class="screen">{link}</p>')
        if each["differences"]:
            items = "".join(f"<li>{escape(text)}</li>" for text in each["differences"])
            count = len(each["differences"])
            out.append(
                f"<details><summary>{count} differ{'s' * (count == 1)} from the aircraft's file"
                f"</summary><ul>{items}</ul></details>"
            )
        else:
            out.append("<p>As in the aircraft's file.</p>")
    for each in found["compared"]:
        names, count = ", ".join(each["aircraft"][:6]), len(each["differences"])
        out.append(f"<h3>{escape(each['file'])}, as given: {escape(names)}</h3>")
        if count:
            items = "".join(f"<li>{escape(text)}</li>" for text in each["differences"])
            out.append(
                f"<p>{count} of these flights differ{'s' * (count == 1)}:</p><ul>{items}</ul>"
            )
        else:
            out.append("<p>All parameters of these flights are those of the file.</p>")
    return "".join(out)


def _not_said(found: Row) -> str:
    return f"<ul>{''.join(f'<li>{escape(each)}</li>' for each in found['not_said'])}</ul>"


def _repeat(found: Row) -> str:
    seconds = f"<p>It took {found['cpu_s']:.0f} s of one processor.</p>"
    return f"<pre>{escape(found['command'])}</pre>{seconds}"


def _command(text: str) -> str:
    if not text:
        return ""
    lines = text.count("\n") + 1
    summary = "Command" if lines == 1 else "Commands"
    return f"<details><summary>{summary}</summary><pre>{escape(text)}</pre></details>"
