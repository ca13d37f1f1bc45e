"""The door to JSBSim: N aircraft that are placed in trim, stepped and read.

The only module that imports jsbsim. Feet and JSBSim's signs (elevator positive nose down, rudder
positive nose left) stop here. Aircraft open no sockets, write no files and print nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import jsbsim
import numpy as np

from testbed.compiled import twin_of
from testbed.errors import InputError
from testbed.frames import FOOT, geodetic_from_ned, metres_per_radian, rotation_ned_body
from testbed.state import AirData, Array, Origin, Surfaces, Truths, VehicleState
from testbed.vehicle.trim import Controls, Placement, TrimPoint, TrimResult, trim

VERSION: str = jsbsim.__version__
LOWEST = 1.0  # m above the terrain: an aircraft below counts as on the ground
_TRIM_RATE_HZ = 200
_SPIN_STEPS = 2000  # at most, until the propeller has settled

# Three numbers per aircraft, then one per aircraft: rows of the flat vector that `read` fills.
_TRIPLES = (
    ("position/lat-geod-rad", "position/long-gc-rad", "position/geod-alt-ft"),
    ("velocities/v-north-fps", "velocities/v-east-fps", "velocities/v-down-fps"),
    ("accelerations/udot-ft_sec2", "accelerations/vdot-ft_sec2", "accelerations/wdot-ft_sec2"),
    ("attitude/phi-rad", "attitude/theta-rad", "attitude/psi-rad"),
    ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec"),
)
_SINGLES = ("velocities/vt-fps", "velocities/ve-fps")
# What `air` fills: one number per aircraft, then three.
_AIR_SINGLES = ("aero/alpha-rad", "aero/beta-rad", "propulsion/engine/propeller-rpm")
_WIND = tuple(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down"))


class AircraftError(InputError):
    """An aircraft folder JSBSim cannot fly."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where and how an aircraft begins, in still air and in trim."""

    position_ned: tuple[float, float, float]  # m from the origin
    course: float = 0.0  # rad
    airspeed: float = 22.0  # true, m/s
    flight_path_angle: float = 0.0  # rad
    bank: float = 0.0  # rad


class JsbsimFleet:
    """N JSBSim aircraft on one clock."""

    def __init__(
        self,
        folders: Sequence[Path],
        starts: Sequence[Start],
        origin: Origin,
        base_rate_hz: int,
    ) -> None:
        """Load, trim and place the aircraft.

        Args:
            folders: N aircraft folders, each holding `<folder name>.xml`.
            starts: N starts.
            origin: of the local frame; its elevation is the terrain's.
            base_rate_hz: steps per second.

        Raises:
            AircraftError: if a folder holds no aircraft JSBSim can load.
            TrimError: if an aircraft has no steady flight at its start.
        """
        models, trims = [], []
        for folder, start in zip(folders, starts, strict=True):
            altitude = origin.elevation_m - start.position_ned[2]
            point = TrimPoint(start.airspeed, start.flight_path_angle, start.bank, altitude)
            trimmed = trim_aircraft(folder, point, origin)
            model = _Model(folder, base_rate_hz)
            model.locate(start.position_ned, origin)
            model.place(trimmed.placement, trimmed.controls, course=start.course, spin=True)
            model.fly()
            models.append(model)
            trims.append(trimmed)
        n = len(models)
        self.wingspan_m: tuple[float, ...] = tuple(
            model.node("metrics/bw-ft").get_double_value() * FOOT for model in models
        )
        self.trims: tuple[TrimResult, ...] = tuple(trims)
        self._runs = [model.fdm.run for model in models]
        self._setters = [model.setters for model in models]
        self._broken = np.zeros(n, dtype=bool)
        self._getters = [
            model.node(name).get_double_value
            for names in _TRIPLES
            for model in models
            for name in names
        ] + [model.node(name).get_double_value for name in _SINGLES for model in models]
        self._air = [
            model.node(name).get_double_value for name in _AIR_SINGLES for model in models
        ] + [model.node(name).get_double_value for model in models for name in _WIND]
        north, east = metres_per_radian(origin)
        latitude, longitude = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
        self._zero = np.zeros(len(self._getters))
        self._zero[: 3 * n] = np.tile([latitude, longitude, origin.elevation_m / FOOT], n)
        self._scale = np.concatenate(
            [
                np.tile([north, east, -FOOT], n),
                np.full(6 * n, FOOT),
                np.ones(6 * n),
                np.full(2 * n, FOOT),
            ]
        )

    @property
    def trimmed(self) -> Surfaces:
        """The surfaces that hold the aircraft in trim at their starts."""
        controls = [trimmed.controls for trimmed in self.trims]
        return Surfaces(
            aileron=np.array([one.aileron for one in controls]),
            elevator=np.array([one.elevator for one in controls]),
            rudder=np.array([one.rudder for one in controls]),
            throttle=np.array([one.throttle for one in controls]),
        )

    def read(self) -> VehicleState:
        """The truth now, as fresh contiguous arrays."""
        return MOTION(np.array([get() for get in self._getters]), self._zero, self._scale)

    def air(self) -> AirData:
        """What the truth knows of the air now; for observers."""
        flat = np.array([get() for get in self._air])
        n = len(self._runs)
        alpha, beta, rpm = flat[: 3 * n].reshape(3, n)
        return AirData(alpha, beta, rpm / 60.0, FOOT * flat[3 * n :].reshape(n, 3))

    def step(self, surfaces: Surfaces, ticks: int) -> None:
        """Set the commands and run every aircraft for `ticks` steps of the base rate."""
        aileron = surfaces.aileron.tolist()
        elevator = surfaces.elevator.tolist()
        rudder = surfaces.rudder.tolist()
        throttle = surfaces.throttle.tolist()
        steps = range(ticks)
        for i, run in enumerate(self._runs):
            if self._broken[i]:
                continue
            set_aileron, set_elevator, set_rudder, set_throttle = self._setters[i]
            set_aileron(aileron[i])
            set_elevator(-elevator[i])
            set_rudder(-rudder[i])
            set_throttle(throttle[i])
            try:
                for _ in steps:
                    if not run():
                        self._broken[i] = True
                        break
            except Exception:  # JSBSim's own, of many types: the state is beyond its models
                self._broken[i] = True

    def bare_runs(self) -> list[Callable[[], bool]]:
        """Each aircraft's own step, for measuring what everything else costs."""
        return list(self._runs)

    def lost(self, state: VehicleState) -> Truths:
        """Which aircraft are on the ground, broken or not finite: (N,) bool."""
        return self._broken | ~(-state.position_ned[:, 2] >= LOWEST)


def trim_aircraft(folder: Path, point: TrimPoint, origin: Origin | None = None) -> TrimResult:
    """Trim the aircraft in a folder; the same question is answered once per process.

    Raises:
        AircraftError: if the folder holds no aircraft JSBSim can load.
        TrimError: if there is no steady flight at the point.
    """
    return _trim_aircraft(Path(folder).resolve(), point, origin or Origin())


@lru_cache(maxsize=256)
def _trim_aircraft(folder: Path, point: TrimPoint, origin: Origin) -> TrimResult:
    model = _Model(folder, _TRIM_RATE_HZ)
    model.locate((0.0, 0.0, origin.elevation_m - point.altitude), origin)
    return trim(model, point)


class _Model:
    """One JSBSim executive before it flies."""

    def __init__(self, folder: Path, rate_hz: int) -> None:
        folder = Path(folder).resolve()
        if not (folder / f"{folder.name}.xml").is_file():
            raise AircraftError(
                f"{folder}: no {folder.name}.xml in it; an aircraft folder holds a JSBSim "
                f"aircraft named like the folder"
            )
        jsbsim.FGJSBBase().debug_lvl = 0
        self.fdm = jsbsim.FGFDMExec(str(folder), None)
        self.fdm.set_debug_level(0)
        self.fdm.set_aircraft_path(str(folder.parent))
        self.fdm.set_engine_path(str(folder / "Engines"))
        self.fdm.set_systems_path(str(folder / "Systems"))
        try:
            loaded = self.fdm.load_model(folder.name)
        except Exception as error:
            raise AircraftError(f"{folder / folder.name}.xml: JSBSim says: {error}") from error
        if not loaded:
            raise AircraftError(f"{folder / folder.name}.xml: JSBSim cannot load it")
        self.fdm.disable_output()
        self.fdm.set_dt(1.0 / rate_hz)
        self._manager = self.fdm.get_property_manager()
        self.node("atmosphere/turb-type").set_double_value(0.0)
        self.setters = tuple(
            self.node(f"fcs/{name}-cmd-norm").set_double_value
            for name in ("aileron", "elevator", "rudder", "throttle")
        )
        self._sense = self.node("propulsion/engine/propeller-sense")
        self._senses = self._sense.get_double_value()
        self._rpm = self.node("propulsion/engine/propeller-rpm").get_double_value
        self._hold = self.node("forces/hold-down").set_double_value
        self._winds = [
            self.node(f"atmosphere/wind-{axis}-fps").set_double_value
            for axis in ("north", "east", "down")
        ]
        self._velocities = [
            self.node(f"velocities/v-{axis}-fps").get_double_value
            for axis in ("north", "east", "down")
        ]
        self._attitude = [
            self.node(f"ic/{name}-rad").set_double_value for name in ("phi", "theta", "psi-true")
        ]
        self._speeds = [self.node(f"ic/{name}-fps").set_double_value for name in "uvw"]
        self._rates = [self.node(f"ic/{name}-rad_sec").set_double_value for name in "pqr"]
        self._accelerations = [
            self.node(f"accelerations/{name}").get_double_value
            for name in (
                "udot-ft_sec2",
                "vdot-ft_sec2",
                "wdot-ft_sec2",
                "pdot-rad_sec2",
                "qdot-rad_sec2",
                "rdot-rad_sec2",
            )
        ]

    def node(self, name: str) -> jsbsim.FGPropertyNode:
        """A property, bound once."""
        node = self._manager.get_node(name)
        if node is None:
            raise AircraftError(f"{self.fdm.get_model_name()}: JSBSim has no property {name}")
        return node

    def locate(self, position_ned: tuple[float, float, float], origin: Origin) -> None:
        """Say where the aircraft is; takes effect when it is placed."""
        latitude, longitude, height = geodetic_from_ned(np.array(position_ned), origin).tolist()
        self.node("ic/terrain-elevation-ft").set_double_value(origin.elevation_m / FOOT)
        self.node("ic/long-gc-deg").set_double_value(longitude)
        self.node("ic/lat-geod-deg").set_double_value(latitude)
        above_sea, geodetic = self.node("ic/h-sl-ft"), self.node("ic/geod-alt-ft")
        above_sea.set_double_value(height / FOOT)
        # JSBSim takes height along the radius; correct it to height above the ellipsoid.
        wrong = geodetic.get_double_value() - height / FOOT
        above_sea.set_double_value(height / FOOT - wrong)

    def place(
        self, placement: Placement, controls: Controls, *, course: float = 0.0, spin: bool
    ) -> None:
        """Put the aircraft in the air.

        A motor of constant power has a huge torque on a propeller at rest, and RPM cannot be set.
        So with `spin` the aircraft is first held still in a wind as fast as it will fly, with no
        torque on the airframe, until the propeller has settled; then it is placed again.
        """
        self._command(controls)
        if spin:
            self._initialise(placement, course)
            self._sense.set_double_value(0.0)
            self._hold(1.0)
            for set_wind, velocity in zip(self._winds, self._velocities, strict=True):
                set_wind(-velocity())
            before = -1.0
            for _ in range(_SPIN_STEPS):
                self.fdm.run()
                now = self._rpm()
                if abs(now - before) < 1e-9 * now:
                    break
                before = now
            self._hold(0.0)
            self._sense.set_double_value(self._senses)
        self._initialise(placement, course)
        for set_wind in self._winds:  # the initial condition leaves rounding errors in it
            set_wind(0.0)

    def fly(self) -> None:
        """Set the clock to zero after placing."""
        self.fdm.set_sim_time(0.0)

    def accelerations(self, placement: Placement, controls: Controls, *, spin: bool) -> Array:
        """u̇, v̇, ẇ (m/s²), ṗ, q̇, ṙ (rad/s²) as placed; with `spin` the propeller settles first."""
        self.place(placement, controls, spin=spin)
        values = np.array([get() for get in self._accelerations])
        values[:3] *= FOOT
        return values

    @property
    def propeller_rps(self) -> float:
        """Revolutions per second."""
        return self._rpm() / 60.0

    def _command(self, controls: Controls) -> None:
        values = (controls.aileron, -controls.elevator, -controls.rudder, controls.throttle)
        for set_value, value in zip(self.setters, values, strict=True):
            set_value(value)

    def _initialise(self, placement: Placement, course: float) -> None:
        angles = (placement.roll, placement.pitch, course - placement.course)
        for set_value, value in zip(self._attitude, angles, strict=True):
            set_value(value)
        for set_value, value in zip(self._speeds, placement.velocity_body, strict=True):
            set_value(value / FOOT)
        for set_value, value in zip(self._rates, placement.rates_body, strict=True):
            set_value(value)
        self.fdm.run_ic()


def motion(raw: Array, zero: Array, scale: Array) -> VehicleState:
    """The state of N aircraft from what JSBSim says of them, (raw − zero) scale, all (17 N,).

    The acceleration is R_NB (d(u, v, w)/dt) + (R_NB ω) × velocity.
    """
    flat = (raw - zero) * scale
    n = flat.size // 17
    position, velocity, uvw_dot, euler, rates = flat[: 15 * n].reshape(5, n, 3)
    airspeed, equivalent = flat[15 * n :].reshape(2, n)
    yaw = euler[:, 2]
    yaw[yaw > np.pi] -= 2.0 * np.pi
    rotation = rotation_ned_body(euler)
    along = (rotation @ uvw_dot[:, :, None])[:, :, 0]
    turning = (rotation @ rates[:, :, None])[:, :, 0]
    acceleration = along + np.cross(turning, velocity)
    return VehicleState(position, velocity, acceleration, euler, rates, airspeed, equivalent)


MOTION = twin_of(motion, "testbed.vehicle.twin")
