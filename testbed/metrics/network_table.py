"""The links of a network as tables for people: what arrived on each, and how late."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from testbed.metrics.network import NOTHING, percent

MOST_LINKS = 12  # shown one by one; of more, the worst

Document = Mapping[str, Any]


def worst_links(links: Mapping[str, Mapping[str, Document]]) -> dict[str, Document]:
    """The links to show: all, or of many those that delivered least, in order.

    Args:
        links: numbers by sender and receiver.
    """
    named = {
        f"{source} > {destination}": link
        for source, receivers in links.items()
        for destination, link in receivers.items()
    }
    if len(named) <= MOST_LINKS:
        return named

    def goodness(name: str) -> tuple[float, float]:
        share, delay = named[name]["delivered_share"], named[name]["delay_s"]
        return (1.0 if share is None else share), -(delay["p99"] if delay else 0.0)

    worst = set(sorted(named, key=goodness)[:MOST_LINKS])
    return {name: link for name, link in named.items() if name in worst}


def link_table(
    title: str,
    columns: Sequence[str],
    links: Mapping[str, Document],
    together: Document,
    cells: Callable[[Document], Sequence[str]],
) -> Table:
    """A row for each link, and one for all together."""
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, collapse_padding=True, header_style="")
    # of all columns this one may be broken over lines: names can be long
    table.add_column(Text(title, style="bold"))
    for name in columns:
        table.add_column(name, justify="right", no_wrap=True)
    for name, link in links.items():
        table.add_row(name, *cells(link))
    table.add_section()
    table.add_row("all", *cells(together))
    return table


def arrival_table(links: Mapping[str, Document], together: Document) -> Table:
    """What arrived on each link, how late, and how many in a row did not."""

    def cells(link: Document) -> list[str]:
        delay, bursts = link["delay_s"], link["bursts"]
        return [
            f"{link['sent']:,}",
            percent(link["delivered_share"]).removesuffix(" %"),
            *(NOTHING if delay is None else f"{1e3 * delay[p]:.1f}" for p in ("p50", "p95", "p99")),
            NOTHING if bursts["mean"] is None else f"{bursts['mean']:.2f}",
            f"{bursts['longest']:,}",
        ]

    late = ("delay\np50, ms", "\np95", "\np99")
    columns = ("\nsent", "arrived\n%", *late, "in a row lost\nmean", "\nmost")
    return link_table("\nlink", columns, links, together, cells)
