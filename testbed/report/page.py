"""The page itself: one HTML file that needs nothing but a browser, and the figures as files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path

from testbed.metrics.document import losses
from testbed.metrics.error_table import (
    ABREAST,
    beside_published,
    compared,
    error_table,
    flown_part,
    published_mean,
    show,
)
from testbed.metrics.network import describe
from testbed.metrics.network_table import MOST_LINKS, arrival_table, worst_links
from testbed.metrics.table import facts, follower_table, worst_followers
from testbed.report.figures import figures_of
from testbed.report.flight import Flight
from testbed.report.shell import (
    cards,
    document,
    draw_all,
    figure_html,
    saved,
    write_text,
)
from testbed.report.tables import rows_to_html, to_html
from testbed.state import listed

MOST_EVENTS = 200
PARTS = (
    ("errors", "Formation error"),
    ("followers", "Followers"),
    ("figures", "Figures"),
    ("events", "Events"),
    ("again", "To repeat this run"),
)


def write_page(flight: Flight, path: Path) -> None:
    """Write the report; the same run gives the same bytes.

    Raises:
        OSError: it cannot be written.
    """
    write_text(page_of(flight), path)


def write_figures(flight: Flight, folder: Path, ending: str) -> list[Path]:
    """Write every figure into a folder, made if need be, and return their files.

    Args:
        flight: the run.
        folder: where.
        ending: one of `FORMATS`.

    Raises:
        OSError: one cannot be written.
    """
    return draw_all(figures_of(flight), folder, ending)


def page_of(flight: Flight) -> str:
    """The page as text."""
    parts = {
        "errors": _errors(flight),
        "followers": _followers(flight),
        "figures": "".join(map(figure_html, figures_of(flight))),
        "events": _events(flight),
        "again": _again(flight),
    }
    return document(
        flight.log.info.scenario_name,
        head=_head(flight),
        parts=parts,
        titles=PARTS,
        foot=f"Made by testbed {_version(flight)} from {flight.path.name}.",
    )


def _version(flight: Flight) -> str:
    return str(flight.log.info.versions.get("testbed", ""))


def _head(flight: Flight) -> str:
    info, metrics = flight.log.info, flight.metrics
    out = [f"<h1>{escape(info.scenario_name)}</h1>"]
    if flight.page and flight.page.scenario.question:
        out.append(f'<p class="question">{escape(flight.page.scenario.question)}</p>')
    line = [f'<span class="outcome {escape(flight.outcome)}">{escape(flight.outcome)}</span>']
    line.append(f"{metrics['simulated_s']:g} of {info.duration_s:g} s simulated")
    count = len(info.names) - 1
    line.append(f"{count} follower{'s' * (count != 1)} of {escape(info.names[0])}")
    line.append(escape(", ".join(sorted(set(info.aircraft)))))
    line.append(f"seed {info.seed}")
    out.append(f'<p class="meta">{" · ".join(line)}</p>')
    if not flight.log.finished:
        out.append(
            "<p>The log was never closed: the run was killed, and this is what it left. Numbers"
            " are counted from the frames that are there.</p>"
        )
    if flight.page and flight.page.scenario.expectation:
        out.append(f"<p>Expected: {escape(flight.page.scenario.expectation)}</p>")
    out.append(cards(_cards(flight)))
    return "".join(out)


def _cards(flight: Flight) -> list[tuple[str, str, str]]:
    """Numbers, what they are, and what is ill about them, if anything is."""
    metrics = flight.metrics
    shown = []
    for name, portion in list(metrics["portions"].items())[:ABREAST]:
        value = show(portion["mean_rms_m"], "{:.2f} m")
        what = f"mean RMS error, {escape(name)}"
        if not portion["complete"]:
            what += f"; flown: {flown_part(metrics, name)}{' s' * bool(portion['covered_s'])}"
        theirs = published_mean(metrics, name)
        shown.append((value, what + (f"; paper\u00a0{theirs:g}\u00a0m" if theirs else ""), ""))
    largest = [each for each in metrics["max_error_m"].values() if each is not None]
    if largest and not metrics["portions"]:
        shown.append((f"{max(largest):.2f} m", "largest formation error", ""))
    apart = show(metrics["min_separation_m"], "{:.2f} m")
    shown.append((apart, "smallest separation", _too_close(flight)))
    engaged = metrics["engaged_at_s"]
    if engaged:
        never = [name for name, at in engaged.items() if at is None]
        count = f"{len(engaged) - len(never)} of {len(engaged)}"
        shown.append((count, "followers engaged", f"never: {listed(never)}" if never else ""))
    lost = losses(metrics)
    shown.append((str(len(lost)), "aircraft lost", listed(lost)))
    return shown


def _too_close(flight: Flight) -> str:
    """In words, that two aircraft came nearer than the larger of them is wide; else ""."""
    info, between = flight.log.info, flight.metrics["min_separation_between"]
    span = max((info.wingspan_m[info.names.index(name)] for name in between or ()), default=0.0)
    if not between or flight.metrics["min_separation_m"] >= span:
        return ""
    return f"closer than a wingspan, {span:.2f} m"


def _errors(flight: Flight) -> str:
    metrics, names = flight.metrics, flight.followers
    if not names:
        return ""
    portions = list(metrics["portions"])
    exact = not any(metrics["relative_position_m"].values())

    def tables(listed: Sequence[str]) -> str:
        return "".join(
            to_html(error_table(metrics, portions[k : k + ABREAST], listed, exact=exact))
            for k in range(0, len(portions), ABREAST)
        )

    out = [_unfolding(flight, tables)]
    if not portions:
        out.append("<p>The page has no portions, so that no RMS errors are taken.</p>")
    else:
        out.append(
            "<p>Root mean square of the distance ‖q̃‖ between a follower and its slot over each"
            " portion, [HBH23] eq. (30); the error in percent is that of eq. (31), a share of the"
            " distance from the leader to the slot.</p>"
        )
    if beside := beside_published(metrics):
        below = " A ratio below 1 is a smaller error." if compared(metrics) else ""
        out.append(f"<p>{escape(beside[0].upper() + beside[1:])}.{below}</p>")
    return "".join(out)


def _unfolding(flight: Flight, table: Callable[[Sequence[str]], str]) -> str:
    """A table of all followers; of many, of the worst, and below it one of all that unfolds."""
    names, worst = flight.followers, worst_followers(flight.metrics)
    if len(worst) == len(names):
        return table(names)
    whole = f"<details><summary>All {len(names)} followers</summary>{table(names)}</details>"
    return table(worst) + whole


def _followers(flight: Flight) -> str:
    metrics = flight.metrics
    out = []
    if flight.followers:
        out.append(_unfolding(flight, lambda listed: to_html(follower_table(metrics, listed))))
    out.append(rows_to_html(facts(metrics)))
    radio = metrics["network"]
    if radio and radio["links"] and not describe(radio):
        out.append(f"<p>All {radio['all']['sent']:,} messages arrived, without delay.</p>")
    elif radio and radio["links"]:
        links = worst_links(radio["links"])
        out.append("<h3>Links</h3>" + to_html(arrival_table(links, radio["all"])))
        count = sum(len(each) for each in radio["links"].values())
        if count > MOST_LINKS:
            out.append(f"<p>Shown are the worst {MOST_LINKS} of {count} links.</p>")
    return "".join(out)


def _events(flight: Flight) -> str:
    events = flight.metrics["events"]
    if not events:
        return "<p>Nothing was reported.</p>"
    rows = "".join(
        f'<tr><td>{event["time_s"]:.2f}</td><td class="{_tone(event["level"])}">'
        f"{escape(event['level'])}</td><td>{escape(event['source'])}</td>"
        f"<td>{escape(event['text'])}</td></tr>"
        for event in events[:MOST_EVENTS]
    )
    head = "".join(f'<th scope="col">{each}</th>' for each in ("time, s", "level", "who", "what"))
    more = len(events) - MOST_EVENTS
    rest = f"<p>… and {more} more in the log.</p>" if more > 0 else ""
    return (
        f'<div class="wide"><table class="facts"><thead><tr>{head}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>{rest}"
    )


def _tone(level: str) -> str:
    return {"error": "red bold", "warning": "yellow"}.get(level, "dim")


def _again(flight: Flight) -> str:
    info, text = flight.log.info, flight.log.info.scenario_yaml
    versions = [(name, str(value)) for name, value in info.versions.items()]
    rows: list[tuple[str, str]] = [("seed", str(info.seed)), *versions]
    rows += [
        ("base rate", f"{info.base_rate_hz} Hz"),
        ("log rate", f"{info.frame_rate_hz} Hz"),
        ("aircraft", ", ".join(map(" ".join, zip(info.names, info.aircraft, strict=True)))),
    ]
    out = [rows_to_html([*rows])]
    if not text:
        return "".join([*out, "<p>The log does not hold the page that was flown.</p>"])
    file = f"{info.scenario_name}.yaml"
    out.append(
        "<p>Save the page below, as it was flown with every default written out, and fly it with"
        f" these versions:</p><pre>testbed run {escape(file)}</pre>"
        f'<p class="screen">{saved(file, "text/yaml", text.encode())}</p>'
    )
    touched = _from_outside(flight)
    if touched:
        out.append(
            f"<p>This run cannot be repeated from its page alone: {escape(', '.join(touched))}.</p>"
        )
    out.append(f'<pre class="page">{escape(text)}</pre>')
    for name, code in info.code.items():
        out.append(
            f"<p>The page names {escape(name)}, the code of its law. Save it beside the page:</p>"
            f'<p class="screen">{saved(name, "text/x-python", code)}</p>'
            f'<pre class="page">{escape(code.decode("utf-8", "replace"))}</pre>'
        )
    return "".join(out)


def _from_outside(flight: Flight) -> Sequence[str]:
    """What other programs had to do with the run."""
    said = {
        "commanded": "programs outside gave commands",
        "arduplane": "ArduPlane flew aircraft",
    }
    return [text for key, text in said.items() if flight.metrics.get(key)]
