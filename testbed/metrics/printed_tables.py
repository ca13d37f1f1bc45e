"""Tables of a metrics document: for terminals, for notebooks, and of links.

The terminal's are readable without colours; the short ones, as text and HTML, are for notebooks and
the interpreter.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from statistics import median
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from testbed.core.flags import Saturation
from testbed.core.records import join_names
from testbed.metrics.document import BOUND_VIOLATED, EXCEEDED
from testbed.metrics.facts import ABSENT, facts, percent, select_largest, shown
from testbed.metrics.model import LinkMetrics, LoggedEvent, Metrics, WindowMetrics

Columns = dict[str, list[Text | str]]  # cells by heading
Row = Sequence[str]

MAX_FOLLOWERS = 12  # listed one by one; of more, those with the largest errors
MAX_WINDOWS = 3  # side by side in 80 columns
MAX_EVENTS = 6
MAX_LINKS = 12  # listed one by one; of more, those that delivered least
SHORT_FOLLOWERS = 4  # in a short table; of more, those with the largest errors
SHORT_WINDOWS = 4
FACT_INDENT = 21  # columns of the name of a line below the tables
EVENT_INDENT = 22  # columns of an event's level and time
NARROW = 70  # columns; below, a wrapped event is indented by `NARROW_INDENT` only
NARROW_INDENT = 4
# A number and its unit, which stay on one line.
_QUANTITY = re.compile(r"(?<=\d) (?=(?:m|m/s|km|s|ms|Hz|%|°|rad|rad/s|V)\b|%|°)")
OUTCOME_STYLES = {"completed": "bold green"} | dict.fromkeys(
    ("lost", *EXCEEDED, BOUND_VIOLATED, "failed"), "bold red"
)
EVENT_STYLES = {"error": "red", "warning": "yellow"}
_PUBLISHED = ("rms_m", "mean_rms_m", "percent_error")  # numbers of a window


def render_table(
    metrics: Metrics,
    console: Console,
    *,
    log: Path | None = None,
    log_size: str = "",
    notes: Sequence[tuple[str, Text]] = (),
) -> None:
    """Print a metrics document; `log` is the run directory to name, `notes` are more facts."""
    for line in _headline(metrics, console.width):
        console.print(line)
    names = worst_followers(metrics)
    for table in error_tables(metrics, names, fits=fits_width(console)):
        console.print()
        console.print(table)
    if source := published_note(metrics):
        for part in wrap_lines(source, console.width - 1):
            console.print(Text(f" {part}", style="dim"))
    if names:
        for table in follower_tables(metrics, names):
            console.print()
            console.print(table)
    console.print()
    _print_facts([*facts(metrics), *notes], console)
    _print_events(metrics["events"], console)
    if log is not None:
        # not wrapped: a path broken over two lines cannot be copied
        size = f" ({log_size})" if log_size else ""
        console.print(Text(f" {'log':<20}{log}{size}"), soft_wrap=True)


def worst_followers(metrics: Metrics) -> list[str]:
    """Return the followers to list: of many, those with the largest RMS error."""

    def largest_error(name: str) -> float:
        errors = [window["rms_m"][name] for window in metrics["windows"].values()]
        errors.append(None if errors else metrics["max_error_m"][name])
        return max((error for error in errors if error is not None), default=float("inf"))

    return select_largest(metrics["joined_at_s"], largest_error, MAX_FOLLOWERS)


def error_tables(
    metrics: Metrics,
    names: Sequence[str],
    *,
    fits: Callable[[Table], bool] = lambda table: True,
) -> list[Table]:
    """Make tables of the RMS errors, with up to `MAX_WINDOWS` windows each.

    Args:
        metrics: the document.
        names: the followers to list.
        fits: whether a table is narrow enough.
    """
    windows, tables = list(metrics["windows"]), []
    while windows:
        for count in range(min(MAX_WINDOWS, len(windows)), 0, -1):
            table = _error_table(metrics, windows[:count], names)
            if count == 1 or fits(table):
                break
        tables.append(table)
        del windows[:count]
    return tables


def _error_table(metrics: Metrics, windows: Sequence[str], names: Sequence[str]) -> Table:
    published: Mapping[str, Any] = metrics["published"] or {}
    compared = [name for name in windows if name in compared_windows(metrics)]
    followers = list(metrics["joined_at_s"])
    table = _new_table()
    table.add_column(Text("\nRMS error, m", style="bold"), no_wrap=True)
    for window in windows:
        start, end = metrics["windows"][window]["window_s"]
        title = Text.assemble((window, "bold cyan"), f"\n{start:g}–{end:g} s", justify="right")
        table.add_column(title, justify="right", no_wrap=True)
        if window in compared:
            table.add_column(Text("\npaper"), justify="right", style="dim", no_wrap=True)
            table.add_column(Text("\nratio"), justify="right", no_wrap=True)

    def add(label: Text | str, by_window: Sequence[list[Text | str]]) -> None:
        cells: list[Text | str] = [label]
        for window, own in zip(windows, by_window, strict=True):
            cells += own + [""] * (3 - len(own) if window in compared else 0)
        table.add_row(*cells)

    def compare(key: str, form: str, window: str, name: str | None = None) -> list[Text | str]:
        """Our number, and the published one with the ratio if the window has one."""
        numbers: Mapping[str, Any] = metrics["windows"][window]
        measured, paper = numbers[key], published.get(key, {}).get(window)
        if name is not None:
            measured, paper = measured[name], _nth(paper, followers.index(name))
        if _lost_within(metrics, window, *(followers if name is None else [name])):
            paper = None
        return (
            _compared_cells(measured, paper, form)
            if window in compared
            else [shown(measured, form)]
        )

    for name in names:
        add(name, [compare("rms_m", "{:.2f}", window, name) for window in windows])
    if len(names) < len(followers):
        table.add_row(Text(f"(the worst of {len(followers)})", style="dim"))
    table.add_section()
    averages = (("mean", "mean_rms_m", "{:.2f}"), ("error, %", "percent_error", "{:.0f}"))
    for label, key, form in averages:
        add(Text(label, style="bold"), [compare(key, form, window) for window in windows])
    found = [metrics["windows"][window] for window in windows]
    rows = [
        ("largest, m", "{:.2f}", [_of_known(each["max_error_m"], max) for each in found]),
        ("leader bank, °", "{:.1f}", [each["leader_bank_deg"] for each in found]),
    ]
    if any(metrics["relative_position_error_m"].values()):
        estimated = [each["estimated_mean_rms_m"] for each in found]
        rows.insert(0, ("mean estimated", "{:.2f}", estimated))
    if len(names) < len(followers):
        rows.insert(0, ("median", "{:.2f}", [_of_known(each["rms_m"], median) for each in found]))
    for label, form, values in rows:
        cells = [Text(shown(value, form), style="dim") for value in values]
        add(Text(label, style="dim"), [[cell] for cell in cells])
    if not all(each["complete"] for each in found):
        cells = [Text(covered_part(metrics, window), style="yellow") for window in windows]
        add(Text("covered, s", style="yellow"), [[cell] for cell in cells])
    return table


def follower_tables(metrics: Metrics, names: Sequence[str]) -> list[Table]:
    """Make tables of joining, limiters and message age, of saturated commands, and of ringing.

    The last one is absent if no bank rings; of recorded flights there is the time of joining alone.
    """
    joined, ages = metrics["joined_at_s"], metrics["age_of_information_s"]
    limits, saturations = metrics["limiter_flags"], metrics["saturations"]
    recovery = metrics["recovery"]
    joining: Columns = {"joined\nat, s": [_joined(joined[name]) for name in names]}
    if metrics.get("recorded"):
        return [_follower_table("\nfollower", names, joining)]
    columns: Columns = {
        **joining,
        "limiter\non, s": [_seconds(limits[name]["seconds"]) for name in names],
        "message\nage, ms": [_milliseconds(ages[name]["mean"]) for name in names],
    }
    saturation: Columns = {
        "any\ns": [_seconds(saturations[name]["seconds"]) for name in names],
        **{
            f"{kind}\n% of time": [_saturated_share(metrics, name, kind) for name in names]
            for kind in (str(flag.name).lower() for flag in Saturation)
        },
        "last\nat, s": [shown(recovery[name]["last_saturated_s"], "{:.1f}") for name in names],
    }
    tables = [
        _follower_table("\nfollower", names, columns),
        _follower_table("command\nsaturated", names, saturation),
    ]
    if any(each["seconds"] for each in metrics["ringing"].values()):
        found = [metrics["ringing"][name] for name in names]
        ringing: Columns = {
            "any\ns": [_seconds(each["seconds"]) for each in found],
            "last\nat, s": [shown(each["last_s"], "{:.1f}") for each in found],
            "period\ns": [shown(each["period_s"], "{:.2f}") for each in found],
            "damping\nratio": [shown(each["damping_ratio"], "{:.2f}") for each in found],
        }
        tables.append(_follower_table("bank\nringing", names, ringing))
    return tables


def _follower_table(title: str, names: Sequence[str], columns: Columns) -> Table:
    table = _new_table()
    table.add_column(Text(title, style="bold"), no_wrap=True)
    for heading in columns:
        style = "dim" if "%" in heading else ""
        table.add_column(heading, justify="right", style=style, no_wrap=True)
    for name, *cells in zip(names, *columns.values(), strict=True):
        table.add_row(name, *cells)
    return table


def compared_windows(metrics: Metrics) -> list[str]:
    """Return the complete windows that have published numbers of this set-up."""
    published = metrics["published"]
    if published is None or published.get("differs"):
        return []
    found = metrics["windows"]
    return [name for name in _published_windows(metrics) if found[name]["complete"]]


def published_numbers(metrics: Metrics, window: str) -> dict[str, Any]:
    """Return the published numbers of a window by the key of `metrics.json`; {}: not comparable."""
    published: Mapping[str, Any] = metrics["published"] or {}
    if window not in compared_windows(metrics):
        return {}
    if _lost_within(metrics, window, *metrics["max_error_m"]):
        return {}
    known = {key: (published.get(key) or {}).get(window) for key in _PUBLISHED}
    return {key: value for key, value in known.items() if value is not None}


def published_mean(metrics: Metrics, window: str) -> float | None:
    """Return the published mean RMS error of a window, m, if comparable."""
    mean = published_numbers(metrics, window).get("mean_rms_m")
    return None if mean is None else float(mean)


def published_note(metrics: Metrics) -> str:
    """Name the source of published numbers and windows not compared; "" if none."""
    known, published = _published_windows(metrics), metrics["published"]
    if published is None:
        return ""
    source = published["source"]
    if known and (differs := published.get("differs")):
        return f"not compared with {source}: another set-up, {join_names(differs)}"
    cut = [name for name in known if not metrics["windows"][name]["complete"]]
    notes = [f"published: {source}"] if len(cut) < len(known) else []
    if cut:
        notes.append(f"incomplete, not compared: {', '.join(cut)}")
    return "; ".join(notes)


def covered_part(metrics: Metrics, window: str) -> str:
    """Name the covered part of a window, s: "all", "none", or start and end."""
    found = metrics["windows"][window]
    if found["complete"]:
        return "all"
    start, end = found["window_s"]
    until = min(float(metrics["simulated_s"]), end)
    return f"{start:g}–{until:g}" if found["covered_s"] else "none"


def fits_width(console: Console) -> Callable[[Table], bool]:
    """Return a function that checks whether a table is narrow enough for a console."""
    unlimited = console.options.update_width(10_000)
    return lambda table: console.measure(table, options=unlimited).maximum <= console.width


def _new_table() -> Table:
    """Rules without a frame; the margin of one column is the padding's."""
    return Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")


def wrap_lines(text: str, width: int) -> list[str]:
    """Break a text into lines; a number and its unit are not parted."""
    joined = _QUANTITY.sub("\N{NO-BREAK SPACE}", text)
    lines = textwrap.wrap(joined, max(width, 10), break_long_words=False, break_on_hyphens=False)
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines] or [""]


def _print_facts(rows: Sequence[tuple[str, str | Text]], console: Console) -> None:
    for name, text in rows:
        style = text.style if isinstance(text, Text) else ""
        lines = [
            line
            for each in str(text).splitlines()
            for line in wrap_lines(each, console.width - FACT_INDENT)
        ]
        for number, line in enumerate(lines):
            start = f" {name if number == 0 else '':<{FACT_INDENT - 1}}"
            console.print(Text.assemble(start, (line, style)), soft_wrap=True)


def _headline(metrics: Metrics, width: int) -> list[Text]:
    """Scenario, outcome, times and seed, broken between these where a line is full."""
    outcome = (metrics["outcome"] or "in flight").replace("_", " ")
    begin_s = metrics.get("begin_s", 0.0)
    recorded = metrics.get("recorded", False)
    kind = "recorded" if recorded else "simulated"
    time = f"{metrics['simulated_s'] - begin_s:.0f} s {kind}"
    if begin_s:
        time += f" from {begin_s:g} s"
    if metrics["wall_s"] is not None:
        time += f" in {metrics['wall_s']:.1f} s"
    if (factor := metrics["real_time_factor"]) is not None:
        time += f" ({factor:.0f} × real time)" if factor >= 10.0 else f" ({factor:.1f} × real time)"
    style = OUTCOME_STYLES.get(metrics["outcome"] or "", "bold yellow")
    parts = [Text(outcome, style=style), Text(time)]
    if not recorded:
        parts.append(Text(f"seed {metrics['seed']}"))
    return join_parts(Text(str(metrics["scenario"]), "bold"), parts, width)


def join_parts(first: Text, parts: Sequence[Text], width: int) -> list[Text]:
    """Join parts by dots, in lines of at most this width."""
    lines = [Text.assemble(" ", first)]
    for part in parts:
        if lines[-1].cell_len + 3 + part.cell_len > width:
            lines.append(Text("  ").append_text(part))
        else:
            lines[-1] = Text.assemble(lines[-1], " · ", part)
    return lines


def _print_events(events: Sequence[LoggedEvent], console: Console) -> None:
    """Print the first warnings and errors, and the run's own notes from before the flight."""
    printed = [
        e
        for e in events
        if e["level"] in EVENT_STYLES or (e["source"] == "run" and not e["time_s"])
    ]
    # errors before warnings, because they decide whether the run is valid
    first = sorted(range(len(printed)), key=lambda i: printed[i]["level"] != "error")[:MAX_EVENTS]
    for event in (printed[i] for i in sorted(first)):
        time = f"{event['time_s']:.2f} s"
        start = f" {event['level']:<8}{time:>11}  "
        indent = EVENT_INDENT if console.width >= NARROW else NARROW_INDENT
        text = f"{event['source']}: {event['text']}"
        head, *_ = wrap_lines(text, console.width - EVENT_INDENT)
        rest = text[len(head) :].lstrip()
        lines = [start + head]
        if rest:
            lines += [" " * indent + line for line in wrap_lines(rest, console.width - indent)]
        style = EVENT_STYLES.get(event["level"], "")
        console.print(Text("\n".join(lines), style=style), soft_wrap=True)
    if len(printed) > MAX_EVENTS:
        more = f" … and {len(printed) - MAX_EVENTS} more in the log"
        console.print(Text(more, style="dim"))


def _published_windows(metrics: Metrics) -> list[str]:
    published: Mapping[str, Any] = metrics["published"] or {}
    known = [published.get(key) or {} for key in _PUBLISHED]
    return [name for name in metrics["windows"] if any(name in each for each in known)]


def _lost_within(metrics: Metrics, window: str, *names: str) -> bool:
    """Return whether one of these, or the leader, was lost before a window ended."""
    lost, end = metrics["lost_at_s"], metrics["windows"][window]["window_s"][1]
    times = [lost.get(name) for name in (next(iter(lost), ""), *names)]
    return any(at is not None and at < end for at in times)


def _compared_cells(measured: float | None, paper: float | None, form: str) -> list[Text | str]:
    value = Text(shown(measured, form))
    if measured is None or not paper:
        return [value, shown(paper, "{:g}"), ABSENT]
    ratio = measured / paper
    style = "green" if ratio <= 1.0 else "red"
    value.stylize(style)
    return [value, f"{paper:g}", Text(f"{ratio:.2f}", style=style)]


def _nth(values: Sequence[float] | None, index: int) -> float | None:
    return values[index] if values is not None and index < len(values) else None


def _of_known(
    values: Mapping[str, float | None], statistic: Callable[[list[float]], float]
) -> float | None:
    known = [value for value in values.values() if value is not None]
    return statistic(known) if known else None


def _joined(at: float | None) -> Text | str:
    return Text("never", style="red") if at is None else f"{at:.1f}"


def _seconds(value: float | None) -> str:
    if value is None:
        return ABSENT
    return f"{value:.1f}" if value else "0"


def _milliseconds(seconds: float | None) -> str:
    return ABSENT if seconds is None else f"{1e3 * seconds:.0f}"


def _saturated_share(metrics: Metrics, name: str, kind: str) -> str:
    """Format the share of the samples in which a command was saturated, %."""
    found = metrics["saturations"][name]
    period = (found["seconds"] or 0.0) / found["samples"] if found["samples"] else 0.0
    # the first and the last sample count, too
    flown_s = metrics["simulated_s"] - metrics.get("begin_s", 0.0)
    samples = flown_s / period + 1.0 if period else 1.0
    share = 100.0 * found["by_kind"][kind] / samples
    return f"{share:.1f}" if share else "0"


def worst_links(links: Mapping[str, Mapping[str, LinkMetrics]]) -> dict[str, LinkMetrics]:
    """Return the links to list: all, or of many those that delivered least, in order.

    Args:
        links: statistics by sender and receiver.
    """
    named = name_links(links)
    worst = select_largest(named, lambda name: impairment(named[name]), MAX_LINKS)
    return {name: named[name] for name in worst}


def name_links(links: Mapping[str, Mapping[str, LinkMetrics]]) -> dict[str, LinkMetrics]:
    """Return statistics by link, "a > b", of those by sender and receiver."""
    return {
        f"{source} > {destination}": link
        for source, receivers in links.items()
        for destination, link in receivers.items()
    }


def impairment(link: LinkMetrics) -> tuple[float, float]:
    """Return by what links are ordered: the share delivered, negated, then the delay, s."""
    share, delay = link["delivered_share"], link["delay_s"]
    return -(1.0 if share is None else share), (delay["p99"] if delay else 0.0)


def link_table(
    title: str,
    columns: Sequence[str],
    links: Mapping[str, LinkMetrics],
    total: LinkMetrics,
    cells: Callable[[LinkMetrics], Sequence[str]],
) -> Table:
    """Make a table with a row for each link and one for all together."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")
    # the only column that may be broken over lines, because names can be long
    table.add_column(Text(title, style="bold"))
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for name, link in links.items():
        table.add_row(name, *cells(link))
    table.add_section()
    table.add_row("all", *cells(total))
    return table


def arrival_tables(
    links: Mapping[str, LinkMetrics],
    total: LinkMetrics,
    fits: Callable[[Table], bool] = lambda table: True,
) -> list[Table]:
    """Make tables of deliveries, delays and bursts of losses by link.

    Args:
        links: statistics by name.
        total: statistics of all links.
        fits: whether a table is narrow enough; if not, bursts get a table of their own.
    """

    def arrivals(link: LinkMetrics) -> list[str]:
        delay = link["delay_s"]
        return [
            f"{link['sent']:,}",
            percent(link["delivered_share"]).removesuffix(" %"),
            *(ABSENT if delay is None else f"{1e3 * delay[p]:.1f}" for p in ("p50", "p95", "p99")),
        ]

    def bursts(link: LinkMetrics) -> list[str]:
        found = link["bursts"]
        mean = ABSENT if found["mean"] is None else f"{found['mean']:.2f}"
        return [mean, f"{found['longest']:,}"]

    early = ("\nsent", "arrived\n%", "delay\np50, ms", "\np95", "\np99")
    late = ("loss burst\nmean", "\nmax")
    whole = link_table(
        "\nlink", early + late, links, total, lambda link: arrivals(link) + bursts(link)
    )
    if fits(whole):
        return [whole]
    return [
        link_table("\nlink", early, links, total, arrivals),
        link_table("\nlink", late, links, total, bursts),
    ]


def table_text(metrics: Metrics, place: str = "") -> str:
    """Return at most ten lines: outcome, RMS error by follower and window, separation.

    Args:
        metrics: of a run.
        place: of its files; "": none.
    """
    rows = list(_rows(metrics))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    table = ("  ".join(_aligned(row, widths)).rstrip() for row in rows)
    return "\n".join([_title(metrics), *table, *_ending(metrics, place)])


def table_html(metrics: Metrics, place: str = "") -> str:
    """Return the same as HTML, for `_repr_html_`."""
    head, *body = (
        "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row)
        for tag, row in zip(("th", *["td"] * 99), _rows(metrics), strict=False)
    )
    lines = "".join(f"<tr>{row}</tr>" for row in body)
    ending = "<br>".join(map(escape, _ending(metrics, place)))
    return (
        f"<p>{escape(_title(metrics))}</p><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{lines}</tbody></table><p>{ending}</p>"
    )


def _title(metrics: Metrics) -> str:
    parts = (
        metrics["scenario"],
        str(metrics["outcome"]).replace("_", " "),
        f"{metrics['simulated_s']:g} s",
        f"seed {metrics['seed']}",
    )
    return " · ".join(parts)


def _rows(metrics: Metrics) -> Iterator[Row]:
    """Yield the cells of the table, its heading first."""
    errors = metrics["max_error_m"]
    windows = {name: window for name, window in list(metrics["windows"].items())[:SHORT_WINDOWS]}
    more = len(metrics["windows"]) - len(windows)

    def largest(name: str) -> float:
        values = [each["rms_m"][name] for each in windows.values()] or [errors[name]]
        return max((each for each in values if each is not None), default=float("inf"))

    listed = select_largest(errors, largest, SHORT_FOLLOWERS)
    kind = "" if len(listed) == len(errors) else f", {len(listed)} worst"
    if not windows:
        yield (f"largest error{kind}, m", "whole flight")
        for name in listed:
            yield (name, shown(errors[name], "{:.2f}"))
    else:
        yield (f"RMS error{kind}, m", *windows, *[f"and {more} more"] * bool(more))
        rest = [""] * bool(more)
        yield ("", *(_span(each) for each in windows.values()), *rest)
        for name in listed:
            cells = (shown(each["rms_m"][name], "{:.2f}") for each in windows.values())
            yield (name, *cells, *rest)
        means = (shown(each["mean_rms_m"], "{:.2f}") for each in windows.values())
        yield (f"mean of {len(errors)}", *means, *rest)


def _span(window: WindowMetrics) -> str:
    """Format the times of a window, and how much of it a run covers that ended in it."""
    start, end = window["window_s"]
    part = "" if window["complete"] else f", {window['covered_s']:g} s flown"
    return f"{start:g}–{end:g} s{part}"


def _ending(metrics: Metrics, place: str) -> list[str]:
    lines = []
    if (separation := metrics["min_separation_m"]) is not None:
        lines.append(f"smallest separation {separation:.2f} m")
    return [*lines, *[place] * bool(place)]


def _aligned(row: Row, widths: Sequence[int]) -> Iterator[str]:
    """Pad a name to the left and numbers to the right."""
    for k, (cell, width) in enumerate(zip(row, widths, strict=True)):
        yield cell.rjust(width) if k else cell.ljust(width)
