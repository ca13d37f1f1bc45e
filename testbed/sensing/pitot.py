"""Airspeed sensors: a pitot tube's dynamic pressure, sampled, filtered and turned into airspeed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.frames import GRAVITY
from testbed.scenario.sensors import Sensors
from testbed.sensing.errors import PITOT_NOISE, Offsets
from testbed.state import Array, Failing, Truths, VehicleState

SEA_LEVEL_DENSITY = 1.225  # kg/m³, ISA
_LEAST_PRESSURE = 1e-4  # Pa: an airspeed of zero has no inverse, and the autopilot scales with that


class Pitots:
    """The airspeed sensors of N aircraft; one that a page does not describe is exact and at once.

    A tube whose mouth and drain are both blocked keeps the total pressure of that moment, so that
    it reads high above that height and low below it; with an open drain it reads nothing (FAA
    Pilot's Handbook of Aeronautical Knowledge, FAA-H-8083-25C, ch. 8).
    """

    def __init__(self, sensors: Sequence[Sensors], *, rate_hz: int) -> None:
        """Sampled at a rate that does not go beyond `rate_hz`, that of the calls."""
        described = [each.airspeed for each in sensors]
        self._erring = np.array([each is not None for each in described])
        self._rate = np.array([rate_hz if each is None else each.rate_hz for each in described])
        self._calls_hz = rate_hz
        smoothing = np.array([each.smoothing_s if each else 0.0 for each in described])
        with np.errstate(divide="ignore"):
            self._share = np.where(
                smoothing > 0.0, 1.0 - np.exp(-1.0 / (self._rate * smoothing)), 1.0
            )
        n = len(described)
        self._pressure = np.full(n, np.nan)  # Pa, filtered
        self._last = np.zeros(n), np.zeros(n)
        # What a blocked tube has trapped: its pressure and height when that happened.
        self._trapped = np.full((2, n), np.nan)

    def sampled(self, tick: int) -> Truths:
        """Which of them (N,) are read at this call."""
        due: Truths = (tick * self._rate) % self._calls_hz < self._rate
        return due

    def read(
        self,
        tick: int,
        truth: VehicleState,
        errors: Array,
        offsets: Offsets,
        failing: Failing | None,
    ) -> tuple[Array, Array]:
        """Equivalent and true airspeed (N,) m/s as measured at this call."""
        eas = truth.equivalent_airspeed
        pressure = 0.5 * SEA_LEVEL_DENSITY * eas * eas
        if failing is not None:
            pressure = self._as_blocked(truth, pressure, failing)
        measured = (1.0 + offsets.scale) * pressure + offsets.pressure + errors[:, PITOT_NOISE]
        before = np.where(np.isnan(self._pressure), measured, self._pressure)
        after = before + self._share * (measured - before)
        self._pressure = np.where(self.sampled(tick), after, before)
        read = np.sqrt(np.maximum(self._pressure, _LEAST_PRESSURE) * (2.0 / SEA_LEVEL_DENSITY))
        # the density is known: nobody errs in it by more than a hundredth
        self._last = read, read * (truth.airspeed / truth.equivalent_airspeed)
        return self._last

    def now(self, truth: VehicleState) -> tuple[Array, Array]:
        """Equivalent and true airspeed (N,) as known now: an exact sensor is never late."""
        exact = ~self._erring & np.isnan(self._trapped[0])
        eas, tas = self._last
        return np.where(exact, truth.equivalent_airspeed, eas), np.where(exact, truth.airspeed, tas)

    def _as_blocked(self, truth: VehicleState, pressure: Array, failing: Failing) -> Array:
        height = -truth.position_ned[:, 2]
        blocked = failing.pitot_blocked
        now = np.where(np.isnan(self._trapped), np.array([pressure, height]), self._trapped)
        self._trapped = np.where(blocked, now, np.nan)
        # static pressure falls by ρ g per metre, with ρ = ρ0 (EAS/TAS)²
        ratio = truth.equivalent_airspeed / truth.airspeed
        climbed = SEA_LEVEL_DENSITY * ratio * ratio * GRAVITY * (height - now[1])
        closed = np.where(failing.pitot_drained, 0.0, now[0] + climbed)
        return np.where(blocked, closed, pressure)
