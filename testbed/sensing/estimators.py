"""What N autopilots believe of their motion, from the truth and from what their sensors get wrong.

A sensor that the page leaves out has no error. An aircraft with any of GPS, barometer, gyro,
accelerometer and magnetometer on its page flies on a navigation filter; the others on the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from testbed.frames import rotation_ned_body
from testbed.scenario.sensors import Sensors
from testbed.sensing.errors import SensorErrors, make_levels, make_offsets
from testbed.sensing.fusion import aligned
from testbed.sensing.jitter import Jitter, NoiseLevel
from testbed.sensing.navigation import begin
from testbed.sensing.pitot import Pitots
from testbed.sensing.senses import READY_SENSE, Broken, Senses
from testbed.sensing.settings import make_settings
from testbed.state import Failing, VehicleState

WARM_UP_S = 60.0  # how long before the flight the filters were switched on, in straight flight
_NAVIGATION = ("gps", "barometer", "gyro", "accelerometer", "magnetometer")


class Estimators:
    """The estimators of N aircraft.

    Args:
        names: N names of aircraft; random numbers come from streams that carry them.
        sensors: N pages.
        seed: of the run.
        rate_hz: estimates in a second.
        start: the motion (N) at the first of them.
        breakable: pitot tubes can be blocked, and GPS lost.
    """

    def __init__(
        self,
        names: Sequence[str],
        sensors: Sequence[Sensors],
        *,
        seed: int,
        rate_hz: int,
        start: VehicleState,
        breakable: bool = False,
    ) -> None:
        """See the class."""
        self._jitter = Jitter(names, [jitter_levels(e) for e in sensors], seed=seed, dt=1 / rate_hz)
        through = np.array([filtered(each) for each in sensors])
        measured = np.array([each.airspeed is not None for each in sensors])
        self._plain = not (through.any() or measured.any() or breakable)
        self.exact = self._plain and self._jitter.exact
        if self._plain:
            return
        n, rows = len(names), np.flatnonzero(through)
        none = np.zeros(n, dtype=bool)
        self._broken = Broken(none, np.zeros((n, 3)), none.copy(), none.copy())
        self._truth: VehicleState | None = None
        errors = SensorErrors(names, make_levels(sensors, 1 / rate_hz), seed=seed, dt=1 / rate_hz)
        offsets = make_offsets(names, sensors, seed)
        settings = make_settings([sensors[row] for row in rows.tolist()], rate_hz)
        nose = rotation_ned_body(start.euler)[:, :, 0]
        wind = start.velocity_ned - start.airspeed[:, np.newaxis] * nose
        periods = round(WARM_UP_S * rate_hz)
        memory = begin(
            settings,
            -periods,
            aligned(settings, errors.now[rows], offsets.heading[rows], wind[rows, :2]),
            (start.position_ned - WARM_UP_S * start.velocity_ned)[rows],
            start.velocity_ned[rows],
        )
        pitots, flown = Pitots(sensors, rate_hz=rate_hz), np.zeros((len(rows), 9))
        vectors, speeds = np.zeros((5, n, 3)), np.zeros((2, n))
        filters = rows, settings, memory, flown
        self._senses = Senses(errors, offsets, pitots, *filters, vectors, speeds)
        self._believed = VehicleState(*vectors, *speeds)
        self._tick = -periods
        self._warm_up(start, rate_hz)

    def estimate(
        self, truth: VehicleState, *, fresh: bool, failing: Failing | None = None
    ) -> VehicleState:
        """The next estimate, which the one after it overwrites. The truth itself where none errs.

        A truth that is the same record each time, written anew, is cheapest.

        Args:
            truth: of N aircraft.
            fresh: errors move on; so once per period. Between they stay as they are.
            failing: what is broken now; None: what was, which is nothing at first.
        """
        if self._plain:
            return self._jitter.on(truth, fresh=fresh)
        if failing is not None:
            tubes = failing.pitot_blocked, failing.pitot_drained
            now = failing.gps_lost, failing.gps_jump, *tubes
            for known, new in zip(self._broken, now, strict=True):
                known[...] = new
        if truth is not self._truth:
            self._truth = truth
            self._sense = READY_SENSE(self._senses, truth, self._broken)
        self._sense(self._tick, fresh)
        self._tick += fresh
        return self._jitter.on(self._believed, fresh=fresh)

    def _warm_up(self, start: VehicleState, rate_hz: int) -> None:
        """Fly straight on with the motion of the start until the filters have settled.

        Everybody's sensors are on as long, so that who has a filter moves no others' errors.
        """
        level = start._replace(
            acceleration_ned=np.zeros_like(start.acceleration_ned),
            rates_body=np.zeros_like(start.rates_body),
        )
        place = np.array(start.position_ned)
        sense = READY_SENSE(self._senses, level._replace(position_ned=place), self._broken)
        for tick in range(self._tick, 0):
            place[:] = start.position_ned + tick / rate_hz * start.velocity_ned
            sense(tick, True)
        self._tick = 0


def filtered(sensors: Sensors) -> bool:
    """Whether a navigation filter makes the estimate."""
    return any(getattr(sensors, name) is not None for name in _NAVIGATION)


def jitter_levels(sensors: Sensors) -> tuple[NoiseLevel, NoiseLevel, NoiseLevel]:
    """What the page adds to the estimate, whatever made it."""
    position, velocity, attitude = sensors.position, sensors.velocity, sensors.attitude
    return (
        NoiseLevel(position.sigma_m, position.time_constant_s),
        NoiseLevel(velocity.sigma_mps, velocity.time_constant_s),
        NoiseLevel(math.radians(attitude.sigma_deg), attitude.time_constant_s),
    )
