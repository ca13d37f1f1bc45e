"""What N autopilots believe of their motion, from the truth and from what their sensors get wrong.

A sensor that the page leaves out has no error. An aircraft with any of GPS, barometer, gyro,
accelerometer and magnetometer on its page flies on a navigation filter; the others on the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.frames import rotation_ned_body
from testbed.scenario.sensors import Sensors
from testbed.sensing.belief import BELIEVE
from testbed.sensing.errors import SensorErrors, make_levels, make_offsets
from testbed.sensing.fusion import NAVIGATE, aligned
from testbed.sensing.jitter import Jitter, NoiseLevel
from testbed.sensing.navigation import Memory, Sensed, begin
from testbed.sensing.pitot import Pitots
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
        self._tick = 0
        self._offsets = make_offsets(names, sensors, seed)
        self._errors = SensorErrors(
            names, make_levels(sensors, 1 / rate_hz), seed=seed, dt=1 / rate_hz
        )
        self._pitots = Pitots(sensors, rate_hz=rate_hz)
        self._rows: NDArray[np.intp] = np.flatnonzero(through)
        self._nothing = np.zeros(len(names), dtype=bool), np.zeros((len(names), 3))
        self._all = bool(through.all())
        self._memory: Memory | None = None
        if self._rows.size:
            own = [sensors[row] for row in self._rows.tolist()]
            self._settings = make_settings(own, rate_hz)
        self._warm_up(start, rate_hz)

    def estimate(
        self, truth: VehicleState, *, fresh: bool, failing: Failing | None = None
    ) -> VehicleState:
        """The next estimate. The truth itself where nothing errs.

        Args:
            truth: of N aircraft.
            fresh: errors move on; so once per period. Between they stay as they are.
            failing: what is broken now.
        """
        if self._plain:
            return self._jitter.on(truth, fresh=fresh)
        if fresh:
            self._advance(truth, failing)
        return self._jitter.on(self._believed(truth), fresh=fresh)

    def _advance(self, truth: VehicleState, failing: Failing | None) -> None:
        """One period of sensors and filters."""
        errors = self._errors.advance()
        tick = self._tick
        eas, tas = self._pitots.read(tick, truth, errors, self._offsets, failing)
        self._tick += 1
        if self._memory is None:
            return
        lost, jump = (failing.gps_lost, failing.gps_jump) if failing else self._nothing
        sensed = Sensed(
            errors=errors,
            heading=self._offsets.heading,
            equivalent_airspeed=eas,
            airspeed=tas,
            airspeed_new=self._pitots.sampled(tick),
            gps_lost=lost,
            gps_jump=jump,
        )
        if not self._all:
            truth, sensed = _rows_of(truth, self._rows), _rows_of(sensed, self._rows)
        self._flown = NAVIGATE(self._memory, self._settings, tick, truth, sensed)

    def _believed(self, truth: VehicleState) -> VehicleState:
        """The truth with the errors of now."""
        eas, tas = self._pitots.now(truth)
        if self._memory is None:
            return truth._replace(airspeed=tas, equivalent_airspeed=eas)
        out = VehicleState(*(each.copy() for each in truth))
        out = out._replace(airspeed=tas, equivalent_airspeed=eas)
        BELIEVE(out, self._rows, self._flown, self._memory.states, self._errors.now)
        return out

    def _warm_up(self, start: VehicleState, rate_hz: int) -> None:
        """Fly straight on with the motion of the start until the filters have settled.

        Everybody's sensors are on as long, so that who has a filter moves no others' errors.
        """
        rows, periods = self._rows, round(WARM_UP_S * rate_hz)
        level = start._replace(
            acceleration_ned=np.zeros_like(start.acceleration_ned),
            rates_body=np.zeros_like(start.rates_body),
        )
        if rows.size:
            nose = rotation_ned_body(start.euler)[:, :, 0]
            wind = start.velocity_ned - start.airspeed[:, np.newaxis] * nose
            sensed = self._errors.now[rows], self._offsets.heading[rows]
            self._memory = begin(
                self._settings,
                -periods,
                aligned(self._settings, *sensed, wind[rows, :2]),
                (start.position_ned - WARM_UP_S * start.velocity_ned)[rows],
                start.velocity_ned[rows],
            )
        for tick in range(-periods, 0):
            self._tick = tick
            place = start.position_ned + tick / rate_hz * start.velocity_ned
            self._advance(level._replace(position_ned=place), None)


def _rows_of(record: Any, rows: NDArray[np.intp]) -> Any:  # noqa: ANN401 - any record of arrays
    return type(record)(*(each[rows] for each in record))


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
