"""The page of a benchmark, made of its document."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

from testbed.reports.html import Page, PageSection, rows_to_html, text_table_to_html

Row = Mapping[str, Any]
MISSING = "–"
ALL = "all"
_ONE_LINE, _WIDE = "white-space: nowrap", "min-width: 14rem"
_LONGEST_LINE = 34


def benchmark_page(found: Row) -> Page:
    """Make the page of a benchmark.

    Args:
        found: its document.
    """
    conditions = found["conditions"]
    tables = {each["name"]: each for each in found["tables"]}
    return Page(
        title=conditions["benchmark"],
        head=_head(found),
        sections=(
            PageSection("ranks", "Ranks", _ranks(found, tables)),
            PageSection("numbers", "Numbers by task", _numbers(found, tables)),
            PageSection("tasks", "Each task", _tasks(found, tables)),
            PageSection("pairs", "Pairs", _pairs(found)),
            PageSection("entries", "Entries", _entries(found)),
            PageSection("meaning", "What the numbers are", _meaning(found)),
            PageSection("repeat", "To repeat", _repeat(found)),
        ),
        footer=f"Made by testbed {conditions['pins'].get('testbed', '')}.",
    )


def rank_text(row: Row) -> str:
    """Return a rank: one number, or the range in which nothing is claimed."""
    first, last = row["rank"], row["last_rank"]
    return str(first) if first == last else f"{first} to {last}"


def interval_text(row: Row) -> str:
    """Return the interval of a number."""
    if row["low_m"] is None:
        return MISSING
    return f"{row['low_m']:.2f} to {row['high_m']:.2f}"


def equal_text(row: Row) -> str:
    """Return the entries from which one shows no difference."""
    return ", ".join(row["equal"])


def row_lines(found: Row) -> Iterator[str]:
    """Yield a line for each entry, for a terminal."""
    tables = {each["name"]: each for each in found["tables"]}
    by_name = {each["name"]: each for each in found["entries"]}
    if ALL in tables:
        for row in tables[ALL]["standings"]:
            entry = by_name[row["entry"]]
            cells = (
                f"{rank_text(row):<8}{row['entry']:<24}{row['mean_m']:6.2f} m "
                f"({interval_text(row)})"
            )
            ended = f"{entry['lost']} lost, {entry['failed']} failed of {entry['flights']}"
            equal = f"no difference from {equal_text(row)}" if row["equal"] else ""
            yield f"{cells:<58} {ended:<34} {equal}".rstrip()
        return
    for entry in found["entries"]:
        yield (
            f"{entry['name']:<24}no rank: {found['missing'][entry['name']]} flights are missing; "
            f"{entry['lost']} lost, {entry['failed']} failed of {entry['flights']}"
        )
        for name, task in entry["tasks"].items():
            levels = ", ".join(f"{each:.2f}" for each in task["levels_m"])
            yield f"  {name:<22}{levels} m by level"


def _head(found: Row) -> str:
    conditions, seeds = found["conditions"], found["conditions"]["seeds"]
    kind = (
        "public practice seeds"
        if seeds["kind"] == "practice"
        else f"seeds of pulse {seeds['pulse'][:16]}…"
    )
    entries = len(found["entries"])
    tasks = max((len(each["tasks"]) for each in found["entries"]), default=0)
    line = (
        f"{entries} entr{'y' if entries == 1 else 'ies'} · {tasks} tasks · {found['levels']} "
        f"levels of chance · {len(seeds['values'])} seeds · {kind}"
    )
    return f'<h1>{escape(conditions["benchmark"])}</h1><p class="meta">{escape(line)}</p>'


def _cells(*texts: str, style: str = "") -> str:
    """Make cells; short texts stay on one line, so that a narrow screen scrolls."""
    mark = f' class="{style}"' if style else ""
    widths = [_ONE_LINE if len(text) <= _LONGEST_LINE else _WIDE for text in texts]
    return "".join(
        f'<td{mark} style="{width}">{escape(text)}</td>'
        for text, width in zip(texts, widths, strict=True)
    )


def _by_name(found: Row) -> dict[str, Row]:
    return {each["name"]: each for each in found["entries"]}


def _ranks(found: Row, tables: Mapping[str, Row]) -> str:
    if ALL not in tables:
        missing = ", ".join(f"{name}: {count}" for name, count in found["missing"].items())
        return f"<p>No ranks: flights are missing ({escape(missing)}).</p>"
    entries, body = _by_name(found), []
    for row in tables[ALL]["standings"]:
        entry = entries[row["entry"]]
        body.append(
            _cells(rank_text(row), row["entry"], f"{row['mean_m']:.2f}", interval_text(row))
            + _cells(equal_text(row), style="dim")
            + _cells(str(entry["lost"]), style="red bold" if entry["lost"] else "")
            + _cells(str(entry["failed"]), style="red bold" if entry["failed"] else "")
        )
    headings = (
        *("rank", "entry", "all tasks, m", "95 % interval, m", "no difference from"),
        *("lost", "failed"),
    )
    seeds = found["conditions"]["seeds"]
    note = (
        " These are practice seeds: anyone can tune on them." if seeds["kind"] == "practice" else ""
    )
    text = (
        "The geometric mean of the ten tasks, smaller is better. A rank is claimed only where the "
        "differences from all others are; where they are not, the entries show no difference and "
        f"share a range of ranks.{note}"
    )
    return f"<p>{text}</p>{text_table_to_html(headings, body)}"


def _numbers(found: Row, tables: Mapping[str, Row]) -> str:
    if not tables:
        return ""
    names = [row["entry"] for row in tables[ALL]["standings"]]
    body = []
    for name, table in tables.items():
        rows = {row["entry"]: row for row in table["standings"]}
        cells = [_cells("all tasks" if name == ALL else name)]
        for each in names:
            row = rows[each]
            best = "green bold" if row["rank"] == 1 else ""
            cells.append(_cells(f"{row['mean_m']:.2f} · {rank_text(row)}", style=best))
        body.append("".join(cells))
    text = "RMS error in metres · rank. Green: no entry is claimed to be better."
    return f"<p>{text}</p>{text_table_to_html(('task', *names), body)}"


def _number(value: float | None, digits: int = 2) -> str:
    return MISSING if value is None else f"{value:.{digits}f}"


def _tasks(found: Row, tables: Mapping[str, Row]) -> str:
    entries, out = _by_name(found), []
    for name in dict.fromkeys(task for each in found["entries"] for task in each["tasks"]):
        table = tables.get(name)
        rows = table["standings"] if table else [{"entry": each} for each in entries]
        body = []
        for row in rows:
            task = entries[row["entry"]]["tasks"].get(name)
            if task is None:
                continue
            ranked = (
                (rank_text(row), row["entry"], f"{row['mean_m']:.2f}", interval_text(row))
                if table
                else (MISSING, row["entry"], MISSING, MISSING)
            )
            levels = " / ".join(f"{each:.2f}" for each in task["levels_m"])
            body.append(
                _cells(*ranked)
                + _cells(equal_text(row) if table else "", style="dim")
                + _cells(levels)
                + _cells(str(task["lost"]), style="red bold" if task["lost"] else "")
                + _cells(str(task["failed"]), style="red bold" if task["failed"] else "")
                + _cells(
                    _number(task["separation_joining_m"]),
                    _number(task["separation_window_m"]),
                    _number(task["saturated_s"], 1),
                    _number(task["effort"], 3),
                )
            )
        headings = (
            *("rank", "entry", "RMS, m", "95 % interval, m", "no difference from"),
            *("by level, m", "lost", "failed", "separation joining, m", "in the window, m"),
            *("saturated, s", "throttle"),
        )
        question = table["question"] if table else ""
        out.append(
            f"<h3>{escape(name)}</h3><p>{escape(question)}</p>{text_table_to_html(headings, body)}"
        )
    return "".join(out)


def _pairs(found: Row) -> str:
    if not found["comparisons"]:
        return ""
    body = [
        _cells(
            "all tasks" if each["table"] == ALL else each["table"],
            f"{each['better']} – {each['worse']}",
            f"{each['difference_m']:.3f}",
            MISSING if each["low_m"] is None else f"{each['low_m']:.3f} to {each['high_m']:.3f}",
            f"{each['p']:.1e}",
        )
        + _cells(
            "better" if each["claimed"] else "no difference",
            style="green" if each["claimed"] else "dim",
        )
        for each in found["comparisons"]
    ]
    claimed = sum(each["claimed"] for each in found["comparisons"])
    headings = ("task", "pair", "difference, m", "95 % interval, m", "p", "the first is")
    text = (
        f"{claimed} of {len(body)} differences are claimed, by Student's t over the seeds and "
        f"Holm's correction over all of them at {100.0 * found['alpha']:g} %: with "
        f"{100.0 - 100.0 * found['alpha']:g} % confidence none of them is false. Intervals are "
        "not corrected."
    )
    table = text_table_to_html(headings, body)
    return f"<p>{text}</p><details><summary>All pairs</summary>{table}</details>"


def _gain(value: Any) -> str:  # noqa: ANN401 - a setting
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _margin(row: Row) -> str:
    if row["problem"]:
        return str(row["problem"])
    damping = "" if row["damping"] is None else f"damping {row['damping']:.2f}, "
    factor = "> 10" if row["factor"] is None else f"{row['factor']:.1f}"
    phase = "> 180" if row["phase_deg"] is None else f"{row['phase_deg']:.0f}"
    latency = "> 1" if row["latency_s"] is None else f"{row['latency_s']:.2f}"
    return f"{damping}factor {factor}, phase {phase}°, latency {latency} s"


def _entries(found: Row) -> str:
    out = []
    for each in found["entries"]:
        tuning, messages = each["tuning"], each["messages"]
        code = f"{each['law']}:{each['function']}" if each["function"] else each["law"]
        rows = [
            (
                "law",
                code.rpartition(":")[0] if each["law"].endswith(f":{each['function']}") else code,
            ),
            ("SHA-256 of its file", each["law_sha256"] or "of the testbed itself"),
            ("digest of the entry", each["digest"]),
            (
                "gains",
                ", ".join(f"{k} {_gain(v)}" for k, v in each["gains"].items()) or "as in its file",
            ),
            (
                "tuned",
                "no"
                if tuning is None
                else f"{tuning['flights']} of {tuning['budget']} flights, from "
                f"{tuning['cost_before_m']:.2f} to {tuning['cost_after_m']:.2f} m on "
                f"{', '.join(tuning['tasks'])}",
            ),
            (
                "messages needed",
                MISSING
                if messages is None
                else f"{messages['per_s']:g} a second, of the leader"
                + (" and all other followers" if messages["neighbours"] else " alone"),
            ),
            *((f"margins, bank {row['bank_deg']:g}°", _margin(row)) for row in each["margins"]),
            ("processor time", f"{each['cpu_s']:.2f} s a flight"),
            ("flights", f"{each['flights']}, {each['lost']} lost, {each['failed']} failed"),
            *(("failed", why) for why in each["failures"]),
        ]
        out.append(f"<h3>{escape(each['name'])}</h3>{rows_to_html(rows)}")
    return "".join(out)


def _meaning(found: Row) -> str:
    items = (
        "RMS, m: of each flight the mean over the followers of their RMS distances from their "
        f"slots in the window, each at most {found['lost_m']:g} m; the mean over levels and seeds.",
        f"Lost: an aircraft without a fault touched another one or the ground, or left its "
        f"formation. The flight counts as {found['lost_m']:g} m, and stays in the mean.",
        "Failed: the code raised an error, did not end in time, or needed too much memory. It "
        f"counts as {found['lost_m']:g} m, too.",
        "Separation: the least of all flights, outside of the window, as while joining, and in it.",
        "Saturated: time with a command at its limit, the mean over followers. Throttle: the mean.",
        "Rank: 1 plus the number of entries that are claimed to be better, to the number of all "
        "less those that are claimed to be worse.",
    )
    return f"<ul>{''.join(f'<li>{escape(each)}</li>' for each in items)}</ul>"


def _repeat(found: Row) -> str:
    conditions = found["conditions"]
    seeds = conditions["seeds"]
    rows = [
        ("benchmark", f"{conditions['benchmark']}, SHA-256 {conditions['benchmark_digest']}"),
        *((f"code, {name}", text) for name, text in conditions["code"].items()),
        *((name, text) for name, text in conditions["pins"].items()),
        ("limits of a flight", ", ".join(f"{k} {v:,}" for k, v in conditions["limits"].items())),
        ("pulse", seeds["pulse"] or "none: practice seeds"),
        ("seeds", ", ".join(map(str, seeds["values"]))),
    ]
    commands = "\n".join(each["command"] for each in found["entries"])
    return (
        "<p>One flight of an entry, where its result and the file of its law are; CELL is "
        f"task/level/seed, and --log DIR keeps its log:</p><pre>{escape(commands)}</pre>"
        f"{rows_to_html(rows)}"
    )
