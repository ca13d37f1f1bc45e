"""Tables and figure of docs/network.md: what loss, latency, divided networks and MAVLink do.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from tables import Case, Metrics, row, versions, write_tables

from testbed.views.figure_door import draw
from testbed.views.panels import BLACK, BLUE, GREEN, ORANGE, Line, Panel, Sheet

FIGURE = Path(__file__).parents[1] / "docs" / "images" / "network-loss-latency.png"
LOSSES = {0.0: BLACK, 0.15: BLUE, 0.3: GREEN, 0.5: ORANGE}
DELAYS = (0.0, 0.1, 0.2, 0.35, 0.5)  # s
WAYS = {
    "from receipt, as [HBH23] sec. 8.3": ("controller.extrapolate_from=receipt",),
    "from the timestamp": (),
    "from the timestamp, along a parabola": ("controller.estimators.extrapolation=acceleration",),
}
GRID = {
    (way, loss, delay): Case(
        "loss-and-latency",
        (f"network.loss.probability={loss}", f"network.delay_s={delay}", *keys),
    )
    for way, keys in WAYS.items()
    for loss in LOSSES
    for delay in DELAYS
}
GROUPS = {
    "leader uav1 / uav2 uav3": "[[leader, uav1], [uav2, uav3]]",
    "leader / uav1 uav2 uav3": "[[leader]]",
    "leader / uav1 / uav2 / uav3": "[[leader], [uav1], [uav2], [uav3]]",
    "leader uav2 uav3 / uav1": "[[uav1]]",
}
POLICIES = {
    "a circle after 2 s": (),
    "straight on after 2 s": ("controller.silence.then=straight",),
    "straight on after 5 s": ("controller.silence={after_s: 5, then: straight}",),
}
HEALS_S, BEGINS_S = 330.0, 310.0
DIVIDED = {
    (groups, policy): Case("partition-and-heal", (f"network.partitions.0.groups={said}", *keys))
    for groups, said in GROUPS.items()
    for policy, keys in POLICIES.items()
}

RADIO = "telemetry-radio"
EXACT = ("network.encoding=exact", "network.corrupt=0.01")
# What is said, and on which radio.
ENCODED = {
    ("every digit", "perfect, 25 Hz"): Case("simulation-3"),
    ("FOLLOW_TARGET", "perfect, 25 Hz"): Case("simulation-3", ("network.encoding=follow-target",)),
    ("FOLLOW_TARGET", "57.6 kbit/s in turns of 0.1 s, 10 Hz"): Case(RADIO),
    ("every digit, 105 bytes", "57.6 kbit/s in turns of 0.1 s, 10 Hz"): Case(
        RADIO, (*EXACT, "network.message_bytes=105")
    ),
    ("every digit, 40 bytes", "57.6 kbit/s in turns of 0.04 s, 25 Hz"): Case(
        RADIO,
        (*EXACT, "network.message_bytes=40", "network.tdma.frame_s=0.04", "rates.broadcast_hz=25"),
    ),
    ("FOLLOW_TARGET", "57.6 kbit/s in turns of 0.1 s, 25 Hz"): Case(
        RADIO, ("rates.broadcast_hz=25",)
    ),
    ("FOLLOW_TARGET, from receipt", "57.6 kbit/s in turns of 0.1 s, 10 Hz"): Case(
        RADIO, ("controller.extrapolate_from=receipt",)
    ),
}


def mean_error(flight: Metrics) -> float:
    """Mean of the RMS errors over portions and followers, m."""
    return float(np.mean([part["mean_rms_m"] for part in flight["portions"].values()]))


def grid_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Error against loss and latency."""
    yield row("extrapolated", "loss", *(f"{delay:g} s" for delay in DELAYS))
    yield "|---|--:|" + "--:|" * len(DELAYS)
    for way in WAYS:
        for loss in LOSSES:
            errors = [mean_error(flown[GRID[way, loss, delay]]) for delay in DELAYS]
            yield row(way, f"{100 * loss:g} %", *(f"{error:.2f}" for error in errors))


def divided_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """How long a formation takes to come together again."""
    yield row("who hears whom", "without the leader", "largest error, m", "back after, s",
              "smallest separation, m")  # fmt: skip
    yield "|---|---|--:|--:|--:|"
    for (groups, policy), case in DIVIDED.items():
        flight = flown[case]
        back = max(each["inside_for_good_from_s"] for each in flight["recovery"].values())
        parts = [flight["portions"][name] for name in ("divided", "returning")]
        largest = max(max(part["max_error_m"].values()) for part in parts)
        yield row(groups, policy, f"{largest:.0f}", f"{max(back - HEALS_S, 0.0):.0f}",
                  f"{flight['min_separation_m']:.1f}")  # fmt: skip


def encoded_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Error by what a message says and how long it takes."""
    yield row(
        "messages", "radio", "delivered", "late in the mean, ms", "rectangles, m", "circles, m"
    )
    yield "|---|---|--:|--:|--:|--:|"
    for (messages, radio), case in ENCODED.items():
        radioed = flown[case]["network"]["all"]
        errors = (
            " / ".join(f"{error:.3f}" for error in part["rms_m"].values())
            for part in flown[case]["portions"].values()
        )
        yield row(messages, radio, f"{100 * radioed['delivered_share']:.1f} %",
                  f"{1e3 * radioed['delay_s']['mean']:.0f}", *errors)  # fmt: skip


def figure(flown: Mapping[Case, Metrics]) -> Sheet:
    """Error against latency, a curve for each loss, a panel for each way to extrapolate."""
    delays = np.array(DELAYS)

    def panel(way: str) -> Panel:
        curves = [
            Line(
                delays,
                np.array([mean_error(flown[GRID[way, loss, delay]]) for delay in DELAYS]),
                colour,
                f"{100 * loss:g} % lost",
                2.0,
            )
            for loss, colour in LOSSES.items()
        ]
        return Panel(
            way, "latency, s", "mean RMS error, m", curves, y_log=True,
            x_limits=(0.0, DELAYS[-1]), y_limits=(0.2, 20.0),
        )  # fmt: skip

    return Sheet(
        "What loss and latency do to Simulation 3",
        "Mean of the followers' RMS errors over rectangles and circles; 25 messages per second, "
        "each lost by itself",
        [[panel(way) for way in WAYS]],
        [1.0] * len(WAYS),
    )


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """The tables; the figure is drawn beside."""
    draw(figure(flown), FIGURE)
    return [
        f"Flown with {versions(flown)}.",
        "",
        "Mean RMS error in m by loss and latency (scenario `loss-and-latency`):",
        "",
        *grid_table(flown),
        "",
        "![Mean RMS error against latency for four rates of loss](images/network-loss-latency.png)",
        "",
        "After 20 s of a divided network (scenario `partition-and-heal` and its like):",
        "",
        *divided_table(flown),
        "",
        "RMS errors of the three followers by what is in a message (scenarios `simulation-3` and "
        "`telemetry-radio`):",
        "",
        *encoded_table(flown),
    ]


if __name__ == "__main__":
    write_tables(__doc__ or "", [*GRID.values(), *DIVIDED.values(), *ENCODED.values()], text)
