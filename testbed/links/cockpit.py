"""What a ground station may do with an aircraft; the simulation implements it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple, Protocol


class Mode(IntEnum):
    """Flight modes, by ArduPlane's numbers."""

    FBWA = 5  # whoever holds the sticks: the formation's controller, or a program outside
    AUTO = 10  # its mission
    LOITER = 12  # a circle about where it was
    GUIDED = 15  # a place or an attitude it is told


class Item(NamedTuple):
    """An item of a mission, as MISSION_ITEM_INT has it, in degrees and m."""

    command: int  # MAV_CMD
    frame: int  # MAV_FRAME
    parameters: tuple[float, float, float, float]
    x: float  # latitude deg, where the command has a place
    y: float  # longitude deg
    z: float  # m, altitude as the frame says
    autocontinue: bool = True


class Target(NamedTuple):
    """Where guidance takes an aircraft: the waypoint it flies to, or the centre of its circle.

    Signs and what a circle has instead of a track are ArduPlane's.
    """

    north: float  # m from the origin
    east: float  # m
    altitude: float  # m above the origin
    airspeed: float  # true, m/s
    course: float  # of the track, rad; of a circle, towards its centre
    crosstrack: float  # m left of the track; of a circle, outside it


class Refusal(NamedTuple):
    """Why something was not done."""

    text: str
    supported: bool = True  # False: nothing of this kind ever is
    item: int | None = None  # of a mission, that is to blame


class Cockpit(Protocol):
    """One aircraft. What is asked is done at once, before the next tick; None says it was."""

    @property
    def name(self) -> str:
        """Of the aircraft."""

    @property
    def mode(self) -> Mode:
        """Now; of one that nobody can command, what it does."""

    @property
    def armed(self) -> bool:
        """Whether the motor may turn."""

    @property
    def failsafe(self) -> bool:
        """Whether it circles because commands have stopped."""

    @property
    def external(self) -> bool:
        """Whether the page has it commanded by a program outside."""

    @property
    def lockstep(self) -> bool:
        """Whether the run waits for its commands: then it must hear of every frame."""

    @property
    def parameters(self) -> Mapping[str, float]:
        """ArduPlane's names and values, in a fixed order; empty without an autopilot of ours."""

    @property
    def mission(self) -> Sequence[Item]:
        """What AUTO flies; item 0 is home. Empty: none."""

    @property
    def item(self) -> int:
        """Of the mission that AUTO is flying or will go on with."""

    @property
    def target(self) -> Target | None:
        """Where its guidance takes it now; None: it follows no place."""

    def change_mode(self, mode: Mode) -> Refusal | None:
        """Fly in this mode from now on."""

    def arm(self, armed: bool, *, force: bool) -> Refusal | None:
        """Let the motor turn, or stop it."""

    def change_parameter(self, name: str, value: float) -> Refusal | None:
        """Fly with this parameter from now on."""

    def change_mission(self, items: Sequence[Item]) -> Refusal | None:
        """Replace the mission; item 0 is home and is not flown. Nothing but home: none is left."""

    def go_on_at(self, item: int) -> Refusal | None:
        """Fly this item of the mission next."""

    def fly_to(
        self,
        latitude_deg: float,
        longitude_deg: float,
        altitude: float | None,
        radius: float | None,
    ) -> Refusal | None:
        """In GUIDED, circle a place: altitude m above the origin, radius m; None: as it has them.

        A negative radius circles anticlockwise.
        """

    def change_airspeed(self, airspeed: float) -> Refusal | None:
        """Fly AUTO, LOITER and GUIDED at this true airspeed, m/s."""

    def sticks(
        self,
        roll: float,
        pitch: float,
        throttle: float,
        *,
        attitude: bool = False,
        answers_s: float | None = None,
    ) -> Refusal | None:
        """A fly-by-wire-A command, rad, rad, 0..1, that holds until the next or the failsafe.

        Args:
            roll: right wing down, rad.
            pitch: nose up, rad.
            throttle: 0..1.
            attitude: it came as an attitude target, which GUIDED takes too; else from sticks.
            answers_s: time of the state that it answers, s, where it says so; in lockstep one
                that answers an older state is left aside.
        """
