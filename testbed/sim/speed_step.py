"""The speed model of an aircraft, by experiment: a step of the commanded ground speed.

Closed around the aircraft are its virtual autopilot and the whole middle loop, [HBH23] eqs. (19)
to (21), as in a formation: throttle by (21), pitch by (19) towards level flight, roll by (20)
towards a straight course. Open is the formation law, in whose place stands the commanded speed u,
first constant, then higher by the step. Air is still, estimates are the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.errors import InputError
from testbed.formation.flags import Saturation
from testbed.formation.middle_loop import MiddleLoop
from testbed.scenario import MiddleLoopGains as Profile
from testbed.sim.middle_loops import middle_gains
from testbed.sim.vehicles import Flown
from testbed.state import Array, Origin, UnicycleCommand
from testbed.steady import Steady
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.identify import FirstOrder, fit_first_order
from testbed.vehicle.params import FbwaParams, stack
from testbed.vehicle.start import Start

BASE_RATE_HZ = 200
AUTOPILOT_TICKS = 4  # 50 Hz
CONTROL_TICKS = 8  # 25 Hz
SETTLE_S = 60.0  # before the step
WATCH_S = 20.0  # after it
ALTITUDE = 100.0  # m above the origin


@dataclass(frozen=True, slots=True)
class SpeedStep:
    """What a step of the commanded speed did."""

    airspeed: float  # m/s, commanded before the step
    step: float  # m/s
    time: Array  # (k,) s after the step
    speed: Array  # (k,) m/s, over the ground
    throttle: Array  # (k,) commanded
    altitude_change: float  # m, the largest since the step
    limited_s: float  # s, for how long the throttle was at a limit
    model: FirstOrder  # with a gain of 1, as the formation law assumes
    free: FirstOrder  # with whatever gain fits best

    @property
    def settled(self) -> float:
        """Where the speed was at the end, in steps."""
        last = self.time > self.time[-1] - 1.0
        return float((self.speed[last].mean() - self.speed[0]) / self.step)


def speed_step(
    folder: Path, profile: Profile, params: FbwaParams, *, airspeed: float, step: float
) -> SpeedStep:
    """Fly the experiment and fit the speed model to it.

    Args:
        folder: of the aircraft.
        profile: of its middle loop.
        params: of its autopilot.
        airspeed: true, before the step, m/s.
        step: of the commanded speed, m/s.

    Raises:
        AircraftError, TrimError: if the aircraft cannot begin.
        InputError: if the step is nothing, or the aircraft comes down.
    """
    if not (math.isfinite(step) and abs(step) >= 0.1 and airspeed + step > 0.0):
        raise InputError(
            f"a step of {step:g} m/s from {airspeed:g} m/s: write 0.1 m/s or more, and leave a "
            f"speed above 0"
        )
    start = Start((0.0, 0.0, -ALTITUDE), airspeed=airspeed)
    fleet = JsbsimFleet([folder], [start], Origin(), BASE_RATE_HZ)
    aircraft = Flown(fleet, stack([params], AUTOPILOT_TICKS / BASE_RATE_HZ))
    loop = _middle_loop(profile)
    loop_memory, handed = loop.start(), Steady()
    first = round(SETTLE_S * BASE_RATE_HZ)
    rows: list[tuple[float, ...]] = []
    command = None
    for tick in range(0, first + round(WATCH_S * BASE_RATE_HZ) + 1, AUTOPILOT_TICKS):
        state = aircraft.read()
        if aircraft.lost(state)[0]:
            raise InputError(
                f"{folder.name}: came down {tick / BASE_RATE_HZ:g} s after it started at "
                f"{airspeed:g} m/s (write another --airspeed, --step or --profile)"
            )
        if command is None or tick % CONTROL_TICKS == 0:
            told = _straight(airspeed + (step if tick >= first else 0.0))
            command, loop_memory, diagnosis = loop.step(state, told, loop_memory)
            if tick >= first:
                speed = float(np.linalg.norm(state.velocity_ned[0]))
                altitude = -float(state.position_ned[0, 2])
                limited = bool(diagnosis.saturations[0] & int(Saturation.THROTTLE))
                rows.append((tick - first, speed, float(command.throttle[0]), altitude, limited))
        aircraft.act(state, handed(command))
        aircraft.step(AUTOPILOT_TICKS)
    ticks, speed, throttle, altitude, at_limit = np.array(rows).T
    time = ticks / BASE_RATE_HZ
    answer = (speed - speed[0]) / step
    return SpeedStep(
        airspeed=airspeed,
        step=step,
        time=time,
        speed=speed,
        throttle=throttle,
        altitude_change=float(np.abs(altitude - altitude[0]).max()),
        limited_s=WATCH_S * float(at_limit.mean()),
        model=fit_first_order(time, answer, gain=1.0),
        free=fit_first_order(time, answer),
    )


def _straight(speed: float) -> UnicycleCommand:
    """Level, to the north, at this ground speed."""
    u = np.array([speed])
    north = np.array([[1.0, 0.0, 0.0]])
    return UnicycleCommand(u, np.zeros((1, 3)), u, north, np.zeros(1, dtype=np.uint8))


def _middle_loop(profile: Profile) -> MiddleLoop:
    """The middle loop of one aircraft with nothing chosen beside its profile."""
    return MiddleLoop(
        gains=middle_gains([profile]),
        speed_low=np.array([0.0]),
        speed_high=np.array([np.inf]),
        altitude=np.array([np.nan]),
        airspeed_error_as_printed=False,
        dt=CONTROL_TICKS / BASE_RATE_HZ,
    )
