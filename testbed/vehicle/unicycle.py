"""The ideal vehicle: extended unicycles, the model that the formation law is proved on.

    q̇ = s R e1        ṡ = p (u − s)        Ṙ = R [ω]×        y = R e1        [HBH23] eqs. (1)-(4)

with f = −p s and g = p in (2): the ground speed s follows its command u with one pole p; or with f
and g of a user. The angular velocity ω is resolved in the zero-roll velocity frame of y, as the
formation law gives it: its second and third components turn y upwards and to the right, its first
only rolls R. Held over a step it does matter: (26) in full keeps a climbing turn's γ exactly,
without the first component γ is off by ½ σ̇² sin γ cos γ dt per second.

There is no attitude in the model. What is reported as attitude is that of a coordinated turn along
the path, so that an ideal vehicle can be drawn and can lead.
"""

from __future__ import annotations

from math import atan, atan2, cos, exp, hypot, isfinite, sin, sqrt

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.errors import InputError
from testbed.core.frames import COURSE_FLOOR, GRAVITY
from testbed.core.records import (
    Array,
    BoolArray,
    Indices,
    Record,
    Records,
    Values,
    Vector,
    allocate,
)
from testbed.core.speed_model import SPEED_MODEL, later_speed, speed_terms
from testbed.core.velocity_frame import velocity_frame

# One extended unicycle.
UNICYCLE = np.dtype(
    [
        ("position", "f8", 3),  # q, m, NED
        ("rotation", "f8", (3, 3)),  # R; its first column is y, the direction of flight in NED
        ("speed", "f8"),  # s, over the ground, m/s
        ("speed_command", "f8"),  # u, m/s
        ("omega", "f8", 3),  # ω, rad/s, in the zero-roll velocity frame
        ("pole", "f8"),  # p, 1/s
        ("speed_model", SPEED_MODEL),  # f and g of a user in place of −p s and p
        ("stopped", "?"),  # it is lost and keeps its motion
    ],
    align=True,
)


def make_unicycles(
    position: Array, velocity: Array, pole: Array, speed_models: Records | None = None
) -> Records:
    """Return n unicycles (n,) of UNICYCLE in straight flight, without roll.

    Args:
        position: (n, 3) m.
        velocity: (n, 3) m/s over the ground.
        pole: p (n,) 1/s.
        speed_models: (n,) of SPEED_MODEL; None: f = −p s and g = p for all.

    Raises:
        InputError: a vehicle does not move, so it has no direction; or a pole is not positive.
    """
    speed = np.sqrt((np.asarray(velocity, dtype=float) ** 2).sum(axis=1))
    if not np.all(speed > 0.0):
        row = int(np.argmin(speed > 0.0))
        raise InputError(
            f"ideal vehicle {row} starts with a speed of {speed[row]:g} m/s, which has no "
            "direction; write a positive speed"
        )
    if not np.all(np.asarray(pole) > 0.0):
        raise InputError(
            f"the speed pole of an ideal vehicle is {np.min(pole):g} 1/s; write a positive number"
        )
    unicycles = allocate(UNICYCLE, len(speed))
    unicycles["position"], unicycles["rotation"] = position, velocity_frame(velocity)
    unicycles["speed"] = unicycles["speed_command"] = speed
    unicycles["pole"] = pole
    if speed_models is not None:
        unicycles["speed_model"] = speed_models
    return unicycles


@entry
def advance(unicycles: Records, dt: float, ticks: int) -> None:
    """Advance unicycles by `ticks` steps of dt (s) under held commands, [HBH23] eqs. (1)-(4).

    Each step resolves ω in NED at its beginning and holds it there: R and the speed are then
    exact, and the position is Simpson's rule over s y, of fourth order in dt. With a user's f and g
    the speed is of fourth order, too.

    Args:
        unicycles: (n,) of UNICYCLE; written.
        dt: s.
        ticks: how many steps.
    """
    for i in range(len(unicycles)):
        if not unicycles[i].stopped:
            _advance(unicycles[i], dt, ticks)


@kernel
def _advance(v: Record, dt: float, ticks: int) -> None:
    r, omega, position = v.rotation, v.omega, v.position
    u, s = v.speed_command, v.speed
    decay_midway, decay = exp(-0.5 * dt * v.pole), exp(-dt * v.pole)
    angle = dt * sqrt(omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2)
    for _ in range(ticks):
        x, y, z = _to_ned(r[:, 0], dt * omega[0], dt * omega[1], dt * omega[2])
        before = (r[0, 0], r[1, 0], r[2, 0])
        midway = _rotated(0.5 * x, 0.5 * y, 0.5 * z, 0.5 * angle, before[0], before[1], before[2])
        for axis in range(3):
            r[0, axis], r[1, axis], r[2, axis] = _rotated(
                x, y, z, angle, r[0, axis], r[1, axis], r[2, axis]
            )
        _orthonormalise(r)
        if v.speed_model.own:
            s_midway = later_speed(v.speed_model, u, s, 0.5 * dt)
            s_after = later_speed(v.speed_model, u, s_midway, 0.5 * dt)
        else:
            s_midway, s_after = u + (s - u) * decay_midway, u + (s - u) * decay
        for axis in range(3):
            mean = s * before[axis] + 4.0 * s_midway * midway[axis] + s_after * r[axis, 0]
            position[axis] += dt * mean / 6.0
        s = s_after
    v.speed = s


@entry
def write_motion(unicycles: Records, rows: Indices, aircraft: Records) -> None:
    """Write the motion of unicycles under their commands, as every vehicle reports it.

    The acceleration is ṡ y + s ω × y. Roll, pitch and yaw are atan(σ̇ s cos γ / g), γ and σ, and
    the body rates are those of γ̇ and σ̇ at a constant roll. The equivalent airspeed is the
    true one: the model has no air density.

    Args:
        unicycles: (n,) of UNICYCLE.
        rows: (n,) of the unicycles among the aircraft.
        aircraft: (N,) of AIRCRAFT; `wind` is read, `truth` is written.
    """
    for i in range(len(unicycles)):
        v, a = unicycles[i], aircraft[rows[i]]
        t, wind = a.truth, a.wind.wind_ned
        s, w2, w3 = v.speed, v.omega[1], v.omega[2]
        y = v.rotation[:, 0]
        level = hypot(y[0], y[1])
        square = 0.0
        for axis in range(3):
            t.position_ned[axis] = v.position[axis]
            t.velocity_ned[axis] = s * y[axis]
            square += (t.velocity_ned[axis] - wind[axis]) ** 2
        t.airspeed = t.equivalent_airspeed = sqrt(square)
        forward = v.pole * (v.speed_command - s)
        if v.speed_model.own:
            f, g = speed_terms(v.speed_model, s)
            forward = f + g * v.speed_command
        ax, ay, az = _to_ned(y, forward, s * w3, -s * w2)
        t.acceleration_ned[0], t.acceleration_ned[1], t.acceleration_ned[2] = ax, ay, az
        phi, theta = atan(w3 * s / GRAVITY), atan2(-y[2], level)
        t.euler[0], t.euler[1], t.euler[2] = phi, theta, atan2(y[1], y[0])
        yaw_rate = w3 / max(level, COURSE_FLOOR)
        t.rates_body[0] = -yaw_rate * sin(theta)
        t.rates_body[1] = w2 * cos(phi) + yaw_rate * sin(phi) * cos(theta)
        t.rates_body[2] = yaw_rate * cos(phi) * cos(theta) - w2 * sin(phi)


@kernel
def _to_ned(y: Vector, forward: float, right: float, down: float) -> Values:
    """Resolve a vector of the zero-roll frame of the unit vector y in NED."""
    level = hypot(y[0], y[1])
    cs, ss = 1.0, 0.0
    if level > COURSE_FLOOR:
        cs, ss = y[0] / level, y[1] / level
    along = level * forward - y[2] * down  # of the course
    return along * cs - right * ss, along * ss + right * cs, y[2] * forward + level * down


@kernel
def _sinc(angle: float) -> float:
    return sin(angle) / angle if angle > 0.0 else 1.0


@kernel
def _rotated(x: float, y: float, z: float, angle: float, vx: float, vy: float, vz: float) -> Values:
    """Rotate a vector by a rotation vector of this length (Rodrigues)."""
    half = _sinc(0.5 * angle)
    first, second = _sinc(angle), 0.5 * half * half
    cx, cy, cz = y * vz - z * vy, z * vx - x * vz, x * vy - y * vx
    return (
        vx + first * cx + second * (y * cz - z * cy),
        vy + first * cy + second * (z * cx - x * cz),
        vz + first * cz + second * (x * cy - y * cx),
    )


@kernel
def _orthonormalise(rotation: Array) -> None:
    """Take one Newton step to the nearest rotation: rounding would add up over hours."""
    excess = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            product = 0.0
            for row in range(3):
                product += rotation[row, a] * rotation[row, b]
            excess[a, b] = 0.5 * ((3.0 if a == b else 0.0) - product)
    for row in range(3):
        x, y, z = rotation[row]
        for b in range(3):
            rotation[row, b] = x * excess[0, b] + y * excess[1, b] + z * excess[2, b]


def stop_unicycles(unicycles: Records, first: Records, rows: BoolArray) -> None:
    """Stop unicycles (n,) in their motion, or in the first if it is not finite.

    Args:
        unicycles: (n,) of UNICYCLE; changed.
        first: (n,) at the start.
        rows: (n,)
    """
    for row in np.flatnonzero(rows & ~unicycles["stopped"]).tolist():
        numbers = unicycles[row]
        finite_fields = ("position", "rotation", "speed", "speed_command", "omega")
        if not all(np.isfinite(numbers[name]).all() for name in finite_fields):
            unicycles[row] = first[row]
        unicycles[row]["stopped"] = True


@kernel
def is_finite(v: Record) -> bool:
    """Return whether a unicycle has a finite position and velocity."""
    total = v.speed
    for a in range(3):
        total += v.position[a]
        for b in range(3):
            total += v.rotation[a, b]
    return isfinite(total)
