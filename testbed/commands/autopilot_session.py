"""Control one aircraft as an autopilot in FBWA, AUTO, LOITER or GUIDED, with its parameters."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace

import numpy as np

from testbed.autopilot.param_file import ParamError
from testbed.autopilot.parameters import FbwaParams, with_param
from testbed.commands.navigator import Navigator, NavigatorConfig
from testbed.core.geodetic import ned_from_geodetic
from testbed.core.records import Event, FbwaCommand, VehicleState
from testbed.flight.leader_control import MissionController
from testbed.mavlink.mission_plans import (
    MAX_ALTITUDE_M,
    MAX_DISTANCE_M,
    MIN_ALTITUDE_M,
    ItemFlightPlan,
)
from testbed.mavlink.vehicle_control import (
    FlightMode,
    MissionItem,
    NavigationTarget,
    Rejection,
    VehicleControl,
)
from testbed.scenario.aircraft import External

_LOITER_RADIUS = 60.0  # m, ArduPlane's default of WP_LOITER_RAD
MANUAL_ANGLE_LIMIT = math.radians(75.0)  # of a manual command, rad
_TIME_RESOLUTION_S = 5e-4  # time_boot_ms has whole milliseconds

OwnMission = tuple[ItemFlightPlan, tuple[MissionItem, ...], MissionController]


class AutopilotSession(VehicleControl):
    """Control an aircraft with a virtual autopilot by external commands.

    In the scenario's own mode, its own controller flies the aircraft, bit for bit as without a
    session. A command takes effect at the next tick.

    Attributes:
        trim: the command of the level flight at the start.
        lost: whether the aircraft crashed or broke.
        frozen: whether its autopilot is frozen.
        command_counts: executed requests by kind.
    """

    def __init__(
        self,
        name: str,
        config: NavigatorConfig,
        params: FbwaParams,
        apply_params: Callable[[FbwaParams], None],
        *,
        external: External | None,
        mission: OwnMission | None,
        companion: bool = False,
    ) -> None:
        """Start in the scenario's mode: AUTO for a leader with a mission, otherwise FBWA.

        Args:
            name: of the aircraft.
            config: of its navigator.
            params: of its autopilot.
            apply_params: gives its autopilot other parameters.
            external: the scenario's `commanded_by: external`, or None.
            mission: of a leader, its mission in the scenario and its controller.
            companion: the run starts a companion computer, which commands a follower from the first
                sample on: it begins in GUIDED, in trim.
        """
        super().__init__(name, FlightMode.AUTO if mission and not external else FlightMode.FBWA, "")
        self.trim = config.trim
        self._external, self._leads = external or External(), mission is not None
        self.companion = companion
        if companion and external is not None:
            self.mode = FlightMode.GUIDED
        self.external = external is not None
        self.lockstep = external is not None and external.lockstep
        self._origin = config.origin
        self._navigator = Navigator(config, _LOITER_RADIUS)
        self._parameters = ParameterServer(params, apply_params, self._navigator)
        if mission:
            self._navigator.take_over(*mission)
        self.lost = self.frozen = False
        self._manual: FbwaCommand[float] = self.trim  # the latest sticks or attitude target
        self._manual_s: float | None = 0.0  # its time; None: GUIDED circles a point
        self._guided: FbwaCommand[float] = self.trim  # command of the navigator
        self._now = 0.0
        self._sample_s: float | None = None  # of the sample that lockstep waits for an answer to
        self._events: list[Event] = []
        self.command_counts: Counter[str] = Counter()

    @property
    def timeout_s(self) -> float:
        """How long lockstep waits for a command, s of wall-clock time."""
        return self._external.timeout_s

    @property
    def parameters(self) -> Mapping[str, float]:
        """See `VehicleControl`."""
        return self._parameters.values

    @property
    def mission(self) -> Sequence[MissionItem]:
        """See `VehicleControl`."""
        return self._navigator.items

    @property
    def current_item(self) -> int:
        """See `VehicleControl`."""
        return self._navigator.current_item

    @property
    def target(self) -> NavigationTarget | None:
        """See `VehicleControl`."""
        return self._navigator.target

    @property
    def waiting(self) -> bool:
        """Whether lockstep waits for a command."""
        return self._sample_s is not None and self._is_manual and not (self.lost or self.frozen)

    @property
    def command(self) -> FbwaCommand[float] | None:
        """The current command; None: the scenario's own controller commands this follower."""
        if self._is_manual and not self.failsafe:
            command = self._manual
        elif self.mode is FlightMode.FBWA and not self._takes_manual:
            return None if self.armed else self.trim._replace(throttle=0.0)
        else:
            command = self._guided
        return command if self.armed else command._replace(throttle=0.0)

    @property
    def guided(self) -> bool:
        """See `VehicleControl`."""
        return self.mode is FlightMode.GUIDED and self._is_manual and not self.failsafe

    def guide(self, now: float, estimate: VehicleState) -> None:
        """Step the failsafe and the active guidance, once per control period.

        Args:
            now: s
            estimate: of N aircraft.
        """
        self._now = now
        self._navigator.update(estimate)
        self._check_command_timeout()
        if self.mode is FlightMode.AUTO:
            self._guided = self._navigator.fly_mission(estimate)
        elif self.failsafe or not (self._is_manual or self.mode is FlightMode.FBWA):
            self._guided = self._navigator.fly_circle(estimate)

    def expect_command(self, now: float) -> None:
        """Wait, in lockstep, for a command in reply to the sample of this time, s."""
        if self.lockstep:
            self._sample_s = now

    def pop_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def set_mode(self, mode: FlightMode) -> Rejection | None:
        """See `VehicleControl`."""
        if self.lost:
            return Rejection("lost: takes no commands")
        if mode is FlightMode.AUTO and not self._navigator.has_mission:
            return Rejection("AUTO: has no mission; upload one")
        if mode is self.mode:
            return None
        if mode is FlightMode.AUTO:
            self._navigator.resume_mission()
        elif mode is not FlightMode.FBWA:
            self._navigator.circle(self._navigator.position)
        self._manual = self._guided = self.trim
        self._manual_s = None if mode is FlightMode.GUIDED else self._now
        self.mode, self.failsafe, self._sample_s = mode, False, None
        self._report(f"mode {mode.name}", "modes")
        return None

    def set_armed(self, armed: bool, *, force: bool) -> Rejection | None:
        """See `VehicleControl`."""
        if armed == self.armed:
            return None
        if self.lost:
            return Rejection("lost: takes no commands")
        if not armed and not force:
            return Rejection("in flight: disarming must be forced (param2 21196)")
        self.armed = armed
        if armed:
            self._report("armed", "arming")
        else:
            self._report("disarmed: motor off", "arming", level="warning")
        return None

    def set_parameter(self, name: str, value: float) -> Rejection | None:
        """See `VehicleControl`."""
        change = self._parameters.set(name, value)
        if isinstance(change, Rejection):
            return change
        if change:
            self._report(change, "parameters")
        return None

    def set_mission(self, items: Sequence[MissionItem]) -> Rejection | None:
        """See `VehicleControl`."""
        if len(items) <= 1:
            if self.mode is FlightMode.AUTO:
                return Rejection("mission: AUTO is flying it; change the mode first")
            self._navigator.clear_mission()
            self._report("mission cleared", "missions")
            return None
        rejection = self._navigator.set_mission(items, self._parameters.airspeed_limits)
        if rejection is None:
            self._report(f"mission of {len(items) - 1} items", "missions")
            for note in self._navigator.notes:
                self._report(note, level="warning")
        return rejection

    def set_current_item(self, item: int) -> Rejection | None:
        """See `VehicleControl`."""
        rejection = self._navigator.set_current_item(item, self._parameters.airspeed_limits)
        if rejection is not None:
            return rejection
        self._report(f"continues at mission item {self.current_item}", "missions")
        return None

    def set_loiter_point(
        self,
        latitude_deg: float,
        longitude_deg: float,
        altitude: float | None,
        radius: float | None,
    ) -> Rejection | None:
        """See `VehicleControl`."""
        if self.mode is not FlightMode.GUIDED:
            return Rejection(f"mode {self.mode.name}: positions are for GUIDED")
        here = self._navigator.position
        position = np.array([latitude_deg, longitude_deg, 0.0])
        north, east, _ = ned_from_geodetic(position, self._origin).tolist()
        distance = math.hypot(north - here[0], east - here[1])
        height = here[2] if altitude is None else altitude
        if not (distance <= MAX_DISTANCE_M and MIN_ALTITUDE_M <= height <= MAX_ALTITUDE_M):
            return Rejection("write a position within 100 km, 5 m to 20 km up")
        self._navigator.circle((north, east, height), radius)
        self._manual_s, self.failsafe = None, False
        self._report(
            f"flies to {north:.0f} m north, {east:.0f} m east, {height:.0f} m up", "places"
        )
        return None

    def set_airspeed(self, airspeed: float) -> Rejection | None:
        """See `VehicleControl`."""
        if self._is_manual or self.mode is FlightMode.FBWA and not self.failsafe:
            by = "manual commands" if self._is_manual else "the formation's commands"
            return Rejection(f"mode {self.mode.name}: {by} set the throttle, no airspeed is held")
        low, high = self._parameters.airspeed_limits
        if not low <= airspeed <= high:
            return Rejection(f"{airspeed:g} m/s: write {low:g} to {high:g}")
        self._navigator.set_airspeed(airspeed)
        self._report(f"airspeed {airspeed:g} m/s", "airspeeds")
        return None

    def set_manual_command(
        self,
        command: FbwaCommand[float],
        *,
        attitude: bool = False,
        answers_s: float | None = None,
    ) -> Rejection | None:
        """See `VehicleControl`."""
        if self.lost:
            return Rejection("lost: takes no commands")
        if self.mode is FlightMode.FBWA and not self._takes_manual:
            return Rejection("flown by the formation, not commanded_by: external")
        if self.mode is not FlightMode.FBWA and not (self.mode is FlightMode.GUIDED and attitude):
            return Rejection(f"mode {self.mode.name}: manual commands are for FBWA")
        if not all(map(math.isfinite, command)):
            return Rejection("manual command with a value that is not finite")
        if (
            self._sample_s is not None
            and answers_s is not None
            and answers_s < self._sample_s - _TIME_RESOLUTION_S
        ):
            return None
        self._manual = FbwaCommand(
            pitch=min(max(command.pitch, -MANUAL_ANGLE_LIMIT), MANUAL_ANGLE_LIMIT),
            roll=min(max(command.roll, -MANUAL_ANGLE_LIMIT), MANUAL_ANGLE_LIMIT),
            throttle=min(max(command.throttle, 0.0), 1.0),
        )
        self._manual_s, self._sample_s = self._now, None
        self.command_counts["commands"] += 1
        if self.failsafe:
            self.failsafe = False
            self._report("receives commands again")
        return None

    @property
    def _takes_manual(self) -> bool:
        """Whether FBWA takes manual commands: of a leader, and of an external follower."""
        return self.external or self._leads

    @property
    def _is_manual(self) -> bool:
        """Whether manual commands control the aircraft, or would but for the failsafe."""
        if self.mode is FlightMode.FBWA:
            return self._takes_manual
        return self.mode is FlightMode.GUIDED and self._manual_s is not None

    def _check_command_timeout(self) -> None:
        """Enter the failsafe when manual commands have stopped: circle the current position."""
        timeout_s = self._external.failsafe_s
        if self.failsafe or not self._is_manual or self._manual_s is None:
            return
        if self._now - self._manual_s > timeout_s:
            self.failsafe = True
            self._navigator.circle(self._navigator.position)
            text = f"receives no commands for {timeout_s:g} s: circles its position"
            self._report(text, level="warning")

    def _report(self, text: str, kind: str = "", level: str = "info") -> None:
        """Add an event; one with a kind counts as an executed request."""
        self._events.append(Event(self._now, level, self.name, text))
        if kind:
            self.command_counts[kind] += 1


LOITER_RADIUS, ACCEPTANCE_RADIUS = "WP_LOITER_RAD", "WP_RADIUS"


class ParameterServer:
    """Read and set the parameters of an aircraft's autopilot and navigator.

    Attributes:
        params: the autopilot's.
        values: all of them, by name, in a fixed order.
    """

    def __init__(
        self,
        params: FbwaParams,
        apply_params: Callable[[FbwaParams], None],
        navigator: Navigator,
    ) -> None:
        """Serve these; `apply_params` gives the autopilot others."""
        self.params, self._apply, self._navigator = params, apply_params, navigator
        self._bank_limit = navigator.flight_params.bank_limit
        self.values: Mapping[str, float] = {}
        self._update_values()

    @property
    def airspeed_limits(self) -> tuple[float, float]:
        """AIRSPEED_MIN and AIRSPEED_MAX, m/s."""
        return self.params.airspeed_min, self.params.airspeed_max

    def set(self, name: str, value: float) -> str | Rejection:
        """Set a parameter and return the change as text, empty if the value is unchanged."""
        before = self.values.get(name)
        if before is None:
            return Rejection(f"{name}: no such parameter", supported=False)
        if np.float32(value) == np.float32(before):  # MAVLink's resolution
            return ""
        if name in (LOITER_RADIUS, ACCEPTANCE_RADIUS):
            rejection = self._set_radius(name, value)
        else:
            rejection = self._set_autopilot(name, value)
        if rejection:
            return rejection
        self._update_values()
        return f"{name} {value:.6g} (was {before:.6g})"

    def _set_radius(self, name: str, value: float) -> Rejection | None:
        navigator = self._navigator
        size = abs(value) if name == LOITER_RADIUS else value
        if not (size >= 1.0 and math.isfinite(value)):
            return Rejection(f"{name}: write 1 m or more")
        if name == LOITER_RADIUS:
            navigator.set_loiter_radius(value)
        else:
            navigator.set_flight_params(replace(navigator.flight_params, waypoint_radius=value))
        return None

    def _set_autopilot(self, name: str, value: float) -> Rejection | None:
        try:
            self.params = with_param(self.params, name, value)
        except ParamError as error:
            return Rejection(str(error))
        self._apply(self.params)
        navigator = self._navigator
        navigator.set_flight_params(
            replace(
                navigator.flight_params,
                period=self.params.navl1_period,
                damping=self.params.navl1_damping,
                bank_limit=min(self._bank_limit, math.radians(self.params.roll_limit_deg)),
            )
        )
        return None

    def _update_values(self) -> None:
        own = {
            field.name.upper(): getattr(self.params, field.name) for field in fields(self.params)
        }
        self.values = own | {
            LOITER_RADIUS: self._navigator.loiter_radius,
            ACCEPTANCE_RADIUS: self._navigator.flight_params.waypoint_radius,
        }
