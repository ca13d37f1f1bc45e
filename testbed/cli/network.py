"""The command that sends messages over the network of a scenario: network."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from testbed.cli.figure_options import DEFAULT_LOOK, FigureLook, draws_figures
from testbed.cli.options import (
    JsonFile,
    Overrides,
    ScenarioName,
    Seed,
    figure_option,
    load_scenario,
    output_option,
    value_option,
)
from testbed.cli.output import PipeSafeConsole, result_console, write_json_output
from testbed.core.errors import InputError
from testbed.core.files import report_write_errors, write_text_file

if TYPE_CHECKING:
    from testbed.metrics.model import LinkMetrics
    from testbed.probes.channel_probe import MessageRecord
    from testbed.scenario import Scenario

MAX_PACKETS = 10_000_000
MAX_ROWS = 50_000_000  # of all links: half a gigabyte of memory, several gigabytes of CSV
COLUMNS = 5  # of counts, which fit side by side in 80 columns; fewer of them in 60
NARROW_COLUMNS = 3
NOT_LOSSES = ("muted", "overtaken", "duplicated")
HEADER = "source,destination,sequence,sent_s,received_s,outcome,copies\n"

Document = Mapping[str, Any]


def _check_packets(parameter: typer.CallbackParam, packets: int) -> int:
    if not 1 <= packets <= MAX_PACKETS:
        raise InputError(f"--packets {packets}: write a number of 1 to {MAX_PACKETS:,}")
    return packets


@draws_figures("plot")
def network_command(
    scenario: ScenarioName,
    packets: Annotated[
        int, value_option("N", "Messages on every link.", check=_check_packets)
    ] = 10_000,
    out: Annotated[
        Path | None,
        output_option(
            metavar="FILE.csv",
            help="Write a row per message: source, destination, sequence, sent_s, received_s "
            "(empty if it did not arrive), outcome, copies.",
            suffixes=(".csv",),
        ),
    ] = None,
    overrides: Overrides = None,
    seed: Seed = None,
    plot: Annotated[
        Path | None,
        figure_option("Plot what arrived on each link and how late, as .png, .pdf or .svg."),
    ] = None,
    json: JsonFile = None,
    look: FigureLook = DEFAULT_LOOK,
) -> None:
    """Send messages over a scenario's network, without simulating aircraft.

    Every aircraft broadcasts as it would in a flight, and messages have the same random numbers.
    Distances and obstruction by airframes are those of the start, in level flight. received_s is
    the time of the first copy, copies the number that arrived.

    The outcome is delivered; lost (by the loss model or a trace); faded (by distance or an
    airframe); corrupted (wrong checksum); queue (full); blackout; partition; listed (in a drop
    list); or muted (the transmitter was off).
    """
    from testbed.cli.progress import progress_counter
    from testbed.probes.channel_probe import probe_channel
    from testbed.runs.stop_request import stop_on_signals

    files = {"--out": out, "--plot": plot, "--json": json}
    _check_different({option: path for option, path in files.items() if path})
    loaded = load_scenario(scenario, overrides, seed)
    _check_rows(loaded, packets)
    total = packets * len(loaded.aircraft_names)
    with stop_on_signals() as stop, progress_counter("network", total=total, unit="sent") as update:
        result = probe_channel(
            loaded, packets, record=bool(out or plot), progress=update, stop=stop
        )
        if stop():
            raise KeyboardInterrupt
    document = {
        "scenario": loaded.name,
        "seed": loaded.scenario.seed,
        "packets": packets,
        **result.summary,
    }
    if out and result.messages:
        _save(out, loaded.aircraft_names, result.messages)
    if plot and result.messages:
        _plot(plot, loaded, document, result.messages, look)
    write_json_output(json, document)
    console = result_console(json)
    _print_summary(console, document)
    for title, file in (("messages", out), ("figure", plot)):
        if file:
            console.write_line(f" {title:<10}{file}")


def _check_different(files: Mapping[str, Path]) -> None:
    """Check that no two options name the same file."""
    seen: dict[Path, str] = {}
    for option, path in files.items():
        other = seen.setdefault(path.absolute(), option)
        if other != option:
            raise InputError(f"{option} {path}: {other} names the same file; write another name")


def _plot(
    path: Path,
    scenario: Scenario,
    document: Document,
    messages: MessageRecord,
    look: FigureLook,
) -> None:
    import numpy as np

    from testbed.views.network_figure import NetworkFigureData, network_figure

    names = scenario.aircraft_names
    share = np.full((len(names) - 1, len(names)), np.nan)
    delays = [[np.empty(0) for _ in names] for _ in names[1:]]
    for m, source in enumerate(names):
        for i, destination in enumerate(names[1:]):
            link = document["links"].get(source, {}).get(destination)
            if link and link["delivered_share"] is not None:
                share[i, m] = link["delivered_share"]
                late = messages.received_s[:, i, m] - messages.sent_s[:, m]
                delays[i][m] = late[~np.isnan(late)]
    data = NetworkFigureData(
        title=f"{scenario.name} · {document['packets']:,} messages on each link",
        subtitle=_worst(document) or f"seed {document['seed']}",
        names=names,
        share=share,
        delays_s=delays,
    )
    look.save(network_figure(data), path)


def _worst(document: Document) -> str:
    """Describe the link that delivered least, the latest of several; "" if all are alike."""
    from testbed.metrics.facts import percent
    from testbed.metrics.printed_tables import impairment, name_links

    links = name_links(document["links"])
    if len({impairment(link) for link in links.values()}) < 2:
        return ""
    name = max(links, key=lambda each: impairment(links[each]))
    delay, bursts = links[name]["delay_s"], links[name]["bursts"]
    parts = [f"{percent(links[name]['delivered_share'])} arrived"]
    if delay and delay["p95"] > 0.0:
        parts.append(f"95 % of these within {1e3 * delay['p95']:.1f} ms")
    if bursts["longest"] > 1:
        parts.append(f"up to {bursts['longest']:,} lost in a row")
    return f"worst link: {name}, {', '.join(parts)}"


def _check_rows(scenario: Scenario, packets: int) -> None:
    followers = len(scenario.aircraft_names) - 1
    links = followers * followers
    if not links:
        raise InputError(f"{scenario.name}: there are no followers, so no links; write a fleet")
    if links * packets > MAX_ROWS:
        raise InputError(
            f"--packets {packets}: {links} links make {links * packets:,} messages; write at most "
            f"{MAX_ROWS // links:,}"
        )


def _save(path: Path, names: Sequence[str], messages: MessageRecord) -> None:
    from testbed.cli.progress import progress_counter

    total, written = len(messages.outcome) * (len(names) - 1) ** 2, 0
    with (
        report_write_errors(f"--out {path}"),
        write_text_file(path) as file,
        progress_counter("network", total=total, unit="written") as update,
    ):
        file.write(HEADER)
        for m, source in enumerate(names):
            sent = [f"{k},{time!r}" for k, time in enumerate(messages.sent_s[:, m].tolist())]
            for i, destination in enumerate(names[1:]):
                if m != i + 1:
                    file.writelines(_rows(f"{source},{destination}", sent, messages, i, m))
                    written += len(sent)
                    update(written, total)


def _rows(link: str, sent: Sequence[str], messages: MessageRecord, i: int, m: int) -> Iterator[str]:
    """Rows of one link; floats are written with as many digits as restore them exactly."""
    from testbed.network.link_statistics import outcome_name
    from testbed.network.links import PacketOutcome

    ends = [
        [f"{outcome_name(outcome)},{copies}\n" for copies in range(3)] for outcome in PacketOutcome
    ]
    for start, received_s, outcome, copies in zip(
        sent,
        messages.received_s[:, i, m].tolist(),
        messages.outcome[:, i, m].tolist(),
        messages.copies[:, i, m].tolist(),
        strict=True,
    ):
        # NaN, which differs from itself: not received
        received = repr(received_s) if received_s == received_s else ""
        yield f"{link},{start},{received},{ends[outcome][copies]}"


def _print_summary(console: PipeSafeConsole, document: Document) -> None:
    from testbed.metrics.printed_tables import arrival_tables, fits_width, worst_links, wrap_lines
    from testbed.network.link_statistics import LOSSES, outcome_name

    together, links = document["all"], _link_count(document)
    console.print(
        Text.assemble(
            " ",
            (document["scenario"], "bold"),
            f" · {document['packets']:,} messages on each of {links} links"
            f" · seed {document['seed']}",
        )
    )
    listed = worst_links(document["links"])
    for table in arrival_tables(listed, together, fits_width(console)):
        console.print()
        console.print(table)
    outcomes = [key for key in (*map(outcome_name, LOSSES), *NOT_LOSSES) if _count(together, key)]
    count = COLUMNS if console.width >= 80 else NARROW_COLUMNS
    for first in range(0, len(outcomes), count):
        console.print()
        console.print(_count_table(listed, together, outcomes[first : first + count]))
    if len(listed) < links:
        console.print(Text(f" (the worst of {links} links)", style="dim"))
    if worst := _worst(document):
        console.print()
        for line in wrap_lines(worst, console.width - 1):
            console.write_line(f" {line}")


def _link_count(document: Document) -> int:
    return sum(len(receivers) for receivers in document["links"].values())


def _count_table(
    links: Mapping[str, LinkMetrics], together: LinkMetrics, keys: Sequence[str]
) -> Table:
    from testbed.metrics.printed_tables import link_table

    def cells(link: LinkMetrics) -> list[str]:
        return [f"{_count(link, key):,}" for key in keys]

    return link_table("link", keys, links, together, cells)


def _count(link: Mapping[str, Any], key: str) -> int:
    return int(link[key] if key in NOT_LOSSES else link["lost"].get(key, 0))
