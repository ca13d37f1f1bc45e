"""One JSBSim aircraft: placed in any state, with its accelerations there.

JSBSim's units and signs occur only here and in `jsbsim_io`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from testbed.airframes.powerplant import AircraftError, Powerplant, at_rest
from testbed.core.frames import FOOT, rotation_ned_body
from testbed.core.geodetic import RADIANS, geodetic_from_ned, local_frame
from testbed.core.records import Array, NedOrigin
from testbed.vehicle.control_surfaces import SURFACES
from testbed.vehicle.environment import INTEGRATORS, Integrators, set_environment
from testbed.vehicle.trim import STILL, Controls, Placement, TrimError, Vector

# Properties of the aircraft files: subtracted from the rates and added to the rolling moment.
_TURNS = ("p-rad_sec", "q-rad_sec", "r-rad_sec", "roll-coefficient")
_DEFLECTED = ("left-aileron", *SURFACES[1:])  # ailerons deflect together
_SETTLING_HZ = 200  # steps per second meanwhile, whatever the rate of the flight
_MAX_SPIN_STEPS = 6000  # until engines, propellers and surfaces have settled
_MAX_CRANK_STEPS = 2000  # until piston engines run
_RESTLESS = 1e-3  # relative change in the last step
_WARM_UP_STEPS = 400  # with the starter off
INTEGRATOR_STEPS = 6  # one more than JSBSim's integrators use
NO_TIME = 1e-12  # s
_ATTACHED = math.cos(-0.5), math.sin(-0.5)  # of an angle of attack below any stall
POUND = 4.4482216152605  # N, of force
_SLUG_FOOT2 = POUND * FOOT  # kg m²; a slug is a pound-force per foot/s²
_RANKINE = 1.8  # degrees Rankine per kelvin
_SHORT_STEP = 1e-5  # s, for the acceleration of the propeller


@dataclass(frozen=True, slots=True)
class Traits:
    """Features of an aircraft that JSBSim has no properties for."""

    probe_speed: float  # m/s, at which an aircraft is examined
    has_engine: bool  # if not, it is a glider
    has_rudder: bool  # the rudder command has an effect
    has_lag: bool  # surfaces lag behind their commands when placed
    lags_by_step: bool  # surfaces move by the time flown: not in a step of no time
    unlikely_inertia: str = ""  # why the tensor is inexact


@dataclass(frozen=True, slots=True)
class Placing:
    """What determines the state after an initial condition of JSBSim."""

    angles: Vector  # roll, pitch and yaw of which JSBSim makes the attitude, rad
    recent: tuple[dict[str, float], ...]  # watched properties before it, the newest first
    after: dict[str, float]  # and after it
    terrain: float  # elevation, ft

    @property
    def before(self) -> dict[str, float]:
        """Watched properties just before it."""
        return self.recent[0]


class JsbsimModel:
    """A JSBSim executive with an aircraft loaded.

    Attributes:
        placing: the last initial condition; None before it, or if nothing is watched.
    """

    def __init__(
        self,
        fdm: Any,  # noqa: ANN401 - untyped
        rate_hz: int,
        traits: Traits,
        integrators: Integrators = INTEGRATORS,
    ) -> None:
        """Set the environment and bind the properties; `fdm` is JSBSim's FGFDMExec, without output.

        Raises:
            AircraftError: the aircraft lacks a required property.
        """
        self.fdm = fdm
        set_environment(fdm, integrators)
        self._manager = fdm.get_property_manager()
        self.power = Powerplant(fdm.get_model_name(), self.find)
        self.has_rudder, self.has_lag = traits.has_rudder, traits.has_lag
        self.probe_speed, self.has_engine = traits.probe_speed, self.power.has_engine
        self.has_propeller, self.throttle_lags = self.power.has_propeller, self.power.throttle_lags
        self.lags_by_step = traits.lags_by_step
        self._dt = 1.0 / rate_hz
        self.fdm.set_dt(self._dt)
        surfaces = (self.node(f"fcs/{name}-cmd-norm") for name in SURFACES[:3])
        self.controls: tuple[Callable[[float], None], ...] = (
            *(node.set_double_value for node in surfaces),
            self.power.set_throttle,
        )
        hysteresis = self.find("aero/stall-hyst-norm")
        self._is_stalled = hysteresis.get_double_value if hysteresis else lambda: 0.0
        self._moments = [self.node(f"moments/{axis}-aero-lbsft").get_double_value for axis in "lmn"]
        self._hold = self.node("forces/hold-down").set_double_value
        self.winds = tuple(
            self.node(f"atmosphere/wind-{axis}-fps") for axis in ("north", "east", "down")
        )
        turns = [self.find(f"air/{name}") for name in _TURNS]
        # all or none
        self.turns = tuple(turns) if all(turns) else ()
        self._velocities = [
            self.node(f"velocities/v-{axis}-fps").get_double_value
            for axis in ("north", "east", "down")
        ]
        self._attitude = [
            self.node(f"ic/{name}-rad").set_double_value for name in ("phi", "theta", "psi-true")
        ]
        self._angles = [self.node(f"ic/{name}-rad").get_double_value for name in ("phi", "theta")]
        self.placing: Placing | None = None
        self._restless = False  # the engines did not settle
        self._terrain = 0.0  # ft
        self._watched: dict[str, Callable[[], float]] = {}
        self._recent: deque[dict[str, float]] = deque(maxlen=0)
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

    def node(self, name: str) -> Any:  # noqa: ANN401
        """Return the node of a property.

        Raises:
            AircraftError: there is no such property.
        """
        node = self._manager.get_node(name)
        if node is None:
            raise AircraftError(f"{self.fdm.get_model_name()}: JSBSim has no property {name}")
        return node

    def find(self, name: str) -> Any:  # noqa: ANN401
        """Return the node of a property; None if the aircraft does not have it."""
        return self._manager.get_node(name)

    def watch(self, names: Iterable[str], frames: int = 0) -> None:
        """Keep the values of properties, of those that there are, before and after placements.

        Args:
            names: of the properties.
            frames: keep also the values of this many frames before, if a placement has them.
        """
        self._recent = deque(maxlen=frames)
        nodes = {name: self.find(name) for name in names}
        self._watched = {name: node.get_double_value for name, node in nodes.items() if node}

    def _look(self) -> dict[str, float]:
        return {name: get() for name, get in self._watched.items()}

    def warm(self, temperature_offset: float) -> None:
        """Make the air warmer than the standard atmosphere, at all heights, by an offset, K.

        The pressure at sea level stays the standard one.
        """
        if temperature_offset:
            self.node("atmosphere/delta-T").set_double_value(temperature_offset * _RANKINE)

    def deflections(self) -> Array:
        """Return the magnitudes of the deflections (5,), rad, in the order of SURFACES.

        0 for surfaces without a position property.
        """
        nodes = [self.find(f"fcs/{name}-pos-rad") for name in _DEFLECTED]
        return np.array([abs(node.get_double_value()) if node else 0.0 for node in nodes])

    def locate(self, position_ned: Vector, origin: NedOrigin) -> None:
        """Set the position of the aircraft, from the next placement on."""
        latitude, longitude, height = geodetic_from_ned(np.array(position_ned), origin).tolist()
        self._terrain = origin.elevation_m / FOOT
        self.node("ic/terrain-elevation-ft").set_double_value(self._terrain)
        self.node("ic/long-gc-deg").set_double_value(longitude)
        self.node("ic/lat-geod-deg").set_double_value(latitude)
        above_sea, geodetic = self.node("ic/h-sl-ft"), self.node("ic/geod-alt-ft")
        above_sea.set_double_value(height / FOOT)
        # JSBSim takes height along the radius; correct it to height above the ellipsoid.
        wrong = geodetic.get_double_value() - height / FOOT
        above_sea.set_double_value(height / FOOT - wrong)

    def displace(self, shift_ned: Sequence[float], origin: NedOrigin) -> None:
        """Move the aircraft in flight by some metres, without a change of its velocity."""
        (north, east, down), frame = shift_ned, local_frame(origin, RADIANS)
        for name, change in (
            ("lat-gc-rad", north / frame.metres_per_latitude),
            ("long-gc-rad", east / frame.metres_per_longitude),
            ("h-sl-ft", -down / FOOT),
        ):
            node = self.node(f"position/{name}")
            node.set_double_value(node.get_double_value() + change)

    def place(
        self,
        placement: Placement,
        controls: Controls,
        *,
        course: float = 0.0,
        wind_ned: Vector = STILL,
        spin: bool,
    ) -> None:
        """Place the aircraft in flight.

        A motor of constant power has a very large torque on a propeller at rest, and the propeller
        speed cannot be set. With `spin` the aircraft is first held in place in a wind of its
        airspeed, without torque on the airframe, until propeller and lagging surfaces have settled;
        then it is placed again.

        Args:
            placement: velocity, rates and attitude.
            controls: commands.
            course: rad, through the air.
            wind_ned: m/s, velocity of the air.
            spin: let propeller and surfaces settle first.
        """
        self._command(controls)
        if self._is_stalled():  # by an earlier placement: between the limits it would stay so
            speed = math.hypot(*placement.velocity_body)
            level = replace(
                placement, velocity_body=(speed * _ATTACHED[0], 0.0, speed * _ATTACHED[1])
            )
            self._initialise(level, course, STILL)
        if spin:
            if not self.power.runs:
                self._start(placement, course)
            self._spin(placement, course)
            if not self.power.runs:  # an engine has stopped, as at a throttle that it cannot bear
                self._start(placement, course)
                self._spin(placement, course)
        spools = self.power.spools()
        self._initialise(placement, course, wind_ned)
        # the initial condition leaves rounding errors in the wind
        for wind, value in zip(self.winds, wind_ned, strict=True):
            wind.set_double_value(value / FOOT)
        if any(wind_ned) or spools:
            # The initial condition had no wind. Integrate over next to no time until accelerations
            # with the wind fill the memory of JSBSim's integrators; suspended runs do not.
            with self._step(NO_TIME):
                for _ in range(INTEGRATOR_STEPS):
                    self.fdm.run()
                    self.power.set_spools(spools)

    def _start(self, placement: Placement, course: float) -> None:
        """Start the engines: pistons with their starters, at rest, in steps of time.

        JSBSim can set engines running at once, but stops light propellers of variable pitch by it.
        Pistons are set running so only where the starter is too weak.
        """
        if self.power.has_pistons:
            still = replace(placement, velocity_body=STILL, rates_body=STILL)
            self._initialise(still, course, STILL)
            self._hold(1.0)
            with self._step(1.0 / _SETTLING_HZ):
                self.power.crank(starter=True)
                for _ in range(_MAX_CRANK_STEPS):
                    self.fdm.run()
                    if self.power.pistons_run:
                        break
                self.power.crank(starter=False)
                for _ in range(_WARM_UP_STEPS):
                    self.fdm.run()
            self._hold(0.0)
        self._initialise(placement, course, STILL)
        if not self.power.runs:
            self.power.set_running()

    def _spin(self, placement: Placement, course: float) -> None:
        """Hold the aircraft in a wind of its airspeed until propellers and surfaces settle."""
        self._initialise(placement, course, STILL)
        self.power.remove_torque(removed=True)
        self._hold(1.0)
        for wind, velocity in zip(self.winds, self._velocities, strict=True):
            wind.set_double_value(-velocity())
        with self._step(1.0 / _SETTLING_HZ):
            self._settle()
        self._hold(0.0)
        self.power.remove_torque(removed=False)

    def _settle(self) -> None:
        # a first step never counts as rest
        values = before = [math.nan] * len(self.power.settling_values())
        self._restless = False
        moments = [math.inf] * 3
        for _ in range(_MAX_SPIN_STEPS):
            self.fdm.run()
            if self._recent.maxlen:
                self._recent.append(self._look())
            before, values = values, self.power.settling_values()
            settled = at_rest(before, values)
            if settled and not self.has_lag:
                return
            moments_before, moments = moments, [get() for get in self._moments]
            if settled and np.allclose(moments, moments_before, rtol=1e-9, atol=1e-12):
                return
        self._restless = not at_rest(before, values, _RESTLESS)

    def fly(self, *, burn: bool = False) -> None:
        """Set the clock to zero after placing; engines then burn fuel, or not."""
        self.fdm.set_sim_time(0.0)
        self.power.freeze_fuel(frozen=not burn)

    def check_engines(self) -> None:
        """Check that the engines run, and turn their propellers at a speed that does not change.

        Raises:
            TrimError: one does not.
        """
        if self._restless:
            raise TrimError(
                "the engines do not settle: their speed changes by more than 0.1 % in each step "
                f"of 1/{_SETTLING_HZ} s (is the propeller's <ixx> right?)"
            )
        if self.power.stands_still:
            raise TrimError("a propeller stands still: JSBSim cannot start its engine")
        if not self.power.runs:
            raise TrimError("an engine stops at the throttle of the trim (write another airspeed)")

    def accelerations(self, placement: Placement, controls: Controls, *, spin: bool) -> Array:
        """Return u̇, v̇, ẇ (m/s²), ṗ, q̇, ṙ (rad/s²) of a placement; see `place`."""
        self.place(placement, controls, spin=spin)
        return self._read_accelerations()

    def accelerations_after_no_time(self, controls: Controls) -> Array:
        """Return `accelerations` at the end of a step of no time with these commands."""
        self._command(controls)
        with self._step(NO_TIME):
            self.fdm.run()
        return self._read_accelerations()

    def _read_accelerations(self) -> Array:
        values = np.array([get() for get in self._accelerations])
        values[:3] *= FOOT
        return values

    def inertia(self) -> Array:
        """Return the inertia tensor (3, 3) about the centre of gravity, kg m²."""
        xx, yy, zz, xy, xz, yz = (
            self.node(f"inertia/i{axes}-slugs_ft2").get_double_value() * _SLUG_FOOT2
            for axes in ("xx", "yy", "zz", "xy", "xz", "yz")
        )
        # JSBSim's ixz is the element itself; its ixy and iyz are the negative elements.
        return np.array([[xx, -xy, xz], [-xy, yy, -yz], [xz, -yz, zz]])

    def propeller_acceleration(self) -> float:
        """Return the rate of change of the propeller's speed, revolutions per s²."""
        before = self.power.propeller_rpm
        with self._step(_SHORT_STEP):
            self.fdm.run()
        after = self.power.propeller_rpm
        return float(after - before) / 60.0 / _SHORT_STEP

    @contextmanager
    def _step(self, dt: float) -> Iterator[None]:
        """Run with another step, s."""
        self.fdm.set_dt(dt)
        yield
        self.fdm.set_dt(self._dt)

    @property
    def propeller_rps(self) -> float:
        """Revolutions per second of the first propeller; NaN without one."""
        return self.power.propeller_rpm / 60.0

    def _command(self, controls: Controls) -> None:
        values = (controls.aileron, -controls.elevator, -controls.rudder, controls.throttle)
        for control, value in zip(self.controls, values, strict=True):
            control(value)

    def _initialise(self, placement: Placement, course: float, wind_ned: Vector) -> None:
        angles = (placement.roll, placement.pitch, course - placement.course)
        recent = tuple(reversed(self._recent)) or (self._look(),)
        *set_others, set_yaw = self._attitude
        for set_value, value in zip(set_others, angles, strict=False):
            set_value(value)
        roll, pitch = (get() for get in self._angles)  # changed by rounding
        set_yaw(angles[2])
        velocity = placement.velocity_body
        if any(wind_ned):
            to_body = rotation_ned_body(np.array(angles)).T
            velocity = tuple((np.array(velocity) + to_body @ np.array(wind_ned)).tolist())
        for set_value, value in zip(self._speeds, velocity, strict=True):
            set_value(value / FOOT)
        for set_value, value in zip(self._rates, placement.rates_body, strict=True):
            set_value(value)
        self.fdm.run_ic()
        if self._watched:
            self.placing = Placing((roll, pitch, angles[2]), recent, self._look(), self._terrain)
            self._recent.clear()
