"""Step one aircraft with its virtual autopilot from Python."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

from testbed.core.errors import InputError
from testbed.core.records import ActuatorCommand, AirData, Event, VehicleState
from testbed.scenario import ScenarioError, loads
from testbed.sim.simulation import Simulation
from testbed.vehicle.trim import TrimError

_ValuesT = TypeVar("_ValuesT", VehicleState, AirData, ActuatorCommand)
# Arguments by a key of the scenario that is made from them
_ARGUMENTS = {
    "speed_mps": "airspeed_mps",
    "aircraft": "aircraft",
    "altitude_m": "altitude_m",
    "course_deg": "course_deg",
    "air": "air",
    "sensors": "sensors",
    "tune": "tune",
    "seed": "seed",
    "duration_s": "duration_s",
}
_AHEAD_M = 50.0  # of a leader that is a formula: a scenario has one


class Aircraft:
    """An aircraft that flies pitch, roll and throttle, as ArduPlane in fly-by-wire A.

    It begins at the origin, in level flight at its airspeed.

    Args:
        aircraft: airframe: a name in aircraft/, or the path of a folder.
        airspeed_mps: at the start, m/s.
        altitude_m: at the start, above the ground, m.
        course_deg: at the start, degrees clockwise from north.
        air: wind, turbulence and gusts, as the section `air` of a scenario; None: still air.
        sensors: as the key `sensors` of a scenario, such as "pixhawk"; `estimate` has their errors.
        tune: autopilot parameters: <tune>.param of the airframe, or the path of a file.
        seed: of turbulence and sensor errors.
        duration_s: after which the flight ends, s.
        compiling: as of `testbed.run`.

    Attributes:
        simulation: the flight; the aircraft is number 1 in its records.

    Raises:
        InputError: an argument, which the text names, is wrong, or the aircraft has no level
            flight at this airspeed.
    """

    def __init__(
        self,
        aircraft: str,
        *,
        airspeed_mps: float,
        altitude_m: float = 100.0,
        course_deg: float = 0.0,
        air: Mapping[str, Any] | None = None,
        sensors: str | Mapping[str, Any] = "truth",
        tune: str = "autopilot",
        seed: int = 1,
        duration_s: float = 3600.0,
        compiling: Callable[[int, int], None] | None = None,
    ) -> None:
        """See the class."""
        numbers = {"airspeed_mps": airspeed_mps, "altitude_m": altitude_m}
        numbers |= {"course_deg": course_deg, "duration_s": duration_s}
        for name, value in numbers.items():
            if not math.isfinite(value):
                raise InputError(f"{name}: {value} (write a finite number)")
        line = {"kind": "virtual", "speed_mps": airspeed_mps, "curve": {"kind": "straight"}}
        course = math.radians(course_deg)
        ahead = {"north_m": _AHEAD_M * math.cos(course), "east_m": _AHEAD_M * math.sin(course)}
        behind = [-_AHEAD_M, 0, 0]
        scenario = {
            "scenario": {"schema": 2, "name": "aircraft", "duration_s": duration_s, "seed": seed},
            "leader": {
                "aircraft": aircraft,
                "start": {**ahead, "altitude_m": altitude_m, "course_deg": course_deg},
                "path": line,
            },
            "fleet": [
                {
                    "name": "aircraft",
                    "aircraft": aircraft,
                    "start_m": behind,
                    "commanded_by": "external",
                    "sensors": sensors,
                    "tune": tune,
                }
            ],
            "formation": {
                "offsets_m": {"aircraft": behind},
                "leader_gains": {"aircraft": 1},
                "speed_mps": [0.5 * airspeed_mps, 2.0 * airspeed_mps],
            },
            "air": dict(air or {}),
            "limits": {"formation_lost_m": None, "min_separation_m": 0},
        }
        with _argument_errors(f"{airspeed_mps:g}", altitude_m):
            loaded = loads(json.dumps(scenario), source="testbed.Aircraft")
            self.simulation = Simulation(loaded, compiling=compiling)
        self._sample = self.simulation.state

    def step(
        self, pitch: float, roll: float, throttle: float, until: float | None = None
    ) -> VehicleState:
        """Fly a command to the next tick of the autopilot, or up to a time; return the motion.

        Args:
            pitch: rad.
            roll: rad.
            throttle: 0..1.
            until: s; the first tick at or after it.

        Raises:
            InputError: a number is not finite, or the flight has ended.
        """
        self._sample = self.simulation.step({"aircraft": (pitch, roll, throttle)}, until)
        return self.truth

    def reset(self, seed: int | None = None) -> VehicleState:
        """Return to the start, with another seed if there is one; return the motion there."""
        self._sample = self.simulation.reset(seed)
        return self.truth

    @property
    def truth(self) -> VehicleState:
        """The motion: position, velocity, acceleration, attitude, rates, airspeeds."""
        return _row(self._sample.truth)

    @property
    def estimate(self) -> VehicleState:
        """The same as the autopilot estimates it."""
        return _row(self._sample.estimate)

    @property
    def air(self) -> AirData:
        """Wind, angles of attack and sideslip, propeller and battery."""
        return _row(self._sample.air)

    @property
    def surfaces(self) -> ActuatorCommand:
        """Control surfaces, −1..1, and throttle, 0..1."""
        return _row(self._sample.surfaces)

    @property
    def time_s(self) -> float:
        """Time since the start, s."""
        return self.simulation.time_s

    @property
    def outcome(self) -> str | None:
        """How the flight ended; None: it has not."""
        return self.simulation.outcome

    @property
    def events(self) -> list[Event]:
        """All events up to now."""
        return self.simulation.events

    def __repr__(self) -> str:
        """Describe the flight in one line."""
        name = self.simulation.scenario.fleet[0].aircraft
        return f"<Aircraft: {name}; {self.time_s:g} s; {self.outcome or 'flying'}>"


@contextmanager
def _argument_errors(airspeed: str, altitude_m: float) -> Iterator[None]:
    """Name the argument in errors of the scenario that is made from the arguments.

    Raises:
        InputError: in place of these errors, with the first of them.
    """
    try:
        yield
    except TrimError as error:
        reason = str(error).rpartition("no steady flight; ")[2]
        raise InputError(
            f"airspeed_mps: {airspeed} m/s, {altitude_m:g} m above the ground: no level flight: "
            f"{reason}"
        ) from None
    except ScenarioError as error:
        first = error.problems[0]
        path = [str(each) for each in first.path]
        name = next((each for key, each in _ARGUMENTS.items() if key in path), "")
        if name == "air":
            name = ".".join(path)
        raise InputError(f"{name}: {first.text}" if name else str(first)) from None
    except InputError as error:
        if "below the ground" in str(error):
            raise InputError(f"altitude_m: {error}") from None
        raise


def _row(values: _ValuesT) -> _ValuesT:
    """Copy the aircraft's row of arrays (2, ...)."""
    return type(values)(*(each[1].copy() for each in values))
