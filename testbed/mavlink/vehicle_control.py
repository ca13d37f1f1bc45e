"""The commands that a MAVLink vehicle passes to its aircraft; the simulation implements them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple

from testbed.core.records import FbwaCommand


class FlightMode(IntEnum):
    """Flight modes, by ArduPlane's numbers."""

    FBWA = 5  # flies the formation's commands, or those of an external program
    AUTO = 10  # flies its mission
    LOITER = 12  # circles the point where the mode was entered
    GUIDED = 15  # circles a commanded point, or flies a commanded attitude


class MissionItem(NamedTuple):
    """An item of a mission, with the fields of MISSION_ITEM_INT in degrees and m."""

    command: int  # MAV_CMD
    frame: int  # MAV_FRAME
    parameters: tuple[float, float, float, float]
    x: float  # latitude, deg, where the command has a position
    y: float  # longitude, deg
    z: float  # altitude, m, in the frame
    autocontinue: bool = True


class NavigationTarget(NamedTuple):
    """The waypoint that guidance flies to, or the centre of the circle that it flies.

    Signs, and the values of a circle, follow ArduPlane's NAV_CONTROLLER_OUTPUT.
    """

    north: float  # m from the origin
    east: float  # m
    altitude: float  # m above the origin
    airspeed: float  # true, m/s
    course: float  # of the track, rad; of a circle, towards its centre
    crosstrack: float  # m left of the track; of a circle, outside it


class Rejection(NamedTuple):
    """The reason why a command was not executed."""

    text: str
    supported: bool = True  # False: the aircraft never executes this kind of command
    item: int | None = None  # the mission item at fault


class VehicleControl:
    """Reject every command to one aircraft; subclasses override what they execute.

    A command takes effect before the next tick; its method returns None, or a `Rejection`.

    Attributes:
        name: of the aircraft.
        mode: current flight mode; of an aircraft that takes no commands, what it does.
        armed: whether the motor may turn.
        failsafe: whether it circles because commands have stopped.
        external: whether the scenario has an external program command it.
        lockstep: whether the run waits for its commands, so that every sample must be sent.
        companion: whether the run has started a companion computer that reads its state.
        local_origin_ned: from which LOCAL_POSITION_NED counts, m from the scenario's origin.
        parameters: by ArduPlane's names, in a fixed order; empty without a virtual autopilot.
        mission: the items that AUTO flies, home as item 0; empty: none.
        current_item: the mission item that AUTO flies or resumes with.
        target: where guidance flies to; None: no guidance is active.
    """

    mode: FlightMode
    armed = True
    failsafe = False
    external = False
    lockstep = False
    companion = False
    local_origin_ned: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __init__(self, name: str, mode: FlightMode, reason: str) -> None:
        """Reject all commands for this reason."""
        self.name, self.mode = name, mode
        self._rejection = Rejection(reason)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The aircraft's parameters."""
        return {}

    @property
    def mission(self) -> Sequence[MissionItem]:
        """The mission's items."""
        return ()

    @property
    def current_item(self) -> int:
        """The mission item that AUTO flies or resumes with."""
        return 0

    @property
    def guided(self) -> bool:
        """Whether it flies an attitude target in GUIDED."""
        return False

    @property
    def target(self) -> NavigationTarget | None:
        """The waypoint or circle that guidance flies to."""
        return None

    def set_mode(self, mode: FlightMode) -> Rejection | None:
        """Change the flight mode."""
        return None if mode is self.mode else self._rejection

    def set_armed(self, armed: bool, *, force: bool) -> Rejection | None:
        """Arm or disarm the motor; `force` disarms in flight."""
        return None if armed is self.armed else self._rejection

    def set_parameter(self, name: str, value: float) -> Rejection | None:
        """Set a parameter."""
        return Rejection(f"{name}: this aircraft has no parameters", supported=False)

    def set_mission(self, items: Sequence[MissionItem]) -> Rejection | None:
        """Replace the mission. Item 0 is home and is not flown; home alone clears the mission."""
        return self._rejection

    def set_current_item(self, item: int) -> Rejection | None:
        """Fly this item of the mission next."""
        return self._rejection

    def set_loiter_point(
        self,
        latitude_deg: float,
        longitude_deg: float,
        altitude: float | None,
        radius: float | None,
    ) -> Rejection | None:
        """Circle a point, in GUIDED.

        Args:
            latitude_deg: of the centre.
            longitude_deg: of the centre.
            altitude: m above the origin; None: the current one.
            radius: m, negative for anticlockwise; None: WP_LOITER_RAD.
        """
        return self._rejection

    def set_airspeed(self, airspeed: float) -> Rejection | None:
        """Set the true airspeed of AUTO, LOITER and GUIDED, m/s."""
        return self._rejection

    def set_manual_command(
        self, command: FbwaCommand[float], *, attitude: bool = False, answers_s: float | None = None
    ) -> Rejection | None:
        """Set the fly-by-wire-A command, valid until the next one or the failsafe.

        Args:
            command: of one aircraft.
            attitude: it came as an attitude target, which GUIDED takes too; otherwise as sticks.
            answers_s: time of the sample that it answers, s, if known; in lockstep a command that
                answers an older sample is ignored.
        """
        return self._rejection
