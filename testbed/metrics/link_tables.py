"""Tables of a network's links: what arrived on each, and how late."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from rich import box
from rich.table import Table
from rich.text import Text

from testbed.metrics.document import Document
from testbed.metrics.facts import ABSENT, percent, select_largest

MAX_LINKS = 12  # listed one by one; of more, those that delivered least


def worst_links(links: Mapping[str, Mapping[str, Document]]) -> dict[str, Document]:
    """Return the links to list: all, or of many those that delivered least, in order.

    Args:
        links: statistics by sender and receiver.
    """
    named = name_links(links)
    worst = select_largest(named, lambda name: impairment(named[name]), MAX_LINKS)
    return {name: named[name] for name in worst}


def name_links(links: Mapping[str, Mapping[str, Document]]) -> dict[str, Document]:
    """Return statistics by link, "a > b", of those by sender and receiver."""
    return {
        f"{source} > {destination}": link
        for source, receivers in links.items()
        for destination, link in receivers.items()
    }


def impairment(link: Document) -> tuple[float, float]:
    """Return by what links are ordered: the share delivered, negated, then the delay, s."""
    share, delay = link["delivered_share"], link["delay_s"]
    return -(1.0 if share is None else share), (delay["p99"] if delay else 0.0)


def link_table(
    title: str,
    columns: Sequence[str],
    links: Mapping[str, Document],
    total: Document,
    cells: Callable[[Document], Sequence[str]],
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
    links: Mapping[str, Document],
    total: Document,
    fits: Callable[[Table], bool] = lambda table: True,
) -> list[Table]:
    """Make a table of what arrived on each link, how late, and of bursts of losses.

    Args:
        links: statistics by name.
        total: statistics of all links.
        fits: whether a table is narrow enough; if not, bursts get a table of their own.
    """

    def arrivals(link: Document) -> list[str]:
        delay = link["delay_s"]
        return [
            f"{link['sent']:,}",
            percent(link["delivered_share"]).removesuffix(" %"),
            *(ABSENT if delay is None else f"{1e3 * delay[p]:.1f}" for p in ("p50", "p95", "p99")),
        ]

    def bursts(link: Document) -> list[str]:
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
