"""Figures of what the aircraft were told, heard, felt and believed."""

from __future__ import annotations

import numpy as np

from testbed.metrics.wind import CALM
from testbed.report.cast import LEADER, LOOKS, Cast, Part, bands, curves, wishes
from testbed.report.drawing import Drawing, TimeAxis, limits_at, masked, settled, span_of
from testbed.report.flight import Flight
from testbed.report.thinning import kept
from testbed.state import Array
from testbed.views.panels import BLACK, GREY, Band, Line

WINDOW_S = 10.0  # over which the share of messages delivered is taken
STRETCHES = 100
LINKS = 4  # those that delivered least


def commands(flight: Flight, cast: Cast) -> Drawing:
    """Bank with its limits, pitch and throttle."""
    log, axis, time = flight.log, TimeAxis(flight), flight.log.time_s
    own = np.where(log.lost, np.nan, 1.0)
    bank, pitch = (np.degrees(log.truth.euler[..., k]) * own for k in (0, 1))
    told = [np.degrees(each) * own for each in (log.command.roll, log.command.pitch)]
    rows = []
    quantities = (
        ("bank", "bank, °", bank, told[0]),
        ("pitch", "pitch, °", pitch, told[1]),
        ("throttle as commanded", "throttle, %", 100.0 * log.command.throttle * own, None),
    )
    for title, unit, actual, wanted in quantities:
        at = kept(actual[:, 0])
        lines = [Line(time[at], actual[at, 0], LEADER, log.info.names[0], 0.9)]
        lines += curves(time, actual[:, 1:], cast)
        if wanted is not None:
            lines += wishes(time, wanted[:, 1:], cast)
        if title == "bank":
            limits = np.degrees(log.info.roll_limit_rad)
            lines += limits_at(time, np.stack((-limits, limits)), "bank limits")
        area = bands(time, actual[:, 1:], cast)
        rows.append([axis.panel(title, unit, lines, area, last=wanted is None)])
    return Drawing(
        "Bank, pitch and throttle",
        "Solid: actual bank and pitch, and the throttle as commanded; dashed: the commands of"
        " fly-by-wire A; thin plain lines: the limits of the bank command." + axis.said,
        rows,
        7.2,
    )


def network(flight: Flight, cast: Cast) -> Drawing | None:
    """The age of what followers used, and the share of the messages that arrived."""
    log, axis, time = flight.log, TimeAxis(flight), flight.log.time_s
    age = 1e3 * np.fmax.reduce(log.formation.age_s, axis=-1)
    sent = log.links.sent.astype(np.float64)
    missing = sent - log.links.delivered
    if not np.nanmax(age, initial=0.0) > 0.0 and not missing.any():
        return None
    at, mean, most = _windows(time, age)
    title = "age of the oldest message in use"
    lines, area = [*curves(at, mean, cast), *wishes(at, most, cast)], bands(at, mean, cast)
    rows = [[axis.panel(title, "age, ms", lines, area, last=not missing.any())]]
    text = (
        "Age of the oldest message that a follower used: mean, and dashed the largest, of one"
        " after the other of a hundred stretches of the run."
    )
    if missing.any():
        lines, area = _shares(flight, sent, missing)
        title = f"delivered of what was sent in the last {WINDOW_S:g} s"
        rows.append([axis.panel(title, "share, %", lines, area, last=True, y_limits=(-3.0, 103.0))])
        text += (
            f" Below: the share of the messages sent in the last {WINDOW_S:g} s that arrived;"
            " thick: all links together; coloured: the links that delivered least;"
            " grey: from the worst to the best link."
        )
    return Drawing("Network", text, rows, 2.5 * len(rows) + 0.3)


def wind(flight: Flight, cast: Cast) -> Drawing | None:
    """The wind each aircraft felt."""
    log, axis, time = flight.log, TimeAxis(flight), flight.log.time_s
    air = np.where(log.lost[..., None], np.nan, log.air.wind_ned)
    if np.nanmax(np.abs(air), initial=0.0) < CALM:
        return None
    level, rising = np.hypot(air[..., 0], air[..., 1]), -air[..., 2]
    rows = []
    for title, unit, values in (
        ("horizontal wind felt", "speed, m/s", level),
        ("vertical wind felt", "upwards, m/s", rising),
    ):
        at = kept(values[:, 0])
        lines = [Line(time[at], values[at, 0], LEADER, log.info.names[0], 0.9)]
        lines += curves(time, values[:, 1:], cast)
        area = bands(time, values[:, 1:], cast)
        rows.append([axis.panel(title, unit, lines, area, last=values is rising)])
    text = (
        "Velocity of the air at each aircraft, averaged over its wing: turbulence, gusts and wakes."
    )
    return Drawing("Wind felt", text + axis.said, rows, 5.2)


def estimates(flight: Flight, cast: Cast) -> Drawing | None:
    """How far aircraft were from where they believed to be."""
    log, axis, time = flight.log, TimeAxis(flight), flight.log.time_s
    if log.estimate is log.truth:
        return None
    off = np.where(log.lost[..., None], np.nan, log.estimate.position_ned - log.truth.position_ned)
    level, height = np.hypot(off[..., 0], off[..., 1]), -off[..., 2]
    rows = []
    for title, unit, values in (
        ("horizontal position, estimate less truth", "distance, m", level),
        ("height, estimate less truth", "height, m", height),
    ):
        at = kept(values[:, 0])
        lines = [Line(time[at], values[at, 0], LEADER, log.info.names[0], 0.9)]
        lines += curves(time, values[:, 1:], cast)
        area = bands(time, values[:, 1:], cast)
        rows.append([axis.panel(title, unit, lines, area, last=not flight.followers)])
    text = "Error of the aircraft's own estimates."
    if flight.followers:
        believed = np.sqrt(np.sum(log.formation.believed_ned**2, axis=-1))
        believed = masked(flight, believed)
        held, said = settled(flight)
        limits = span_of([np.where(held, each, np.nan) for each in (believed, flight.error)])
        lines = [*curves(time, flight.error, cast), *wishes(time, believed, cast)]
        area = bands(time, flight.error, cast)
        title = "‖q̃‖, true and believed"
        rows.append([axis.panel(title, "‖q̃‖, m", lines, area, last=True, y_limits=limits)])
        text += " Below: the formation error, solid, and what everyone believed it to be, dashed."
        text += said
    return Drawing("Estimates", text + axis.said, rows, 2.4 * len(rows) + 0.2)


def _windows(time: Array, values: Array) -> tuple[Array, Array, Array]:
    """Of `STRETCHES` stretches of the run their middle, and mean and maximum (., n) of (K, n)."""
    frames = max(-(-len(time) // STRETCHES), 1)
    lacking = -len(time) % frames  # of the last stretch
    each = np.pad(values, ((0, lacking), (0, 0)), constant_values=np.nan)
    each = each.reshape(-1, frames, values.shape[1])
    count = np.isfinite(each).sum(axis=1)
    total = np.nansum(each, axis=1)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    middle = np.nanmean(
        np.pad(time, (0, lacking), constant_values=np.nan).reshape(-1, frames), axis=1
    )
    return middle, mean, np.fmax.reduce(each, axis=1)


def _shares(flight: Flight, sent: Array, missing: Array) -> tuple[list[Line], tuple[Band, ...]]:
    """Shares of the messages delivered, in percent, over a moving window.

    A log counts messages from the first loss on; before, everything arrived.

    Args:
        flight: the run.
        sent: (K, n, N) messages since the start; zero before the log tells of them.
        missing: (K, n, N) of these, those that do not arrive.
    """
    log, names = flight.log, flight.log.info.names
    frames = max(round(WINDOW_S * log.info.frame_rate_hz), 1)
    back = np.maximum(np.arange(log.tick.size) - frames, 0)
    told = sent.sum(axis=(1, 2)) > 0.0
    young = np.arange(log.tick.size) < min(frames, log.tick.size // 2)  # of few messages

    def share(sent: Array, missing: Array) -> Array:
        """Of cumulative counts (K, ...)."""
        lost, said = missing - missing[back], sent - sent[back]
        known = (told & told[back]).reshape(-1, *[1] * (sent.ndim - 1))
        out = np.where(known & (said > 0.0), 100.0 * (1.0 - lost / np.maximum(said, 1.0)), np.nan)
        out = np.where(~known & (lost == 0.0), 100.0, out)
        out[young] = np.nan
        return out

    together = share(sent.sum(axis=(1, 2)), missing.sum(axis=(1, 2)))
    # links by receiver and sender; nobody hears itself
    links = [
        (missing[-1, i, j] / sent[-1, i, j], i, j)
        for i in range(sent.shape[1])
        for j in range(sent.shape[2])
        if sent[-1, i, j] > 0.0
    ]
    each = share(sent, missing).reshape(len(sent), -1)
    heard = np.array([i * sent.shape[2] + j for _, i, j in links])
    at = kept(together)
    lines: list[Line] = []
    worst = sorted(links, key=lambda link: -link[0])[: LINKS if len(links) > 1 else 0]
    for k, (_, i, j) in enumerate(sorted(worst, key=lambda link: link[1:])):
        part = Part(0, f"{names[j]} > {names[i + 1]}", *LOOKS[k], phase=k / LINKS)
        lines += curves(log.time_s, each[:, i * sent.shape[2] + j][:, None], Cast((part,), 0))
    lines.append(Line(log.time_s[at], together[at], BLACK, "all links", 1.6))
    low = np.fmin.reduce(each[:, heard], axis=1)
    high = np.fmax.reduce(each[:, heard], axis=1)
    where = kept(low, high)
    return lines, (Band(log.time_s[where], low[where], high[where], GREY, "worst to best link"),)
