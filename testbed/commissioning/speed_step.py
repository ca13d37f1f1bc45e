"""Identify the speed model of an aircraft from a step of the commanded ground speed.

The aircraft flies with its virtual autopilot and the middle loop, [HBH23] eqs. (19) to (21), as in
a formation: throttle by (21), pitch by (19) for level flight, roll by (20) for a straight course.
In place of the formation law, the commanded speed u is constant, then larger by the step. There is
no wind, and estimates are exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.autopilot.parameters import FbwaParams, make_gains
from testbed.commissioning.identify import FirstOrder, fit_first_order
from testbed.core.compile import entry
from testbed.core.errors import InputError
from testbed.core.flags import Saturation
from testbed.core.records import AIRCRAFT, FOLLOWER, Array, NedOrigin, Records, allocate
from testbed.flight.steps import copy_truth
from testbed.flight.vehicles import JsbsimVehicles
from testbed.formation.middle_loop import initial_memory, middle_loop
from testbed.plan.control import make_loops
from testbed.scenario import MiddleLoopGains
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.jsbsim_adapter import modes_of_aircraft
from testbed.vehicle.step_size import check_fixed_step
from testbed.vehicle.trim import InitialState

BASE_RATE_HZ = 200
AUTOPILOT_TICKS = 4  # 50 Hz
CONTROL_TICKS = 8  # 25 Hz
SETTLE_S = 60.0  # before the step
RECORD_S = 20.0  # after it
ALTITUDE = 100.0  # m above the origin


@dataclass(frozen=True, slots=True)
class SpeedStep:
    """Response to a step of the commanded speed."""

    airspeed: float  # m/s, commanded before the step
    step: float  # m/s
    time: Array  # (k,) s after the step
    speed: Array  # (k,) m/s, over the ground
    throttle: Array  # (k,) commanded, 0..1
    altitude_change: float  # m, the largest after the step
    limited_s: float  # s, during which the throttle was at a limit
    model: FirstOrder  # with a gain of 1, as the formation law assumes
    free: FirstOrder  # with a fitted gain

    @property
    def settled(self) -> float:
        """Speed change in the last second, relative to the step."""
        last = self.time > self.time[-1] - 1.0
        return float((self.speed[last].mean() - self.speed[0]) / self.step)


def speed_step(
    folder: Path,
    profile: MiddleLoopGains,
    params: FbwaParams,
    *,
    airspeed: float,
    step: float,
    warn: Callable[[str], None] = lambda text: None,
) -> SpeedStep:
    """Fly a speed step, and fit first-order models to the response.

    Args:
        folder: of the aircraft.
        profile: of its middle loop.
        params: of its autopilot.
        airspeed: true, before the step, m/s.
        step: of the commanded speed, m/s.
        warn: receives a line if the flight model is too fast for the steps of 1/200 s.

    Raises:
        AircraftError, TrimError: the aircraft cannot be loaded or trimmed.
        InputError: the step is too small, or the aircraft crashes, or diverges with these steps.
    """
    if not (math.isfinite(step) and abs(step) >= 0.1 and airspeed + step > 0.0):
        raise InputError(
            f"a step of {step:g} m/s from {airspeed:g} m/s: write 0.1 m/s or more, and leave a "
            f"speed above 0"
        )
    start = InitialState((0.0, 0.0, -ALTITUDE), airspeed=airspeed)
    fleet = JsbsimFleet([folder], [start], NedOrigin(), BASE_RATE_HZ)
    point = fleet.trims[0].point
    modes = modes_of_aircraft(folder, point, NedOrigin())
    check_fixed_step(folder.name, point.airspeed, modes, BASE_RATE_HZ, warn)
    gains = make_gains([params], AUTOPILOT_TICKS / BASE_RATE_HZ)
    aircraft, followers = allocate(AIRCRAFT, 1), allocate(FOLLOWER, 1)
    aircraft["faults"]["power"] = 1.0
    vehicles = JsbsimVehicles(fleet, gains, aircraft, np.zeros(1, dtype=np.intp))
    loop = make_loops(
        [profile],
        dt=CONTROL_TICKS / BASE_RATE_HZ,
        speed_min=np.zeros(1),
        speed_max=np.full(1, np.inf),
    )
    integrals = initial_memory(1)
    first = round(SETTLE_S * BASE_RATE_HZ)
    rows: list[tuple[float, ...]] = []
    for tick in range(0, first + round(RECORD_S * BASE_RATE_HZ) + 1, AUTOPILOT_TICKS):
        copy_truth(aircraft)
        if fleet.lost(fleet.read())[0]:
            raise InputError(
                f"{folder.name}: crashed {tick / BASE_RATE_HZ:g} s after its start at "
                f"{airspeed:g} m/s (write another --airspeed, --step or --profile)"
            )
        if tick % CONTROL_TICKS == 0:
            followers["speed_command"] = airspeed + (step if tick >= first else 0.0)
            followers["direction"] = (1.0, 0.0, 0.0)  # level, to the north
            followers["limiter_flags"] = 0
            _middle_loop(loop, aircraft, integrals, followers)
            if tick >= first:
                truth = aircraft["truth"][0]
                speed = float(np.linalg.norm(truth["velocity_ned"]))
                altitude = -float(truth["position_ned"][2])
                throttle = float(aircraft["command"]["throttle"][0])
                limited = bool(followers["saturations"][0] & int(Saturation.THROTTLE))
                rows.append((tick - first, speed, throttle, altitude, limited))
        vehicles.autopilot_step()
        vehicles.step(AUTOPILOT_TICKS, None)
    ticks, speed, throttle, altitude, at_limit = np.array(rows).T
    time = ticks / BASE_RATE_HZ
    response = (speed - speed[0]) / step
    return SpeedStep(
        airspeed=airspeed,
        step=step,
        time=time,
        speed=speed,
        throttle=throttle,
        altitude_change=float(np.abs(altitude - altitude[0]).max()),
        limited_s=RECORD_S * float(at_limit.mean()),
        model=fit_first_order(time, response, gain=1.0),
        free=fit_first_order(time, response),
    )


@entry
def _middle_loop(loop: Records, aircraft: Records, integrals: Records, followers: Records) -> None:
    a = aircraft[0]
    middle_loop(loop[0], a.estimate, integrals[0], followers[0], a.command)
