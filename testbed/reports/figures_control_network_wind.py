"""Figures of commands, network, wind and estimates."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array
from testbed.metrics.ringing import needed_bank
from testbed.metrics.summary import CALM_MPS
from testbed.reports.figure_spec import (
    FigureSpec,
    TimeAxis,
    bound_lines,
    padded_limits,
    samples_on_axis,
    stack,
)
from testbed.reports.plot_selection import (
    MAX_SINGLE,
    STYLES,
    DrawnFollower,
    PlotSelection,
    decimate,
    follower_curves,
    percentile_bands,
)
from testbed.reports.run_data import RunData
from testbed.views.panels import BLACK, GREY, Band, Line, Panel
from testbed.views.quantities import PLOTTED

DELIVERY_WINDOW_S = 10.0  # of the share of delivered messages
AGE_INTERVALS = 100
MAX_LINKS = 4  # drawn one by one


def commands(run: RunData, selection: PlotSelection) -> FigureSpec:
    """Draw bank with its limits, the bank that the slots need, pitch and throttle."""
    log, axis = run.log, TimeAxis(run, selection)
    limits = np.degrees(log.info.roll_limit_rad)
    bounds = bound_lines(log.time_s, np.stack((-limits, limits)), "bank limits")
    panels = [axis.quantity("bank", also=bounds)]
    needs_bank = bool(run.followers) and len(log.time_s) > 2
    if needs_bank:
        panels.append(_needed_bank(run, axis, bounds))
    panels += [axis.quantity("pitch"), axis.quantity("throttle")]
    caption = (
        "Solid: actual bank and pitch, and the commanded throttle; dashed: the fly-by-wire-A"
        " commands; dotted lines: the limits of the bank command."
    )
    if needs_bank:
        caption += (
            " Second panel, dashed: the bank of a coordinated turn with which the follower would"
            " fly its slot exactly."
        )
    rows = stack(panels)
    return FigureSpec("Bank, pitch and throttle", caption + axis.note, rows, 2.4 * len(rows))


def _needed_bank(run: RunData, axis: TimeAxis, bounds: list[Line]) -> Panel:
    """Make the panel of the followers' banks, beside those that the slots need."""
    log, time = run.log, run.log.time_s
    bank = run.mask_lost(PLOTTED["bank"].values(log))[:, 1:]
    needed = np.full(bank.shape, np.nan)
    formation, wind_ned = log.formation, log.air.wind_ned[:, 1:]
    needed[1:-1] = np.degrees(needed_bank(time, formation.slot_ned, formation.slot_index, wind_ned))
    # in turbulence the slots of a disturbed leader need far larger banks than are flown
    limits = padded_limits([bank, *(line.y for line in bounds)])
    return axis.curves(
        bank, run.mask_lost(needed), also=bounds, y_degrees=True, y_limits=limits,
        y_label="bank, and that of the slot, °",
    )  # fmt: skip


def network(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw the ages of the messages used, and the share of messages delivered."""
    log, axis, oldest = run.log, TimeAxis(run, selection), PLOTTED["age"]
    age = oldest.values(log)
    sent = log.links.sent.astype(np.float64)
    missing = sent - log.links.delivered
    if not np.nanmax(age, initial=0.0) > 0.0 and not missing.any():
        return None
    at, mean, largest = interval_statistics(log.time_s, age)
    panels = []
    for words, values in (("mean", mean), ("largest", largest)):
        lines = [*follower_curves(at, values, selection)]
        label = f"{words} {oldest.label()}"
        panels.append(axis.panel(label, lines, percentile_bands(at, values, selection)))
    caption = (
        "Age of the oldest message that a follower used: mean, and below the largest, over each of"
        f" {AGE_INTERVALS} equal intervals."
    )
    if missing.any():
        lines, bands = _delivered_shares(run, sent, missing)
        label = f"delivered in the last {DELIVERY_WINDOW_S:g} s, %"
        panels.append(axis.panel(label, lines, bands, y_limits=(-3.0, 103.0)))
        caption += (
            f" Below: the share of the messages sent in the last {DELIVERY_WINDOW_S:g} s that"
            " arrived; thick: all links together; coloured: the links that delivered least;"
            " grey: from the worst to the best link."
        )
    return FigureSpec("Network", caption, stack(panels), 2.5 * len(panels) + 0.3)


def wind(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw the wind at each aircraft."""
    wind_ned = np.where(run.log.lost[..., None], np.nan, run.log.air.wind_ned)
    if np.nanmax(np.abs(wind_ned), initial=0.0) < CALM_MPS:
        return None
    axis = TimeAxis(run, selection)
    panels = [axis.quantity("wind"), axis.quantity("updraught")]
    caption = (
        "Velocity of the air at each aircraft, averaged over its wing: mean wind, turbulence,"
        " gusts and wakes."
    )
    return FigureSpec("Wind", caption + axis.note, stack(panels), 5.2)


def estimates(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw the position errors of estimates, and the formation error by them."""
    log, axis = run.log, TimeAxis(run, selection)
    if log.estimate is log.truth:
        return None
    panels = [axis.quantity("estimate_horizontal"), axis.quantity("estimate_height")]
    caption = "Errors of the aircraft's own estimates."
    if run.followers:
        estimated = np.sqrt(np.sum(log.formation.estimated_error_ned**2, axis=-1))
        estimated, error = run.mask_lost(estimated), run.error
        on_axis, note = samples_on_axis(run)
        limits = padded_limits([np.where(on_axis, each, np.nan) for each in (estimated, error)])
        panels.append(
            axis.curves(
                error, estimated, y_label="‖q̃‖, true and estimated, m", y_limits=limits
            )
        )  # fmt: skip
        caption += " Below: the formation error, true (solid) and by the estimates (dashed)." + note
    rows = stack(panels)
    return FigureSpec("Estimates", caption + axis.note, rows, 2.4 * len(rows) + 0.2)


def interval_statistics(time: Array, values: Array) -> tuple[Array, Array, Array]:
    """Compute mean and maximum over `AGE_INTERVALS` equal intervals of a run.

    Args:
        time: (K,) s.
        values: (K, n); NaN is left out.

    Returns:
        Mean times (m,), means (m, n) and maxima (m, n), with m at most `AGE_INTERVALS`.
    """
    samples = max(-(-len(time) // AGE_INTERVALS), 1)
    padding = -len(time) % samples  # of the last interval
    blocks = np.pad(values, ((0, padding), (0, 0)), constant_values=np.nan)
    blocks = blocks.reshape(-1, samples, values.shape[1])
    count = np.isfinite(blocks).sum(axis=1)
    total = np.nansum(blocks, axis=1)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    mean_time = np.nanmean(
        np.pad(time, (0, padding), constant_values=np.nan).reshape(-1, samples), axis=1
    )
    return mean_time, mean, np.fmax.reduce(blocks, axis=1)


def _delivered_shares(
    run: RunData, sent: Array, missing: Array
) -> tuple[list[Line], tuple[Band, ...]]:
    """Make curves of the share of messages delivered, percent, over a moving window.

    Args:
        run: the run.
        sent: (K, n, N) messages since the start. A log counts them from the first loss on; they
            are zero before, when all messages arrived.
        missing: (K, n, N) of these, the ones that do not arrive.
    """
    log, names = run.log, run.log.info.names
    samples = max(round(DELIVERY_WINDOW_S * log.info.sample_rate_hz), 1)
    window_start = np.maximum(np.arange(log.tick.size) - samples, 0)
    counted = sent.sum(axis=(1, 2)) > 0.0
    # the first windows hold too few messages for a share
    early = np.arange(log.tick.size) < min(samples, log.tick.size // 2)

    def share(sent: Array, missing: Array) -> Array:
        """Compute the share over the window from cumulative counts (K, ...)."""
        lost, total = missing - missing[window_start], sent - sent[window_start]
        known = (counted & counted[window_start]).reshape(-1, *[1] * (sent.ndim - 1))
        delivered = 100.0 * (1.0 - lost / np.maximum(total, 1.0))
        out = np.where(known & (total > 0.0), delivered, np.nan)
        out = np.where(~known & (lost == 0.0), 100.0, out)
        out[early] = np.nan
        return out

    all_links = share(sent.sum(axis=(1, 2)), missing.sum(axis=(1, 2)))
    # links by receiver and sender; no link from an aircraft to itself
    links = [
        (missing[-1, i, j] / sent[-1, i, j], i, j)
        for i in range(sent.shape[1])
        for j in range(sent.shape[2])
        if sent[-1, i, j] > 0.0
    ]
    by_link = share(sent, missing).reshape(len(sent), -1)
    columns = np.array([i * sent.shape[2] + j for _, i, j in links])
    lines: list[Line] = []
    worst = sorted(links, key=lambda link: -link[0])[: MAX_LINKS if len(links) > 1 else 0]
    for k, (_, i, j) in enumerate(sorted(worst, key=lambda link: link[1:])):
        style = STYLES[MAX_SINGLE + k]  # of no follower
        curve = DrawnFollower(0, f"{names[j]} > {names[i + 1]}", *style, phase=k / MAX_LINKS)
        values = by_link[:, i * sent.shape[2] + j][:, None]
        lines += follower_curves(log.time_s, values, PlotSelection((curve,), 0))
    at = decimate(all_links)
    lines.append(Line(log.time_s[at], all_links[at], BLACK, "all links", 1.6))
    low = np.fmin.reduce(by_link[:, columns], axis=1)
    high = np.fmax.reduce(by_link[:, columns], axis=1)
    at = decimate(low, high)
    return lines, (Band(log.time_s[at], low[at], high[at], GREY, "worst to best link"),)
