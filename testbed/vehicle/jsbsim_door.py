"""The door to JSBSim: the aircraft of a folder, loaded, and what is asked of it before it flies.

The only module that imports jsbsim. Feet and JSBSim's signs stop in `jsbsim_model` and
`instruments`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import jsbsim

from testbed.state import Airframe, Origin
from testbed.vehicle.airframe_files import explored
from testbed.vehicle.breakage import Rig, find_rig
from testbed.vehicle.folder_cache import digest, kept
from testbed.vehicle.heard import Heard
from testbed.vehicle.inertia import impossible_inertia
from testbed.vehicle.jsbsim_model import AircraftError, JsbsimModel, Traits, find_traits
from testbed.vehicle.linearize import Linear, linearize
from testbed.vehicle.measure import measured_airframe
from testbed.vehicle.trim import TrimPoint, TrimResult, said_of, trim

VERSION: str = jsbsim.__version__
_TRIM_RATE_HZ = 200
# What was found out of folders, by what their files say.
_FOUND: dict[tuple[Path, str], Traits] = {}


def trim_aircraft(folder: Path, point: TrimPoint, origin: Origin | None = None) -> TrimResult:
    """Trim the aircraft in a folder; until its files change the same question is answered once.

    Raises:
        AircraftError, TrimError: there is no such aircraft, or no steady flight at the point.
    """
    return _trim_aircraft(folder, point, origin or Origin())


@kept(maxsize=64)
def airframe(folder: Path) -> Airframe:
    """What the air has to know of the aircraft in a folder.

    Raises:
        AircraftError: if the folder holds no aircraft JSBSim can load.
    """
    return measured_airframe(_aloft(folder))


@kept(maxsize=64)
def rig_of(folder: Path) -> Rig:
    """The surfaces of the aircraft in a folder, for those that break."""
    return find_rig(_aloft(folder))


def _aloft(folder: Path) -> JsbsimModel:
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


@kept(maxsize=256)
def _trim_aircraft(folder: Path, point: TrimPoint, origin: Origin) -> TrimResult:
    model = _located(folder, point, origin)
    with said_of(folder.name):
        return trim(model, point)


def _located(folder: Path, point: TrimPoint, origin: Origin) -> JsbsimModel:
    model = load(folder, _TRIM_RATE_HZ)
    model.locate((0.0, 0.0, origin.elevation_m - point.altitude), origin)
    model.charge(point.state_of_charge)
    return model


def load(folder: Path, rate_hz: int) -> JsbsimModel:
    """The aircraft in a folder, stepped so often per second; it is nowhere yet.

    Raises:
        AircraftError: if the folder holds no aircraft JSBSim can load.
    """
    folder = Path(folder).resolve()
    traits = _traits(folder)
    return JsbsimModel(_executive(folder), rate_hz, traits)


def explore(folders: Iterable[Path], meanwhile: Callable[[], None]) -> None:
    """Find out what `load` has to know of aircraft, in copies of this process, while it does more.

    What is wrong with an aircraft is for who loads it.

    Args:
        folders: of the aircraft.
        meanwhile: what else is to be done.
    """
    begun = {}
    for folder in {Path(each).resolve() for each in folders}:
        files = folder, digest(folder)
        if files not in _FOUND:
            with suppress(AircraftError):
                begun[files] = explored(folder, partial(_explore, folder))
    try:
        meanwhile()
    finally:
        for files, answer in begun.items():
            with suppress(AircraftError):
                _FOUND[files] = Traits(**answer())


def _traits(folder: Path) -> Traits:
    """Found in a copy of this process: JSBSim crashes on many an aircraft that is wrong."""
    files = folder, digest(folder)
    if files not in _FOUND:
        _FOUND[files] = Traits(**explored(folder, partial(_explore, folder))())
    return _FOUND[files]


def _explore(folder: Path, tell: Callable[[str], None]) -> dict[str, bool]:
    _LISTENER.tell = tell
    model = JsbsimModel(_executive(folder), _TRIM_RATE_HZ, Traits(has_rudder=True, has_lag=True))
    traits = find_traits(model)
    if fault := impossible_inertia(model.inertia()):
        raise AircraftError(f"mass_balance: no rigid body has {fault}")
    return asdict(traits)


def _executive(folder: Path) -> jsbsim.FGFDMExec:
    """JSBSim with the aircraft of a folder loaded, silent."""
    jsbsim.FGJSBBase().debug_lvl = 0
    jsbsim.set_logger(_LISTENER)
    fdm = jsbsim.FGFDMExec(str(folder), None)
    fdm.set_debug_level(0)
    fdm.set_aircraft_path(str(folder.parent))
    fdm.set_engine_path(str(folder / "Engines"))
    fdm.set_systems_path(str(folder / "Systems"))
    if not fdm.load_model(folder.name):
        raise AircraftError("JSBSim cannot load it")
    fdm.disable_output()
    return fdm


# Prints nothing; kept here, for JSBSim has no hold of it.
_LISTENER: Any = type("Listener", (Heard, jsbsim.FGLogger), {})()
