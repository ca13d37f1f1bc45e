"""Aircraft of folders in JSBSim: loaded, trimmed, linearised and examined.

The only module that imports jsbsim. `jsbsim_model` and `jsbsim_io` convert JSBSim's units and
signs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import jsbsim

from testbed.core.records import Airframe, Origin
from testbed.vehicle.airframe_properties import measured_airframe
from testbed.vehicle.airframe_validation import probe_in_copy
from testbed.vehicle.control_surfaces import ControlGeometry, find_control_geometry
from testbed.vehicle.folder_cache import cache_by_folder, folder_digest
from testbed.vehicle.inertia import impossible_inertia
from testbed.vehicle.jsbsim_log import JsbsimLogCapture
from testbed.vehicle.jsbsim_model import AircraftError, JsbsimModel, Traits, find_traits
from testbed.vehicle.linearize import Linear, linearize
from testbed.vehicle.trim import TrimPoint, TrimResult, error_prefix, trim

VERSION: str = jsbsim.__version__
_TRIM_RATE_HZ = 200
# By folder and digest of its files.
_TRAITS: dict[tuple[Path, str], Traits] = {}


def trim_aircraft(folder: Path, point: TrimPoint, origin: Origin | None = None) -> TrimResult:
    """Trim the aircraft in a folder; the result is cached until its files change.

    Raises:
        AircraftError, TrimError: there is no such aircraft, or no steady flight at the point.
    """
    return _trim_aircraft(folder, point, origin or Origin())


@cache_by_folder(maxsize=64)
def airframe(folder: Path) -> Airframe:
    """Measure the airframe properties of the aircraft in a folder.

    Raises:
        AircraftError: JSBSim cannot load an aircraft from the folder.
    """
    return measured_airframe(_load_in_flight(folder))


@cache_by_folder(maxsize=64)
def control_geometry(folder: Path) -> ControlGeometry:
    """Find the control surfaces of the aircraft in a folder."""
    return find_control_geometry(_load_in_flight(folder))


def _load_in_flight(folder: Path) -> JsbsimModel:
    model = load(folder, _TRIM_RATE_HZ)
    model.locate((0.0, 0.0, -1000.0), Origin())
    return model


def linearize_aircraft(folder: Path, point: TrimPoint, origin: Origin | None = None) -> Linear:
    """Linearise the aircraft in a folder about its trim.

    Raises:
        AircraftError, TrimError: as `trim_aircraft` does.
    """
    origin = origin or Origin()
    trimmed = trim_aircraft(folder, point, origin)
    return linearize(_located(folder, point, origin), trimmed)


@cache_by_folder(maxsize=256)
def _trim_aircraft(folder: Path, point: TrimPoint, origin: Origin) -> TrimResult:
    model = _located(folder, point, origin)
    with error_prefix(folder.name):
        return trim(model, point)


def _located(folder: Path, point: TrimPoint, origin: Origin) -> JsbsimModel:
    model = load(folder, _TRIM_RATE_HZ)
    model.locate((0.0, 0.0, origin.elevation_m - point.altitude), origin)
    model.warm(point.temperature_offset)
    model.set_cells(point.cells)
    model.charge(point.state_of_charge)
    return model


def load(folder: Path, rate_hz: int) -> JsbsimModel:
    """Load the aircraft in a folder, with a step rate and without a position.

    Raises:
        AircraftError: JSBSim cannot load an aircraft from the folder.
    """
    folder = Path(folder).resolve()
    traits = _traits(folder)
    return JsbsimModel(_executive(folder), rate_hz, traits)


def probe_airframes(folders: Iterable[Path]) -> None:
    """Determine the traits of aircraft, which `load` needs, in parallel processes.

    An error of an aircraft is raised when it is loaded.
    """
    started = {}
    for folder in {Path(each).resolve() for each in folders}:
        files = folder, folder_digest(folder)
        if files not in _TRAITS:
            with suppress(AircraftError):
                started[files] = probe_in_copy(folder, partial(_probe, folder))
    for files, wait in started.items():
        with suppress(AircraftError):
            _TRAITS[files] = Traits(**wait())


def _traits(folder: Path) -> Traits:
    """Determine traits in a copy of this process, because JSBSim crashes on invalid aircraft."""
    files = folder, folder_digest(folder)
    if files not in _TRAITS:
        _TRAITS[files] = Traits(**probe_in_copy(folder, partial(_probe, folder))())
    return _TRAITS[files]


def _probe(folder: Path, on_error: Callable[[str], None]) -> dict[str, bool]:
    _LOGGER.on_error = on_error
    model = JsbsimModel(_executive(folder), _TRIM_RATE_HZ, Traits(has_rudder=True, has_lag=True))
    traits = find_traits(model)
    if fault := impossible_inertia(model.inertia()):
        raise AircraftError(f"mass_balance: no rigid body has {fault}")
    return asdict(traits)


def _executive(folder: Path) -> jsbsim.FGFDMExec:
    """Load the aircraft of a folder into JSBSim, without output."""
    jsbsim.FGJSBBase().debug_lvl = 0
    jsbsim.set_logger(_LOGGER)
    fdm = jsbsim.FGFDMExec(str(folder), None)
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(str(folder.parent))
    fdm.set_engine_path(str(folder / "Engines"))
    fdm.set_systems_path(str(folder / "Systems"))
    if not fdm.load_model(folder.name):
        raise AircraftError("JSBSim cannot load it")
    fdm.disable_output()
    return fdm


# JSBSim holds no reference to its logger, so it must outlive every executive.
_LOGGER: Any = type("Logger", (JsbsimLogCapture, jsbsim.FGLogger), {})()
