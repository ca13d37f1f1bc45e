"""The quantities that are plotted over time: words, unit, values, and tab of the layouts.

Each is declared once. The Rerun viewer (`plots`) and the figures of `testbed.reports` draw its
values; the layouts of Foxglove and PlotJuggler (`log_plots`) draw its fields of the log.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np

from testbed.core.flags import flag_names
from testbed.core.frames import course, flight_path_angle, wrap_pi
from testbed.core.records import Array
from testbed.logs.messages import QUANTITIES
from testbed.views.panels import break_at_wrap
from testbed.views.sample_columns import ViewBatch

if TYPE_CHECKING:  # the process that feeds a viewer needs no reader of logs
    from testbed.logs.read import RunLog

DEGREES = "°"
# Values (K, N), or (K, n) of followers, of the arrays of these sources: paths from a sample.
Computed = tuple[Callable[..., Array], tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class PlottedQuantity:
    """A quantity of each of N aircraft, or of each of n followers, over time.

    Attributes:
        words: what it is, without its unit.
        unit: of its values; "" if it has none.
        fields: its names in the log, as in `FlightData`; several: the components of a vector.
        desired: name of its desired or commanded value in the log; "" without one.
        computed: its values, where they are not those of its only field.
        tab: of the layouts, with a plot for each of the fields; "": layouts do not have it.
        wraps: an angle that is drawn within ±180°, with gaps where it wraps around.
    """

    words: str
    unit: str = ""
    fields: tuple[str, ...] = ()
    desired: str = ""
    computed: Computed | None = None
    tab: str = ""
    wraps: bool = False

    def label(self, also: str = "") -> str:
        """Return words and unit, as of an axis; `also`: what else is drawn."""
        words = f"{self.words} and {also}" if also else self.words
        return ", ".join(filter(None, [words, self.unit]))

    def title(self, also: str = "") -> str:
        """Return the label with a capital letter, as of a plot."""
        label = self.label(also)
        return label[0].upper() + label[1:]

    def values(self, run: ViewBatch | RunLog) -> Array:
        """Return the values of K samples (K, N), or (K, n) of followers."""
        if self.computed is None:
            return self.field(run, self.fields[0])
        function, sources = self.computed
        return self._in_unit(function(*(_array(run, source) for source in sources)))

    def field(self, run: ViewBatch | RunLog, name: str) -> Array:
        """Return the values of a field of the log, as `values` does."""
        found = QUANTITIES[name]
        return self._in_unit(found.of(_array(run, found.source)))

    def _in_unit(self, values: Array) -> Array:
        if self.unit != DEGREES:
            return values
        return break_at_wrap(np.degrees(wrap_pi(values))) if self.wraps else np.degrees(values)


def _array(run: ViewBatch | RunLog, source: str) -> Array:
    name = _COLUMNS[source] if isinstance(run, ViewBatch) else source
    array: Array = attrgetter(name)(run)
    return array


_COLUMNS = {each.metadata["source"]: each.name for each in fields(ViewBatch) if each.metadata}


def _length(vectors: Array) -> Array:
    length: Array = np.linalg.norm(vectors, axis=-1)
    return length


def _horizontal(vectors: Array) -> Array:
    return np.hypot(vectors[..., 0], vectors[..., 1])


def _bits(words: str, name: str) -> PlottedQuantity:
    """Make the quantity of a set of bits; its title has the value and the name of each bit."""
    bits = QUANTITIES[name].bits
    assert bits is not None
    values = zip(bits, flag_names(bits), strict=True)
    named = ", ".join(f"{int(bit)}: {text.replace('_', ' ')}" for bit, text in values)
    return PlottedQuantity(f"{words} ({named})", fields=(name,), tab="limits")


_POSITIONS = ("estimate.position_ned", "truth.position_ned")


def _ned(field: str) -> tuple[str, ...]:
    return tuple(field.format(axis) for axis in ("north", "east", "down"))


# By name, which in the viewer is that of an entity; in the order of the layouts.
PLOTTED: Mapping[str, PlottedQuantity] = {
    "error": PlottedQuantity(
        "formation error", "m", _ned("formation_error_{}_m"),
        computed=(_length, ("formation.error_ned",)), tab="formation",
    ),
    "speed": PlottedQuantity(
        "ground speed", "m/s", ("formation_speed_mps",), "formation_speed_desired_mps",
        (_length, ("truth.velocity_ned",)), "law",
    ),
    # those that depend on the bounds of the speed, and so on the run
    "bounded_speed": PlottedQuantity("airspeed in the steady wind", "m/s"),
    "speed_margin": PlottedQuantity("margin to the nearer speed bound", "m/s"),
    "barrier": PlottedQuantity("speed barrier h of (14)"),
    "course": PlottedQuantity(
        "course", DEGREES, ("formation_course_rad",), "formation_course_desired_rad",
        (course, ("truth.velocity_ned",)), "law", wraps=True,
    ),
    "flight_path_angle": PlottedQuantity(
        "flight-path angle", DEGREES, ("formation_flight_path_angle_rad",),
        "formation_flight_path_angle_desired_rad",
        (flight_path_angle, ("truth.velocity_ned",)), "law",
    ),
    "bank": PlottedQuantity(
        "bank", DEGREES, ("state_roll_rad",), "command_roll_rad", tab="attitude"
    ),
    "pitch": PlottedQuantity(
        "pitch", DEGREES, ("state_pitch_rad",), "command_pitch_rad", tab="attitude"
    ),
    "throttle": PlottedQuantity("commanded throttle", fields=("command_throttle",)),
    "servo_throttle": PlottedQuantity(
        "throttle", "", ("state_throttle",), "command_throttle", tab="attitude"
    ),
    "altitude": PlottedQuantity(
        "altitude", "m", computed=(lambda position: -position[..., 2], ("truth.position_ned",))
    ),
    "airspeed": PlottedQuantity("airspeed", "m/s", ("state_airspeed_mps",), tab="air"),
    "wind": PlottedQuantity(
        "horizontal wind", "m/s", _ned("state_wind_{}_mps"),
        computed=(_horizontal, ("air.wind_ned",)), tab="air",
    ),
    "updraught": PlottedQuantity(
        "upward wind", "m/s", computed=(lambda wind: -wind[..., 2], ("air.wind_ned",))
    ),
    "estimate_error": PlottedQuantity(
        "error of position estimate", "m",
        computed=(lambda estimate, truth: _length(estimate - truth), _POSITIONS),
    ),
    "estimate_horizontal": PlottedQuantity(
        "horizontal position, estimate − truth", "m",
        computed=(lambda estimate, truth: _horizontal(estimate - truth), _POSITIONS),
    ),
    "estimate_height": PlottedQuantity(
        "height, estimate − truth", "m",
        computed=(lambda estimate, truth: -(estimate - truth)[..., 2], _POSITIONS),
    ),
    "age": PlottedQuantity(
        "age of the oldest message in use", "s",
        computed=(lambda age: np.fmax.reduce(age, axis=-1), ("formation.age_s",)),
    ),
    "leader_age": PlottedQuantity(
        "age of the leader's message in use", "s", ("formation_age_s",), tab="network"
    ),
    "limiters": _bits("limiters of the law, sum", "formation_limiter_bits"),
    "saturations": _bits("saturations of the command, sum", "formation_saturation_bits"),
}  # fmt: skip
