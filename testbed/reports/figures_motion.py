"""Figures of positions, errors and speeds over time: the kinds of figure of [HBH23]."""

from __future__ import annotations

from typing import Any

import numpy as np

from testbed.core.frames import wrap_pi
from testbed.core.records import Array, FormationState
from testbed.core.velocity_frame import velocity_frame
from testbed.formation.barrier import logged_barriers, logged_curve
from testbed.reports.figure_spec import (
    FigureSpec,
    TimeAxis,
    bound_lines,
    padded_limits,
    samples_on_axis,
    stack,
)
from testbed.reports.plot_selection import PlotSelection
from testbed.reports.run_data import RunData
from testbed.views.quantities import PLOTTED

FLOOR_M = 1e-3  # lower end of the logarithmic axis of the error
MIN_BARRIER = 0.9  # above it everywhere, h is a straight line that needs no panel


def altitude(run: RunData, selection: PlotSelection) -> FigureSpec:
    """Draw altitudes over time."""
    desired = run.mask_lost(-run.log.formation.slot_ned[..., 2])
    panel = TimeAxis(run, selection).quantity("altitude", desired=desired)
    return FigureSpec(
        "Altitude",
        "Altitude above the origin over time; dashed: the altitudes of the slots.",
        stack([panel]),
        3.2,
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
    axis, distance = TimeAxis(run, selection), run.error
    on_axis, note = samples_on_axis(run)
    known = np.isfinite(distance)
    largest = float(distance.max(initial=FLOOR_M, where=known))
    largest_on_axis = float(distance.max(initial=FLOOR_M, where=known & on_axis))
    smallest = float(distance.min(initial=largest, where=known & (distance > FLOOR_M)))
    label: Any = {"y_label": "‖q̃‖, m"}
    linear = axis.quantity("error", y_limits=(0.0, 1.15 * largest_on_axis), **label)
    limits = 0.8 * smallest, 1.6 * largest
    logarithmic = axis.quantity("error", y_log=True, y_limits=limits, **label)
    return FigureSpec(
        "Formation error ‖q̃‖",
        "Distance of each follower from its slot, on a linear axis above and a logarithmic one"
        " below; shaded: the windows over which RMS errors are computed." + note + axis.note,
        stack([linear, logarithmic]),
        5.4,
    )


def speed(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw speed, flight-path angle and course, actual and desired."""
    if not run.followers:
        return None
    axis, info = TimeAxis(run, selection), run.log.info
    bounds = bound_lines(run.log.time_s, info.speed_bounds_mps, "speed bounds")
    bounds_note = "dotted lines: the speed bounds"
    if any(info.bounded_in_ned):
        bounds_note += ", which hold for the airspeed in the steady wind"
        bounded = PLOTTED["bounded_speed"]
        panels = [
            axis.quantity("speed", leader=False),
            axis.curves(_bounded_speed(run), also=bounds, y_label=bounded.label()),
        ]
    else:
        panels = [axis.quantity("speed", leader=False, also=bounds)]
    panels.append(axis.quantity("flight_path_angle", leader=False))
    actual, desired = map(run.mask_lost, _turned(run.log.formation))
    label = "course, whole turns counted, °"
    # all followers fly the same course, so that a band would be a line
    panels.append(axis.curves(actual, desired, with_bands=False, y_label=label))
    return FigureSpec(
        "Speed, flight-path angle and course",
        f"Solid: actual; dashed: desired; {bounds_note}." + axis.note,
        stack(panels),
        2.5 * len(panels),
    )


def barrier(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw the margins of speeds to their bounds, and the law's barrier."""
    if not run.followers:
        return None
    log, axis, time = run.log, TimeAxis(run, selection), run.log.time_s
    low, high = np.array(log.info.speed_bounds_mps).T
    s = _bounded_speed(run)
    bounds = bound_lines(time, [0.0], "bound")
    quantities = [(PLOTTED["speed_margin"], np.minimum(s - low, high - s))]
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
            quantities.append((PLOTTED["barrier"], value))
            caption += " Below: the barrier function h at that speed, negative outside the bounds."
    panels = [
        axis.curves(values, also=bounds, y_label=quantity.label())
        for quantity, values in quantities
    ]
    height_in = 2.4 * len(panels) + 0.9
    return FigureSpec("Speed bounds and barrier", caption, stack(panels), height_in)


def _turned(formation: FormationState) -> tuple[Array, Array]:
    """Return actual and desired courses (K, n), degrees, that do not jump at ±180°."""
    actual = formation.course.copy()
    for column in actual.T:
        known = np.isfinite(column)
        column[known] = np.unwrap(column[known])
    # within half a turn of the actual one
    desired = actual + wrap_pi(formation.course_desired - formation.course)
    return np.degrees(actual), np.degrees(desired)


def _bounded_speed(run: RunData) -> Array:
    """Compute the speeds (K, n), m/s, that the speed bounds limit; see `RunInfo.bounded_in_ned`."""
    velocity = run.log.truth.velocity_ned[:, 1:] - np.array(run.log.info.bounded_in_ned)
    return run.mask_lost(np.sqrt(np.sum(velocity**2, axis=-1)))


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
    log, axis = run.log, TimeAxis(run, selection)
    position = log.truth.position_ned
    # a row vector times R_NG is R_NGᵀ times the column vector: from N to G
    actual = (position[:, 1:] - position[:, :1]) @ frame
    desired = (log.formation.slot_ned - position[:, :1]) @ frame
    on_axis, note = samples_on_axis(run)
    panels = []
    for k, label in enumerate(labels):
        values, targets = (run.mask_lost(each[..., k]) for each in (actual, desired))
        limits = padded_limits(
            [np.where(on_axis, values, np.nan), np.where(on_axis, targets, np.nan)], min_span=4.0
        )
        panels.append(axis.curves(values, targets, y_label=label, y_limits=limits))
    return FigureSpec(title, caption + note, stack(panels), 6.6)
