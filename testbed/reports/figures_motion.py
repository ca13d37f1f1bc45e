"""Figures of positions, errors and speeds over time: the kinds of figure of [HBH23]."""

from __future__ import annotations

import numpy as np

from testbed.core.frames import wrap_pi
from testbed.core.records import Array
from testbed.core.velocity_frame import velocity_frame
from testbed.formation.barrier import logged_barriers, logged_curve
from testbed.reports.figure_spec import (
    FigureSpec,
    TimeAxis,
    bound_lines,
    mask_without_slot,
    padded_limits,
    samples_on_axis,
)
from testbed.reports.plot_selection import (
    LEADER_COLOUR,
    PlotSelection,
    decimate,
    desired_curves,
    follower_curves,
    percentile_bands,
)
from testbed.reports.run_data import RunData
from testbed.views.panels import BLACK, Line, break_at_wrap

FLOOR_M = 1e-3  # lower end of the logarithmic axis of the error
MIN_BARRIER = 0.9  # above it everywhere, h is a straight line that needs no panel


def altitude(run: RunData, selection: PlotSelection) -> FigureSpec:
    """Draw altitudes over time."""
    log = run.log
    axis = TimeAxis(run)
    height = np.where(log.lost, np.nan, -log.truth.position_ned[..., 2])
    desired = mask_without_slot(run, -log.formation.slot_ned[..., 2])
    at = decimate(height[:, 0])
    lines = [Line(log.time_s[at], height[at, 0], LEADER_COLOUR, log.info.names[0], 1.2)]
    lines += follower_curves(log.time_s, height[:, 1:], selection)
    lines += desired_curves(log.time_s, desired, selection)
    bands = percentile_bands(log.time_s, height[:, 1:], selection)
    return FigureSpec(
        "Altitude",
        "Altitude above the origin over time; dashed: the altitudes of the slots.",
        [[axis.panel("", "altitude, m", lines, bands, last=True)]],
        2.9,
    )


def relative(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw positions relative to the leader, in its velocity frame."""
    with np.errstate(invalid="ignore", divide="ignore"):  # undefined for a leader at rest
        R_NG = velocity_frame(run.log.truth.velocity_ned[:, 0])  # noqa: N806
    return _relative(
        run,
        selection,
        R_NG,
        ("forward, m", "right, m", "down, m"),
        "Positions relative to the leader, in its velocity frame",
        "Forward along the leader's velocity, right in the horizontal, down; dashed: the slots.",
    )


def relative_ned(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw positions relative to the leader, north, east and down."""
    identity = np.broadcast_to(np.eye(3), (run.log.tick.size, 3, 3))
    return _relative(
        run,
        selection,
        identity,
        ("north, m", "east, m", "down, m"),
        "Positions relative to the leader, north, east, down",
        "The same resolved in NED, q_i − q_g, as in the paper's figures; dashed: the desired χ_i,"
        " which turns with the leader.",
    )


def error(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw distances from the slots."""
    if not run.followers:
        return None
    log, axis, distance = run.log, TimeAxis(run), run.error
    lines = [*follower_curves(log.time_s, distance, selection)]
    bands = percentile_bands(log.time_s, distance, selection)
    on_axis, note = samples_on_axis(run)
    known = np.isfinite(distance)
    largest = float(distance.max(initial=FLOOR_M, where=known))
    largest_on_axis = float(distance.max(initial=FLOOR_M, where=known & on_axis))
    smallest = float(distance.min(initial=largest, where=known & (distance > FLOOR_M)))
    linear = axis.panel("", "‖q̃‖, m", lines, bands, y_limits=(0.0, 1.15 * largest_on_axis))
    logarithmic = axis.panel(
        "", "‖q̃‖, m", lines, bands, last=True, y_log=True,
        y_limits=(0.8 * smallest, 1.6 * largest),
    )  # fmt: skip
    return FigureSpec(
        "Formation error ‖q̃‖",
        "Distance of each follower from its slot, on a linear axis above and a logarithmic one"
        " below; shaded: the windows over which RMS errors are computed." + note + axis.note,
        [[linear], [logarithmic]],
        5.4,
    )


def speed(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw speed, flight-path angle and course, actual and desired."""
    if not run.followers:
        return None
    log, axis = run.log, TimeAxis(run)
    formation, time = log.formation, log.time_s
    bounds_airspeed = any(log.info.bounded_in_ned)
    rows = []
    quantities = (
        ("speed", "ground speed, m/s", formation.speed, formation.speed_desired),
        (
            "flight-path angle",
            "flight path, °",
            np.degrees(formation.flight_path_angle),
            np.degrees(formation.flight_path_angle_desired),
        ),
        (
            "course",
            "course, °",
            break_at_wrap(np.degrees(wrap_pi(formation.course))),
            break_at_wrap(np.degrees(wrap_pi(formation.course_desired))),
        ),
    )
    for title, unit, actual, desired in quantities:
        actual, desired = mask_without_slot(run, actual), mask_without_slot(run, desired)
        lines = [*follower_curves(time, actual, selection)]
        lines += desired_curves(time, desired, selection)
        if title == "speed" and not bounds_airspeed:
            lines += bound_lines(time, log.info.speed_bounds_mps, "speed bounds")
        # percentiles of angles that wrap around mean nothing
        bands = () if title == "course" else percentile_bands(time, actual, selection)
        degrees = title != "speed"
        rows.append(
            [axis.panel(title, unit, lines, bands, last=title == "course", y_degrees=degrees)]
        )
    bounds_note = "thin solid lines: the speed bounds"
    if bounds_airspeed:
        airspeed = _bounded_speed(run)
        lines = [*follower_curves(time, airspeed, selection)]
        lines += bound_lines(time, log.info.speed_bounds_mps, "speed bounds")
        bands = percentile_bands(time, airspeed, selection)
        title = "speed relative to the steady wind"
        rows.insert(1, [axis.panel(title, "speed, m/s", lines, bands)])
        bounds_note += ", which hold for the speed relative to the steady wind"
    return FigureSpec(
        "Speed, flight-path angle and course",
        f"Solid: actual; dashed: desired; {bounds_note}." + axis.note,
        rows,
        2.5 * len(rows),
    )


def barrier(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw the margins of speeds to their bounds, and the law's barrier."""
    if not run.followers:
        return None
    log, axis, time = run.log, TimeAxis(run), run.log.time_s
    low, high = np.array(log.info.speed_bounds_mps).T
    s = _bounded_speed(run)
    bound = Line(time[[0, -1]], np.zeros(2), BLACK, "bound", 0.8)
    quantities = [("margin to the nearer speed bound", "m/s", np.minimum(s - low, high - s))]
    caption = "Distance of the speed from the nearer bound; negative outside."
    value = np.full(s.shape, np.nan)
    for i, each in enumerate(logged_barriers(log.info)):
        if each is not None:
            value[:, i] = logged_curve(each, s[:, i], float(low[i]), float(high[i]))
    if np.isfinite(value).any():
        least = float(np.nanmin(value))
        if least > MIN_BARRIER:
            caption += f" The barrier function h of (14) at that speed is {least:.2f} or more."
        else:
            quantities.append(("barrier", "h of (14)", value))
            caption += " Below: the barrier function h at that speed, negative outside the bounds."
    rows = []
    for k, (title, unit, values) in enumerate(quantities, start=1):
        lines = [*follower_curves(time, values, selection), bound]
        bands = percentile_bands(time, values, selection)
        rows.append([axis.panel(title, unit, lines, bands, last=k == len(quantities))])
    return FigureSpec("Speed bounds and barrier", caption, rows, 2.4 * len(rows) + 0.3)


def _bounded_speed(run: RunData) -> Array:
    """Compute the speeds (K, n), m/s, that the speed bounds limit; see `RunInfo.bounded_in_ned`."""
    velocity = run.log.truth.velocity_ned[:, 1:] - np.array(run.log.info.bounded_in_ned)
    return mask_without_slot(run, np.sqrt(np.sum(velocity**2, axis=-1)))


def _relative(
    run: RunData,
    selection: PlotSelection,
    frame: Array,
    labels: tuple[str, ...],
    title: str,
    caption: str,
) -> FigureSpec | None:
    """Draw positions and slots relative to the leader, resolved in frames (K, 3, 3)."""
    if not run.followers:
        return None
    log, axis = run.log, TimeAxis(run)
    position = log.truth.position_ned
    # a row vector times R_NG is R_NGᵀ times the column vector: from N to G
    actual = (position[:, 1:] - position[:, :1]) @ frame
    desired = (log.formation.slot_ned - position[:, :1]) @ frame
    on_axis, note = samples_on_axis(run)
    rows = []
    for k, label in enumerate(labels):
        values = mask_without_slot(run, actual[..., k])
        targets = mask_without_slot(run, desired[..., k])
        lines = [*follower_curves(log.time_s, values, selection)]
        lines += desired_curves(log.time_s, targets, selection)
        bands = percentile_bands(log.time_s, values, selection)
        limits = padded_limits(
            [np.where(on_axis, values, np.nan), np.where(on_axis, targets, np.nan)], min_span=4.0
        )
        rows.append([axis.panel("", label, lines, bands, last=k == 2, y_limits=limits)])
    return FigureSpec(title, caption + note, rows, 6.6)
