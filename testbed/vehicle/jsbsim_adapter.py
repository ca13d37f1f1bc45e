"""Aircraft of folders in JSBSim: loaded, trimmed, linearised and examined.

The only module that imports jsbsim. `jsbsim_model` and `jsbsim_io` convert JSBSim's units and
signs.
"""

from __future__ import annotations

import hashlib
import math
import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict
from functools import lru_cache, partial, wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import jsbsim
import numpy as np

from testbed.core.errors import InputError
from testbed.core.frames import FOOT
from testbed.core.input_files import open_regular
from testbed.core.records import Airframe, Array, NedOrigin
from testbed.vehicle.airframe_validation import MAX_BYTES, probe_in_copy
from testbed.vehicle.control_surfaces import ControlGeometry, find_control_geometry
from testbed.vehicle.environment import INTEGRATORS, Integrators
from testbed.vehicle.jsbsim_model import POUND, AircraftError, JsbsimModel, Traits, find_traits
from testbed.vehicle.linearize import Linear, NaturalMode, find_modes, linearize
from testbed.vehicle.trim import (
    STILL,
    Controls,
    Placement,
    TrimPoint,
    TrimResult,
    error_prefix,
    trim,
)

# Set by the files; properties and point masses may change them when loaded.
_SIZES = ("inertia/mass-slugs", "metrics/Sw-sqft", "metrics/bw-ft", "metrics/cbarw-ft")
_ROUNDING = 1e-6  # of the largest moment; a flat plate has J1 + J2 = J3 exactly
_AXES = ((0, 0, "Jxx"), (1, 1, "Jyy"), (2, 2, "Jzz"), (0, 1, "Jxy"), (0, 2, "Jxz"), (1, 2, "Jyz"))


def impossible_inertia(tensor: Array) -> str | None:
    """Return why an inertia tensor (3, 3), kg m², is impossible, or None.

    The principal moments J1 ≤ J2 ≤ J3 are integrals of y² + z², x² + z² and x² + y² over a mass
    without negative density: they are positive, and none exceeds the sum of the others.
    """
    elements = ", ".join(
        f"{name} {tensor[i, j]:.4g}" for i, j, name in _AXES if i == j or tensor[i, j] != 0.0
    )
    if not np.isfinite(tensor).all():
        return f"{elements} kg m²: they must be finite"
    first, second, third = np.linalg.eigvalsh(0.5 * (tensor + tensor.T)).tolist()
    principal = f"J1 {first:.4g}, J2 {second:.4g}, J3 {third:.4g}"
    if not first > 0.0:
        return (
            f"{elements} kg m²: the principal moments are {principal}, and J1 > 0 fails: the "
            f"tensor must be positive definite"
        )
    if first + second < third * (1.0 - _ROUNDING):
        return (
            f"{elements} kg m²: the principal moments are {principal}, and J1 + J2 ≥ J3 fails: "
            f"{first + second:.4g} < {third:.4g}"
        )
    return None


_TILT = 1.0  # rad, of the attitudes in which contact points are found
_INCIDENCE = 0.02  # rad, far from the stall
_ALPHAS = np.radians(np.arange(0.0, 45.1, 0.1))  # searched for the stall


def measured_airframe(model: JsbsimModel) -> Airframe:
    """Measure wing size, mass with fuel, lift slope and stall angle.

    The wind is sampled ahead of and behind the centre of gravity at the distance of the tail, or of
    half a chord without a tail. The stall angle has the largest lift with neutral controls.
    """
    size = {
        name: model.node(f"metrics/{key}").get_double_value()
        for name, key in (("area", "Sw-sqft"), ("span", "bw-ft"), ("tail", "lh-ft"))
    }
    chord = model.node("metrics/cbarw-ft").get_double_value()
    low, high = (_lift(model, alpha) for alpha in (0.0, _INCIDENCE))  # also initialises the fuel
    mass = model.node("inertia/mass-slugs").get_double_value()
    lifts = [_lift(model, alpha) for alpha in _ALPHAS]
    largest = int(np.argmax(lifts))
    return Airframe(
        span=size["span"] * FOOT,
        area=size["area"] * FOOT**2,
        arm=(size["tail"] or 0.5 * chord) * FOOT,
        mass=mass * POUND / FOOT,
        lift_slope=(high - low) / _INCIDENCE / size["area"],
        stall_angle=math.inf if largest == len(lifts) - 1 else float(_ALPHAS[largest]),
        contact_radius=_contact_radius(model),
    )


def _contact_radius(model: JsbsimModel) -> float:
    """Return the distance of the farthest contact point from the centre of gravity, m.

    JSBSim tells the heights of its contact points: their distances below the centre of gravity in
    three attitudes are those along the axes of the body.
    """
    points = range(int(model.node("gear/num-units").get_double_value()))
    heights = [
        model.find(f"gear/unit[{k}]/AGL-ft") or model.node(f"contact/unit[{k}]/AGL-ft")
        for k in points
    ]
    below = []
    for roll, pitch in ((0.0, 0.0), (0.0, _TILT), (_TILT, 0.0)):
        placement = Placement((20.0, 0.0, 0.0), STILL, roll, pitch, 0.0)
        model.place(placement, Controls(0.0, 0.0, 0.0, 0.0), spin=False)
        centre = model.node("position/h-agl-ft").get_double_value()
        below.append([centre - each.get_double_value() for each in heights])
    z, pitched, rolled = np.array(below).reshape(3, -1) * FOOT
    x = (z * math.cos(_TILT) - pitched) / math.sin(_TILT)
    y = (rolled - z * math.cos(_TILT)) / math.sin(_TILT)
    return float(np.max(np.sqrt(x * x + y * y + z * z), initial=0.0))


def _lift(model: JsbsimModel, alpha: float) -> float:
    """Return lift divided by dynamic pressure at an angle of attack, ft²."""
    speed = 20.0
    velocity = (speed * math.cos(alpha), 0.0, speed * math.sin(alpha))
    neutral = Controls(0.0, 0.0, 0.0, 0.0)
    model.place(Placement(velocity, STILL, 0.0, alpha, 0.0), neutral, spin=False)
    # unlike its other forces, JSBSim's aerodynamic force has lift and drag positive
    force = model.node("forces/fwz-aero-lbs").get_double_value()
    return float(force) / float(model.node("aero/qbar-psf").get_double_value())


_Rest = ParamSpec("_Rest")
_ResultT = TypeVar("_ResultT")
_Function = Callable[Concatenate[Path, _Rest], _ResultT]


def cache_by_folder(
    maxsize: int,
) -> Callable[[_Function[_Rest, _ResultT]], _Function[_Rest, _ResultT]]:
    """Cache a function of a folder until one of its XML files changes.

    Args:
        maxsize: number of results.
    """

    def decorate(function: _Function[_Rest, _ResultT]) -> _Function[_Rest, _ResultT]:
        @lru_cache(maxsize=maxsize)
        def cached(_: str, folder: Path, *args: _Rest.args, **kwargs: _Rest.kwargs) -> _ResultT:
            return function(folder, *args, **kwargs)

        @wraps(function)
        def call(folder: Path, /, *args: _Rest.args, **kwargs: _Rest.kwargs) -> _ResultT:
            folder = Path(folder).resolve()
            return cached(folder_digest(folder), folder, *args, **kwargs)  # type: ignore[arg-type]

        return call

    return decorate


def folder_digest(folder: Path) -> str:
    """Return a digest of all XML files in and below a folder.

    Times and sizes are not enough: an edit can keep both.
    """
    content = hashlib.blake2b(digest_size=16)
    for file in sorted(folder.rglob("*.xml")):
        data = _read_start(file)
        content.update(os.fsencode(f"{file.relative_to(folder)}\0{len(data)}\0"))
        content.update(data)
    return content.hexdigest()


def _read_start(file: Path) -> bytes:
    """Read an aircraft file up to the size limit; empty if unreadable."""
    # an error is reported when the aircraft is loaded
    with suppress(OSError, InputError), open_regular(file, sys.maxsize) as stream:
        return stream.read(MAX_BYTES + 1)
    return b""


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
        """Start without a record."""
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
# By folder and digest of its files.
_TRAITS: dict[tuple[Path, str], Traits] = {}


def trim_aircraft(folder: Path, point: TrimPoint, origin: NedOrigin | None = None) -> TrimResult:
    """Trim the aircraft in a folder; the result is cached until its files change.

    Raises:
        AircraftError, TrimError: there is no such aircraft, or no steady flight at the point.
    """
    return _trim_aircraft(folder, point, origin or NedOrigin())


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

    The result is cached until a file of the folder changes. It is empty where the aircraft cannot
    be linearised, as with a propeller whose speed does not depend on the throttle.

    Raises:
        AircraftError, TrimError: as `trim_aircraft` does.
    """
    return _modes_of_aircraft(folder, point, origin)


@cache_by_folder(maxsize=64)
def _modes_of_aircraft(
    folder: Path, point: TrimPoint, origin: NedOrigin
) -> tuple[NaturalMode, ...]:
    with np.errstate(divide="ignore", invalid="ignore"):
        a = linearize_aircraft(folder, point, origin).a
    return find_modes(a) if np.isfinite(a).all() else ()


@cache_by_folder(maxsize=256)
def _trim_aircraft(folder: Path, point: TrimPoint, origin: NedOrigin) -> TrimResult:
    model = _located(folder, point, origin)
    with error_prefix(folder.name):
        return trim(model, point)


def _located(folder: Path, point: TrimPoint, origin: NedOrigin) -> JsbsimModel:
    model = load(folder, _TRIM_RATE_HZ)
    model.locate((0.0, 0.0, origin.elevation_m - point.altitude), origin)
    model.warm(point.temperature_offset)
    model.set_cells(point.cells)
    model.charge(point.state_of_charge)
    return model


def load(folder: Path, rate_hz: int, integrators: Integrators = INTEGRATORS) -> JsbsimModel:
    """Load the aircraft in a folder, with a step rate and without a position.

    Raises:
        AircraftError: JSBSim cannot load an aircraft from the folder.
    """
    folder = Path(folder).resolve()
    traits = _traits(folder)
    return JsbsimModel(load_executive(folder), rate_hz, traits, integrators)


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
    assumed = Traits(has_rudder=True, has_lag=True, lags_by_step=False)
    model = JsbsimModel(load_executive(folder), _TRIM_RATE_HZ, assumed)
    traits = find_traits(model)
    for name in _SIZES:
        if not 0.0 < (size := model.node(name).get_double_value()) < math.inf:
            raise AircraftError(f"{name} is {size:g} when loaded; it must be greater than 0")
    if fault := impossible_inertia(model.inertia()):
        raise AircraftError(f"mass_balance: no rigid body has {fault}")
    return asdict(traits)


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
    if not fdm.load_model(folder.name):
        raise AircraftError("JSBSim cannot load it")
    fdm.disable_output()
    return fdm


# JSBSim holds no reference to its logger, so it must outlive every executive.
_LOGGER: Any = type("Logger", (JsbsimLogCapture, jsbsim.FGLogger), {})()
