"""Figures of positions, errors and speeds: the kinds of figure of [HBH23]."""

from __future__ import annotations

import numpy as np

from testbed.core.frames import velocity_frame, wrap_pi
from testbed.core.records import Array
from testbed.formation.barrier import NO_BARRIER, OWN_BARRIER, Barrier, barrier_curve
from testbed.reports.axes import (
    TimeAxis,
    bound_lines,
    mask_without_slot,
    padded_limits,
    samples_on_axis,
)
from testbed.reports.decimate import decimate
from testbed.reports.figure_spec import FigureSpec
from testbed.reports.plot_selection import (
    LEADER_COLOUR,
    PlotSelection,
    desired_curves,
    follower_curves,
    percentile_bands,
)
from testbed.reports.run_data import RunData
from testbed.views.panels import BLACK, DASHED, Curve3D, Line, Panel, Panel3D, break_at_wrap

FLOOR_M = 1e-3  # lower end of the logarithmic axis of the error
PATH_BUCKETS = 900  # more than of other curves: corners are short
PATH_COLOUR = "#c4c4c4"  # of the commanded path
CORNER_S = 24.0
LAP_MARKS = 12  # markers on each path of the first lap


def trajectory(run: RunData, selection: PlotSelection) -> FigureSpec:
    """Draw paths with time as the vertical axis, and from above."""
    log = run.log
    north, east = (np.where(log.lost, np.nan, log.truth.position_ned[..., k]) for k in (0, 1))
    aircraft = [(log.info.names[0], 0, LEADER_COLOUR, "")]
    aircraft += [(each.name, each.row + 1, each.colour, each.marker) for each in selection.drawn]
    paths, above = [], []
    for k, (name, row, colour, marker) in enumerate(aircraft):
        x, y = north[:, row], east[:, row]
        at = decimate(x, y, buckets=PATH_BUCKETS)
        paths.append(Curve3D(y[at], x[at], log.time_s[at], colour))
        phase = k / len(aircraft)
        above.append(Line(y[at], x[at], colour, name, marker=marker, marker_phase=phase))
    commanded, grey = log.info.leader_path_ned, ""
    if commanded.size and not run.part:
        # broad and light: dashes would fill each other's gaps where laps repeat
        path = Line(commanded[:, 1], commanded[:, 0], PATH_COLOUR, "leader, path", width=3.5)
        above.insert(0, path)
        grey = "; grey: the leader's commanded path"
    space = Panel3D("over time", "east, m", "north, m", "time, s", paths)
    plan = Panel("from above", "east, m", "north, m", above, equal=True)
    return FigureSpec(
        "Trajectories",
        "Left: paths in the horizontal plane with time as the vertical axis. Right: the same from"
        f" above, with equal scales{grey}." + selection.worst_note,
        [[space, plan]],
        5.6,
        (1.1, 1.0),
        needs_selection_note=False,
    )


def first_lap(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw the convergence while the leader turns its first full circle, from above."""
    log = run.log
    with np.errstate(invalid="ignore"):
        velocity = log.truth.velocity_ned[:, 0]
        course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
        turned = np.abs(course - course[0]) >= 2.0 * np.pi
    if not run.followers or not turned.any():
        return None
    lap = slice(0, int(turned.argmax()) + 1)
    time, lost = log.time_s[lap], log.lost[lap]
    north, east = (np.where(lost, np.nan, log.truth.position_ned[lap, :, k]) for k in (0, 1))
    lines = [Line(east[:, 0], north[:, 0], LEADER_COLOUR, log.info.names[0], 1.4, dashes=DASHED)]
    errors: list[Line] = []
    for each in selection.drawn:
        x, y, error = east[:, each.row + 1], north[:, each.row + 1], run.error[lap, each.row]
        # markers at the same times in both panels: each at a multiple of the same step
        marks = slice(0, None, max(time.size // LAP_MARKS, 1))
        for to, (a, b) in ((lines, (x, y)), (errors, (time, error))):
            to.append(Line(a, b, each.colour, each.name, 1.2))
            to.append(Line(a[marks], b[marks], each.colour, width=0.0, marker=each.marker, marks=0))
    above = Panel("from above", "east, m", "north, m", lines, equal=True)
    distance = Panel("distance from the slot", "time, s", "‖q̃‖, m", errors)
    return FigureSpec(
        "The first lap",
        f"Until the leader, dashed, has turned a full circle at {time[-1]:.1f} s. Markers are at"
        " the same times in both panels." + selection.worst_note,
        [[above, distance]],
        5.0,
        (1.1, 1.0),
        needs_selection_note=False,
    )


def corner(run: RunData, selection: PlotSelection) -> FigureSpec | None:
    """Draw the formation from above in the leader's steepest turn, at the scale of the slots."""
    log, time = run.log, run.log.time_s
    if not run.followers:
        return None
    on_axis, _ = samples_on_axis(run)
    bank = np.where(log.lost[:, 0] | ~on_axis.any(axis=1), np.nan, np.abs(log.truth.euler[:, 0, 0]))
    if not np.isfinite(bank).any():
        return None
    centre = time[np.nanargmax(bank)]
    near = np.abs(time - centre) <= 0.5 * CORNER_S
    leader = log.truth.position_ned[near, 0]
    lines = [Line(leader[:, 1], leader[:, 0], LEADER_COLOUR, log.info.names[0], 1.4)]
    without_slot = run.without_slot[near][..., None]
    position = np.where(without_slot, np.nan, log.truth.position_ned[near, 1:])
    slot = np.where(without_slot, np.nan, log.formation.slot_ned[near])
    for each in selection.drawn:
        if log.lost[:, each.row + 1].any():
            continue
        own, desired = position[:, each.row], slot[:, each.row]
        lines.append(
            Line(own[:, 1], own[:, 0], each.colour, each.name, 1.4,
                 marker=each.marker, marker_phase=0.5)
        )  # fmt: skip
        lines.append(Line(desired[:, 1], desired[:, 0], each.colour, width=1.0, dashes=DASHED))
    panel = Panel("", "east, m", "north, m", lines, equal=True)
    return FigureSpec(
        "A corner from above",
        f"{CORNER_S:g} s around the leader's steepest bank, at {centre:.1f} s; dashed: the paths of"
        " the slots. Markers are at the same times on all paths. Aircraft that were lost in the run"
        " are left out." + selection.worst_note,
        [[panel]],
        5.6,
        needs_selection_note=False,
    )


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
        rows.append([axis.panel(title, unit, lines, bands, last=title == "course")])
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
    barriers = [Barrier(*each) for each in log.info.barriers]
    unknown = (NO_BARRIER, OWN_BARRIER)
    if any(each.example not in unknown for each in barriers):
        value = np.full(s.shape, np.nan)
        for i, each in enumerate(barriers):
            if each.example not in unknown:
                bounds = (
                    float(np.broadcast_to(low, s.shape[1:])[i]),
                    float(np.broadcast_to(high, s.shape[1:])[i]),
                )
                value[:, i] = barrier_curve(each, s[:, i], *bounds)[0]
        quantities.append(("barrier", "h of (14)", value))
        caption += " Below: the barrier function h at that speed, 0 at a bound, negative outside."
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
