"""Step one aircraft with its virtual autopilot from Python."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

from testbed.core.errors import InputError, NotCopied
from testbed.core.exclusive import Exclusive, exclusive
from testbed.core.records import (
    ActuatorCommand,
    AirData,
    Event,
    FbwaCommand,
    VehicleState,
)
from testbed.runs.flight_progress import Progress
from testbed.runs.simulation import Simulation
from testbed.scenario import SingleAircraft, resolve_single_aircraft
from testbed.scenario.aircraft import AircraftSection, External, Mission, Start
from testbed.scenario.arguments import check_argument
from testbed.scenario.fields import Section
from testbed.scenario.sections import Header, Rates, Sections
from testbed.vehicle.trim import TrimError

_ValuesT = TypeVar("_ValuesT", VehicleState, AirData, ActuatorCommand)
# Arguments: the section and the key of the files that have their types and bounds.
_ARGUMENTS: Mapping[str, tuple[type[Section], str]] = {
    "aircraft": (AircraftSection, "aircraft"),
    "airspeed_mps": (Mission, "airspeed_mps"),
    "altitude_m": (Start, "altitude_m"),
    "course_deg": (Start, "course_deg"),
    "air": (Sections, "air"),
    "sensors": (AircraftSection, "sensors"),
    "tune": (AircraftSection, "tune"),
    "seed": (Header, "seed"),
    "duration_s": (Header, "duration_s"),
    "physics_hz": (Rates, "physics_hz"),
}
_AUTOPILOT_HZ = Rates().autopilot_hz
_NAME = "aircraft"


class Aircraft(NotCopied):
    """An aircraft that flies pitch, roll and throttle, as ArduPlane in fly-by-wire A.

    It begins at the origin, in level flight at its airspeed.

    Args:
        aircraft: airframe: a name in aircraft/, or the path of a folder.
        airspeed_mps: true airspeed at the start, m/s; in wind the speed over the ground is another.
        altitude_m: at the start, above the ground, m.
        course_deg: over the ground at the start, degrees clockwise from north.
        air: wind, turbulence and gusts, as the section `air` of a scenario; None: still air.
        sensors: as the key `sensors` of a scenario, such as "pixhawk"; `estimate` has their errors.
        tune: autopilot parameters: <tune>.param of the airframe, or the path of a file.
        seed: of turbulence and sensor errors.
        duration_s: after which the flight ends, s.
        physics_hz: steps of the flight model per second, a multiple of 50, up to 10,000; an
            aircraft with fast modes needs more, which an error or an event says.
        progress: of compiling, as of `testbed.run`.

    Attributes:
        simulation: the flight; the aircraft is number 0 in its records, and it has no followers.

    Raises:
        InputError: an argument, which the text names, is wrong, or the aircraft has no level
            flight at this airspeed, or not on this course in the wind.
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
        physics_hz: int = 100,
        progress: Progress = None,
    ) -> None:
        given: dict[str, object] = {
            "aircraft": aircraft,
            "airspeed_mps": airspeed_mps,
            "altitude_m": altitude_m,
            "course_deg": course_deg,
            "air": {} if air is None else air,
            "sensors": sensors,
            "tune": tune,
            "seed": seed,
            "duration_s": duration_s,
            "physics_hz": physics_hz,
        }
        checked = {
            name: check_argument(name, value, *_ARGUMENTS[name]) for name, value in given.items()
        }
        if physics_hz % _AUTOPILOT_HZ:
            raise InputError(
                f"physics_hz: is {physics_hz} (write a multiple of {_AUTOPILOT_HZ}, the rate of "
                "the autopilot)"
            )
        flight = resolve_single_aircraft(_flight(checked))
        with _argument_errors(f"{airspeed_mps:g}", altitude_m):
            self.simulation = Simulation(flight, progress=progress)
        self._exclusive = Exclusive(f"the flight of {checked['aircraft']}")
        self._sample = self.simulation.state

    @exclusive
    def step(
        self, pitch: float, roll: float, throttle: float, until: float | None = None
    ) -> VehicleState:
        """Fly a command to the next tick of the autopilot, or up to a time; return the motion.

        Args:
            pitch: rad, up to 75° either way.
            roll: rad, up to 75° either way.
            throttle: 0..1.
            until: s, from 0 to a day; the first tick at or after it, and after the present one.

        Raises:
            InputError: a number is out of range, or the flight has ended. The flight then goes on
                as if there had been no call.
        """
        try:
            self._sample = self.simulation.step({_NAME: FbwaCommand(pitch, roll, throttle)}, until)
        except InputError as error:
            raise InputError(str(error).removeprefix(f"{_NAME}: ")) from None
        return self.truth

    @exclusive
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

    def _why_not_copied(self) -> str:
        """See `NotCopied`."""
        return (
            f"the flight of {self.simulation.scenario.aircraft[0].aircraft} cannot be copied or "
            "pickled (make another Aircraft, with the same seed, and give it the same commands)"
        )

    def __repr__(self) -> str:
        """Describe the flight in one line."""
        name = self.simulation.scenario.aircraft[0].aircraft
        return f"<Aircraft: {name}; {self.time_s:g} s; {self.outcome or 'flying'}>"


def _flight(arguments: Mapping[str, Any]) -> SingleAircraft:
    header, own = ("duration_s", "seed"), ("aircraft", "sensors", "tune")
    return SingleAircraft(
        scenario=Header(schema_version=2, name=_NAME, **{key: arguments[key] for key in header}),
        rates=Rates(physics_hz=arguments["physics_hz"]),
        only=AircraftSection(
            name=_NAME, commanded_by=External(), **{key: arguments[key] for key in own}
        ),
        start=Start(altitude_m=arguments["altitude_m"], course_deg=arguments["course_deg"]),
        airspeed_mps=arguments["airspeed_mps"],
        air=arguments["air"],
    )


@contextmanager
def _argument_errors(airspeed: str, altitude_m: float) -> Iterator[None]:
    """Name the argument in errors of the flight that is built from the arguments.

    Raises:
        InputError: in place of these errors, with the first of them.
    """
    try:
        yield
    except TrimError as error:
        reason = str(error).removeprefix("fleet: ").rpartition("no steady flight; ")[2]
        raise InputError(
            f"airspeed_mps: {airspeed} m/s, {altitude_m:g} m above the ground: no level flight: "
            f"{reason}"
        ) from None
    except InputError as error:
        text = str(error)
        if "below the ground" in text:
            raise InputError(f"altitude_m: {text}") from None
        raise InputError(text.replace("rates.physics_hz", "physics_hz")) from None


def _row(values: _ValuesT) -> _ValuesT:
    """Copy the aircraft's row of arrays (1, ...)."""
    return type(values)(*(each[0].copy() for each in values))
