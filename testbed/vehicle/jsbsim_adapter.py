"""Aircraft of folders in JSBSim: loaded, trimmed, linearised and examined.

The only module that imports jsbsim. `jsbsim_model` and `jsbsim_io` convert JSBSim's units and
signs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from testbed.airframes.airframe_validation import has_planet, probe_in_copy
from testbed.airframes.inertia import impossible_inertia, unlikely_inertia
from testbed.airframes.powerplant import AircraftError
from testbed.core.errors import needs_jsbsim
from testbed.core.records import Airframe, NedOrigin
from testbed.vehicle.airframe_measurement import (
    SLOWEST_PROBE,
    cruise_airspeed,
    find_traits,
    lift_slope,
    measured_airframe,
)
from testbed.vehicle.control_surfaces import ControlGeometry, find_control_geometry
from testbed.vehicle.environment import INTEGRATORS, Integrators, load_planet
from testbed.vehicle.folder_results import cache_by_folder
from testbed.vehicle.jsbsim_model import JsbsimModel, Traits
from testbed.vehicle.linearize import Linear, NaturalMode, find_modes, linearize
from testbed.vehicle.trim import (
    TrimError,
    TrimPoint,
    TrimResult,
    error_prefix,
    trim,
)

with needs_jsbsim():
    import jsbsim

# Set by the files; properties and point masses may change them when loaded.
_SIZES = ("inertia/mass-slugs", "metrics/Sw-sqft", "metrics/bw-ft", "metrics/cbarw-ft")
_CRUISE_TRIES = (1.0, 1.25, 0.85, 1.6)  # of the airspeed of CRUISE_LIFT
# Of an airspeed that does not trim, in the order in which others are tried.
_OTHER_SPEEDS = (1.05, 0.95, 1.1, 0.9, 1.2, 0.8, 1.4, 0.7, 1.7, 0.5, 2.0, 3.0)
_SMALLEST_SLOPE = 0.3  # 1/rad, of a lift coefficient; that of a slender delta wing is 1.5


_MAX_TEXT = 300  # characters of a log record


def _ignore(_: str) -> None:
    pass


class JsbsimLogCapture:
    """The methods of JSBSim's FGLogger.

    A record has a level, a text in parts, and maybe a place.

    Attributes:
        on_error: called with each error, and its place.
    """

    on_error: Callable[[str], None] = staticmethod(_ignore)

    def __init__(self) -> None:
        super().__init__()
        self._is_error, self._place, self._text = False, "", ""

    def set_level(self, level: Any) -> None:  # noqa: ANN401 - JSBSim's
        """Begin a record."""
        self._is_error = level.name in ("ERROR", "FATAL")
        self._place, self._text = "", ""

    def file_location(self, file: str, line: int) -> None:
        """Set the place of the record."""
        self._place = f"{file}:{line}: "

    def message(self, text: str) -> None:
        """Append to the text of the record."""
        self._text += text

    def format(self, _: Any) -> None:  # noqa: ANN401
        """Ignore colours."""

    def flush(self) -> None:
        """Report the record if it is an error."""
        if self._is_error:
            self.on_error(f"{self._place}JSBSim: {' '.join(self._text.split())[:_MAX_TEXT]}")


VERSION: str = jsbsim.__version__
SHARED_FILES = Path(jsbsim.get_default_root_dir())  # with the folders engine and systems
_TRIM_RATE_HZ = 200


def trim_aircraft(folder: Path, point: TrimPoint, origin: NedOrigin | None = None) -> TrimResult:
    """Trim the aircraft in a folder; the result is cached until its files change.

    Raises:
        AircraftError, TrimError: there is no such aircraft, or no steady flight at the point.
    """
    return _trim_aircraft(folder, point, origin or NedOrigin())


def trim_or_suggest(folder: Path, point: TrimPoint, origin: NedOrigin | None = None) -> TrimResult:
    """Trim an aircraft, as `trim_aircraft` does; an error has the next airspeed that trims.

    Raises:
        AircraftError, TrimError: as `trim_aircraft`.
    """
    try:
        return trim_aircraft(folder, point, origin)
    except TrimError as error:
        for factor in _OTHER_SPEEDS:
            other = replace(point, airspeed=float(f"{factor * point.airspeed:.3g}"))
            with suppress(TrimError):
                trim_aircraft(folder, other, origin)
                break
        else:
            raise
        raise TrimError(f"{error} (it trims at {other.airspeed:g} m/s)") from None


def find_cruise(folder: Path, airspeed: float | None = None, altitude: float = 400.0) -> TrimResult:
    """Trim the aircraft in a folder in level flight, or a glider in its descent.

    Args:
        folder: of the aircraft.
        airspeed: true, m/s; default: that of a lift coefficient of 0.4 at sea level, or where there
            is no steady flight the first of 1.25, 0.85 and 1.6 times that speed.
        altitude: m above sea level.

    Raises:
        AircraftError: JSBSim cannot load an aircraft from the folder, or it is no aeroplane.
        TrimError: there is no steady flight; of several speeds the error of the first one.
    """
    if airspeed is not None:
        return trim_aircraft(folder, TrimPoint(airspeed, altitude=altitude))
    cruise = cruise_airspeed(airframe(folder))
    errors = list[TrimError]()
    for factor in _CRUISE_TRIES:
        try:
            return trim_aircraft(folder, TrimPoint(factor * cruise, altitude=altitude))
        except TrimError as error:
            errors.append(error)
    raise errors[0]


@cache_by_folder(64, kept=Airframe)
def airframe(folder: Path) -> Airframe:
    """Measure the airframe properties of the aircraft in a folder.

    Raises:
        AircraftError: JSBSim cannot load an aircraft from the folder.
    """
    return measured_airframe(_load_in_flight(folder))


@cache_by_folder(64, kept=ControlGeometry)
def control_geometry(folder: Path) -> ControlGeometry:
    """Find the control surfaces of the aircraft in a folder."""
    return find_control_geometry(_load_in_flight(folder))


def _load_in_flight(folder: Path) -> JsbsimModel:
    model = load(folder, _TRIM_RATE_HZ)
    model.locate((0.0, 0.0, -1000.0), NedOrigin())
    return model


def linearize_aircraft(folder: Path, point: TrimPoint, origin: NedOrigin | None = None) -> Linear:
    """Linearise the aircraft in a folder about its trim.

    Raises:
        AircraftError, TrimError: as `trim_aircraft` does.
    """
    origin = origin or NedOrigin()
    trimmed = trim_aircraft(folder, point, origin)
    return linearize(_located(folder, point, origin), trimmed)


def modes_of_aircraft(folder: Path, point: TrimPoint, origin: NedOrigin) -> tuple[NaturalMode, ...]:
    """Find the modes of the aircraft in a folder about its trim, the fastest first.

    The result is cached until a file of the folder changes.

    Raises:
        AircraftError, TrimError: as `trim_aircraft` does.
    """
    return _modes_of_aircraft(folder, point, origin)


@cache_by_folder(64)
def _modes_of_aircraft(
    folder: Path, point: TrimPoint, origin: NedOrigin
) -> tuple[NaturalMode, ...]:
    linear = linearize_aircraft(folder, point, origin)
    return find_modes(linear.a, linear.states)


@cache_by_folder(256, kept=TrimResult)
def _trim_aircraft(folder: Path, point: TrimPoint, origin: NedOrigin) -> TrimResult:
    model = _located(folder, point, origin)
    with error_prefix(folder.name):
        try:
            return trim(model, point)
        except TrimError:
            if (slope := lift_slope(model)) <= _SMALLEST_SLOPE:  # not where it is NaN
                raise TrimError(
                    f"its lift coefficient grows by {slope:.2g} per radian of angle of attack near "
                    "0: that is no aeroplane's, and the testbed flies aeroplanes"
                ) from None
            raise


def _located(folder: Path, point: TrimPoint, origin: NedOrigin) -> JsbsimModel:
    model = load(folder, _TRIM_RATE_HZ)
    model.locate((0.0, 0.0, origin.elevation_m - point.altitude), origin)
    model.warm(point.temperature_offset)
    model.power.set_cells(point.cells)
    model.power.charge(point.state_of_charge)
    return model


def load(folder: Path, rate_hz: int, integrators: Integrators = INTEGRATORS) -> JsbsimModel:
    """Load the aircraft in a folder, with a step rate and without a position.

    Raises:
        AircraftError: JSBSim cannot load an aircraft from the folder.
    """
    folder = Path(folder).resolve()
    traits = _find_traits(folder)
    return JsbsimModel(load_executive(folder), rate_hz, traits, integrators)


def airframe_warnings(folder: Path) -> tuple[str, ...]:
    """Return what a user should know about the aircraft in a folder before it flies.

    Raises:
        AircraftError: JSBSim cannot load an aircraft from the folder.
    """
    folder = Path(folder).resolve()
    traits, found = _find_traits(folder), list[str]()
    if traits.unlikely_inertia:
        main = folder / f"{folder.name}.xml"
        found.append(f"{main}: mass_balance: no rigid body has {traits.unlikely_inertia}")
    if not traits.has_engine:
        found.append(
            f"{folder.name} has no engine: its throttle has no effect, and in steady flight it "
            "descends at the angle that its airspeed gives"
        )
    return tuple(found)


def probe_airframes(folders: Iterable[Path]) -> None:
    """Determine the traits of aircraft, which `load` needs, in parallel processes.

    An error of an aircraft is raised when it is loaded.
    """
    started = {}
    for folder in {Path(each).resolve() for each in folders}:
        key = _find_traits.key(folder)
        if _find_traits.find(key) is None:
            with suppress(AircraftError):
                started[key] = probe_in_copy(folder, partial(_probe, folder))
    for key, wait in started.items():
        with suppress(AircraftError):
            _find_traits.keep(key, Traits(**wait()))


@cache_by_folder(64, kept=Traits)
def _find_traits(folder: Path) -> Traits:
    """Determine traits in a copy of this process, because JSBSim crashes on invalid aircraft."""
    return Traits(**probe_in_copy(folder, partial(_probe, folder))())


def _probe(folder: Path, on_error: Callable[[str], None]) -> dict[str, Any]:
    _LOGGER.on_error = on_error
    assumed = Traits(
        SLOWEST_PROBE, has_engine=True, has_rudder=True, has_lag=True, lags_by_step=False
    )
    model = JsbsimModel(load_executive(folder), _TRIM_RATE_HZ, assumed)
    traits = find_traits(model)
    for name in _SIZES:
        if not 0.0 < (size := model.node(name).get_double_value()) < math.inf:
            raise AircraftError(f"{name} is {size:g} when loaded; it must be greater than 0")
    inertia = model.inertia()
    if fault := impossible_inertia(inertia):
        raise AircraftError(f"mass_balance: no rigid body has {fault}")
    return asdict(replace(traits, unlikely_inertia=unlikely_inertia(inertia)))


def load_executive(folder: Path) -> jsbsim.FGFDMExec:
    """Load the model `<folder name>.xml` of a folder into JSBSim, without output.

    Raises:
        AircraftError: JSBSim cannot load it.
    """
    jsbsim.FGJSBBase().debug_lvl = 0
    jsbsim.set_logger(_LOGGER)
    fdm = jsbsim.FGFDMExec(str(folder), None)
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(str(folder.parent))
    fdm.set_engine_path(str(folder / "Engines"))
    fdm.set_systems_path(str(folder / "Systems"))
    load_planet(fdm)
    if not fdm.load_model(folder.name):
        raise AircraftError("JSBSim cannot load it")
    # `check_airframe` refuses such an aircraft; unchecked, it still does not replace the Earth
    if has_planet(folder / f"{folder.name}.xml"):
        load_planet(fdm)
    fdm.disable_output()
    return fdm


# JSBSim holds no reference to its logger, so it must outlive every executive.
_LOGGER: Any = type("Logger", (JsbsimLogCapture, jsbsim.FGLogger), {})()
