"""What an autopilot believes of its own motion: the truth plus first-order Gauss-Markov errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.frames import GRAVITY, rotation_ned_body
from testbed.state import Array, VehicleState
from testbed.streams import stream

BLOCK = 512  # draws made at a time; a draw's value does not depend on it


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """Standard deviation and correlation time of one quantity; per axis, axes independent."""

    sigma: float
    time_constant_s: float


@dataclass(frozen=True, slots=True)
class SensorErrors:
    """The errors of one aircraft's estimate: position m, velocity m/s, attitude rad."""

    position: NoiseLevel
    velocity: NoiseLevel
    attitude: NoiseLevel


class Estimators:
    """The estimators of N aircraft, one stream of random numbers each, keyed by its name.

    Args:
        names: N names of aircraft.
        errors: N sets of errors.
        seed: of the run.
        dt: s between estimates.
    """

    def __init__(
        self, names: Sequence[str], errors: Sequence[SensorErrors], *, seed: int, dt: float
    ) -> None:
        """See the class."""
        levels = [[e.position, e.velocity, e.attitude] for e in errors]
        sigma = np.array([[level.sigma for level in row] for row in levels])
        tau = np.array([[level.time_constant_s for level in row] for row in levels])
        self._sigma = np.repeat(sigma, 3, axis=1)  # (N, 9)
        # exact for the step: the variance does not depend on it
        self._keep = np.repeat(np.exp(-dt / tau), 3, axis=1)
        self._fresh = self._sigma * np.sqrt(1.0 - self._keep**2)
        self.exact = not self._sigma.any()
        self._streams = [stream(seed, f"sensors/{name}") for name in names]
        self._draws = np.empty((0, len(names), 9))
        self._next = 0
        self._error = self._sigma * self._draw()

    def _draw(self) -> Array:
        """The next standard normal numbers (N, 9)."""
        if self._next == len(self._draws):
            blocks = [each.standard_normal((BLOCK, 9)) for each in self._streams]
            self._draws, self._next = np.stack(blocks, axis=1), 0
        self._next += 1
        numbers: Array = self._draws[self._next - 1]
        return numbers

    def estimate(self, truth: VehicleState, *, fresh: bool) -> VehicleState:
        """The next estimate. The truth itself where nothing errs.

        Accelerations are the specific force an accelerometer feels, resolved with the estimated
        attitude; rates and airspeeds are exact.

        Args:
            truth: of N aircraft.
            fresh: errors move on; so once per `dt`. Between they stay as they are.
        """
        if self.exact:
            return truth
        if fresh:
            self._error = self._keep * self._error + self._fresh * self._draw()
        position, velocity, attitude = self._error.reshape(-1, 3, 3).swapaxes(0, 1)
        euler = truth.euler + attitude
        gravity = np.array([0.0, 0.0, GRAVITY])
        force_body = (truth.acceleration_ned - gravity)[:, None, :] @ rotation_ned_body(truth.euler)
        force = (rotation_ned_body(euler) @ force_body.swapaxes(1, 2))[:, :, 0]
        return VehicleState(
            position_ned=truth.position_ned + position,
            velocity_ned=truth.velocity_ned + velocity,
            acceleration_ned=force + gravity,
            euler=euler,
            rates_body=truth.rates_body,
            airspeed=truth.airspeed,
            equivalent_airspeed=truth.equivalent_airspeed,
        )
