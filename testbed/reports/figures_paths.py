"""Figures of paths from above: the whole run, the first lap, a corner close up."""

from __future__ import annotations

import numpy as np

from testbed.core.velocity_frame import velocity_frame
from testbed.reports.figure_spec import TIME_LABEL, FigureSpec, samples_on_axis
from testbed.reports.plot_selection import (
    LEADER_COLOUR,
    PlotSelection,
    decimate,
    desired_curves,
    follower_curves,
)
from testbed.reports.run_data import RunData
from testbed.views.panels import BLACK, DASHED, PATH, Line, Panel

PATH_BUCKETS = 900  # more than of other curves: corners are short
CORNER_S = 24.0
LAP_MARKS = 12  # markers on each path of the first lap


def trajectory(run: RunData, selection: PlotSelection) -> FigureSpec:
    """Draw paths from above, and the followers' positions relative to the leader."""
    log = run.log
    north, east = (np.where(log.lost, np.nan, log.truth.position_ned[..., k]) for k in (0, 1))
    aircraft = [(log.info.names[0], 0, LEADER_COLOUR, "")]
    aircraft += [(each.name, each.row + 1, each.colour, each.marker) for each in selection.drawn]
    above = []
    for k, (name, row, colour, marker) in enumerate(aircraft):
        x, y = north[:, row], east[:, row]
        at = decimate(x, y, buckets=PATH_BUCKETS)
        phase = k / len(aircraft)
        above.append(Line(y[at], x[at], colour, name, marker=marker, marker_phase=phase))
    commanded, grey = log.info.leader_path_ned, ""
    if commanded.size and not run.part:
        # broad and light: dashes would fill each other's gaps where laps repeat
        path = Line(commanded[:, 1], commanded[:, 0], PATH, "leader, path", width=3.5)
        above.insert(0, path)
        grey = "; grey: the leader's commanded path"
    plan = Panel("", "east, m", "north, m", above, equal=True)
    if not run.followers:
        caption = f"Paths from above, with equal scales{grey}."
        return FigureSpec("Trajectories", caption, [[plan]], 5.6, needs_selection_note=False)
    relative, note = _relative_to_leader(run, selection)
    return FigureSpec(
        "Trajectories",
        f"Left: paths from above, with equal scales{grey}. Middle and right: positions relative to"
        f" the leader in the frame of its velocity, from above and from behind; crosses: the slots."
        f"{note}" + selection.worst_note,
        [[plan, *relative]],
        5.0,
        (1.25, 1.0, 1.0),
        needs_selection_note=False,
    )


def _relative_to_leader(run: RunData, selection: PlotSelection) -> tuple[list[Panel], str]:
    """Draw followers and slots beside the leader from two sides; and a note for the caption."""
    log, position = run.log, run.log.truth.position_ned
    with np.errstate(invalid="ignore", divide="ignore"):  # undefined for a leader at rest
        frame = velocity_frame(log.truth.velocity_ned[:, 0]) * [1.0, 1.0, -1.0]  # up, not down
    on_axis, note = samples_on_axis(run)
    shown = (on_axis & ~run.without_slot)[..., None]
    actual, slot = (
        np.where(shown, (each - position[:, :1]) @ frame, np.nan)
        for each in (position[:, 1:], log.formation.slot_ned)
    )
    panels = []
    for axis, label in ((0, "forward, m"), (2, "up, m")):
        here, name = np.zeros(1), log.info.names[0]
        lines = [Line(here, here, LEADER_COLOUR, name, dots=True, marker="^")]
        for each in selection.drawn:
            x, y = actual[:, each.row, 1], actual[:, each.row, axis]
            at = decimate(x, y, buckets=PATH_BUCKETS)
            lines.append(Line(x[at], y[at], each.colour, each.name, 0.7))
        for each in selection.drawn:
            own = slot[np.isfinite(slot[:, each.row, 0]), each.row]
            if len(own):
                cross = np.median(own, axis=0)
                lines.append(Line(cross[1:2], cross[[axis]], BLACK, dots=True, marker="x"))
        panels.append(Panel("", "right, m", label, lines, equal=True))
    return panels, note


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
        # markers at the same times in both panels
        for to, (a, b) in ((lines, (x, y)), (errors, (time, error))):
            to.append(Line(a, b, each.colour, each.name, 1.2, marker=each.marker, marks=LAP_MARKS))
    above = Panel("", "east, m", "north, m", lines, equal=True)
    distance = Panel("", TIME_LABEL, "distance from the slot, m", errors, y_log=True)
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
    truth, lost = log.truth, np.any(log.lost, axis=0).tolist()
    # aircraft that were lost in the run are left out
    drawn = tuple(each for each in selection.drawn if not lost[each.row + 1])
    selection = PlotSelection(drawn, 0)
    without_slot = run.without_slot[near][..., None]
    position = np.where(without_slot, np.nan, truth.position_ned[near, 1:])
    slot = np.where(without_slot, np.nan, log.formation.slot_ned[near])
    name, leader = log.info.names[0], truth.position_ned[near, 0]
    lines = [Line(leader[:, 1], leader[:, 0], LEADER_COLOUR, name, 1.4)]
    for each in drawn:
        own, desired = position[:, each.row], slot[:, each.row]
        lines.append(
            Line(own[:, 1], own[:, 0], each.colour, each.name, 1.4,
                 marker=each.marker, marker_phase=0.5)
        )  # fmt: skip
        label = "slots" if each is drawn[-1] else ""
        lines.append(Line(desired[:, 1], desired[:, 0], BLACK, label, 0.9, dashes=DASHED))
    time = time[near]
    formation, error = log.formation, run.error[near]
    speed, desired_speed = (
        np.where(run.without_slot[near], np.nan, each[near])
        for each in (formation.speed, formation.speed_desired)
    )
    banks = np.degrees(truth.euler[near, :, 0])
    limits = float(time[0]), float(time[-1])
    panels = (
        Panel("", "east, m", "north, m", lines, equal=True),
        Panel(
            "", TIME_LABEL, "distance from the slot, m",
            [*follower_curves(time, error, selection)], x_limits=limits,
        ),
        Panel(
            "", TIME_LABEL, "ground speed, m/s",
            [*follower_curves(time, speed, selection),
             *desired_curves(time, desired_speed, selection)],
            x_limits=limits,
        ),
        Panel(
            "", TIME_LABEL, "bank, °",
            [Line(time, banks[:, 0], LEADER_COLOUR, name, 1.2),
             *follower_curves(time, banks[:, 1:], selection)],
            y_degrees=True, x_limits=limits,
        ),
    )  # fmt: skip
    return FigureSpec(
        "A corner, close up",
        f"{CORNER_S:g} s around the leader's steepest bank, at {centre:.1f} s. Dashed: the paths of"
        " the slots, and desired speeds. Markers are at the same times on all paths. Aircraft that"
        " were lost in the run are left out." + selection.worst_note,
        [panels[:2], panels[2:]],
        7.6,
        needs_selection_note=False,
    )
