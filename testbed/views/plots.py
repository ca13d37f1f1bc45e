"""The plots of a live or replayed view, for any number of aircraft."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.frames import course, flight_path_angle, wrap_pi
from testbed.core.records import Array
from testbed.formation.barrier import logged_curve
from testbed.views.annotations import STALE_S
from testbed.views.batch import Batch
from testbed.views.panels import Colour, break_at_wrap, unique_values
from testbed.views.scene import BACKDROP, Scene, mix

LIMIT: Colour = (150, 150, 150)
MAX_DESIRED = 8  # aircraft: of more, desired values are not drawn
COURSE_RANGE = (-180.0, 180.0)  # deg

Values = Callable[[Batch], Array]  # (m, k)


@dataclass(frozen=True, slots=True)
class PlotSeries:
    """One quantity of k aircraft; the series of a plot share its axes."""

    name: str
    labels: tuple[str, ...]  # k
    colours: tuple[Colour, ...]  # k
    values: Values
    width: float = 1.5  # points


@dataclass(frozen=True, slots=True)
class TimePlot:
    """A pair of axes over time; the vertical range fits what is shown.

    Attributes:
        name: of the entity.
        title: quantity and unit.
        series: of aircraft.
        min_range: the vertical range is never smaller, so that small changes look small.
        limits: names and values of horizontal lines, always inside the range.
        fixed_range: whether the range is `min_range`, whatever is shown.
    """

    name: str
    title: str
    series: tuple[PlotSeries, ...]
    min_range: tuple[float, float]
    limits: tuple[tuple[str, float], ...] = ()
    fixed_range: bool = False

    @property
    def constants(self) -> tuple[float, ...]:
        """Values drawn as constants: the limits, and `min_range` unless the range is fixed."""
        limits = tuple(value for _, value in self.limits)
        return limits if self.fixed_range else (*limits, *self.min_range)


def tabs(scene: Scene) -> tuple[tuple[TimePlot, ...], ...]:
    """List the plots as rows of tabs; the first of each row is open."""
    motion = (*_speeds(scene), *_directions(scene))
    commands, air = (_bank(scene), _throttle(scene)), _air(scene)
    if not scene.followers:
        return (motion[:1], motion[1:], (_altitude(scene), *commands, *air))
    errors = (
        _error(scene),
        *([_estimate_error(scene)] if scene.estimated else []),
        _data_age(scene),
    )
    barrier = (_barrier(scene),) if any(scene.barriers) else ()
    return (
        errors,
        (motion[0], *barrier, *motion[1:]),
        (*commands, _altitude(scene), *air),
    )


def _speeds(scene: Scene) -> tuple[TimePlot, ...]:
    """Plot speed with its bounds; and ground speed if the bounds are of airspeed."""
    ground = _actual_and_desired(
        scene,
        lambda batch: np.linalg.norm(batch.velocity, axis=-1),
        lambda batch: batch.speed_desired,
    )
    bounds = unique_values(scene.speed_bounds) or [12.0, 33.0]
    limits = tuple((f"bound {value:g}", value) for value in bounds if scene.followers)
    min_range = bounds[0] - 1.0, bounds[-1] + 1.0
    if not scene.bounds_wind.any():
        title = "Ground speed and bounds, m/s" if limits else "Ground speed, m/s"
        return (TimePlot("speed", title, ground, min_range, limits),)
    air = _all_aircraft(
        scene, "actual", lambda batch: np.linalg.norm(batch.velocity - scene.bounds_wind, axis=-1)
    )
    mixed = len({bool(each.any()) for each in scene.bounds_wind}) > 1
    title = "Speed as its bounds are measured, m/s" if mixed else "Airspeed and bounds, m/s"
    return (
        TimePlot("speed", title, (air,), min_range, limits),
        TimePlot("ground_speed", "Ground speed, m/s", ground, min_range),
    )


def _directions(scene: Scene) -> tuple[TimePlot, TimePlot]:
    courses = _actual_and_desired(
        scene,
        lambda batch: break_at_wrap(np.degrees(course(batch.velocity))),
        lambda batch: break_at_wrap(np.degrees(wrap_pi(batch.course_desired))),
    )
    angles = _actual_and_desired(
        scene,
        lambda batch: np.degrees(flight_path_angle(batch.velocity)),
        lambda batch: np.degrees(batch.flight_path_angle_desired),
    )
    return (
        TimePlot("course", "Course, deg", courses, COURSE_RANGE, fixed_range=True),
        TimePlot("flight_path_angle", "Flight-path angle, deg", angles, (-10.0, 10.0)),
    )


def _bank(scene: Scene) -> TimePlot:
    limits_deg = unique_values(np.degrees(scene.roll_limit))
    largest = 1.02 * limits_deg[-1] if limits_deg else 60.0
    actual = _all_aircraft(scene, "actual", lambda batch: np.degrees(batch.euler[..., 0]))
    lines = tuple(
        (f"limit {sign * each:g}", sign * each) for each in limits_deg for sign in (-1, 1)
    )
    return TimePlot("bank", "Bank and limits, deg", (actual,), (-largest, largest), lines)


def _throttle(scene: Scene) -> TimePlot:
    commanded = _all_aircraft(scene, "commanded", lambda batch: batch.throttle)
    return TimePlot("throttle", "Throttle", (commanded,), (0.0, 1.0))


def _altitude(scene: Scene) -> TimePlot:
    heights = -np.concatenate(scene.paths)[:, 2] if scene.paths else np.array([100.0])
    actual = _all_aircraft(scene, "actual", lambda batch: -batch.position[..., 2])
    min_range = (float(heights.min()) - 10.0, float(heights.max()) + 10.0)
    return TimePlot("altitude", "Altitude, m", (actual,), min_range)


def _air(scene: Scene) -> tuple[TimePlot, TimePlot]:
    horizontal = _all_aircraft(
        scene, "horizontal", lambda batch: np.linalg.norm(batch.wind[..., :2], axis=-1)
    )
    up = _all_aircraft(scene, "up", lambda batch: -batch.wind[..., 2])
    return (
        TimePlot("wind", "Horizontal wind, m/s", (horizontal,), (0.0, 5.0)),
        TimePlot("updraught", "Updraught, m/s", (up,), (-1.0, 1.0)),
    )


def _error(scene: Scene) -> TimePlot:
    error = _followers(scene, "error", lambda batch: np.linalg.norm(batch.error, axis=-1))
    return TimePlot("error", "Position error, m", (error,), (0.0, 1.0))


def _estimate_error(scene: Scene) -> TimePlot:
    error = _all_aircraft(
        scene,
        "error",
        lambda batch: np.linalg.norm(batch.estimated_position - batch.position, axis=-1),
    )
    return TimePlot("estimate_error", "Error of position estimate, m", (error,), (0.0, 1.0))


def _barrier(scene: Scene) -> TimePlot:
    """Plot the barrier h of (14): 1 in the middle of the speed set, 0 at its bounds."""
    known = [i for i, each in enumerate(scene.barriers) if each is not None]
    rows = np.array(scene.followers)[known]
    chosen = [each for each in scene.barriers if each is not None]
    low, high = scene.speed_bounds[known].T

    def value(batch: Batch) -> Array:
        through = batch.velocity[:, rows] - scene.bounds_wind[rows]
        speed = np.linalg.norm(through, axis=-1)
        curves = [logged_curve(each, speed[:, i], low[i], high[i]) for i, each in enumerate(chosen)]
        return np.stack(curves, axis=1)

    series = (_series(scene, "h", rows.tolist(), value),)
    return TimePlot("barrier", "Speed barrier", series, (-0.1, 1.1), (("bound", 0.0),))


def _data_age(scene: Scene) -> TimePlot:
    """Plot the largest age of the data that each follower uses of another aircraft."""
    oldest = _followers(scene, "age", lambda batch: np.fmax.reduce(batch.age, axis=-1))
    return TimePlot("age", "Oldest data used, s", (oldest,), (0.0, STALE_S))


def _actual_and_desired(scene: Scene, actual: Values, desired: Values) -> tuple[PlotSeries, ...]:
    """Plot what all aircraft do and, thin and faded, what followers should do."""
    rows = scene.followers
    done = _all_aircraft(scene, "actual", actual)
    if not rows or len(scene.names) > MAX_DESIRED:
        return (done,)
    wanted = _series(scene, "desired", rows, desired)
    return (
        done,
        replace(
            wanted,
            labels=tuple(f"{label} desired" for label in wanted.labels),
            colours=tuple(mix(colour, BACKDROP, 0.45) for colour in wanted.colours),
            width=1.0,
        ),
    )


def _all_aircraft(scene: Scene, name: str, values: Values) -> PlotSeries:
    return _series(scene, name, range(len(scene.names)), values)


def _followers(scene: Scene, name: str, values: Values) -> PlotSeries:
    return _series(scene, name, scene.followers, values)


def _series(scene: Scene, name: str, rows: Sequence[int], values: Values) -> PlotSeries:
    """Plot the values (m, k) of k aircraft, by their rows, until they are lost."""
    chosen = list(rows)

    def until_lost(batch: Batch) -> Array:
        return np.where(batch.lost[:, chosen] > 0.0, np.nan, values(batch))

    return PlotSeries(
        name,
        tuple(scene.names[row] for row in chosen),
        tuple(scene.colours[row] for row in chosen),
        until_lost,
    )
