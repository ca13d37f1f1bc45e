"""The plots of a live or replayed view, for any number of aircraft."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.core.records import Array
from testbed.formation.barrier import logged_curve
from testbed.views.annotations import STALE_S
from testbed.views.panels import Colour, unique_values
from testbed.views.quantities import PLOTTED
from testbed.views.sample_columns import ViewBatch
from testbed.views.scene import BACKDROP, MAX_SINGLE, Scene, mix

LIMIT: Colour = (150, 150, 150)
MEDIAN: Colour = (240, 240, 240)
MAX_DESIRED = 8  # aircraft: of more, desired values are not drawn
COURSE_RANGE = (-180.0, 180.0)  # deg

Values = Callable[[ViewBatch], Array]  # (m, k)


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
    rows = _tabs(scene)
    if len(scene.names) <= MAX_SINGLE:
        return rows
    marked = [[_with_median(plot) for plot in row] for row in rows]
    for row in marked:  # in the title of the open tab only: titles of tabs are short
        row[0] = replace(row[0], title=f"{row[0].title}; white: median")
    return tuple(map(tuple, marked))


def _with_median(plot: TimePlot) -> TimePlot:
    """Draw the curves of many aircraft thin and faded, and their median over them.

    A median of courses means nothing: they wrap around.
    """
    first = plot.series[0]
    faded = tuple(mix(colour, BACKDROP, 0.45) for colour in first.colours)
    thin = replace(first, colours=faded, width=0.8)
    if plot.name == "course":
        return replace(plot, series=(thin, *plot.series[1:]))

    def median(batch: ViewBatch) -> Array:
        # by sorting, which puts NaN last
        ordered = np.sort(first.values(batch), axis=1)
        count = np.isfinite(ordered).sum(axis=1)
        rows = np.arange(len(ordered))
        low, high = np.maximum(count - 1, 0) // 2, count // 2
        values = 0.5 * (ordered[rows, low] + ordered[rows, np.minimum(high, ordered.shape[1] - 1)])
        middle: Array = np.where(count > 0, values, np.nan)[:, None]
        return middle

    middle = PlotSeries("median", ("median",), (MEDIAN,), median, width=2.0)
    return replace(plot, series=(thin, middle, *plot.series[1:]))


def _tabs(scene: Scene) -> tuple[tuple[TimePlot, ...], ...]:
    motion = (*_speeds(scene), *_directions(scene))
    commands = (
        _bank(scene),
        _plot("throttle", [_quantity(scene, "throttle", "commanded")], (0.0, 1.0)),
    )
    air = (
        _plot("wind", [_quantity(scene, "wind", "horizontal")], (0.0, 5.0)),
        _plot("updraught", [_quantity(scene, "updraught", "up")], (-1.0, 1.0)),
    )
    if not scene.followers:
        return (motion[:1], motion[1:], (_altitude(scene), *commands, *air))
    error = _quantity(scene, "error", "error", followers=True)
    estimate_error = _quantity(scene, "estimate_error", "error")
    age = _quantity(scene, "age", "age", followers=True)
    errors = (
        _plot("error", [error], (0.0, 1.0)),
        *([_plot("estimate_error", [estimate_error], (0.0, 1.0))] if scene.estimated else []),
        _plot("age", [age], (0.0, STALE_S)),
    )
    barrier = (_barrier(scene),) if any(scene.barriers) else ()
    return (
        errors,
        (motion[0], *barrier, *motion[1:]),
        (*commands, _altitude(scene), *air),
    )


def _plot(
    name: str,
    series: Sequence[PlotSeries],
    min_range: tuple[float, float],
    limits: tuple[tuple[str, float], ...] = (),
    *,
    also: str = "",
) -> TimePlot:
    """Plot a quantity of `PLOTTED`, and in words what its horizontal lines are."""
    return TimePlot(name, PLOTTED[name].title(also), tuple(series), min_range, limits)


def _speeds(scene: Scene) -> tuple[TimePlot, ...]:
    """Plot speed with its bounds; and ground speed if the bounds are of airspeed."""
    ground = _actual_and_desired(scene, "speed")
    bounds = unique_values(scene.speed_bounds) or [12.0, 33.0]
    limits = tuple((f"bound {value:g}", value) for value in bounds if scene.followers)
    min_range = bounds[0] - 1.0, bounds[-1] + 1.0
    if not scene.bounds_wind.any():
        return (_plot("speed", ground, min_range, limits, also="bounds" if limits else ""),)
    rows = range(len(scene.names))
    air = _series(
        scene,
        "actual",
        rows,
        lambda batch: np.linalg.norm(batch.velocity - scene.bounds_wind, axis=-1),
    )
    mixed = len({bool(each.any()) for each in scene.bounds_wind}) > 1
    title = PLOTTED["bounded_speed"].title("bounds")
    if mixed:
        title = "Speed as its bounds are measured, m/s"
    return (
        TimePlot("speed", title, (air,), min_range, limits),
        replace(_plot("speed", ground, min_range), name="ground_speed"),
    )


def _directions(scene: Scene) -> tuple[TimePlot, TimePlot]:
    courses, angles = (_actual_and_desired(scene, name) for name in ("course", "flight_path_angle"))
    return (
        replace(_plot("course", courses, COURSE_RANGE), fixed_range=True),
        _plot("flight_path_angle", angles, (-10.0, 10.0)),
    )


def _bank(scene: Scene) -> TimePlot:
    limits_deg = unique_values(np.degrees(scene.roll_limit))
    largest = 1.02 * limits_deg[-1] if limits_deg else 60.0
    lines = tuple(
        (f"limit {sign * each:g}", sign * each) for each in limits_deg for sign in (-1, 1)
    )
    bank = _quantity(scene, "bank", "actual")
    return _plot("bank", [bank], (-largest, largest), lines, also="limits")


def _altitude(scene: Scene) -> TimePlot:
    heights = -np.concatenate(scene.paths)[:, 2] if scene.paths else np.array([100.0])
    min_range = (float(heights.min()) - 10.0, float(heights.max()) + 10.0)
    return _plot("altitude", [_quantity(scene, "altitude", "actual")], min_range)


def _barrier(scene: Scene) -> TimePlot:
    """Plot the barrier h of (14): 1 in the middle of the speed set, 0 at its bounds."""
    known = [i for i, each in enumerate(scene.barriers) if each is not None]
    rows = np.array(scene.followers)[known]
    chosen = [each for each in scene.barriers if each is not None]
    low, high = scene.speed_bounds[known].T

    def value(batch: ViewBatch) -> Array:
        through = batch.velocity[:, rows] - scene.bounds_wind[rows]
        speed = np.linalg.norm(through, axis=-1)
        curves = [logged_curve(each, speed[:, i], low[i], high[i]) for i, each in enumerate(chosen)]
        return np.stack(curves, axis=1)

    series = _series(scene, "h", rows.tolist(), value)
    return _plot("barrier", [series], (-0.1, 1.1), (("bound", 0.0),))


def _actual_and_desired(scene: Scene, name: str) -> tuple[PlotSeries, ...]:
    """Plot what all aircraft do and, thin and faded, what followers should do."""
    done, rows, quantity = _quantity(scene, name, "actual"), scene.followers, PLOTTED[name]
    if not rows or len(scene.names) > MAX_DESIRED:
        return (done,)
    wanted = _series(scene, "desired", rows, lambda batch: quantity.field(batch, quantity.desired))
    return (
        done,
        replace(
            wanted,
            labels=tuple(f"{label} desired" for label in wanted.labels),
            colours=tuple(mix(colour, BACKDROP, 0.45) for colour in wanted.colours),
            width=1.0,
        ),
    )


def _quantity(scene: Scene, name: str, series: str, *, followers: bool = False) -> PlotSeries:
    """Make the series of a quantity of `PLOTTED`, of all aircraft or of followers."""
    rows = scene.followers if followers else range(len(scene.names))
    return _series(scene, series, rows, PLOTTED[name].values)


def _series(scene: Scene, name: str, rows: Sequence[int], values: Values) -> PlotSeries:
    """Plot the values (m, k) of k aircraft, by their rows, until they are lost."""
    chosen = list(rows)

    def until_lost(batch: ViewBatch) -> Array:
        return np.where(batch.lost[:, chosen] > 0.0, np.nan, values(batch))

    return PlotSeries(
        name,
        tuple(scene.names[row] for row in chosen),
        tuple(scene.colours[row] for row in chosen),
        until_lost,
    )
