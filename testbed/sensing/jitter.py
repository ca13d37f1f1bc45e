"""First-order Gauss-Markov errors on top of an estimate, whatever made it."""

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


Levels = tuple[NoiseLevel, NoiseLevel, NoiseLevel]


class Jitter:
    """Errors of position, velocity and attitude of N aircraft, a stream "sensors/<name>" each.

    Args:
        names: N names of aircraft.
        levels: of position (m), velocity (m/s) and attitude (rad), for N aircraft.
        seed: of the run.
        dt: s between estimates.
    """

    def __init__(
        self, names: Sequence[str], levels: Sequence[Levels], *, seed: int, dt: float
    ) -> None:
        """See the class."""
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

    def on(self, estimate: VehicleState, *, fresh: bool) -> VehicleState:
        """An estimate of N aircraft with these errors added; itself where there are none.

        Accelerations are resolved anew with the attitude: they are what an accelerometer feels.
        Rates and airspeeds stay as they are.

        Args:
            estimate: of N aircraft.
            fresh: errors move on; so once per `dt`. Between they stay as they are.
        """
        if self.exact:
            return estimate
        if fresh:
            self._error = self._keep * self._error + self._fresh * self._draw()
        position, velocity, attitude = self._error.reshape(-1, 3, 3).swapaxes(0, 1)
        euler = estimate.euler + attitude
        gravity = np.array([0.0, 0.0, GRAVITY])
        force_body = (estimate.acceleration_ned - gravity)[:, None, :] @ rotation_ned_body(
            estimate.euler
        )
        force = (rotation_ned_body(euler) @ force_body.swapaxes(1, 2))[:, :, 0]
        return VehicleState(
            position_ned=estimate.position_ned + position,
            velocity_ned=estimate.velocity_ned + velocity,
            acceleration_ned=force + gravity,
            euler=euler,
            rates_body=estimate.rates_body,
            airspeed=estimate.airspeed,
            equivalent_airspeed=estimate.equivalent_airspeed,
        )
