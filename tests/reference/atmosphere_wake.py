"""Reference for `atmosphere.wake`: the same equations in numpy, for all aircraft at once."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.frames import rotation_ned_body
from testbed.atmosphere.wake import (
    FADE,
    NEAREST,
    PAIRS,
    POINTS,
    ROLL_UP,
    SLOWEST,
    STORAGE_S,
    roll_gain,
    sheet_pairs,
    wing_stations,
)
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, BoolArray


class Tables(NamedTuple):
    """What does not change of N aircraft and their vortices."""

    span: Array  # b (N,) m
    mass: Array  # (N,) kg
    roll_gain: Array  # (N,) of `lifting_line.roll_gain`
    sheds: BoolArray  # (N,)
    affected: BoolArray  # (N,)
    points: Array  # (M,) half spans, right positive, where a wing is sampled
    weights: Array  # (M,) of the mean over the wing
    pair_positions: Array  # (P,) half spans, of the right vortex of each pair in the flat sheet
    pair_parts: Array  # (P,) of the circulation
    core: Array  # r_c (N,) m
    density: float  # kg/m³
    decay: float  # 1/s
    memory_s: float
    dt: float  # s, one tick
    storage_ticks: int  # ticks between the places of a trail


class Trails(NamedTuple):
    """Where N aircraft were in the air, in rings of K places; written in place."""

    position: Array  # (N, K, 3) m, in the frame that the mean wind carries
    forward: Array  # (N, K, 3) unit vector of flight through the air
    right: Array  # (N, K, 3) unit vector across it, along the wing
    circulation: Array  # Γ (N, K) m²/s
    path: Array  # (N, K) m flown
    tick: NDArray[np.int64]  # (K,)
    newest: NDArray[np.int64]  # (1,) the row of the present, which is one of the K


class Places(NamedTuple):
    """The place of N trails abeam of N followers."""

    position: Array  # (N, N, 3) m: follower, shedder
    forward: Array  # (N, N, 3)
    right: Array  # (N, N, 3)
    circulation: Array  # (N, N) m²/s, as shed
    ahead: Array  # (N, N) m along the trail to the wing that shed it; negative: the wing is behind
    age: Array  # (N, N) s
    found: BoolArray  # (N, N)


def unit(vector: Array) -> Array:
    """Vectors (..., 3) of length one; of none where there is no direction."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.asarray(vector / np.maximum(length, np.finfo(float).tiny))


def straight(
    position: Array,
    velocity: Array,
    forward: Array,
    right: Array,
    circulation: Array,
    *,
    storage_ticks: int,
    dt: float,
    memory_s: float,
) -> Trails:
    """The trails of aircraft that have flown straight on to where they are, which is tick 0.

    Args:
        position: (N, 3) m.
        velocity: (N, 3) m/s, through the air.
        forward: (N, 3) unit vector.
        right: (N, 3) unit vector.
        circulation: (N,) m²/s.
        storage_ticks: ticks between the places of a trail.
        dt: s, one tick.
        memory_s: that the trails reach back, at least.
    """
    places = math.ceil(memory_s / (storage_ticks * dt)) + 2
    tick = storage_ticks * np.arange(-places, 0)
    return Trails(
        position=position[:, None, :] + velocity[:, None, :] * (tick * dt)[:, None],
        forward=np.repeat(forward[:, None], places, axis=1),
        right=np.repeat(right[:, None], places, axis=1),
        circulation=np.repeat(circulation[:, None], places, axis=1),
        path=np.linalg.norm(velocity, axis=-1)[:, None] * (tick * dt),
        tick=tick,
        newest=np.array([places - 1]),
    )


def remember(
    trails: Trails,
    storage_ticks: int,
    tick: int,
    position: Array,
    forward: Array,
    right: Array,
    circulation: Array,
) -> None:
    """Write the present into the trails; what it replaces stays if it is time to keep it."""
    row = int(trails.newest[0])
    if trails.tick[row] - trails.tick[row - 1] >= storage_ticks:
        row = (row + 1) % len(trails.tick)
        trails.newest[0] = row
    trails.position[:, row] = position
    trails.forward[:, row] = forward
    trails.right[:, row] = right
    trails.circulation[:, row] = circulation
    step_length = np.linalg.norm(position - trails.position[:, row - 1], axis=-1)
    trails.path[:, row] = trails.path[:, row - 1] + step_length
    trails.tick[row] = tick


def trail_crossings(trails: Trails, dt: float, position: Array) -> Places:
    """The place of each trail where it passes followers at `position` (N, 3) m, newest first.

    There the follower lies across the flight direction; between two stored places, on the
    straight line. A follower ahead of the wing has the wing itself.
    """
    places = len(trails.tick)
    order = (trails.newest[0] - np.arange(places)) % places
    to = position[:, None, None, :] - trails.position[None, :, order]
    along = (to * trails.forward[None, :, order]).sum(axis=-1)  # (N, N, K)
    passed = along >= 0.0
    older = passed.argmax(axis=-1)
    newer = np.maximum(older - 1, 0)
    least = np.take_along_axis(along, newer[..., None], axis=-1)[..., 0]
    most = np.take_along_axis(along, older[..., None], axis=-1)[..., 0]
    past = older > 0
    part = np.where(past, least / np.where(past, least - most, 1.0), 0.0)
    column = np.arange(len(position))

    def between(values: Array) -> Array:
        first, last = values[column, order[newer]], values[column, order[older]]
        weight = part if first.ndim == 2 else part[..., None]
        return np.asarray(first + weight * (last - first))

    forward = unit(between(trails.forward))
    right = between(trails.right)
    right = right - (right * forward).sum(axis=-1, keepdims=True) * forward
    path, ticks = between(trails.path), trails.tick.astype(np.float64)
    tick = ticks[order[newer]] + part * (ticks[order[older]] - ticks[order[newer]])
    return Places(
        position=between(trails.position),
        forward=forward,
        right=unit(right),
        circulation=between(trails.circulation),
        ahead=np.where(past, trails.path[:, order[0]] - path, -along[..., 0]),
        age=(ticks[order[0]] - tick) * dt,
        found=passed.any(axis=-1),
    )


def horseshoe(at: Array, half_span: Array, core: Array) -> Array:
    """Velocity (..., 3) m/s of a horseshoe vortex of unit circulation, forward, right and down.

    Biot and Savart's law for the bound vortex and for the two that trail backwards without end,
    each with Burnham and Hallock's factor r²/(r² + r_c²).

    Args:
        at: (..., 3) m from the middle of the bound vortex, forward, right, down.
        half_span: (...,) m, of the bound vortex.
        core: r_c (...,) m.
    """
    x, y, z = np.moveaxis(at, -1, 0)
    y1, y2 = y - half_span, y + half_span  # from the right tip and from the left
    r1 = np.sqrt(x * x + y1 * y1 + z * z + NEAREST)
    r2 = np.sqrt(x * x + y2 * y2 + z * z + NEAREST)
    square = core * core + z * z
    trail1 = (1.0 - x / r1) / (y1 * y1 + square)
    trail2 = (1.0 - x / r2) / (y2 * y2 + square)
    bound = (y2 / r2 - y1 / r1) / (x * x + square)
    out = np.stack(
        [z * bound, z * (trail1 - trail2), y2 * trail2 - y1 * trail1 - x * bound], axis=-1
    )
    return np.asarray(out / (4.0 * np.pi))


def wake_delta_cl(downwash: Array, airspeed: Array, gain: Array) -> Array:
    """Rolling-moment coefficient (...,), right wing down, of a downwash along the span.

    The second term of the series alone rolls: C_l = (π A/4) μ/(1 + 2 μ) (2/π) ∫ (w/V) sin θ sin 2θ
    dθ over 0..π at y = (b/2) cos θ.

    Args:
        downwash: w (..., M) m/s at the `nodes`, across the flight direction, down.
        airspeed: V (...,) m/s.
        gain: `roll_gain` (...,).
    """
    points, weights = wing_stations(downwash.shape[-1])
    return np.asarray(gain * (downwash * weights * points).sum(axis=-1) / airspeed)


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


def induced_velocity(
    tables: Tables,
    trails: Trails,
    tick: int,
    position: Array,
    velocity: Array,
    acceleration: Array,
    euler: Array,
) -> tuple[Array, Array]:
    """Write this tick into the trails, and return the effect of the others' on each aircraft.

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
    remember(trails, tables.storage_ticks, tick, position, forward, right, circulation)
    place = trail_crossings(trails, tables.dt, position)

    effective_age = place.age
    if tables.decay > 0.0:
        effective_age = -np.expm1(-tables.decay * place.age) / tables.decay
    sunk = place.circulation / (0.5 * np.pi**2 * tables.span) * effective_age
    left = np.clip((1.0 - place.age / tables.memory_s) / FADE, 0.0, 1.0)
    strength = place.circulation * np.exp(-tables.decay * place.age) * left
    meets = (
        place.found & tables.affected[:, None] & tables.sheds & ~np.eye(len(position), dtype=bool)
    )
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
    for where, part in zip(tables.pair_positions, tables.pair_parts, strict=True):
        drawn = half_span + flat * (0.5 * tables.span * where - half_span)
        local += part * horseshoe(at, drawn[..., None], tables.core[:, None])
    # selected, not multiplied by zero: NaN stays with the aircraft it occurred in
    local = np.where(meets[..., None, None], strength[..., None, None] * local, 0.0)
    flow = local @ np.where(meets[..., None, None], axes, 0.0).swapaxes(-1, -2)

    mean = (tables.weights[:, None] * flow).sum(axis=(1, 2))
    downwash = (flow.sum(axis=1) * np.cross(forward, right)[:, None, :]).sum(axis=-1)
    speed = np.maximum(np.linalg.norm(velocity, axis=-1), SLOWEST)
    return mean, wake_delta_cl(downwash, speed, tables.roll_gain)


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
    """As `induced_velocity`, over the ground; into given arrays.

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
    args = position - drift, velocity - ambient, acceleration, euler
    washed, roll[:] = induced_velocity(tables, trails, tick, *args)
    wind += washed
    # one drift for all trails: affected aircraft fly near those that shed them
    if tables.sheds.any():
        drift += tables.dt * ambient[tables.sheds].mean(axis=0)


class Wakes:
    """The wakes of aircraft, step by step; arguments as of `atmosphere.wake.WakeModel`."""

    def __init__(
        self, airframes, *, sheds, affected, core_spans, decay_s, memory_s, dt, density
    ) -> None:
        span, area, slope, mass = (
            np.array([getattr(each, name) for each in airframes])
            for name in ("span", "area", "lift_slope", "mass")
        )
        self.tables = Tables(
            span,
            mass,
            roll_gain(span**2 / area, slope),
            np.array(sheds),
            np.array(affected),
            *wing_stations(POINTS),
            *sheet_pairs(PAIRS),
            core_spans * span,
            density,
            1.0 / decay_s if decay_s else 0.0,
            memory_s,
            dt,
            max(1, round(STORAGE_S / dt)),
        )
        self.trails, self.tick, self.drift = None, 0, np.zeros(3)

    def add(self, position, velocity, acceleration, euler, ambient, wind, roll):
        tables = self.tables
        if self.trails is None:
            through_air = velocity - ambient
            self.trails = straight(
                position,
                through_air,
                *shed(tables, through_air, acceleration, euler),
                storage_ticks=tables.storage_ticks,
                dt=tables.dt,
                memory_s=tables.memory_s,
            )
        args = position, velocity, acceleration, euler, ambient, wind, roll
        add_wakes(tables, self.trails, self.drift, *args, self.tick)
        self.tick += 1
