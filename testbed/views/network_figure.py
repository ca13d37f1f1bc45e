"""The figure of `testbed network`: what arrived on each link, and how late."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.views.panels import BLUE, GREY, ORANGE, Heatmap, Line, Panel, PanelGrid

MAX_NAMED = 12  # aircraft whose names and numbers fit beside the cells
POINTS = 400  # of a distribution
SHOWN_SHARE = 0.99  # of the delays lies within the axis


@dataclass(frozen=True, slots=True)
class NetworkFigureData:
    """Messages of N aircraft to n followers.

    Args:
        title: of the figure.
        subtitle: below it.
        names: N, the leader first.
        share: (n, N) 0..1, messages that arrived of those sent; NaN: no link.
        delays_s: (n, N) of arrays: delays of the messages that arrived, s; empty without a link.
    """

    title: str
    subtitle: str
    names: Sequence[str]
    share: Array
    delays_s: Sequence[Sequence[Array]]


def network_figure(data: NetworkFigureData) -> PanelGrid:
    """Lay out arrived share, delay and distribution of delays of the links."""
    late = np.array(
        [[_quantile(each, 0.95) for each in by_sender] for by_sender in data.delays_s], dtype=float
    )
    most = float(np.nanmax(late, initial=0.0))
    rows = [
        [
            _map(data, "messages that arrived", 100.0 * data.share, (0.0, 100.0), "%"),
            _map(data, "delay of 95 % of these at most", late, (0.0, most or 1.0), "ms"),
            _distributions(data, late),
        ]
    ]
    return PanelGrid(data.title, data.subtitle, rows, (1.0, 1.0, 1.15), (17.0, 6.6))


def worst_and_best(share: Array, late: Array) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return receiver and sender of the links with the worst and the best delivery.

    Of links that delivered the same share, the later one is worse.

    Args:
        share: (n, N) 0..1; NaN: no link.
        late: (n, N) delay, any unit; NaN: nothing arrived.
    """
    receivers, senders = np.nonzero(np.isfinite(share))
    delay = np.where(np.isnan(late), np.inf, late)[receivers, senders]
    order = np.lexsort((-delay, share[receivers, senders]))
    links = [(int(receivers[k]), int(senders[k])) for k in (order[0], order[-1])]
    return links[0], links[1]


def _quantile(delays_s: Array, part: float) -> float:
    """Return a quantile of delays, ms; NaN without any."""
    return float(1e3 * np.quantile(delays_s, part)) if len(delays_s) else np.nan


def _map(
    data: NetworkFigureData, title: str, values: Array, limits: tuple[float, float], unit: str
) -> Panel:
    """Draw a number of each link as a cell: senders from left to right, receivers below."""
    names, (n, aircraft) = data.names, values.shape
    small = aircraft <= MAX_NAMED
    shown = values[::-1]
    texts = [["–" if np.isnan(v) else f"{v:.3g}" for v in row] for row in shown] if small else ()
    step = 1 if small else -(-aircraft // MAX_NAMED)
    across = 1 if small else 2 * step  # names are wider than high
    return Panel(
        "",
        "sender",
        "receiver",
        heat=Heatmap(shown, limits, f"{title}, {unit}", texts),
        x_ticks=[(k + 0.5, names[k]) for k in range(0, aircraft, across)],
        y_ticks=[(n - i - 0.5, names[i + 1]) for i in range(0, n, step)],
        note="no messages",
    )


def _distributions(data: NetworkFigureData, late: Array) -> Panel:
    """Draw the share of messages that arrived within a time: worst and best link, the others grey.

    Curves end at the share that arrived at all.
    """
    links = [(int(i), int(m)) for i, m in np.argwhere(np.isfinite(data.share))]
    ends = [_quantile(data.delays_s[i][m], SHOWN_SHARE) for i, m in links]
    end = max(1.0, 1.1 * float(np.nanmax(ends, initial=0.0)))
    lines: list[Line] = []
    if links:
        worst, best = worst_and_best(data.share, late)
        marked = {worst: (ORANGE, "worst", "o"), best: (BLUE, "best", "s")}
        if len({(data.share[link], late[link]) for link in links}) == 1:
            marked = {best: (BLUE, "all links", "s")}
            links = []
        others = [link for link in links if link not in marked]
        for number, (i, m) in enumerate(others):
            lines.append(_curve(data, i, m, end, GREY, "" if number else "other links", ""))
        for (i, m), (colour, word, marker) in marked.items():
            name = f"{word}: {data.names[m]} > {data.names[i + 1]}" if links else word
            lines.append(_curve(data, i, m, end, colour, name, marker))
    return Panel(
        "",
        "time since the message was sent, ms",
        "messages that arrived, %",
        lines,
        x_limits=(-0.02 * end, end),
        y_limits=(0.0, 103.0),
        note="no links",
    )


def _curve(
    data: NetworkFigureData, i: int, m: int, end: float, colour: str, name: str, marker: str
) -> Line:
    share, delays = 100.0 * float(data.share[i, m]), data.delays_s[i][m]
    parts = np.linspace(0.0, 1.0, POINTS)
    times = 1e3 * np.quantile(delays, parts) if len(delays) else np.zeros(POINTS)
    x = np.concatenate(([times[0]], times, [max(end, times[-1])]))
    y = share * np.concatenate(([0.0], parts, [1.0]))
    return Line(x, y, colour, name, 2.0 if marker else 1.0, marker=marker, marks=6)
