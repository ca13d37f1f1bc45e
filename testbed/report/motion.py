"""Figures of where the aircraft were and how they moved: the kinds of figure of [HBH23]."""

from __future__ import annotations

import numpy as np

from testbed.formation.barrier import NO_BARRIER, Barrier, h, per_agent
from testbed.frames import velocity_frame, wrap_pi
from testbed.report.cast import LEADER, Cast, bands, curves, wishes
from testbed.report.drawing import Drawing, TimeAxis, limits_at, masked, settled, span_of
from testbed.report.flight import Flight
from testbed.report.thinning import kept
from testbed.state import Array
from testbed.views.panels import BLACK, DASHED, Curve, Line, Panel, Space, break_turns

FLOOR_M = 1e-3  # where the axis of the error's logarithm ends
PATH_BUCKETS = 900  # paths bend in a corner, which is short
PLANNED = "#c4c4c4"
CLOSE_S = 24.0  # of a corner seen from near


def trajectory(flight: Flight, cast: Cast) -> Drawing:
    """Paths in the horizontal plane over time, and from above."""
    log = flight.log
    # position of all that are drawn, until they are lost
    north, east = (np.where(log.lost, np.nan, log.truth.position_ned[..., k]) for k in (0, 1))
    names = [("leader", 0, LEADER, "")]
    names += [(part.name, part.row + 1, part.colour, part.marker) for part in cast.parts]
    names[0] = (log.info.names[0], *names[0][1:])
    paths, above = [], []
    for k, (name, row, colour, marker) in enumerate(names):
        x, y = north[:, row], east[:, row]
        at = kept(x, y, buckets=PATH_BUCKETS)
        paths.append(Curve(y[at], x[at], log.time_s[at], colour))
        phase = k / len(names)
        above.append(Line(y[at], x[at], colour, name, marker=marker, marker_phase=phase))
    commanded = log.info.leader_path_ned
    if commanded.size:
        # Broad and light below the rest: dots would fill each other's gaps where laps repeat.
        planned = Line(commanded[:, 1], commanded[:, 0], PLANNED, "leader, path", width=3.5)
        above.insert(0, planned)
    space = Space("over time", "east, m", "north, m", "time, s", paths)
    plan = Panel("from above", "east, m", "north, m", above, equal=True)
    crowd = f" Of {cast.crowd} followers those with the largest RMS error are drawn."
    return Drawing(
        "Trajectories",
        "Left: paths in the horizontal plane with time as the vertical axis. Right: the same from"
        " above, on one scale; grey: the path the leader was told to fly."
        + crowd
        * bool(cast.crowd),
        [[space, plan]],
        5.6,
        (1.1, 1.0),
        of_all=False,
    )


def corner(flight: Flight, cast: Cast) -> Drawing | None:
    """The formation from above in the leader's steepest turn, near enough to see the slots."""
    log, time = flight.log, flight.log.time_s
    if not flight.followers:
        return None
    late, _ = settled(flight)
    bank = np.where(log.lost[:, 0] | ~late.any(axis=1), np.nan, np.abs(log.truth.euler[:, 0, 0]))
    if not np.isfinite(bank).any():
        return None
    centre = time[np.nanargmax(bank)]
    near = np.abs(time - centre) <= 0.5 * CLOSE_S
    lines = []
    leader = log.truth.position_ned[near, 0]
    lines.append(Line(leader[:, 1], leader[:, 0], LEADER, log.info.names[0], 1.4))
    gone = flight.gone[near][..., None]
    position = np.where(gone, np.nan, log.truth.position_ned[near, 1:])
    slot = np.where(gone, np.nan, log.formation.slot_ned[near])
    stayed = [part for part in cast.parts if not log.lost[:, part.row + 1].any()]
    for part in stayed:
        own, wanted = position[:, part.row], slot[:, part.row]
        lines.append(
            Line(own[:, 1], own[:, 0], part.colour, part.name, 1.4,
                 marker=part.marker, marker_phase=0.5)
        )  # fmt: skip
        lines.append(Line(wanted[:, 1], wanted[:, 0], part.colour, width=1.0, dashes=DASHED))
    panel = Panel("", "east, m", "north, m", lines, equal=True)
    crowd = f" Of {cast.crowd} followers those with the largest RMS error are drawn."
    return Drawing(
        "A corner from above",
        f"{CLOSE_S:g} s round the leader's steepest bank, at {centre:.1f} s; dashed: the paths of"
        " the slots. Marks are at the same moments for all; who was lost in the run is left out."
        + crowd
        * bool(cast.crowd),
        [[panel]],
        5.6,
        of_all=False,
    )


def altitude(flight: Flight, cast: Cast) -> Drawing:
    """Altitudes over time."""
    log = flight.log
    axis = TimeAxis(flight)
    lost = log.lost
    height = np.where(lost, np.nan, -log.truth.position_ned[..., 2])
    at = kept(height[:, 0])
    lines = [Line(log.time_s[at], height[at, 0], LEADER, log.info.names[0], 1.2)]
    lines += curves(log.time_s, height[:, 1:], cast)
    lines += wishes(log.time_s, masked(flight, -log.formation.slot_ned[..., 2]), cast)
    panel = axis.panel("", "altitude, m", lines, bands(log.time_s, height[:, 1:], cast), last=True)
    return Drawing(
        "Altitude",
        "Metres above the origin over time; dashed: the altitudes of the slots.",
        [[panel]],
        2.9,
    )


def relative(flight: Flight, cast: Cast) -> Drawing | None:
    """Positions relative to the leader, in its velocity frame."""
    with np.errstate(invalid="ignore", divide="ignore"):  # a leader that stands has no such frame
        R_NG = velocity_frame(flight.log.truth.velocity_ned[:, 0])  # noqa: N806
    return _relative(
        flight,
        cast,
        R_NG,
        ("forward, m", "right, m", "down, m"),
        "Positions relative to the leader, in its velocity frame",
        "Forward along the leader's velocity, right in the horizontal, down; dashed: the slots.",
    )


def relative_ned(flight: Flight, cast: Cast) -> Drawing | None:
    """Positions relative to the leader, north, east and down."""
    same = np.broadcast_to(np.eye(3), (flight.log.tick.size, 3, 3))
    return _relative(
        flight,
        cast,
        same,
        ("north, m", "east, m", "down, m"),
        "Positions relative to the leader, north, east, down",
        "The same in fixed directions, q_i − q_g, as in the paper's figures; dashed: the desired"
        " χ_i, which turns with the leader.",
    )


def error(flight: Flight, cast: Cast) -> Drawing | None:
    """Distances from the slots."""
    if not flight.followers:
        return None
    log, axis, distance = flight.log, TimeAxis(flight), flight.error
    lines, area = [*curves(log.time_s, distance, cast)], bands(log.time_s, distance, cast)
    late, said = settled(flight)
    known = np.isfinite(distance)
    top = float(distance.max(initial=FLOOR_M, where=known))
    later = float(distance.max(initial=FLOOR_M, where=known & late))
    low = float(distance.min(initial=top, where=known & (distance > FLOOR_M)))
    return Drawing(
        "Formation error ‖q̃‖",
        "Distance of each follower from its slot, above on a linear and below on a logarithmic"
        " axis; shaded: the portions over which RMS errors are taken." + said + axis.said,
        [
            [axis.panel("", "‖q̃‖, m", lines, area, y_limits=(0.0, 1.15 * later))],
            [axis.panel("", "‖q̃‖, m", lines, area, last=True, y_log=True,
                        y_limits=(0.8 * low, 1.6 * top))],
        ],
        5.4,
    )  # fmt: skip


def speed(flight: Flight, cast: Cast) -> Drawing | None:
    """Speed, flight-path angle and course, actual and desired."""
    if not flight.followers:
        return None
    log, axis = flight.log, TimeAxis(flight)
    formation, time = log.formation, log.time_s
    in_air = any(log.info.bounded_in_ned)
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
            break_turns(np.degrees(wrap_pi(formation.course))),
            break_turns(np.degrees(wrap_pi(formation.course_desired))),
        ),
    )
    for title, unit, actual, desired in quantities:
        actual, desired = masked(flight, actual), masked(flight, desired)
        lines = [*curves(time, actual, cast), *wishes(time, desired, cast)]
        if title == "speed" and not in_air:
            lines += limits_at(time, log.info.speed_bounds_mps, "speed bounds")
        # a band of angles that go round would be none
        area = () if title == "course" else bands(time, actual, cast)
        rows.append([axis.panel(title, unit, lines, area, last=title == "course")])
    bounded = "thin plain lines: the speed bounds"
    if in_air:
        moving = log.truth.velocity_ned[:, 1:] - np.array(log.info.bounded_in_ned)
        airspeed = masked(flight, np.sqrt(np.sum(moving**2, axis=-1)))
        lines = [*curves(time, airspeed, cast)]
        lines += limits_at(time, log.info.speed_bounds_mps, "speed bounds")
        area = bands(time, airspeed, cast)
        rows.insert(1, [axis.panel("speed through the steady wind", "speed, m/s", lines, area)])
        bounded += ", which hold for the speed through the steady wind"
    return Drawing(
        "Speed, flight-path angle and course",
        f"Solid: actual; dashed: desired; {bounded}." + axis.said,
        rows,
        2.5 * len(rows),
    )


def barrier(flight: Flight, cast: Cast) -> Drawing | None:
    """How near the speeds came to their bounds, and the law's barrier there."""
    if not flight.followers:
        return None
    log, axis, time = flight.log, TimeAxis(flight), flight.log.time_s
    low, high = np.array(log.info.speed_bounds_mps).T
    moving = log.truth.velocity_ned[:, 1:] - np.array(log.info.bounded_in_ned)
    s = masked(flight, np.sqrt(np.sum(moving**2, axis=-1)))
    zero = Line(time[[0, -1]], np.zeros(2), BLACK, "bound", 0.8)
    quantities = [("room to the nearer speed bound", "m/s", np.minimum(s - low, high - s))]
    text = "How far speeds stayed from the nearer bound; negative is outside."
    chosen = [Barrier(*each) for each in log.info.barriers]
    if any(each.example != NO_BARRIER for each in chosen):
        value, _ = h(per_agent(chosen), s, low, high)
        value[:, [each.example == NO_BARRIER for each in chosen]] = np.nan
        quantities.append(("barrier", "h of (14)", value))
        text += " Below: the barrier function h at that speed, 1 within and 0 at a bound."
    rows = []
    for k, (title, unit, values) in enumerate(quantities, start=1):
        lines = [*curves(time, values, cast), zero]
        area = bands(time, values, cast)
        rows.append([axis.panel(title, unit, lines, area, last=k == len(quantities))])
    return Drawing("Speed bounds and barrier", text, rows, 2.4 * len(rows) + 0.3)


def _relative(
    flight: Flight, cast: Cast, frame: Array, units: tuple[str, ...], title: str, caption: str
) -> Drawing | None:
    """Of positions and slots relative to the leader, resolved in frames (K, 3, 3)."""
    if not flight.followers:
        return None
    log, axis = flight.log, TimeAxis(flight)
    position = log.truth.position_ned
    # rows times R_NG are columns of its transpose: from N to G
    actual = (position[:, 1:] - position[:, :1]) @ frame
    desired = (log.formation.slot_ned - position[:, :1]) @ frame
    late, said = settled(flight)
    rows = []
    for k, unit in enumerate(units):
        values = masked(flight, actual[..., k])
        wanted = masked(flight, desired[..., k])
        lines = [*curves(log.time_s, values, cast), *wishes(log.time_s, wanted, cast)]
        area = bands(log.time_s, values, cast)
        limits = span_of(
            [np.where(late, values, np.nan), np.where(late, wanted, np.nan)], least=4.0
        )
        rows.append([axis.panel("", unit, lines, area, last=k == 2, y_limits=limits)])
    return Drawing(title, caption + said, rows, 6.6)
