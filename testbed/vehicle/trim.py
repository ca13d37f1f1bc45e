"""Trim: the steady flight of an aircraft at a given airspeed, flight-path angle and bank.

Steady means that all six accelerations of the body axes vanish while the aircraft turns at the
coordinated rate g tan φ / (V cos γ). The six unknowns are angle of attack, sideslip, aileron,
elevator, rudder and throttle; the propeller turns at the speed where its torque balances the
motor's.

Without an engine the flight-path angle is the sixth unknown in place of the throttle: a glider
descends at the angle that its airspeed gives.

Without a rudder, one requirement is dropped. In straight flight the bank is free, which balances
the propeller's torque; in a banked flight the turn rate is free.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.records import Array

Vector = tuple[float, float, float]
STILL: Vector = (0.0, 0.0, 0.0)
_STEP = np.array([1e-4, 1e-4, 1e-4, 1e-4, 1e-4, 1e-4])  # of the finite differences
_MAX_STEP = np.array([0.08, 0.05, 0.3, 0.3, 0.3, 0.3])  # of one Newton iteration
_LOW = np.array([-0.3, -0.3, -1.0, -1.0, -1.0, 0.0])
_HIGH = np.array([0.5, 0.3, 1.0, 1.0, 1.0, 1.0])
_ITERATIONS = 40
_PATIENCE = 8  # iterations without a smaller residual
_STEADY = 1e-4  # m/s² and rad/s², largest acceptable residual
_AXES = (
    ("m/s²", "forward"),
    ("m/s²", "to the right"),
    ("m/s²", "down"),
    ("rad/s²", "in roll"),
    ("rad/s²", "in pitch"),
    ("rad/s²", "in yaw"),
)  # of the residual
_FIRST_THROTTLES = (0.3, 0.6, 0.9)  # thrust may fall with throttle while the propeller brakes
_STEEPEST, _HIGHEST = -1.0, 0.2  # rad, flight-path angles of a glider
_FIRST_DESCENTS = (-0.05, -0.15, -0.4)  # rad
_USELESS = 0.02  # m/s² and rad/s², of a control moved by 0.8
_CONVERGED = 1e-8  # m/s² and rad/s², residual at which the iteration ends


class TrimError(InputError):
    """There is no steady flight at the requested point."""


@dataclass(frozen=True, slots=True)
class TrimPoint:
    """Requested steady flight."""

    airspeed: float  # true, m/s
    flight_path_angle: float = 0.0  # rad, climbing positive
    bank: float = 0.0  # rad, right wing down positive
    altitude: float = 400.0  # m above sea level
    state_of_charge: float = 1.0  # 0..1 of its battery, where it has one
    cells: int = 0  # of its battery, in series; 0: those of the airframe
    temperature_offset: float = 0.0  # K, of the air, to the standard atmosphere


@dataclass(frozen=True, slots=True)
class Placement:
    """Velocity, rates and attitude of an aircraft at a heading of zero."""

    velocity_body: Vector  # u, v, w through still air, m/s
    rates_body: Vector  # p, q, r, rad/s
    roll: float  # rad
    pitch: float  # rad
    course: float  # rad, of the velocity, when the heading is zero


@dataclass(frozen=True, slots=True)
class Controls:
    """Commands with the signs of `core.records.ActuatorCommand`."""

    aileron: float
    elevator: float
    rudder: float
    throttle: float


@dataclass(frozen=True, slots=True)
class TrimResult:
    """Steady flight, and the controls that hold it."""

    point: TrimPoint
    alpha: float  # rad
    beta: float  # rad
    turn_rate: float  # rad/s about the vertical, to the right positive
    controls: Controls
    propeller_rps: float  # revolutions per second; NaN without a propeller
    placement: Placement
    has_rudder: bool  # if not, the rudder command is zero and has no effect
    residual: float  # largest remaining acceleration, m/s² and rad/s²
    has_engine: bool = True  # if not, the throttle is zero and has no effect
    flight_path_angle: float = 0.0  # rad; that of the point, or as found for a glider


class TrimModel(Protocol):
    """A flight model with accelerations in any placement."""

    has_rudder: bool  # the rudder command has an effect
    has_lag: bool  # surfaces lag behind their commands, unless placed with `spin`
    has_engine: bool  # if not, it is a glider

    def accelerations(self, placement: Placement, controls: Controls, *, spin: bool) -> Array:
        """Return u̇, v̇, ẇ (m/s²), ṗ, q̇, ṙ (rad/s²); with `spin` propeller and surfaces settle."""

    @property
    def propeller_rps(self) -> float:
        """Revolutions per second; NaN without a propeller."""

    def check_engines(self) -> None:
        """Check that the engines run.

        Raises:
            TrimError: one does not.
        """


def place(
    point: TrimPoint,
    alpha: float,
    beta: float,
    *,
    bank: float | None = None,
    turn_rate: float | None = None,
) -> Placement:
    """Compute attitude, velocity and rates of a steady turn, at rate zero of level flight.

    The pitch attitude follows from γ by solving sin γ = a sin θ − b cos θ, where a and b are the
    components of the direction of flight along and across the wings' plane.

    Args:
        point: requested flight.
        alpha: angle of attack, rad.
        beta: sideslip, rad.
        bank: rad; default that of the point.
        turn_rate: rad/s; default the coordinated one of the point's bank.
    """
    v, gamma = point.airspeed, point.flight_path_angle
    phi = point.bank if bank is None else bank
    turn = coordinated_turn(point) if turn_rate is None else turn_rate
    along = math.cos(alpha) * math.cos(beta)
    side = math.sin(beta)
    below = math.sin(alpha) * math.cos(beta)
    across = math.sin(phi) * side + math.cos(phi) * below
    theta = math.asin(math.sin(gamma) / math.hypot(along, across)) + math.atan2(across, along)
    east = math.cos(phi) * side - math.sin(phi) * below
    north = along * math.cos(theta) + across * math.sin(theta)
    rates = (
        -turn * math.sin(theta),
        turn * math.sin(phi) * math.cos(theta),
        turn * math.cos(phi) * math.cos(theta),
    )
    return Placement(
        velocity_body=(v * along, v * side, v * below),
        rates_body=rates,
        roll=phi,
        pitch=theta,
        course=math.atan2(east, north),
    )


def coordinated_turn(point: TrimPoint) -> float:
    """Return the coordinated turn rate g tan φ / (V cos γ), rad/s."""
    v, gamma, phi = point.airspeed, point.flight_path_angle, point.bank
    return GRAVITY * math.tan(phi) / (v * math.cos(gamma))


def course_through_air(airspeed: float, course: float, wind_ned: Vector) -> float:
    """Return the course through the air (rad) that gives a course over the ground.

    Args:
        airspeed: horizontal, m/s.
        course: over the ground, rad.
        wind_ned: velocity of the air, m/s.

    Raises:
        TrimError: the wind is too strong to fly along the course.
    """
    north, east, _ = wind_ned
    across = east * math.cos(course) - north * math.sin(course)
    along = north * math.cos(course) + east * math.sin(course)
    if abs(across) >= airspeed or along + math.sqrt(airspeed**2 - across**2) <= 0.0:
        raise TrimError(
            f"wind of {math.hypot(north, east):g} m/s: at an airspeed of {airspeed:g} m/s the "
            f"aircraft cannot fly a course of {math.degrees(course):g}° over the ground"
        )
    return course - math.asin(across / airspeed)


@contextmanager
def error_prefix(name: str) -> Iterator[None]:
    """Begin each `TrimError` of the block with the name of an aircraft, or a key."""
    try:
        yield
    except TrimError as error:
        raise TrimError(f"{name}: {error}") from None


def trim(model: TrimModel, point: TrimPoint) -> TrimResult:
    """Find steady flight by Newton's method with limited steps.

    Raises:
        TrimError: the controls saturate, the accelerations do not vanish, an engine stops, or a
            glider is to fly a given flight-path angle.
    """
    if not point.airspeed > 0.0 or abs(point.bank) > 1.4 or abs(point.flight_path_angle) > 1.4:
        raise TrimError(f"{_words(point)}: airspeed must be positive, angles below 80°")
    if not model.has_engine and point.flight_path_angle != 0.0:
        raise TrimError(
            f"{_words(point)}: it has no engine, so its flight-path angle follows from its "
            "airspeed (leave the climb angle out)"
        )
    best_x, best = np.zeros(6), np.inf
    for first in _FIRST_THROTTLES if model.has_engine else _FIRST_DESCENTS:
        x, size = _newton(model, point, first)
        if size < best:
            best_x, best = x, size
        if best <= _STEADY:
            break
    if best > _STEADY:
        model.check_engines()
        if useless := _without_effect(model, point):
            raise TrimError(
                f"{_words(point)}: no steady flight: the commands of {' and '.join(useless)} have "
                "no effect (an autopilot in the files of the aircraft may take their place: remove "
                "it)"
            )
        sixth = (
            f"throttle {best_x[5]:.2f}"
            if model.has_engine
            else f"a flight-path angle of {math.degrees(best_x[5]):.1f}°"
        )
        residual = _residual(model, point, best_x, spin=True)
        axis = int(np.abs(residual).argmax())
        unit, name = _AXES[axis]
        raise TrimError(
            f"{_words(point)}: no steady flight; an acceleration of {residual[axis]:+.2g} {unit} "
            f"{name} remains at {sixth}, elevator {best_x[3]:+.2f}, angle of attack "
            f"{math.degrees(best_x[0]):.1f}°"
        )
    largest = float(np.max(np.abs(_residual(model, point, best_x, spin=True))))
    model.check_engines()
    placement, controls, turn_rate = _flight(model, point, best_x)
    return TrimResult(
        point=point,
        alpha=float(best_x[0]),
        beta=float(best_x[1]),
        turn_rate=turn_rate,
        controls=controls,
        propeller_rps=model.propeller_rps,
        placement=placement,
        has_rudder=model.has_rudder,
        residual=largest,
        has_engine=model.has_engine,
        flight_path_angle=_flown_point(model, point, best_x).flight_path_angle,
    )


def _without_effect(model: TrimModel, point: TrimPoint) -> list[str]:
    """Return the names of the controls that do not accelerate the aircraft, but for the rudder."""
    ahead, found = place(point, 0.0, 0.0), list[str]()
    for name in ("aileron", "elevator", "throttle"):
        if name == "throttle" and not model.has_engine:
            continue
        middle = Controls(0.0, 0.0, 0.0, 0.5)
        low, high = (
            model.accelerations(
                ahead, replace(middle, **{name: getattr(middle, name) + change}), spin=True
            )
            for change in (-0.4, 0.4)
        )
        if float(np.max(np.abs(high - low))) < _USELESS:
            found.append(name)
    return found


def _newton(model: TrimModel, point: TrimPoint, first: float) -> tuple[Array, float]:
    """Iterate from a first value of the sixth unknown.

    Returns:
        The best unknowns (6,), and their largest acceleration.
    """
    x = np.array([0.0, 0.0, 0.0, 0.0, 0.0, first])
    low, high = _LOW.copy(), _HIGH.copy()
    if not model.has_engine:
        low[5], high[5] = _STEEPEST, _HIGHEST
    f = _residual(model, point, x, spin=True)
    best_x, best, since = x, np.inf, 0
    for _ in range(_ITERATIONS):
        size = float(np.max(np.abs(f)))
        since += 1
        if size < best:
            best_x, best, since = x, size, 0
        if size < _CONVERGED or since > _PATIENCE:
            break
        jacobian = np.empty((6, 6))
        for j in range(6):
            step = -_STEP[j] if x[j] + _STEP[j] > high[j] else _STEP[j]
            moved = x.copy()
            moved[j] += step
            spin = (j == 5 and model.has_engine) or (model.has_lag and j >= 2)
            jacobian[:, j] = (_residual(model, point, moved, spin=spin) - f) / step
        if not np.isfinite(jacobian).all():
            break  # outside the range of the model
        newton = np.linalg.lstsq(jacobian, -f, rcond=None)[0]
        newton *= min(1.0, float(np.min(_MAX_STEP / np.maximum(np.abs(newton), 1e-12))))
        x = np.minimum(high, np.maximum(low, x + newton))
        f = _residual(model, point, x, spin=True)
    return best_x, best


def _residual(model: TrimModel, point: TrimPoint, x: Array, *, spin: bool) -> Array:
    placement, controls, _ = _flight(model, point, x)
    return model.accelerations(placement, controls, spin=spin)


def _flight(model: TrimModel, point: TrimPoint, x: Array) -> tuple[Placement, Controls, float]:
    """Return placement, controls and turn rate of the unknowns; the fifth balances yaw."""
    alpha, beta, aileron, elevator, fifth, sixth = (float(value) for value in x)
    point = _flown_point(model, point, x)
    throttle = sixth if model.has_engine else 0.0
    turn = coordinated_turn(point)
    if model.has_rudder:
        placement = place(point, alpha, beta)
        return placement, Controls(aileron, elevator, fifth, throttle), turn
    controls = Controls(aileron, elevator, 0.0, throttle)
    if point.bank == 0.0:
        return place(point, alpha, beta, bank=fifth, turn_rate=0.0), controls, 0.0
    turn += fifth
    return place(point, alpha, beta, turn_rate=turn), controls, turn


def _flown_point(model: TrimModel, point: TrimPoint, x: Array) -> TrimPoint:
    """Return the point with the flight-path angle of a glider."""
    return point if model.has_engine else replace(point, flight_path_angle=float(x[5]))


def _words(point: TrimPoint) -> str:
    return (
        f"trim at {point.airspeed:g} m/s, climb angle {math.degrees(point.flight_path_angle):g}°, "
        f"bank {math.degrees(point.bank):g}°, altitude {point.altitude:g} m"
    )


@dataclass(frozen=True, slots=True)
class InitialState:
    """Initial state of an aircraft, in trim relative to the air.

    In wind the heading is corrected so that the track over the ground has the given course.
    """

    position_ned: Vector  # m from the origin
    course: float = 0.0  # rad, over the ground
    airspeed: float = 22.0  # true, m/s
    flight_path_angle: float = 0.0  # rad, through the air; a glider's follows from its airspeed
    bank: float = 0.0  # rad
    wind_ned: Vector = STILL  # m/s, initial velocity of the air
    state_of_charge: float = 1.0  # 0..1 of its battery, where it has one
    cells: int = 0  # of its battery, in series; 0: those of the airframe
    temperature_offset: float = 0.0  # K, of the air, to the standard atmosphere
    fuel_burn: bool = False  # its engines burn fuel; if not, its mass is constant
