"""Airspeed sensors: a pitot tube's dynamic pressure, sampled, filtered and turned into airspeed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from testbed.frames import GRAVITY
from testbed.scenario.sensors import Sensors
from testbed.sensing.errors import PITOT_NOISE, Offsets
from testbed.state import Array, Truths, VehicleState

SEA_LEVEL_DENSITY = 1.225  # kg/m³, ISA
LEAST_PRESSURE = 1e-4  # Pa: an airspeed of zero has no inverse, and the autopilot scales with that

PITOT = np.dtype(
    [
        ("rate_hz", "i8"),
        ("share", "f8"),  # of what is new, that the filter takes in
        ("erring", "?"),  # the page describes it
    ]
)
# Rows of what N tubes remember: filtered pressure, Pa; what a blocked tube has trapped, its
# pressure and the height at which that happened; not numbers where there is nothing.
PRESSURE, TRAPPED, TRAPPED_AT = range(3)


class Blocked(Protocol):
    """What is broken in N tubes, as `state.Failing` has it."""

    @property
    def pitot_blocked(self) -> Truths:
        """(N,) mouths."""

    @property
    def pitot_drained(self) -> Truths:
        """(N,) drains that are open."""


class Pitots:
    """The airspeed sensors of N aircraft; one that a page does not describe is exact and at once.

    A tube whose mouth and drain are both blocked keeps the total pressure of that moment, so that
    it reads high above that height and low below it; with an open drain it reads nothing (FAA
    Pilot's Handbook of Aeronautical Knowledge, FAA-H-8083-25C, ch. 8).

    Attributes:
        each: (N,) of PITOT.
        held: (3, N) what is remembered.
        told: (2, N) equivalent and true airspeed, m/s, as read last.
        calls_hz: how often they are called.
    """

    def __init__(self, sensors: Sequence[Sensors], *, rate_hz: int) -> None:
        """Sampled at a rate that does not go beyond `rate_hz`, that of the calls."""
        described = [each.airspeed for each in sensors]
        self.calls_hz = rate_hz
        self.each = np.zeros(len(described), dtype=PITOT)
        self.each["erring"] = [each is not None for each in described]
        self.each["rate_hz"] = [rate_hz if each is None else each.rate_hz for each in described]
        smoothing = np.array([each.smoothing_s if each else 0.0 for each in described])
        with np.errstate(divide="ignore"):
            share = 1.0 - np.exp(-1.0 / (self.each["rate_hz"] * smoothing))
        self.each["share"] = np.where(smoothing > 0.0, share, 1.0)
        self.held = np.full((3, len(described)), np.nan)
        self.told = np.zeros((2, len(described)))

    def sampled(self, tick: int) -> Truths:
        """Which of them (N,) are read at this call."""
        rate = self.each["rate_hz"]
        due: Truths = (tick * rate) % self.calls_hz < rate
        return due

    def read(
        self,
        tick: int,
        truth: VehicleState,
        errors: Array,
        offsets: Offsets,
        failing: Blocked,
    ) -> None:
        """Measure once more; see `told`."""
        eas = truth.equivalent_airspeed
        pressure = self._as_blocked(truth, 0.5 * SEA_LEVEL_DENSITY * eas * eas, failing)
        measured = (1.0 + offsets.scale) * pressure + offsets.pressure + errors[:, PITOT_NOISE]
        filtered = self.held[PRESSURE]
        before = np.where(np.isnan(filtered), measured, filtered)
        after = before + self.each["share"] * (measured - before)
        filtered[:] = np.where(self.sampled(tick), after, before)
        read = np.sqrt(np.maximum(filtered, LEAST_PRESSURE) * (2.0 / SEA_LEVEL_DENSITY))
        # the density is known: nobody errs in it by more than a hundredth
        self.told[:] = read, read * (truth.airspeed / truth.equivalent_airspeed)

    def now(self, truth: VehicleState) -> Array:
        """Equivalent and true airspeed (2, N) as known now: an exact sensor is never late."""
        exact = ~self.each["erring"] & np.isnan(self.held[TRAPPED])
        return np.where(exact, np.array([truth.equivalent_airspeed, truth.airspeed]), self.told)

    def _as_blocked(self, truth: VehicleState, pressure: Array, failing: Blocked) -> Array:
        height, trapped = -truth.position_ned[:, 2], self.held[TRAPPED:]
        blocked = failing.pitot_blocked
        now = np.where(np.isnan(trapped), np.array([pressure, height]), trapped)
        trapped[:] = np.where(blocked, now, np.nan)
        # static pressure falls by ρ g per metre, with ρ = ρ0 (EAS/TAS)²
        ratio = truth.equivalent_airspeed / truth.airspeed
        climbed = SEA_LEVEL_DENSITY * ratio * ratio * GRAVITY * (height - now[1])
        closed = np.where(failing.pitot_drained, 0.0, now[0] + climbed)
        return np.where(blocked, closed, pressure)
