"""The report of a run as a page."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from html import escape

from rich.table import Table

from testbed.core.records import join_names
from testbed.metrics.document import losses
from testbed.metrics.facts import describe_network, facts, shown
from testbed.metrics.printed_tables import (
    MAX_LINKS,
    MAX_WINDOWS,
    arrival_tables,
    compared_windows,
    covered_part,
    error_tables,
    follower_tables,
    published_mean,
    published_note,
    worst_followers,
    worst_links,
)
from testbed.reports.figures import run_figures
from testbed.reports.html import (
    Page,
    PageSection,
    cards_html,
    download_link,
    figure_html,
    file_html,
    rows_to_html,
    text_table_to_html,
    to_html,
)
from testbed.reports.run_data import RunData

MAX_EVENTS = 200
LEVEL_CLASSES = {"error": "red bold", "warning": "yellow"}
EXTERNAL = {
    "commanded": "external programs sent commands",
    "arduplane": "ArduPlane flew aircraft",
}  # by key of the metrics


def run_page(run: RunData) -> Page:
    """Make the page of a run."""
    version = run.log.info.versions.get("testbed", "")
    return Page(
        title=run.log.info.scenario_name,
        head=head_html(run),
        sections=(
            PageSection("errors", "Formation error", _errors(run)),
            PageSection("followers", "Followers", _followers(run)),
            PageSection("figures", "Figures", _figures(run)),
            PageSection("events", "Events", _events(run)),
            PageSection("repeat", "To repeat this run", _repeat(run)),
        ),
        footer=f"Made by testbed {version} from {run.path.name}.",
    )


def head_html(run: RunData) -> str:
    """Make the head: question, outcome, and the most important numbers."""
    info, metrics = run.log.info, run.metrics
    out = [f"<h1>{escape(info.scenario_name)}</h1>"]
    if run.scenario and run.scenario.scenario.question:
        out.append(f'<p class="question">{escape(run.scenario.scenario.question)}</p>')
    outcome = escape(run.outcome)
    line = [f'<span class="outcome {outcome}">{outcome.replace("_", " ")}</span>']
    recorded = metrics.get("recorded", False)
    kind = "recorded" if recorded else "simulated"
    begin_s = metrics.get("begin_s", 0.0)
    line.append(f"{metrics['simulated_s'] - begin_s:g} of {info.duration_s - begin_s:g} s {kind}")
    count = len(info.names) - 1
    line.append(f"{count} follower{'s' * (count != 1)} of {escape(info.names[0])}")
    line.append(escape(", ".join(sorted(set(info.aircraft)))))
    if not recorded:
        line.append(f"seed {info.seed}")
    out.append(f'<p class="meta">{" · ".join(line)}</p>')
    if not run.log.finished:
        out.append(
            "<p>The run was killed before it closed its log. The numbers are computed from the"
            " samples in the log.</p>"
        )
    if run.scenario and run.scenario.scenario.expectation:
        ended = metrics["simulated_s"] < info.duration_s - 0.5 / run.scenario.rates.log_hz
        of = f"of the whole flight of {info.duration_s:g} s" if ended else ""
        text = escape(run.scenario.scenario.expectation)
        out.append(f"<p>{' '.join(filter(None, ('Expected', of)))}: {text}</p>")
    out.append(cards_html(_cards(run)))
    return "".join(out)


def _cards(run: RunData) -> list[tuple[str, str, str]]:
    """List the most important numbers; see `cards_html`."""
    metrics = run.metrics
    out = []
    for name, window in list(metrics["windows"].items())[:MAX_WINDOWS]:
        value = shown(window["mean_rms_m"], "{:.2f} m")
        meaning = f"mean RMS error, {escape(name)}"
        if not window["complete"]:
            unit = " s" if window["covered_s"] else ""
            meaning += f"; covered: {covered_part(metrics, name)}{unit}"
        published = published_mean(metrics, name)
        if published:
            meaning += f"; paper\u00a0{published:g}\u00a0m"
        out.append((value, meaning, ""))
    largest = [each for each in metrics["max_error_m"].values() if each is not None]
    if largest and not metrics["windows"]:
        out.append((f"{max(largest):.2f} m", "largest formation error", ""))
    separation = shown(metrics["min_separation_m"], "{:.2f} m")
    out.append((separation, "smallest separation", _separation_problem(run)))
    joined = metrics["joined_at_s"]
    if joined:
        never = [name for name, at in joined.items() if at is None]
        count = f"{len(joined) - len(never)} of {len(joined)}"
        problem = f"never: {join_names(never)}" if never else ""
        out.append((count, "followers joined", problem))
    lost = losses(metrics)
    out.append((str(len(lost)), "aircraft lost", join_names(lost)))
    return out


def _separation_problem(run: RunData) -> str:
    """Describe a separation below the larger wingspan of the two aircraft; "" without one."""
    info, between = run.log.info, run.metrics["min_separation_between"]
    separation = run.metrics["min_separation_m"]
    span = max((info.wingspan_m[info.names.index(name)] for name in between or ()), default=0.0)
    if separation is None or separation >= span:
        return ""
    return f"closer than a wingspan, {span:.2f} m"


def _errors(run: RunData) -> str:
    metrics = run.metrics
    if not run.followers:
        return ""
    out = [_with_all_followers(run, lambda names: error_tables(metrics, names))]
    if not metrics["windows"]:
        out.append("<p>The scenario has no windows, so there are no RMS errors.</p>")
    else:
        out.append(
            "<p>Root mean square of the distance ‖q̃‖ between a follower and its slot over each"
            " window, [HBH23] eqs. (30) and (31); the error in percent, relative to the distance"
            " between the leader and the slot, is that of its Table 1.</p>"
        )
    if note := published_note(metrics):
        below = " A ratio below 1 is a smaller error." if compared_windows(metrics) else ""
        out.append(f"<p>{escape(note[0].upper() + note[1:])}.{below}</p>")
    return "".join(out)


def _with_all_followers(run: RunData, make: Callable[[Sequence[str]], Sequence[Table]]) -> str:
    """Make tables of all followers; with many, of the worst, and of all in a closed element."""

    def tables(names: Sequence[str]) -> str:
        return "".join(map(to_html, make(names)))

    names, worst = run.followers, worst_followers(run.metrics)
    if len(worst) == len(names):
        return tables(names)
    summary = f"<summary>All {len(names)} followers</summary>"
    return f"{tables(worst)}<details>{summary}{tables(names)}</details>"


def _followers(run: RunData) -> str:
    metrics = run.metrics
    out = []
    if run.followers:
        out.append(_with_all_followers(run, lambda names: follower_tables(metrics, names)))
    out.append(rows_to_html(facts(metrics)))
    network = metrics["network"]
    if network and network["links"] and not describe_network(network):
        out.append(f"<p>All {network['all']['sent']:,} messages arrived, without delay.</p>")
    elif network and network["links"]:
        links = worst_links(network["links"])
        out.append("<h3>Links</h3>" + "".join(map(to_html, arrival_tables(links, network["all"]))))
        count = sum(len(each) for each in network["links"].values())
        if count > MAX_LINKS:
            out.append(f"<p>The table has the worst {MAX_LINKS} of {count} links.</p>")
    return "".join(out)


def _figures(run: RunData) -> str:
    part = f"<p>The figures show {run.part}; all numbers are of the whole run.</p>"
    return (part if run.part else "") + "".join(map(figure_html, run_figures(run)))


def _events(run: RunData) -> str:
    events = run.metrics["events"]
    if not events:
        return "<p>No events.</p>"
    rows = (
        f"<td>{event['time_s']:.2f}</td>"
        f'<td class="{LEVEL_CLASSES.get(event["level"], "dim")}">{escape(event["level"])}</td>'
        f"<td>{escape(event['source'])}</td><td>{escape(event['text'])}</td>"
        for event in events[:MAX_EVENTS]
    )
    table = text_table_to_html(("time, s", "level", "source", "event"), rows)
    more = len(events) - MAX_EVENTS
    return table + (f"<p>{more} more events are in the log.</p>" if more > 0 else "")


def _repeat(run: RunData) -> str:
    info, text = run.log.info, run.log.info.scenario_yaml
    versions = [(name, str(value)) for name, value in info.versions.items()]
    aircraft = ", ".join(map(" ".join, zip(info.names, info.aircraft, strict=True)))
    out = [
        rows_to_html(
            [
                ("seed", str(info.seed)),
                *versions,
                *([("engine", info.engine)] if info.engine else []),
                ("base rate", f"{info.base_rate_hz} Hz"),
                ("log rate", f"{info.sample_rate_hz} Hz"),
                ("aircraft", aircraft),
            ]
        )
    ]
    if not text:
        return "".join([*out, "<p>The log has no copy of the scenario.</p>"])
    file = f"{info.scenario_name}.yaml"
    recorded = run.metrics.get("recorded", False)
    out.append(
        "<p>Real aircraft flew this run: testbed import-formation made it from their logs. The"
        " scenario below has the slots, and flies a simulation of the formation:</p>"
        if recorded
        else "<p>Save the scenario below, which has all defaults written out, and run it with these"
        " versions:</p>"
    )
    out.append(f"<pre>testbed run {escape(file)}</pre>")
    causes = [cause for key, cause in EXTERNAL.items() if run.metrics.get(key)]
    if causes:
        out.append(
            f"<p>The scenario alone does not repeat this run: {escape(', '.join(causes))}.</p>"
        )
    out.append(file_html(file, "text/yaml", text.encode()))
    for name, code in info.code.items():
        out.append(
            f"<p>The scenario uses {escape(name)}, the code of its law. Save it in the same"
            " folder:</p>"
        )
        if name.endswith(".py"):
            out.append(file_html(name, "text/x-python", code))
        else:
            link = download_link(name, "application/zip", code)
            digest = hashlib.sha256(code).hexdigest()[:12]
            out.append(f"<p>{link} (SHA-256 {digest})</p>")
    return "".join(out)
