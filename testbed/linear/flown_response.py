"""Frequency responses of a formation, measured in flights with one sinusoidal input.

The leader swings on its path, or the wind or messages of a steady flight swing. After the transient
a sinusoid with a constant and a trend is fitted to each position over whole periods.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from testbed.core.records import Array
from testbed.linear.held_flight import HeldFlight
from testbed.linear.linear_formation import LEADER_SIZE
from testbed.linear.predicted_response import (
    GUST_INPUTS,
    INPUTS,
    LEADER_INPUTS,
    Complex,
    Response,
    leader_motion,
    slot_motion,
)
from testbed.linear.steady_flight import build_compiled, check_measurable, steady_scenario
from testbed.linear.straight_formation import SETTLED_S
from testbed.scenario import Scenario

RECORD_S = 40.0  # of it at least, in whole periods
# Largest of an input: m/s², m/s, m. With more, throttles fall below TRIM_THROTTLE, where ArduPlane
# pitches down by STAB_PITCH_DOWN, and responses are no longer proportional to inputs.
ACCELERATION, SPEED, DISTANCE = 0.01, 0.03, 1.0
LEAST_M = 0.001  # of a curve
# curves of a virtual leader by the input: kind, key of its amplitude, derivative that this is
_CURVES = {
    "leader-speed": ("speed-change", "amplitude_mps", 1),
    "leader-weave": ("weave", "amplitude_m", 0),
}


class Flown(NamedTuple):
    """A measured response at one frequency.

    Attributes:
        response: of one frequency, F = 1, per unit of the input.
        residual: (n, 3) of the positions, RMS of what the sinusoid leaves over its own RMS.
    """

    response: Response
    residual: Array


def amplitude_of(name: str, frequency_hz: float, factor: float = 1.0) -> float:
    """Return the amplitude of an input, m, or m/s of a gust; at a factor of 1 a small one."""
    rate = 2.0 * math.pi * frequency_hz
    if name in GUST_INPUTS:
        return factor * SPEED
    largest = factor * min(ACCELERATION / rate**2, SPEED / rate, DISTANCE)
    return max(largest, LEAST_M) if name in _CURVES else largest


def fly_response(
    scenario: Scenario, name: str, frequency_hz: float, sender: int = 0, factor: float = 1.0
) -> Flown:
    """Fly a formation with one input and without it; the difference is its response.

    Args:
        scenario: see `check_measurable` of steady_flight.
        name: of INPUTS.
        frequency_hz: of the input.
        sender: row of the aircraft whose messages have the error, of MESSAGE_INPUTS.
        factor: of the amplitude.

    Raises:
        InputError: an aircraft has no compiled flight model.
    """
    check_measurable(scenario)
    amplitude = amplitude_of(name, frequency_hz, factor)
    record_s = math.ceil(RECORD_S * frequency_hz) / frequency_hz
    duration_s = SETTLED_S + record_s
    still = _Flight(_swinging(scenario, "", amplitude, frequency_hz, duration_s))
    moved = _Flight(_swinging(scenario, name, amplitude, frequency_hz, duration_s))
    change = None
    if name not in _CURVES:
        change = moved.swing(name, amplitude, frequency_hz, sender)
    steady = still.record(duration_s, None)
    time_s, rows = moved.record(duration_s, change)
    motions, left = _fit(time_s, rows - steady[1], frequency_hz)
    position, error, axis = motions[1::2], motions[2::2], INPUTS[name]
    unit = motions[0, axis] if name in _CURVES else amplitude
    if name in LEADER_INPUTS and name not in _CURVES:  # only the leader's messages have moved
        message = amplitude * leader_motion(axis, moved.speed, np.array([frequency_hz]))
        error = position - slot_motion(message, moved.offsets, moved.speed, moved.level)[0]
    response = Response(position[np.newaxis] / unit, error[np.newaxis] / unit)
    return Flown(response, left[1::2])


class _Flight:
    """A flight that is recorded at each control step."""

    def __init__(self, scenario: Scenario) -> None:
        self._flight = HeldFlight(build_compiled(scenario))
        world = self._flight.world
        self.speed = float(np.linalg.norm(world.aircraft["truth"]["velocity_ned"][0]))
        self.offsets: Array = np.array(world.formation.control.offsets[1:])
        self.level = ~np.isnan(world.formation.altitudes)

    def swing(
        self, name: str, amplitude: float, frequency_hz: float, sender: int
    ) -> Callable[[float], None] | None:
        """Let messages swing, by the times of their content, or return what sets a gust at a time.

        Args:
            name: of the input.
            amplitude: of it.
            frequency_hz: of it.
            sender: see `fly_response`.
        """
        flight, axis, rate = self._flight, INPUTS[name], 2.0 * math.pi * frequency_hz
        if name in GUST_INPUTS:
            wind = flight.world.aircraft["wind"]["wind_ned"]

            def gust(now: float) -> None:
                wind[1:, axis] = amplitude * math.cos(rate * now)
                flight.fleet.write_wind(now)

            return gust
        moved = np.eye(LEADER_SIZE)[axis] + 0j
        if name in LEADER_INPUTS:
            sender, moved = 0, leader_motion(axis, self.speed, np.array([frequency_hz]))[0]

        def added(measured_s: Array) -> Array:
            out = np.zeros((*measured_s.shape, LEADER_SIZE))
            now = np.exp(1j * rate * np.nan_to_num(measured_s[:, sender, np.newaxis]))
            out[:, sender] = (amplitude * now * moved).real
            return out

        flight.inputs.swing = added
        return None

    def record(self, until_s: float, change: Callable[[float], None] | None) -> tuple[Array, Array]:
        """Fly, and return times (K,) after the transient and rows (K, 1 + 2 n, 3), m.

        A row has the position of the leader, then position and slot error of each follower.
        """
        flight, times, rows = self._flight, [], []
        for k in range(round(until_s / flight.dt)):
            now = k * flight.dt
            if change is not None:
                change(now)
            if now >= SETTLED_S - 1e-9:
                times.append(now)
                rows.append(self._look())
            flight.fly_to((k + 1) * flight.dt)
        return np.array(times), np.array(rows)

    def _look(self) -> Array:
        self._flight.write_errors()
        world = self._flight.world
        truth, errors = world.aircraft["truth"]["position_ned"], world.followers["error_ned"]
        rows = np.empty((1 + 2 * len(errors), 3))
        rows[0], rows[1::2], rows[2::2] = truth[0], truth[1:], errors
        return rows


def _swinging(
    scenario: Scenario, name: str, amplitude: float, frequency_hz: float, duration_s: float
) -> Scenario:
    """Return a scenario's formation behind a leader on a straight line, or on one of _CURVES."""
    data = steady_scenario(scenario, 0.0, "compiled").model_dump(mode="json", by_alias=True)
    if name in _CURVES:
        kind, key, order = _CURVES[name]
        size = amplitude * (2.0 * math.pi * frequency_hz) ** order
        curve = {"kind": kind, key: size, "period_s": 1.0 / frequency_hz}
        data["leader"]["path"]["curve"] = curve
    data["scenario"]["duration_s"] = duration_s + 1.0
    return Scenario.model_validate(data)


def _fit(time_s: Array, rows: Array, frequency_hz: float) -> tuple[Complex, Array]:
    """Return amplitudes (R, 3) of rows (K, R, 3), and what they leave, RMS over RMS."""
    rate = 2.0 * math.pi * frequency_hz
    ones = np.ones_like(time_s)
    basis = np.stack((np.cos(rate * time_s), np.sin(rate * time_s), ones, time_s), axis=-1)
    flat = rows.reshape(len(rows), -1)
    found, *_ = np.linalg.lstsq(basis, flat, rcond=None)
    left = np.sqrt(((flat - basis @ found) ** 2).mean(axis=0))
    motion = found[0] - 1j * found[1]
    rest = left / np.maximum(np.abs(motion) / math.sqrt(2.0), 1e-12)
    return motion.reshape(rows.shape[1:]), rest.reshape(rows.shape[1:])
