"""What is plotted of a run, for any number of aircraft: arithmetic only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from testbed.formation.barrier import Barrier, h
from testbed.frames import course, flight_path_angle, wrap_pi
from testbed.state import Array
from testbed.views.batch import Batch
from testbed.views.panels import break_turns, each_once
from testbed.views.scene import BACKDROP, Colour, Scene, mixed
from testbed.views.signs import STALE_S

LIMIT: Colour = (150, 150, 150)
MOST_DESIRED = 8  # aircraft: of more, what they should do is not drawn beside what they do
ANGLES = (-180.0, 180.0)  # deg

Values = Callable[[Batch], Array]  # (m, k)


@dataclass(frozen=True, slots=True)
class Series:
    """One quantity of some aircraft; those of one plot share its axes."""

    name: str
    labels: tuple[str, ...]  # k
    colours: tuple[Colour, ...]  # k
    values: Values
    width: float = 1.5  # points


@dataclass(frozen=True, slots=True)
class Plot:
    """A pair of axes over time, as high as what is seen in them.

    Attributes:
        name: of the entity.
        title: what, and its unit.
        series: of aircraft.
        least: what the axis shows at the least, so that a quiet plot looks quiet.
        limits: lines with their names, always in sight.
        whole: whether the axis shows `least` and nothing beyond.
    """

    name: str
    title: str
    series: tuple[Series, ...]
    least: tuple[float, float]
    limits: tuple[tuple[str, float], ...] = ()
    whole: bool = False

    @property
    def still(self) -> tuple[float, ...]:
        """What is drawn and does not move: the limits, and unless it is the whole axis, `least`."""
        return (*(value for _, value in self.limits), *(() if self.whole else self.least))


def tabs(still: Scene) -> tuple[tuple[Plot, ...], ...]:
    """The plots, as rows of tabs: the first of each row is on top."""
    flown = (*_speeds(still), *_directions(still))
    steered, air = (_bank(still), _throttle(still)), _air(still)
    if not still.followers:
        return (flown[:1], flown[1:], (_altitude(still), *steered), air)
    errors = (_error(still), *([_estimate(still)] if still.estimated else []))
    barrier = (_barrier(still),) if any(still.barriers) else ()
    return (
        errors,
        (flown[0], *barrier, *flown[1:]),
        (*steered, _altitude(still)),
        (_age(still), *air),
    )


def _speeds(still: Scene) -> tuple[Plot, ...]:
    """Speed within its bounds; where they are of airspeed, the speed over the ground too."""
    ground = _both(
        still,
        lambda batch: np.linalg.norm(batch.velocity, axis=-1),
        lambda batch: batch.speed_desired,
    )
    bounds = each_once(still.speed_bounds) or [12.0, 33.0]
    within = tuple((f"bound {value:g}", value) for value in bounds if still.followers)
    least = bounds[0] - 1.0, bounds[-1] + 1.0
    if not still.bounded_in.any():
        title = "Ground speed and bounds, m/s" if within else "Ground speed, m/s"
        return (Plot("speed", title, ground, least, within),)
    air = _everyone(
        still, "actual", lambda batch: np.linalg.norm(batch.velocity - still.bounded_in, axis=-1)
    )
    both = len({bool(each.any()) for each in still.bounded_in}) > 1
    title = "Speed as its bounds are measured, m/s" if both else "Airspeed and bounds, m/s"
    return (
        Plot("speed", title, (air,), least, within),
        Plot("ground_speed", "Ground speed, m/s", ground, least),
    )


def _directions(still: Scene) -> tuple[Plot, Plot]:
    headed = _both(
        still,
        lambda batch: break_turns(np.degrees(course(batch.velocity))),
        lambda batch: break_turns(np.degrees(wrap_pi(batch.course_desired))),
    )
    climbing = _both(
        still,
        lambda batch: np.degrees(flight_path_angle(batch.velocity)),
        lambda batch: np.degrees(batch.climb_desired),
    )
    return (
        Plot("course", "Course, deg", headed, ANGLES, whole=True),
        Plot("climb", "Flight path, deg", climbing, (-10.0, 10.0)),
    )


def _bank(still: Scene) -> Plot:
    banks = each_once(np.degrees(still.roll_limit))
    largest = 1.1 * banks[-1] if banks else 60.0
    actual = _everyone(still, "actual", lambda batch: np.degrees(batch.euler[..., 0]))
    limits = tuple((f"limit {side * each:g}", side * each) for each in banks for side in (-1, 1))
    return Plot("bank", "Bank and limits, deg", (actual,), (-largest, largest), limits)


def _throttle(still: Scene) -> Plot:
    commanded = _everyone(still, "commanded", lambda batch: batch.throttle)
    return Plot("throttle", "Throttle", (commanded,), (0.0, 1.0))


def _altitude(still: Scene) -> Plot:
    heights = -np.concatenate(still.paths)[:, 2] if still.paths else np.array([100.0])
    actual = _everyone(still, "actual", lambda batch: -batch.position[..., 2])
    around = (float(heights.min()) - 10.0, float(heights.max()) + 10.0)
    return Plot("altitude", "Altitude, m", (actual,), around)


def _air(still: Scene) -> tuple[Plot, Plot]:
    along = _everyone(still, "felt", lambda batch: np.linalg.norm(batch.wind[..., :2], axis=-1))
    up = _everyone(still, "felt", lambda batch: -batch.wind[..., 2])
    return (
        Plot("wind", "Wind felt, m/s", (along,), (0.0, 5.0)),
        Plot("updraught", "Updraught, m/s", (up,), (-1.0, 1.0)),
    )


def _error(still: Scene) -> Plot:
    error = _followers(still, "error", lambda batch: np.linalg.norm(batch.error, axis=-1))
    return Plot("error", "Position error, m", (error,), (0.0, 1.0))


def _estimate(still: Scene) -> Plot:
    off = _everyone(
        still, "off", lambda batch: np.linalg.norm(batch.believed - batch.position, axis=-1)
    )
    return Plot("estimate", "Estimate off by, m", (off,), (0.0, 1.0))


def _barrier(still: Scene) -> Plot:
    """The barrier h of (14): 1 in the midst of the speed set, 0 at its bounds."""
    known = [i for i, each in enumerate(still.barriers) if each is not None]
    rows = np.array(still.followers)[known]
    chosen = [each for each in still.barriers if each is not None]
    example, nu = (np.array(each) for each in zip(*chosen, strict=True))
    low, high = still.speed_bounds[known].T

    def value(batch: Batch) -> Array:
        through = batch.velocity[:, rows] - still.bounded_in[rows]
        return h(Barrier(example, nu), np.linalg.norm(through, axis=-1), low, high)[0]

    series = (_series(still, "h", rows.tolist(), value),)
    return Plot("barrier", "Speed barrier", series, (-0.1, 1.1), (("bound", 0.0),))


def _age(still: Scene) -> Plot:
    """How old the oldest news is that each follower uses of another."""
    oldest = _followers(still, "age", lambda batch: np.fmax.reduce(batch.age, axis=-1))
    return Plot("age", "Oldest news used, s", (oldest,), (0.0, STALE_S))


def _both(still: Scene, actual: Values, desired: Values) -> tuple[Series, ...]:
    """What all do and, thin and faded, what followers should do."""
    rows = still.followers
    done = _everyone(still, "actual", actual)
    if not rows or len(still.names) > MOST_DESIRED:
        return (done,)
    wanted = _series(still, "desired", rows, desired)
    return (
        done,
        replace(
            wanted,
            labels=tuple(f"{label} desired" for label in wanted.labels),
            colours=tuple(mixed(colour, BACKDROP, 0.45) for colour in wanted.colours),
            width=1.0,
        ),
    )


def _everyone(still: Scene, name: str, values: Values) -> Series:
    return _series(still, name, range(len(still.names)), values)


def _followers(still: Scene, name: str, values: Values) -> Series:
    return _series(still, name, still.followers, values)


def _series(still: Scene, name: str, rows: Sequence[int], values: Values) -> Series:
    """The values (m, k) of k aircraft, by their rows, until they are lost."""
    chosen = list(rows)

    def until_lost(batch: Batch) -> Array:
        return np.where(batch.lost[:, chosen] > 0.0, np.nan, values(batch))

    return Series(
        name,
        tuple(still.names[row] for row in chosen),
        tuple(still.colours[row] for row in chosen),
        until_lost,
    )
