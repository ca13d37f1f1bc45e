"""Responses of one aircraft to steps of its controls, from steady flight.

Copies of the aircraft fly abreast, without an autopilot: one holds the controls of the trim, and
each of the others moves one control at the start. What the first one does is subtracted, so that a
slow drift from the trim is no part of a response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import ActuatorCommand, Array, NedOrigin
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.trim import InitialState, TrimPoint

RATE_HZ = 200
ABOVE_GROUND = 1000.0  # m: no response comes near the ground
AILERON, ELEVATOR, THROTTLE = 0.1, 0.05, 0.1  # steps, of the whole travel to one side
ROLL_S, PITCH_S, THROTTLE_S = 1.5, 2.0, 6.0  # of the responses
YAW_S = 0.3  # in which the rudder turns the nose, before the roll that follows
RUDDER_MIXES = (0.0, 0.25, 0.5, 0.75, 1.0)  # rudder per aileron
_PITCH_MEAN_S = 0.5, 1.5  # between which the pitch rate is averaged
_SLOPE_S = 0.05  # over which an acceleration is taken
# Rows of the aircraft after the first: what each moves; the others move ailerons and rudder.
_ELEVATOR, _MORE, _LESS, _MIXED = 1, 2, 3, 4
_LEAST_RATE = 0.02  # rad/s per full control: less is no control
_LEAST_SPEED = 0.05  # m/s per full throttle


class ResponseError(InputError):
    """An aircraft whose controls have no effect that an autopilot can use."""


@dataclass(frozen=True, slots=True)
class StepResponses:
    """What the controls of an aircraft do; rates and accelerations are per full control."""

    airspeed: float  # m/s, true
    equivalent_airspeed: float  # m/s
    roll_rate: float  # rad/s, the largest within ROLL_S
    roll_s: float  # to 63 % of it
    rudder_mix: float  # of RUDDER_MIXES, that with the least sideslip
    sideslip: float  # rad, the largest after the aileron step with this mix, per full aileron
    pitch_rate: float  # rad/s, mean of 0.5 to 1.5 s
    pitch_s: float  # to 63 % of it
    pitch_acceleration: float  # rad/s², the largest
    throttle_acceleration: float  # m/s², settled; 0 without an engine
    throttle_s: float  # to 63 % of it; 0 without an engine


class _Flown(NamedTuple):
    """Samples of M aircraft: 0 is the first tick after the step."""

    time: Array  # (k,) s
    rates: Array  # (k, M, 3) rad/s
    airspeed: Array  # (k, M) m/s
    beta: Array  # (k, M) rad


def start_of(point: TrimPoint) -> tuple[InitialState, NedOrigin]:
    """Return a start in a level trim, far above the ground, and the origin."""
    start = InitialState(
        (0.0, 0.0, -ABOVE_GROUND),
        airspeed=point.airspeed,
        bank=point.bank,
    )
    return start, NedOrigin(elevation_m=point.altitude - ABOVE_GROUND)


def measure_steps(folder: Path, point: TrimPoint) -> StepResponses:
    """Measure the responses of the aircraft in a folder, from a trim.

    Raises:
        AircraftError, TrimError: the aircraft cannot be loaded or trimmed.
        ResponseError: ailerons or elevator have no effect, or a control has the wrong one.
    """
    start, origin = start_of(point)
    count = _MIXED + len(RUDDER_MIXES)
    fleet = JsbsimFleet([folder] * count, [start] * count, origin, RATE_HZ)
    first, trim = fleet.read(), fleet.trims[0].controls
    surfaces = ActuatorCommand(*(each.copy() for each in fleet.trimmed))
    up = ELEVATOR if trim.elevator < 0.5 else -ELEVATOR
    surfaces.elevator[_ELEVATOR] += up
    throttles = {
        row: step
        for row, step in ((_MORE, THROTTLE), (_LESS, -THROTTLE))
        if fleet.trims[0].has_engine and 0.0 <= trim.throttle + step <= 1.0
    }
    for row, step in throttles.items():
        surfaces.throttle[row] += step
    surfaces.aileron[_MIXED:] += AILERON
    surfaces.rudder[_MIXED:] += AILERON * np.array(RUDDER_MIXES)
    flown = _fly(fleet, surfaces, THROTTLE_S)
    rates = flown.rates - flown.rates[:, :1]

    p = rates[flown.time <= ROLL_S, _MIXED:, 0] / AILERON
    beta = (
        np.abs(flown.beta[:, _MIXED:] - flown.beta[:, :1])[flown.time <= ROLL_S].max(axis=0)
        / AILERON
    )
    best = int(beta.argmin())
    roll_rate = float(p[np.abs(p[:, best]).argmax(), best])  # that of a wrong sign is negative
    q = rates[flown.time <= PITCH_S, _ELEVATOR, 1] / up
    low, high = _PITCH_MEAN_S
    settled = (flown.time >= low) & (flown.time <= high)
    pitch_rate = float((rates[settled, _ELEVATOR, 1] / up).mean())
    for name, rate, way in (
        ("aileron", roll_rate, "rolls the aircraft to the right"),
        ("elevator", pitch_rate, "pitches the aircraft up"),
    ):
        _check_effect(name, rate)
        _check_sign(name, rate, way)
    if fleet.trims[0].has_rudder:
        yawing = rates[flown.time <= YAW_S, _MIXED:, 2].mean(axis=0)
        yaw_rate = float(yawing[-1] - yawing[0]) / (AILERON * RUDDER_MIXES[-1])
        _check_sign("rudder", yaw_rate, "yaws the aircraft to the right")
    for row, step in throttles.items():
        _check_throttle(flown, row, step)
    within = round(_SLOPE_S * RATE_HZ)
    slope = (q[within:] - q[:-within]) / _SLOPE_S
    # the stronger and the slower of both: an engine may lose power later than it gains it
    responses = [_throttle_response(flown, row, step) for row, step in throttles.items()]
    acceleration = max((each[0] for each in responses), default=0.0)
    throttle_s = max((each[1] for each in responses), default=0.0)
    return StepResponses(
        airspeed=point.airspeed,
        equivalent_airspeed=float(first.equivalent_airspeed[0]),
        roll_rate=roll_rate,
        roll_s=_time_to_63(p[:, best], roll_rate),
        rudder_mix=RUDDER_MIXES[best],
        sideslip=float(beta[best]),
        pitch_rate=pitch_rate,
        pitch_s=_time_to_63(q, pitch_rate),
        pitch_acceleration=float(slope[: round(0.5 * RATE_HZ)].max()),
        throttle_acceleration=acceleration,
        throttle_s=throttle_s,
    )


def _fly(fleet: JsbsimFleet, surfaces: ActuatorCommand, duration_s: float) -> _Flown:
    rows: list[tuple[Array, Array, Array]] = []
    commanded: ActuatorCommand | None = surfaces
    for _ in range(round(duration_s * RATE_HZ)):
        fleet.step(commanded, 1)
        commanded = None
        state, air = fleet.read(), fleet.air()
        rows.append((state.rates_body, state.airspeed, air.beta))
    rates, airspeed, beta = (np.array(each) for each in zip(*rows, strict=True))
    time = np.arange(1, len(rates) + 1) / RATE_HZ
    return _Flown(time, rates, airspeed, beta)


def _throttle_response(flown: _Flown, row: int, step: float) -> tuple[float, float]:
    """Return the settled acceleration for full throttle, m/s², and its time to 63 %, s."""
    speed = (flown.airspeed[:, row] - flown.airspeed[:, 0]) / step
    within = round(0.25 * RATE_HZ)
    acceleration = (speed[within:] - speed[:-within]) * (RATE_HZ / within)
    # drag takes the acceleration away again: its largest value is the engine's
    largest = int(acceleration.argmax())
    value = float(acceleration[largest])
    return value, _time_to_63(acceleration, value) + 0.5 * within / RATE_HZ


def _check_effect(control: str, rate: float) -> None:
    if not math.isfinite(rate) or abs(rate) < _LEAST_RATE:
        raise ResponseError(
            f"the {control} has no effect: fcs/{control}-cmd-norm of 1 gives "
            f"{math.degrees(rate):.2g}°/s; the autopilot flies with ailerons and elevator"
        )


def _check_sign(control: str, rate: float, way: str) -> None:
    """Check the rate of a full command, rad/s; a small one is none."""
    if rate < -_LEAST_RATE:
        raise ResponseError(
            f"the {control} acts the wrong way: a command that {way} gives "
            f"{math.degrees(rate):.3g}°/s (change the sign in the flight control)"
        )


def _check_throttle(flown: _Flown, row: int, step: float) -> None:
    """Check that the aircraft is faster with more throttle, in the mean of the first seconds."""
    change = (flown.airspeed[:, row] - flown.airspeed[:, 0])[flown.time <= PITCH_S]
    faster = float(change.mean()) / step
    if faster < -_LEAST_SPEED:
        raise ResponseError(
            "the throttle acts the wrong way: within the first "
            f"{PITCH_S:g} s a full one makes the aircraft {-faster:.3g} m/s slower in the mean "
            "(change the sign in the propulsion, or in the flight control)"
        )


def _time_to_63(response: Array, final: float) -> float:
    """Return when a response first has 63 % of its final value, s."""
    reached = np.flatnonzero(response >= (1.0 - math.exp(-1.0)) * final)
    return float(reached[0] + 1 if reached.size else len(response)) / RATE_HZ
