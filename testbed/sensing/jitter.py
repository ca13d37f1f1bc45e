"""First-order Gauss-Markov errors on top of an estimate, whatever made it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from testbed.compiled import ready_of
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


def jitter(
    errors: Array, parts: Array, estimate: VehicleState, out: VehicleState, draw: Array | None
) -> None:
    """Let errors of N aircraft move on, and write an estimate with them.

    Args:
        errors: (N, 9) of position, velocity and attitude; changed.
        parts: (2, N, 9) of them that stays, and of a draw that is added.
        estimate: of N aircraft.
        out: of N aircraft; written.
        draw: (N, 9) standard normal numbers; None: the errors stay as they are.
    """
    if draw is not None:
        errors[:] = parts[0] * errors + parts[1] * draw
    position, velocity, attitude = errors.reshape(-1, 3, 3).swapaxes(0, 1)
    euler = estimate.euler + attitude
    gravity = np.array([0.0, 0.0, GRAVITY])
    force_body = (estimate.acceleration_ned - gravity)[:, None, :] @ rotation_ned_body(
        estimate.euler
    )
    force = (rotation_ned_body(euler) @ force_body.swapaxes(1, 2))[:, :, 0]
    wrong = estimate._replace(
        position_ned=estimate.position_ned + position,
        velocity_ned=estimate.velocity_ned + velocity,
        acceleration_ned=force + gravity,
        euler=euler,
    )
    for old, new in zip(out, wrong, strict=True):
        old[:] = new


READY_JITTER = ready_of(jitter, "testbed.sensing.jitter_twin")


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
        keep = np.repeat(np.exp(-dt / tau), 3, axis=1)
        self._parts = np.array([keep, self._sigma * np.sqrt(1.0 - keep**2)])
        self.exact = not self._sigma.any()
        self._streams = [stream(seed, f"sensors/{name}") for name in names]
        self._draws: Sequence[Array] = ()
        self._next = 0
        self._errors = self._sigma * self._draw()
        n = len(names)
        self._out = VehicleState(*np.empty((5, n, 3)), *np.empty((2, n)))
        self._estimate: VehicleState | None = None

    def _draw(self) -> Array:
        """The next standard normal numbers (N, 9)."""
        if self._next == len(self._draws):
            blocks = [each.standard_normal((BLOCK, 9)) for each in self._streams]
            self._draws, self._next = list(np.stack(blocks, axis=1)), 0
        self._next += 1
        return self._draws[self._next - 1]

    def on(self, estimate: VehicleState, *, fresh: bool) -> VehicleState:
        """An estimate of N aircraft with these errors, until the next; itself where are none.

        Accelerations are resolved anew with the attitude: they are what an accelerometer feels.
        Rates and airspeeds stay as they are.

        Args:
            estimate: of N aircraft.
            fresh: errors move on; so once per `dt`. Between they stay as they are.
        """
        if self.exact:
            return estimate
        if estimate is not self._estimate:
            self._estimate = estimate
            self._write = READY_JITTER(self._errors, self._parts, estimate, self._out)
        self._write(self._draw() if fresh else None)
        return self._out
