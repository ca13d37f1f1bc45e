"""Wind and rolling moment that aircraft induce on one another by their trailing vortices.

Each aircraft leaves the vortices of an elliptically loaded wing along the path that it has flown
through the air, with the circulation that its lift had there. They lie as a flat sheet behind the
wing, which rolls up into a pair π/4 of the span apart within the distance 0.28 (A/C_L) b
(J. R. Spreiter and A. H. Sacks, J. Aeronautical Sciences 18, 1951, pp. 21-32). Here the sheet is
some nested pairs, which draw together in proportion to their age; their impulse stays constant.
They sink as the rolled-up pair does, turbulence does not displace them, and the ground is far away.
The velocity about each is that of D. C. Burnham and J. N. Hallock (1982), Γ r/(2π (r² + r_c²)).

A follower crosses each trail where the trail passes abeam of it. The vortices act on it as if they
were straight from there to the wing that sheds them.

What a downwash that varies along a wing does to it is Prandtl's lifting line. The wing is elliptic,
so that the series of its circulation takes the downwash term by term (H. Glauert, "The Elements of
Aerofoil and Airscrew Theory", chapters X and XI). Its section's lift slope is the one with which
it has the lift slope of the whole airframe. The rolling moment of a wake is a coefficient of its
own, not the roll rate of air that would roll the aircraft as much, because the damping in an
airframe's data need not be its wing's: the Rascal's is −0.40 per unit of p b/(2 V), the lifting
line's −0.52.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import exp, expm1, pi, sqrt

import numpy as np

from testbed.core.call_list import Call
from testbed.core.compile import entry, kernel
from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY, rotation_rows
from testbed.core.records import (
    Airframe,
    Array,
    BoolArray,
    Record,
    Records,
    Values,
    Vector,
    allocate,
)

POINTS = 32  # along a follower's span; half as many err by up to 3 %, with cores of 0.05 spans
PAIRS = 3  # that stand for the sheet; more change a rolling moment by 3 % of its maximum
# The roll-up distance as the time b² k/Γ: A/C_L = V b²/(2 Γ b₀) with b₀ = π b/4.
ROLL_UP = 0.28 * 2.0 / math.pi
STORAGE_S = 0.05  # between points of a trail: a turn deviates from straight by millimetres
FADE = 0.1  # of the memory, over which a trail fades out instead of ending
SLOWEST = 1.0  # m/s, below which a wing's circulation is not that of its lift
NEAREST = 1e-18  # m², so that the velocity at a vortex's own end is finite: zero

# One aircraft's wing.
WING = np.dtype(
    [
        ("span", "f8"),  # b, m
        ("mass", "f8"),  # kg, of the aircraft
        ("core", "f8"),  # r_c, m
        ("roll_gain", "f8"),
        ("sheds", "?"),  # leaves a trail
        ("affected", "?"),  # by the trails of others
    ],
    align=True,
)
# The wakes of a run: parameters, and what all trails have in common.
WAKE = np.dtype(
    [
        ("density", "f8"),  # kg/m³
        ("decay", "f8"),  # 1/s; 0: none
        ("memory_s", "f8"),  # age at which a trail ends
        ("dt", "f8"),  # s, one tick
        ("storage_ticks", "i8"),  # between points of a trail
        ("tick", "i8"),  # number of the present step
        ("newest", "i8"),  # row of the trails that is the present
        ("started", "?"),  # False before the first step
        ("drift", "f8", 3),  # m NED, how far the ambient wind has carried the trails
    ],
    align=True,
)
# One point of a trail, where the aircraft was in the air.
TRAIL_POINT = np.dtype(
    [
        ("position", "f8", 3),  # m NED, in the frame that the ambient wind carries
        ("forward", "f8", 3),  # unit vector of flight through the air
        ("right", "f8", 3),  # unit vector across it, along the wing
        ("circulation", "f8"),  # Γ, m²/s
        ("path", "f8"),  # m flown
        ("tick", "i8"),
    ],
    align=True,
)


def wing_stations(count: int) -> tuple[Array, Array]:
    """Return sample points of a wing, and their chord-weighted weights.

    Gauss's quadrature for the weight √(1 − x²), Chebyshev's polynomials of the second kind: exact
    for polynomials up to the order 2 count − 1.

    Returns:
        (count,) positions along the span in half spans, from the right tip to the left, and
        (count,) weights, whose sum is one.
    """
    theta = np.arange(1, count + 1) * np.pi / (count + 1)
    return np.cos(theta), 2.0 / (count + 1) * np.sin(theta) ** 2


def sheet_pairs(count: int) -> tuple[Array, Array]:
    """Return vortex pairs that stand for an elliptic wing's sheet.

    Strips of equal angle θ of y = (b/2) cos θ, each concentrated at its centroid.

    Returns:
        (count,) positions of the right vortices in half spans, and (count,) parts of the
        circulation.
    """
    edges = np.linspace(0.0, 0.5 * np.pi, count + 1)
    parts = np.diff(np.sin(edges))
    return np.diff(0.5 * edges + 0.25 * np.sin(2.0 * edges)) / parts, parts


def roll_gain(aspect_ratio: Array, lift_slope: Array) -> Array:
    """Return the response of a wing to the first moment of its downwash.

    It is (π A/2) μ/(1 + 2 μ), with μ = a₀/(π A) and the section's lift slope a₀ from
    C_Lα = a₀/(1 + μ).

    Args:
        aspect_ratio: A (...,).
        lift_slope: C_Lα (...,) per rad, of the airframe.

    Raises:
        InputError: no section gives a wing such a lift slope.
    """
    limit = np.pi * aspect_ratio
    for aspect, slope in np.broadcast(aspect_ratio, lift_slope):
        if not 0.0 < slope < np.pi * aspect:
            raise InputError(
                f"no wing of aspect ratio {aspect:g} has the lift slope {slope:g} per rad: "
                f"give the airframe one between 0 and {np.pi * aspect:.3g}"
            )
    mu = lift_slope / (limit - lift_slope)
    return np.asarray(0.5 * limit * mu / (1.0 + 2.0 * mu))


STATIONS, WEIGHTS = wing_stations(POINTS)
PAIR_POSITIONS, PAIR_PARTS = sheet_pairs(PAIRS)


class WakeModel:
    """The wakes of N aircraft in flight.

    Before the first step all aircraft are taken to have flown straight on.

    Args:
        airframes: N.
        sheds: (N,) whether the aircraft leaves a trail.
        affected: (N,) whether the others' trails act on it.
        core_spans: r_c in spans of the aircraft that sheds.
        decay_s: in which a trail falls to 1/e; None: it does not decay.
        memory_s: age at which a trail ends; it fades out over the last tenth.
        dt: s between steps.
        density: kg/m³, of the air.

    Attributes:
        wake: (1,) of WAKE.
        wings: (N,) of WING.
        trails: (N, K) of TRAIL_POINT, rings of which the oldest points are overwritten.
    """

    def __init__(
        self,
        airframes: Sequence[Airframe],
        *,
        sheds: Sequence[bool] | BoolArray,
        affected: Sequence[bool] | BoolArray,
        core_spans: float,
        decay_s: float | None,
        memory_s: float,
        dt: float,
        density: float,
    ) -> None:
        self.wake, self.wings = allocate(WAKE, 1), allocate(WING, len(airframes))
        wake, wings = self.wake, self.wings
        wings["span"] = span = np.array([each.span for each in airframes])
        wings["mass"] = [each.mass for each in airframes]
        area = np.array([each.area for each in airframes])
        lift_slope = np.array([each.lift_slope for each in airframes])
        wings["roll_gain"] = roll_gain(span**2 / area, lift_slope)
        wings["core"] = core_spans * span
        wings["sheds"], wings["affected"] = sheds, affected
        wake["density"], wake["decay"] = density, 1.0 / decay_s if decay_s else 0.0
        wake["memory_s"], wake["dt"] = memory_s, dt
        wake["storage_ticks"] = storage = max(1, round(STORAGE_S / dt))
        points = math.ceil(memory_s / (storage * dt)) + 2
        self.trails = allocate(TRAIL_POINT, len(airframes), points)

    def bind(self, aircraft: Records, local: Records) -> Call:
        """Return the step of aircraft (N,) of AIRCRAFT and their LOCAL_WIND (N,)."""
        return Call(add_wake_wind, self.wake, self.wings, self.trails, local, aircraft)

    def remove(self, rows: BoolArray) -> None:
        """Remove the trails of aircraft (N,), and the effect of trails on them."""
        self.wings["sheds"] &= ~rows
        self.wings["affected"] &= ~rows


@entry
def add_wake_wind(
    wake: Records, wings: Records, trails: Records, local: Records, aircraft: Records
) -> None:
    """Extend all trails by one step and add the wind they induce.

    Args:
        wake: (1,) of WAKE; written.
        wings: (N,) of WING.
        trails: (N, K) of TRAIL_POINT; written.
        local: (N,) of LOCAL_WIND.
        aircraft: (N,) of AIRCRAFT; truth is read, wind_ned is added to, wake_delta_cl is written.
    """
    w = wake[0]
    drift = np.zeros(3)
    shedding = 0
    for i in range(len(aircraft)):
        if wings[i].sheds:
            shedding += 1
            for axis in range(3):
                drift[axis] += local[i].ambient_wind[axis]
    if not w.started:
        for i in range(len(aircraft)):
            start_trail(w, wings[i], trails[i], aircraft[i].truth, local[i].ambient_wind)
        w.newest = trails.shape[1] - 1
        w.started = True
    if trails[0, w.newest].tick - trails[0, w.newest - 1].tick >= w.storage_ticks:
        w.newest = (w.newest + 1) % trails.shape[1]
    for i in range(len(aircraft)):
        extend_trail(w, wings[i], trails[i], aircraft[i].truth, local[i].ambient_wind)
    flow = np.empty((3, len(STATIONS)))
    for i in range(len(aircraft)):
        a = aircraft[i]
        a.wind.wake_delta_cl = 0.0
        if wings[i].affected:
            _add_induced(w, wings, trails, i, a, local[i].ambient_wind, flow)
    w.tick += 1
    # one drift for all trails: affected aircraft fly near those that shed them
    for axis in range(3):
        if shedding > 0:
            w.drift[axis] += w.dt * (drift[axis] / shedding)


@kernel
def circulation(w: Record, wing: Record, motion: Record, ambient: Vector) -> Values:
    """Return the circulation Γ = L/(ρ V b₀), m²/s, and directions.

    The directions are those of flight and right, unit vectors.

    The lift L is what the wing must give, mass times specific force, on the axis across the
    flight direction in the aircraft's plane of symmetry.

    Args:
        w: record of WAKE.
        wing: record of WING.
        motion: record of MOTION.
        ambient: m/s NED, the wind that carries the air.
    """
    velocity = _minus(_vector(motion.velocity_ned), ambient)
    acceleration = motion.acceleration_ned
    speed = max(_norm(velocity), SLOWEST)
    forward = _unit(velocity)
    down = _unit(_cross(forward, _wing_axis(motion.euler)))
    load = _dot((-acceleration[0], -acceleration[1], GRAVITY - acceleration[2]), down)
    lift = wing.mass * load
    gamma = lift / (w.density * speed * (0.25 * pi * wing.span))
    return gamma, forward, _cross(down, forward)


@kernel
def start_trail(w: Record, wing: Record, trail: Records, motion: Record, ambient: Vector) -> None:
    """Write the initial trail of an aircraft that has flown straight on.

    Args:
        w: record of WAKE.
        wing: record of WING.
        trail: (K) of TRAIL_POINT; written.
        motion: record of MOTION.
        ambient: m/s NED, the wind that carries the air.
    """
    gamma, forward, right = circulation(w, wing, motion, ambient)
    velocity = _minus(_vector(motion.velocity_ned), ambient)
    position = motion.position_ned
    speed = _norm(velocity)
    for k in range(len(trail)):
        point = trail[k]
        point.tick = w.storage_ticks * (k - len(trail))
        time = point.tick * w.dt
        for axis in range(3):
            point.position[axis] = position[axis] + velocity[axis] * time
        _write(point.forward, forward)
        _write(point.right, right)
        point.circulation = gamma
        point.path = speed * time


@kernel
def extend_trail(w: Record, wing: Record, trail: Records, motion: Record, ambient: Vector) -> None:
    """Write the present into the newest point of a trail; arguments as of `start_trail`."""
    point, last = trail[w.newest], trail[w.newest - 1]
    gamma, forward, right = circulation(w, wing, motion, ambient)
    point.tick, point.circulation = w.tick, gamma
    _write(point.position, _minus(_vector(motion.position_ned), w.drift))
    _write(point.forward, forward)
    _write(point.right, right)
    point.path = last.path + _norm(_minus(_vector(point.position), last.position))


@kernel
def trail_crossing(w: Record, trail: Records, place: Vector) -> Values:
    """Return where a trail passes a place: where the place lies across the flight direction.

    Between two points the trail is a straight line. The first crossing counts, seen from the wing.
    For a place ahead of the wing it is the wing itself.

    Args:
        w: record of WAKE.
        trail: (K) of TRAIL_POINT.
        place: m NED, in the frame that the ambient wind carries.

    Returns:
        Position, m, and unit vectors forward and right of the trail there; its circulation, m²/s,
        as shed; m along the trail to the wing that shed it, negative if the wing is behind; its
        age, s; whether there is a crossing.
    """
    count, newest = len(trail), w.newest
    older = newer = newest
    along = _ahead_of(trail[newest], place)
    ahead, part, found = -along, 0.0, along >= 0.0
    for _ in range(count - 1):
        if found:
            break
        newer, older = older, older - 1 if older > 0 else count - 1
        before = along
        along = _ahead_of(trail[older], place)
        found = along >= 0.0
        if found:
            part = before / (before - along)
            ahead = trail[newest].path - (
                trail[newer].path + part * (trail[older].path - trail[newer].path)
            )
    a, b = trail[newer], trail[older]
    at = _between(a.position, b.position, part)
    forward = _unit(_between(a.forward, b.forward, part))
    right = _between(a.right, b.right, part)
    lean = _dot(right, forward)
    right = _unit(_minus(right, (lean * forward[0], lean * forward[1], lean * forward[2])))
    gamma = a.circulation + part * (b.circulation - a.circulation)
    tick = a.tick + part * (b.tick - a.tick)
    age = (trail[newest].tick - tick) * w.dt
    return at, forward, right, gamma, ahead, age, found


@kernel
def _ahead_of(point: Record, place: Vector) -> float:
    """Return how far, m, a place lies ahead of a point of a trail."""
    return float(_dot(_minus(place, point.position), point.forward))


@kernel
def horseshoe(
    strength: float, half_span: float, core: float, x: float, y: float, z: float
) -> Vector:
    """Return the velocity of a horseshoe vortex, m/s, forward, right and down.

    Biot and Savart's law for the bound vortex and for the two that trail backwards without end,
    each with Burnham and Hallock's factor r²/(r² + r_c²).

    Args:
        strength: circulation over 4π, m²/s.
        half_span: m, of the bound vortex.
        core: r_c, m.
        x: m forward of the middle of the bound vortex.
        y: m right of it.
        z: m below it.
    """
    y1, y2 = y - half_span, y + half_span  # from the right tip and from the left
    r1 = sqrt(x * x + y1 * y1 + z * z + NEAREST)
    r2 = sqrt(x * x + y2 * y2 + z * z + NEAREST)
    square = core * core + z * z
    trail1 = (1.0 - x / r1) / (y1 * y1 + square)
    trail2 = (1.0 - x / r2) / (y2 * y2 + square)
    bound = (y2 / r2 - y1 / r1) / (x * x + square)
    return (
        strength * z * bound,
        strength * z * (trail1 - trail2),
        strength * (y2 * trail2 - y1 * trail1 - x * bound),
    )


@kernel
def write_sheet_flow(
    wing: Record, flatness: float, start: Vector, step: Vector, flow: Array
) -> None:
    """Write the velocities of a vortex sheet of unit circulation along a follower's wing.

    Args:
        wing: record of WING that sheds it.
        flatness: 1 as shed, 0 rolled up.
        start: (3,) m forward, right and down of the sheet's wing, the follower's centre.
        step: (3,) m, the follower's half span.
        flow: (3, M) m/s, forward, right and down, at the stations; written.
    """
    rolled_up = 0.5 * wing.span * 0.25 * pi
    flow[:] = 0.0
    for pair in range(len(PAIR_POSITIONS)):
        half_span = rolled_up + flatness * (0.5 * wing.span * PAIR_POSITIONS[pair] - rolled_up)
        strength = PAIR_PARTS[pair] / (4.0 * pi)
        for k in range(len(STATIONS)):
            x = start[0] + STATIONS[k] * step[0]
            y = start[1] + STATIONS[k] * step[1]
            z = start[2] + STATIONS[k] * step[2]
            u, v, w = horseshoe(strength, half_span, wing.core, x, y, z)
            flow[0, k] += u
            flow[1, k] += v
            flow[2, k] += w


@kernel
def wing_average(flow: Array) -> Vector:
    """Return the average of a flow (3, M), m/s, over a wing."""
    x = y = z = 0.0
    for k in range(len(STATIONS)):
        x += WEIGHTS[k] * flow[0, k]
        y += WEIGHTS[k] * flow[1, k]
        z += WEIGHTS[k] * flow[2, k]
    return x, y, z


@kernel
def add_moment(moment: float, strength: float, flow: Array, down: Vector) -> float:
    """Add the first moment of a flow's downwash along a wing, m/s.

    Args:
        moment: to which it is added.
        strength: factor of the flow.
        flow: (3, M) m/s at the stations.
        down: unit vector across flight direction and wing, in the axes of the flow.
    """
    for k in range(len(STATIONS)):
        downwash = _dot(down, (flow[0, k], flow[1, k], flow[2, k]))
        moment += strength * WEIGHTS[k] * STATIONS[k] * downwash
    return moment


@kernel
def wake_delta_cl(roll_gain: float, moment: float, airspeed: float) -> float:
    """Return the rolling-moment coefficient, right wing down, of a downwash along the span.

    The second term of the series alone rolls: C_l = (π A/4) μ/(1 + 2 μ) (2/π) ∫ (w/V) sin θ sin 2θ
    dθ over 0..π at y = (b/2) cos θ.

    Args:
        roll_gain: of `roll_gain`.
        moment: of `add_moment`, m/s.
        airspeed: V, m/s.
    """
    return roll_gain * moment / airspeed


@kernel
def _add_induced(
    w: Record, wings: Records, trails: Records, i: int, a: Record, ambient: Vector, flow: Array
) -> None:
    """Add the wind and the rolling moment that the other trails induce on one aircraft."""
    place, axis = _minus(_vector(a.truth.position_ned), w.drift), _wing_axis(a.truth.euler)
    half_span = 0.5 * wings[i].span
    own = trails[i, w.newest]
    own_down = _cross(own.forward, own.right)
    north = east = down = moment = 0.0
    for j in range(len(wings)):
        if j == i or not wings[j].sheds:
            continue
        at, forward, right, gamma, ahead, age, found = trail_crossing(w, trails[j], place)
        left = min(max((1.0 - age / w.memory_s) / FADE, 0.0), 1.0)
        if not found or left == 0.0:
            continue
        below = _cross(forward, right)
        effective_age = age
        if w.decay > 0.0:
            effective_age = -expm1(-w.decay * age) / w.decay
        span = wings[j].span
        sunk = gamma / (0.5 * pi**2 * span) * effective_age
        flatness = max(0.0, 1.0 - age * abs(gamma) / (ROLL_UP * span**2))
        to = _minus(place, at)
        start = (_dot(to, forward) - ahead, _dot(to, right), _dot(to, below) - sunk)
        step = (
            half_span * _dot(axis, forward),
            half_span * _dot(axis, right),
            half_span * _dot(axis, below),
        )
        write_sheet_flow(wings[j], flatness, start, step, flow)
        strength = gamma * exp(-w.decay * age) * left
        across = (_dot(own_down, forward), _dot(own_down, right), _dot(own_down, below))
        x, y, z = wing_average(flow)
        moment = add_moment(moment, strength, flow, across)
        north += strength * (x * forward[0] + y * right[0] + z * below[0])
        east += strength * (x * forward[1] + y * right[1] + z * below[1])
        down += strength * (x * forward[2] + y * right[2] + z * below[2])
    speed = max(_norm(_minus(_vector(a.truth.velocity_ned), ambient)), SLOWEST)
    a.wind.wake_delta_cl = wake_delta_cl(wings[i].roll_gain, moment, speed)
    a.wind.wind_ned[0] += north
    a.wind.wind_ned[1] += east
    a.wind.wind_ned[2] += down


@kernel
def _wing_axis(euler: Vector) -> Vector:
    """Return the body's y axis, NED."""
    x, y, z = rotation_rows(euler)
    return x[1], y[1], z[1]


@kernel
def _cross(a: Vector, b: Vector) -> Vector:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel
def _dot(a: Vector, b: Vector) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@kernel
def _norm(a: Vector) -> float:
    return sqrt(_dot(a, a))


@kernel
def _unit(a: Vector) -> Vector:
    length = _norm(a)
    return a[0] / length, a[1] / length, a[2] / length


@kernel
def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel
def _between(a: Vector, b: Vector, part: float) -> Vector:
    return (a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2]))


@kernel
def _vector(a: Vector) -> Vector:
    """Return a field of a record as a tuple."""
    return a[0], a[1], a[2]


@kernel
def _write(a: Array, b: Vector) -> None:
    a[0], a[1], a[2] = b
