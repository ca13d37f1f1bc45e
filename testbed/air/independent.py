"""Turbulence that each aircraft flies through on its own, by MIL-F-8785C."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from testbed.air.filters import FILTERS, Filters, blank_filters, count
from testbed.air.mil import share_above
from testbed.compiled import ready_of
from testbed.errors import InputError
from testbed.frames import COURSE_FLOOR, rotation_ned_body
from testbed.state import Array
from testbed.streams import stream

BLOCK = 256  # draws made at a time; a draw's value does not depend on it


def advance_filters(state: Array, draw: Array, filters: Filters) -> tuple[Array, Array, Array]:
    """The filters' next states and what they give.

    Args:
        state: (N, 7 M + 1): M longitudinal, one of p, M × 3 lateral, M × 3 vertical.
        draw: standard normal numbers (N, 7 M + 1).
        filters: of this step.

    Returns:
        The states (N, 7 M + 1); longitudinal, lateral and vertical turbulence (N, 3), m/s; p, q
        and r of the air (N, 3), rad/s.
    """
    plain = filters.keep.shape[1]
    blocks = filters.transition.shape[:-1]  # (N, 2, M, 3)
    out = np.empty_like(state)
    out[:, :plain] = filters.keep * state[:, :plain] + filters.fresh * draw[:, :plain]
    old, new = state[:, plain:].reshape(blocks), draw[:, plain:].reshape(blocks)
    transverse = (filters.transition @ old[..., None] + filters.root @ new[..., None])[..., 0]
    out[:, plain:] = transverse.reshape(len(state), -1)
    turbulence, rates = np.empty((len(state), 3)), np.empty((len(state), 3))
    turbulence[:, 0] = (filters.gain * out[:, :plain])[:, :-1].sum(axis=1)
    turbulence[:, 1:] = (filters.speed * transverse[..., :2]).sum(axis=(2, 3))
    rates[:, 0] = filters.gain[:, -1] * out[:, plain - 1]
    rates[:, :0:-1] = (filters.rate * transverse).sum(axis=(2, 3))  # r, then q
    return out, turbulence, rates


def turbulence_axes(height: Array, velocity_through_air_ned: Array, euler: Array) -> Array:
    """The matrices (N, 3, 3) that take turbulence from its axes to NED, MIL-F-8785C 3.7.2, 3.7.3.

    Up to 1000 ft longitudinal turbulence is along the horizontal motion through the air and
    vertical turbulence is vertical; from 2000 ft its axes are the body's. Between, the two vectors
    are mixed linearly, so the matrix there is no rotation: where a bank parts the two frames it
    shortens.

    Args:
        height: above the ground (N), m.
        velocity_through_air_ned: (N, 3), m/s.
        euler: roll, pitch, yaw (N, 3), rad.
    """
    north, east = velocity_through_air_ned[:, 0], velocity_through_air_ned[:, 1]
    horizontal = np.hypot(north, east)
    moving = horizontal > COURSE_FLOOR
    upright = np.where(moving, horizontal, 1.0)
    cosine, sine = np.where(moving, north / upright, 1.0), np.where(moving, east / upright, 0.0)
    level = np.zeros((len(height), 3, 3))
    level[:, 0, 0] = level[:, 1, 1] = cosine
    level[:, 0, 1] = -sine
    level[:, 1, 0] = sine
    level[:, 2, 2] = 1.0
    above = share_above(height)[:, None, None]
    return (1.0 - above) * level + above * rotation_ned_body(euler)


def add_turbulence(
    state: Array,
    filters: Filters,
    position: Array,
    velocity: Array,
    euler: Array,
    mean: Array,
    wind: Array,
    rates: Array,
    draw: Array,
) -> None:
    """Step the filters, and add what they give to the wind and to the turns of the air.

    Args:
        state: (N, 7 M + 1), as in `advance_filters`; changed in place.
        filters: of this step.
        position: (N, 3) m, NED.
        velocity: (N, 3) m/s over the ground, NED.
        euler: (N, 3) rad.
        mean: (N, 3) m/s, the mean wind.
        wind: (N, 3) m/s; added to.
        rates: (N, 3) rad/s; added to.
        draw: standard normal numbers (N, 7 M + 1).
    """
    state[:], turbulence, turns = advance_filters(state, draw, filters)
    axes = turbulence_axes(-position[:, 2], velocity - mean, euler)
    wind += (axes @ turbulence[:, :, np.newaxis])[:, :, 0]
    rates += turns


READY_ADD_TURBULENCE = ready_of(add_turbulence, "testbed.air.independent_twin")


class Independent:
    """Turbulence of N aircraft, one stream of random numbers each, keyed by its name.

    Args:
        names: N names of aircraft.
        seed: of the run.
        dt: s between samples.
        spans: N wingspans, m.
        spectrum: "dryden" or "von-karman".
        scales: gives σ (N, 3) m/s and L (N, 3) m at heights (N), such as `mil.Scales`.
        hold_s: how long the filters of a height and an airspeed are kept, s.

    Raises:
        InputError: a span or a step that no flight has.
    """

    def __init__(
        self,
        names: Sequence[str],
        *,
        seed: int,
        dt: float,
        spans: Sequence[float],
        spectrum: str,
        scales: Callable[[Array], tuple[Array, Array]],
        hold_s: float = 0.5,
    ) -> None:
        """See the class."""
        for name, span in zip(names, spans, strict=True):
            if not 0.0 < span < np.inf:
                raise InputError(f"{name} has a wingspan of {span:g} m: write one above 0 m")
        if not 0.0 < dt < np.inf:
            raise InputError(f"turbulence every {dt:g} s: write a step above 0 s")
        self._dt = dt
        self._spans = np.array(spans, dtype=np.float64)
        self._spectrum = spectrum
        self._scales = scales
        self._hold = max(1, round(hold_s / dt))
        self._held = 0  # steps that the filters are still good for
        self._filters = blank_filters(spectrum, len(names))
        self._numbers = count(spectrum)
        self._streams = [stream(seed, f"air/{name}") for name in names]
        self._draws: Sequence[Array] = ()
        self._next = 0
        # of unit variance and uncorrelated: the filters start as they go on
        self._state = self._draw().copy()

    def _draw(self) -> Array:
        """The next standard normal numbers (N, 7 M + 1)."""
        if self._next == len(self._draws):
            blocks = [each.standard_normal((BLOCK, self._numbers)) for each in self._streams]
            self._draws, self._next = list(np.stack(blocks, axis=1)), 0
        self._next += 1
        return self._draws[self._next - 1]

    def bind(
        self,
        position: Array,
        velocity: Array,
        euler: Array,
        mean: Array,
        wind: Array,
        rates: Array,
    ) -> Callable[[], None]:
        """What moves on by dt and adds what is felt; see `add_turbulence`.

        The arrays may change from call to call. The standard's turbulence is longitudinal
        (forward), lateral (right) and vertical (down).
        Rates are those with which the air turns about body axes: an airframe that turned with it
        would feel none.
        """
        given = position, velocity, euler, mean, wind, rates
        add = READY_ADD_TURBULENCE(self._state, self._filters, *given)

        def step() -> None:
            if self._held == 0:
                airspeed = np.sqrt(((velocity - mean) ** 2).sum(axis=1))
                sigma, length = self._scales(-position[:, 2])
                distance = airspeed * self._dt
                FILTERS(self._spectrum, distance, sigma, length, self._spans, self._filters)
                self._held = self._hold
            self._held -= 1
            add(self._draw())

        return step
