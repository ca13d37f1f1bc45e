"""What aircraft feel of one another's trailing vortices.

Each aircraft leaves the vortices of an elliptically loaded wing along the path that it has flown
through the air, with the circulation that its lift had there. They lie as a flat sheet behind the
wing, which rolls up into a pair π/4 of the span apart within the distance 0.28 (A/C_L) b
(J. R. Spreiter and A. H. Sacks, J. Aeronautical Sciences 18, 1951, pp. 21-32). Here the sheet is
some nested pairs, which draw together in proportion to their age; their impulse stays as it is.
They sink as the rolled-up pair does, turbulence does not stir them, and the ground is far away.
The velocity about each is that of D. C. Burnham and J. N. Hallock (1982), Γ r/(2π (r² + r_c²)).

A follower feels of each trail the place abeam of it, as if the trail were straight from there to
the wing that sheds it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from testbed.air.lifting_line import nodes, roll_coefficient, roll_gain
from testbed.air.trails import Trails, abeam, remember, straight, unit
from testbed.air.vortices import horseshoe, pairs
from testbed.compiled import ready_of
from testbed.frames import GRAVITY, rotation_ned_body
from testbed.state import Array, Truths

POINTS = 32  # along a follower's span; half as many err by up to 3 %, with cores of 0.05 spans
PAIRS = 3  # that stand for the sheet; more change a rolling moment by 3 % of its greatest
# The distance above, as the time b² k/Γ: A/C_L = V b²/(2 Γ b₀) with b₀ = π b/4.
ROLL_UP = 0.28 * 2.0 / math.pi
KEPT_S = 0.05  # between places of a trail: a turn strays from straight by millimetres
FADED = 0.1  # of what is remembered, over which a trail fades to nothing instead of ending
SLOWEST = 1.0  # m/s, below which a wing's circulation is not its lift's


class Tables(NamedTuple):
    """What does not change of N aircraft and their vortices."""

    span: Array  # b (N,) m
    mass: Array  # (N,) kg
    roll_gain: Array  # (N,) of `lifting_line.roll_gain`
    sheds: Truths  # (N,)
    feels: Truths  # (N,)
    points: Array  # (M,) half spans, right positive, where a wing is sampled
    weights: Array  # (M,) of the mean over the wing
    pair_places: Array  # (P,) half spans, of the right vortex of each pair in the flat sheet
    pair_shares: Array  # (P,) of the circulation
    core: Array  # r_c (N,) m
    density: float  # kg/m³
    decay: float  # 1/s
    memory_s: float
    dt: float  # s, one tick
    kept: int  # ticks between the places of a trail


def shed(
    tables: Tables, velocity: Array, acceleration: Array, euler: Array
) -> tuple[Array, Array, Array]:
    """Flight direction and right (N, 3), unit vectors, and circulation Γ = L/(ρ V b₀) (N,).

    The lift L is what the wing must give, mass times specific force, on the axis across the
    flight direction in the aircraft's plane of symmetry.

    Args:
        tables: of the N aircraft.
        velocity: (N, 3) m/s through the air, NED.
        acceleration: (N, 3) m/s², NED.
        euler: (N, 3) rad.
    """
    speed = np.maximum(np.linalg.norm(velocity, axis=-1), SLOWEST)
    forward = unit(velocity)
    down = unit(np.cross(forward, rotation_ned_body(euler)[:, :, 1]))
    load = ((np.array([0.0, 0.0, GRAVITY]) - acceleration) * down).sum(axis=-1)
    lift = tables.mass * load
    circulation = lift / (tables.density * speed * (0.25 * np.pi * tables.span))
    return forward, np.cross(down, forward), circulation


def felt(
    tables: Tables,
    trails: Trails,
    tick: int,
    position: Array,
    velocity: Array,
    acceleration: Array,
    euler: Array,
) -> tuple[Array, Array]:
    """Write this tick into the trails, and say what each aircraft feels of the others'.

    Args:
        tables: of the N aircraft.
        trails: of the N aircraft, written in place.
        tick: of this call.
        position: (N, 3) m, in the frame that the mean wind carries.
        velocity: (N, 3) m/s through the air, NED.
        acceleration: (N, 3) m/s², NED.
        euler: (N, 3) rad.

    Returns:
        The velocity of the air (N, 3) m/s, NED, averaged over the wing; and the rolling-moment
        coefficient (N,), right wing down, of what varies along it.
    """
    forward, right, circulation = shed(tables, velocity, acceleration, euler)
    remember(trails, tables.kept, tick, position, forward, right, circulation)
    place = abeam(trails, tables.dt, position)

    effective_age = place.age
    if tables.decay > 0.0:
        effective_age = -np.expm1(-tables.decay * place.age) / tables.decay
    sunk = place.circulation / (0.5 * np.pi**2 * tables.span) * effective_age
    left = np.clip((1.0 - place.age / tables.memory_s) / FADED, 0.0, 1.0)
    strength = place.circulation * np.exp(-tables.decay * place.age) * left
    meets = place.found & tables.feels[:, None] & tables.sheds & ~np.eye(len(position), dtype=bool)
    # 1 in the flat sheet, 0 in the pair
    flat = np.maximum(0.0, 1.0 - place.age * abs(place.circulation) / (ROLL_UP * tables.span**2))

    axes = np.stack(
        [place.forward, place.right, np.cross(place.forward, place.right)], axis=-1
    )  # (N, N, 3, 3), its columns forward, right and down
    wing = rotation_ned_body(euler)[:, :, 1]
    reach = 0.5 * tables.span[:, None, None] * tables.points[:, None] * wing[:, None, :]
    at = (position[:, None, :] + reach)[:, None] - place.position[:, :, None]
    at = at @ axes  # (N, N, M, 3) from the place of the trail
    at[..., 0] -= place.ahead[..., None]
    at[..., 2] -= sunk[..., None]
    half_span = 0.5 * tables.span * 0.25 * np.pi
    local = np.zeros_like(at)
    for where, share in zip(tables.pair_places, tables.pair_shares, strict=True):
        drawn = half_span + flat * (0.5 * tables.span * where - half_span)
        local += share * horseshoe(at, drawn[..., None], tables.core[:, None])
    # chosen, not multiplied by zero: what is not a number stays with whom it befell
    local = np.where(meets[..., None, None], strength[..., None, None] * local, 0.0)
    flow = local @ np.where(meets[..., None, None], axes, 0.0).swapaxes(-1, -2)

    mean = (tables.weights[:, None] * flow).sum(axis=(1, 2))
    downwash = (flow.sum(axis=1) * np.cross(forward, right)[:, None, :]).sum(axis=-1)
    speed = np.maximum(np.linalg.norm(velocity, axis=-1), SLOWEST)
    return mean, roll_coefficient(downwash, speed, tables.roll_gain)


def add_wakes(
    tables: Tables,
    trails: Trails,
    drift: Array,
    position: Array,
    velocity: Array,
    acceleration: Array,
    euler: Array,
    ambient: Array,
    wind: Array,
    roll: Array,
    tick: int,
) -> None:
    """As `felt`, over the ground; what is felt goes into arrays that are there.

    Args:
        tables: of the N aircraft.
        trails: of the N aircraft, written in place.
        drift: (3,) m, how far the air has carried the trails; moved on by a tick.
        position: (N, 3) m, NED.
        velocity: (N, 3) m/s over the ground, NED.
        acceleration: (N, 3) m/s², NED.
        euler: (N, 3) rad.
        ambient: (N, 3) m/s, the wind that carries the air.
        wind: (N, 3) m/s; added to.
        roll: (N,) rolling-moment coefficient; written.
        tick: of this call.
    """
    given = position - drift, velocity - ambient, acceleration, euler
    washed, roll[:] = felt(tables, trails, tick, *given)
    wind += washed
    # one drift for all trails: who feels them flies near to who sheds them
    if tables.sheds.any():
        drift += tables.dt * ambient[tables.sheds].mean(axis=0)


READY_WAKES = ready_of(add_wakes, "testbed.air.wake_twin")


class Wakes:
    """The trails of N aircraft in flight.

    Args:
        span: (N,) m.
        area: (N,) m², of the wing.
        lift_slope: (N,) per rad, of the airframe.
        mass: (N,) kg.
        sheds: (N,) whether it leaves a trail.
        feels: (N,) whether it feels the others'.
        core_spans: r_c in spans of the shedder.
        decay_s: in which a trail falls to 1/e; None: it does not decay.
        memory_s: a trail is forgotten behind this age; it fades over the last tenth.
        dt: s between steps.
        density: kg/m³, of the air.
    """

    def __init__(
        self,
        *,
        span: Array,
        area: Array,
        lift_slope: Array,
        mass: Array,
        sheds: Truths,
        feels: Truths,
        core_spans: float,
        decay_s: float | None,
        memory_s: float,
        dt: float,
        density: float,
    ) -> None:
        """See the class."""
        self._tables = Tables(
            span,
            mass,
            roll_gain(span**2 / area, lift_slope),
            sheds.copy(),
            feels.copy(),
            *nodes(POINTS),
            *pairs(PAIRS),
            core_spans * span,
            density,
            1.0 / decay_s if decay_s else 0.0,
            memory_s,
            dt,
            max(1, round(KEPT_S / dt)),
        )
        self._trails: Trails | None = None
        self._tick, self._drift = 0, np.zeros(3)

    def remove(self, rows: Truths) -> None:
        """Leave out the trails of these (N,), and what they feel."""
        for which in (self._tables.sheds, self._tables.feels):
            which &= ~rows

    def bind(
        self,
        position: Array,
        velocity: Array,
        acceleration: Array,
        euler: Array,
        ambient: Array,
        wind: Array,
        roll: Array,
    ) -> Callable[[], None]:
        """What moves on by dt and adds what is felt; see `add_wakes`.

        The arrays may change from call to call. At the first step the trails are as if the flight
        had been straight.
        """
        tables = self._tables
        given = position, velocity, acceleration, euler, ambient, wind, roll
        add: Callable[[int], None] | None = None

        def step() -> None:
            nonlocal add
            if self._trails is None:
                through_air = velocity - ambient
                self._trails = straight(
                    position,
                    through_air,
                    *shed(tables, through_air, acceleration, euler),
                    kept=tables.kept,
                    dt=tables.dt,
                    memory_s=tables.memory_s,
                )
            if add is None:
                add = READY_WAKES(tables, self._trails, self._drift, *given)
            add(self._tick)
            self._tick += 1

        return step
