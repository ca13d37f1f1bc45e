"""Write tables and figure of docs/network.md: loss, latency, partitions and MAVLink messages.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from inputs import Case, Inputs
from tables import COMMAND, Metrics, draw, row, versions, write_tables

from testbed.views.panels import BLUE, DASHED, GREEN, ORANGE, Band, Line, Panel, PanelGrid

FIGURE = Path(__file__).parents[1] / "docs" / "images" / "network-loss-latency.png"
LOSSES = (0.0, 0.15, 0.3, 0.5)
STYLES = ((ORANGE, "s"), (BLUE, "o"), (GREEN, "^"))  # of the extrapolations
DELAYS = (0.0, 0.1, 0.2, 0.35, 0.5)  # s
EXTRAPOLATIONS = {
    "from receipt, as [HBH23] sec. 8.3": ("controller.extrapolate_from=receipt",),
    "from the time stamp": (),
    "from the time stamp, along a parabola": ("controller.estimators.extrapolation=acceleration",),
}
GRID = {
    (extrapolation, loss, delay): Case(
        "loss-and-latency",
        (f"network.loss.probability={loss}", f"network.delay_s={delay}", *keys),
    )
    for extrapolation, keys in EXTRAPOLATIONS.items()
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
    "loiter after 2 s": (),
    "straight after 2 s": ("controller.on_leader_timeout=straight",),
    "straight after 5 s": (
        "controller.leader_timeout_s=5",
        "controller.on_leader_timeout=straight",
    ),
}
PARTITION_END_S = 324.0
DIVIDED = {
    (groups, policy): Case("partition-and-heal", (f"network.partitions.0.groups={value}", *keys))
    for groups, value in GROUPS.items()
    for policy, keys in POLICIES.items()
}

RADIO = "telemetry-radio"
EXACT = ("network.encoding=exact", "network.corrupt=0.01")
# By encoding and radio.
ENCODED = {
    ("exact", "perfect, 25 Hz"): Case("simulation-3"),
    ("FOLLOW_TARGET", "perfect, 25 Hz"): Case("simulation-3", ("network.encoding=follow-target",)),
    ("FOLLOW_TARGET", "57.6 kbit/s, TDMA frame of 0.1 s, 10 Hz"): Case(RADIO),
    ("exact, 105 bytes", "57.6 kbit/s, TDMA frame of 0.1 s, 10 Hz"): Case(
        RADIO, (*EXACT, "network.message_bytes=105")
    ),
    ("exact, 40 bytes", "57.6 kbit/s, TDMA frame of 0.04 s, 25 Hz"): Case(
        RADIO,
        (*EXACT, "network.message_bytes=40", "network.tdma.frame_s=0.04", "rates.broadcast_hz=25"),
    ),
    ("FOLLOW_TARGET", "57.6 kbit/s, TDMA frame of 0.1 s, 25 Hz"): Case(
        RADIO, ("rates.broadcast_hz=25",)
    ),
    ("FOLLOW_TARGET, from receipt", "57.6 kbit/s, TDMA frame of 0.1 s, 10 Hz"): Case(
        RADIO, ("controller.extrapolate_from=receipt",)
    ),
}


def mean_error(flight: Metrics) -> float:
    """Return the mean of the RMS errors over windows and followers, m."""
    return float(np.mean([part["mean_rms_m"] for part in flight["windows"].values()]))


def grid_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of errors by loss and latency."""
    yield row("extrapolated", "loss", *(f"{delay:g} s" for delay in DELAYS))
    yield "|---|--:|" + "--:|" * len(DELAYS)
    for extrapolation in EXTRAPOLATIONS:
        for loss in LOSSES:
            errors = [mean_error(flown[GRID[extrapolation, loss, delay]]) for delay in DELAYS]
            yield row(extrapolation, f"{100 * loss:g} %", *(f"{error:.2f}" for error in errors))


def divided_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of errors and recovery after a partition."""
    yield row("groups", "on leader timeout", "largest error, m", "all in slot after, s",
              "smallest separation, m")  # fmt: skip
    yield "|---|---|--:|--:|--:|"
    for (groups, policy), case in DIVIDED.items():
        flight = flown[case]
        back = max(each["in_slot_since_s"] for each in flight["recovery"].values())
        parts = [flight["windows"][name] for name in ("divided", "returning")]
        largest = max(max(part["max_error_m"].values()) for part in parts)
        yield row(groups, policy, f"{largest:.0f}", f"{max(back - PARTITION_END_S, 0.0):.0f}",
                  f"{flight['min_separation_m']:.1f}")  # fmt: skip


def encoded_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of errors by encoding and radio."""
    yield row("messages", "radio", "delivered", "mean delay, ms", "rectangles, m", "circles, m")
    yield "|---|---|--:|--:|--:|--:|"
    for (messages, radio), case in ENCODED.items():
        radio_metrics = flown[case]["network"]["all"]
        errors = (
            " / ".join(f"{error:.3f}" for error in part["rms_m"].values())
            for part in flown[case]["windows"].values()
        )
        yield row(messages, radio, f"{100 * radio_metrics['delivered_share']:.1f} %",
                  f"{1e3 * radio_metrics['delay_s']['mean']:.0f}", *errors)  # fmt: skip


def figure(flown: Mapping[Case, Metrics]) -> PanelGrid:
    """Return the figure: error against latency by extrapolation, from no loss to the most."""
    delays, losses = np.array(DELAYS), list(LOSSES)
    least, most = losses[0], losses[-1]
    lines, bands = [], []
    for extrapolation, (colour, marker) in zip(EXTRAPOLATIONS, STYLES, strict=True):
        low, high = (
            np.array([mean_error(flown[GRID[extrapolation, loss, delay]]) for delay in DELAYS])
            for loss in (least, most)
        )
        lines.append(Line(delays, low, colour, extrapolation, 2.0, marker=marker, marks=0))
        lines.append(Line(delays, high, colour, width=1.2, dashes=DASHED))
        bands.append(Band(delays, low, high, colour))
    panel = Panel(
        "", "latency, s", "mean RMS error, m", lines, bands, y_log=True,
        x_limits=(0.0, DELAYS[-1]), y_limits=(0.3, 20.0),
    )  # fmt: skip
    return PanelGrid(
        "Simulation 3 with loss and latency",
        "Mean of the followers' RMS errors over rectangles and circles; solid: no message lost, "
        f"dashed: {100 * most:g} % lost",
        [[panel]],
        [1.0],
        (13.0, 6.0),
    )


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """Return the tables as Markdown lines, and draw the figure."""
    draw(figure(flown), FIGURE)
    return [
        f"Flown with {versions(flown)}.",
        "",
        "Mean RMS error in m by loss and latency (scenario `loss-and-latency`):",
        "",
        *grid_table(flown),
        "",
        "![Mean RMS error against latency with and without loss](images/network-loss-latency.png)",
        "",
        "After 20 s of a divided network (`partition-and-heal` with other groups and timeouts):",
        "",
        *divided_table(flown),
        "",
        "RMS errors of the three followers by encoding and radio (scenarios `simulation-3` and "
        "`telemetry-radio`):",
        "",
        *encoded_table(flown),
    ]


INPUTS = {COMMAND: Inputs((*GRID.values(), *DIVIDED.values(), *ENCODED.values()))}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, {COMMAND: text})
