"""The ideal vehicle: n extended unicycles, the model that the formation law is proved on.

    q̇ = s R e1        ṡ = p (u − s)        Ṙ = R [ω]×        y = R e1        [HBH23] eqs. (1)-(4)

with f = −p s and g = p in (2): the ground speed s follows its command u with one pole p. The turn ω
is resolved in the zero-roll velocity frame of y, as the formation law gives it: its second and
third components turn y upwards and to the right, its first only rolls R. Held over a step it does
matter: (26) in full keeps a climbing turn's γ exactly, without the first component γ is off by
½ σ̇² sin γ cos γ dt per second.

There is no attitude in the model. What is reported as attitude is that of a coordinated turn along
the path, so that an ideal vehicle can be drawn and can lead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from reference.frames import velocity_frame
from testbed.core.errors import InputError
from testbed.core.frames import COURSE_FLOOR, GRAVITY, body_rates, course, flight_path_angle
from testbed.core.records import Array, VehicleState


class Unicycle(NamedTuple):
    """The state of n extended unicycles."""

    position: Array  # q (n, 3) m, NED
    rotation: Array  # R (n, 3, 3); its first column is y, the direction of flight in NED
    speed: Array  # s (n,) over the ground, m/s


def unicycle(position: Array, velocity: Array) -> Unicycle:
    """Unicycles at positions (n, 3) m with velocities over the ground (n, 3) m/s, without roll.

    Raises:
        InputError: if one of them does not move: it has no direction of flight.
    """
    position, velocity = np.array(position, dtype=float), np.asarray(velocity, dtype=float)
    speed = np.sqrt((velocity**2).sum(axis=1))
    if not np.all(speed > 0.0):
        row = int(np.argmin(speed > 0.0))
        raise InputError(
            f"ideal vehicle {row} starts with a speed of {speed[row]:g} m/s, which has no "
            "direction; write a positive speed"
        )
    return Unicycle(position, velocity_frame(velocity), speed)


def rotation_by(vector: Array) -> Array:
    """The exponential map: exp([v]×) (n, 3, 3) of rotation vectors (n, 3), rad.

    I + sin a / a [v]× + ½ (sin ½a / ½a)² [v]×² with a = ‖v‖ (Rodrigues), exact for any angle.
    """
    angle = np.sqrt((vector**2).sum(axis=1))[:, np.newaxis, np.newaxis]
    skew = np.zeros((len(vector), 3, 3))
    skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0] = vector.T
    skew[:, 1, 2], skew[:, 2, 0], skew[:, 0, 1] = -vector.T
    half = np.sinc(0.5 * angle / np.pi)
    out: Array = np.eye(3) + np.sinc(angle / np.pi) * skew + 0.5 * half * half * (skew @ skew)
    return out


def advance(state: Unicycle, speed_command: Array, turn: Array, pole: Array, dt: float) -> Unicycle:
    """The unicycles `dt` s later, [HBH23] eqs. (1)-(4) under commands held meanwhile.

    The turn is resolved in NED at the beginning and held there: R and the speed are then exact,
    and the position is Simpson's rule over s y, of fourth order in dt.

    Args:
        state: of n unicycles.
        speed_command: u (n,) m/s.
        turn: ω (n, 3) rad/s in the zero-roll velocity frame.
        pole: p (n,) 1/s.
        dt: s.
    """
    pointing = state.rotation[:, :, 0]
    omega = (velocity_frame(pointing) @ turn[:, :, np.newaxis])[:, :, 0]
    midway = (rotation_by(0.5 * dt * omega) @ pointing[:, :, np.newaxis])[:, :, 0]
    rotation = rotation_by(dt * omega) @ state.rotation
    # one Newton step to the nearest rotation, or rounding would add up over the hours
    rotation = 0.5 * rotation @ (3.0 * np.eye(3) - rotation.transpose(0, 2, 1) @ rotation)

    gap = state.speed - speed_command
    speed_midway = speed_command + gap * np.exp(-0.5 * dt * pole)
    speed = speed_command + gap * np.exp(-dt * pole)
    mean = (
        state.speed[:, np.newaxis] * pointing
        + 4.0 * speed_midway[:, np.newaxis] * midway
        + speed[:, np.newaxis] * rotation[:, :, 0]
    ) / 6.0
    return Unicycle(state.position + dt * mean, rotation, speed)


def advance_ticks(
    state: Unicycle, speed_command: Array, turn: Array, pole: Array, dt: float, ticks: int
) -> Unicycle:
    """`advance`, `ticks` times; the turn is held in the velocity frame, which turns."""
    for _ in range(ticks):
        state = advance(state, speed_command, turn, pole, dt)
    return state


def report(
    state: Unicycle, speed_command: Array, turn: Array, pole: Array, wind_ned: Array
) -> VehicleState:
    """The motion of n unicycles under their commands, as every vehicle reports it.

    The acceleration is ṡ y + s ω × y. Roll, pitch and yaw are atan(σ̇ s cos γ / g), γ and σ, and
    the body rates are those of γ̇ and σ̇ at a constant roll. The equivalent airspeed is the true
    one: the model knows no density.
    """
    frame = velocity_frame(state.rotation[:, :, 0])
    velocity = state.speed[:, np.newaxis] * frame[:, :, 0]
    speed_rate = pole * (speed_command - state.speed)
    across = np.stack([speed_rate, state.speed * turn[:, 2], -state.speed * turn[:, 1]], axis=1)
    acceleration = (frame @ across[:, :, np.newaxis])[:, :, 0]
    gamma, sigma = flight_path_angle(frame[:, :, 0]), course(frame[:, :, 0])
    level = np.maximum(frame[:, 2, 2], COURSE_FLOOR)
    euler = np.stack([np.arctan(turn[:, 2] * state.speed / GRAVITY), gamma, sigma], axis=1)
    angle_rates = np.stack([np.zeros_like(gamma), turn[:, 1], turn[:, 2] / level], axis=1)
    airspeed = np.sqrt(((velocity - wind_ned) ** 2).sum(axis=1))
    return VehicleState(
        position_ned=state.position.copy(),
        velocity_ned=velocity,
        acceleration_ned=acceleration,
        euler=euler,
        rates_body=body_rates(euler, angle_rates),
        airspeed=airspeed,
        equivalent_airspeed=airspeed.copy(),
    )
