"""The followers' control: groups that step together, each with its law and its middle loop."""

from __future__ import annotations

import inspect
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from operator import is_
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from testbed.errors import InputError
from testbed.formation.flags import Guard, Saturation
from testbed.formation.law import Diagnosis, Law, Team
from testbed.formation.measurement import AGES
from testbed.formation.middle_loop import MiddleLoop
from testbed.formation.paper_law import PaperLaw
from testbed.formation.together import READY, begun, put, silent
from testbed.frames import course, flight_path_angle
from testbed.sim.vehicles import choose
from testbed.state import (
    Array,
    Counts,
    Event,
    FbwaCommand,
    Inbox,
    Truths,
    UnicycleCommand,
    VehicleState,
)
from testbed.steady import Steady

if TYPE_CHECKING:
    from testbed.sim.roster import Roster

OUTSIDE, CLIPPED = int(Guard.OUTSIDE_SPEED_SET), int(Guard.SPEED_COMMAND_CLIPPED)
SILENT = int(Guard.LEADER_SILENT)


@dataclass(frozen=True)
class Group:
    """Followers that step at the same moments."""

    rows: NDArray[np.intp]  # (m,) among the n followers
    team: Team
    law: Law
    middle: MiddleLoop
    ideal: Truths  # (m,) an ideal vehicle, which flies the law's answer without middle loop
    trusted: bool  # False: the law is the user's own, and what it says is looked at

    @cached_property
    def unheeded(self) -> Truths:
        """(m, N) whose messages the law does not use: it has no gains for them.

        The leader's are always used. What a law of the user's own uses is not known.
        """
        if not self.trusted:
            return np.zeros(self.team.gains.shape[:2], dtype=bool)
        unused: Truths = (self.team.gains == 0.0).all(axis=2)
        unused[:, 0] = False
        return unused

    @cached_property
    def patience(self) -> Array:
        """(N,) s since news of each aircraft arrived, after which the law does not use it.

        A neighbour that the law holds at its place is reckoned with however old its news is.
        """
        holds = isinstance(self.law, PaperLaw) and self.law.hold
        limit = np.full(self.team.gains.shape[1], np.inf if holds else self.team.stale_after)
        limit[0] = self.team.silent_after
        return limit

    @cached_property
    def some_ideal(self) -> bool:
        """Whether there are ideal vehicles among them."""
        return bool(self.ideal.any())


class Control:
    """What the n followers were last told by their own controllers.

    Every step writes into the same arrays.
    """

    def __init__(self, groups: tuple[Group, ...], offsets: Array, roster: Roster | None) -> None:
        """Nobody has stepped yet.

        Args:
            groups: all followers, each in one.
            offsets: υ (N, 3) m of the followers' places, the leader's zero first.
            roster: what they make of it that somebody fails; None: nothing.
        """
        self.groups, self.offsets, self._roster = groups, offsets, roster
        aircraft = len(offsets)
        self.alone: Truths = np.zeros(aircraft - 1, dtype=bool)  # (n,) who has left the formation
        self.places: Counts = np.arange(1, aircraft, dtype=np.uint32)  # (n,) whose place each has
        self._memory: list[Any] = [None] * len(groups)
        # of each group what its step is bound to, and that step
        self._given: list[tuple[Any, ...]] = [(None,) * 4] * len(groups)
        self._ready: list[Any] = [None] * len(groups)
        self._heard = Steady()
        sticks = np.zeros((3, aircraft))
        self.told = FbwaCommand(*sticks)  # (N,) the leader's is for others to write
        self._said = silent(sticks[:, 1:], aircraft)
        self.command, self.unicycle, self.diagnosis, self.age_s = self._said

    def learn(self, number: int, now: float, inbox: Inbox, measured_s: Array) -> list[Event]:
        """What the followers of a group have learnt of who has failed; they act on it from now on.

        Args:
            number: of the group.
            now: s.
            inbox: (n, N)
            measured_s: (n, N) s, as in `step`.
        """
        if self._roster is None:
            return []
        learnt = list(self._roster.changes(now, self.groups[number].rows, inbox, measured_s))
        if learnt:
            self.groups = tuple(map(self._roster.regrouped, self.groups))
            self.offsets = self._roster.offsets
            self.places = self._roster.places.astype(np.uint32)
            self.alone = self._roster.alone
        return learnt

    def step(
        self, number: int, now: float, own: VehicleState, inbox: Inbox, measured_s: Array
    ) -> NDArray[np.intp]:
        """Step one group at the time `now` (s) from all followers' estimates and inboxes (n).

        Args:
            number: of the group.
            now: s.
            own: (n)
            inbox: (n, N)
            measured_s: (n, N) s, when its content was true, which the followers do not know.

        Returns:
            Who stepped (m,).
        """
        group, said = self.groups[number], self._said
        rows, law = group.rows, group.law
        if self._roster is not None:
            inbox = self._heard(self._roster.heard(inbox))
        if group.trusted and isinstance(law, PaperLaw):
            given = group, own, inbox, measured_s
            if not all(map(is_, given, self._given[number])):
                if self._memory[number] is None:
                    self._memory[number] = begun(law, group.middle, choose(own, rows))
                memory, heed = self._memory[number], (group.unheeded, group.patience)
                self._ready[number] = READY(
                    law, group.middle, *heed, rows, *given[1:], memory, said
                )
                self._given[number] = given
            self._ready[number](now)
        else:
            self._own_law(number, group, now, choose(own, rows), choose(inbox, rows))
            received_s, measured_s = inbox.received_s[rows], measured_s[rows]
            said.age_s[rows] = AGES(
                now, measured_s, received_s, group.unheeded, group.patience, group.trusted
            )
            deaf = rows[np.isnan(said.age_s[rows, 0])]
            if not group.trusted:
                said.diagnosis.guards[deaf] |= SILENT
        if group.some_ideal:
            parts = (choose(each, rows) for each in (own, said.unicycle, said.diagnosis))
            flown, diagnosis = without_middle_loop(group.ideal, *parts)
            put(said.unicycle, rows, flown)
            put(said.diagnosis, rows, diagnosis)
        return rows

    def _own_law(
        self, number: int, group: Group, now: float, own: VehicleState, inbox: Inbox
    ) -> None:
        """Step a group of m by whatever law; what it is given is its own to keep."""
        law_memory, middle_memory = self._memory[number] or (
            group.law.start(own),
            group.middle.start(),
        )
        if group.trusted:
            told, law_memory = group.law.step(now, own, inbox, law_memory)
        else:
            with blamed(file_of(group.law)):
                told, law_memory = group.law.step(now, own, inbox, law_memory)
            told = checked(told, group.team, now)
        if isinstance(told, UnicycleCommand):
            unicycle = told
            command, middle_memory, diagnosis = group.middle.step(own, told, middle_memory)
        else:
            command, unicycle, diagnosis = direct(told, own, group.team)
        self._memory[number] = law_memory, middle_memory
        for whole, part in zip(self._said, (command, unicycle, diagnosis), strict=False):
            put(whole, group.rows, part)


def without_middle_loop(
    ideal: Truths, own: VehicleState, told: UnicycleCommand, diagnosis: Diagnosis
) -> tuple[UnicycleCommand, Diagnosis]:
    """What ideal vehicles (m,) fly, and nothing said of a middle loop that they have not.

    They fly u as it is; but outside the speed set, where (14) divides by a slope of h that all but
    vanishes, the guard on the commanded airspeed stands for them too.
    """
    outside = ideal & ((told.guards & OUTSIDE) != 0)
    speed = np.linalg.norm(own.velocity_ned, axis=1)
    guarded = np.where(outside, diagnosis.speed_command - own.airspeed + speed, told.speed)
    unclipped = diagnosis.guards & np.uint8(0xFF ^ CLIPPED)
    clipped = np.where(ideal & ~outside, unclipped, diagnosis.guards)
    return told._replace(speed=guarded), diagnosis._replace(
        speed_command=np.where(ideal, guarded + own.airspeed - speed, diagnosis.speed_command),
        guards=clipped.astype(np.uint8),
        saturations=np.where(ideal, 0, diagnosis.saturations).astype(np.uint8),
    )


def direct(
    told: FbwaCommand, own: VehicleState, team: Team
) -> tuple[FbwaCommand, UnicycleCommand, Diagnosis]:
    """A law's fly-by-wire-A command within its limits; what it was after it did not say."""
    pitch = np.clip(told.pitch, -team.pitch_limit, team.pitch_limit)
    roll = np.clip(told.roll, -team.roll_limit, team.roll_limit)
    throttle = np.clip(told.throttle, 0.0, 1.0)
    saturations = (
        (pitch != told.pitch) * int(Saturation.PITCH)
        + (roll != told.roll) * int(Saturation.ROLL)
        + (throttle != told.throttle) * int(Saturation.THROTTLE)
    ).astype(np.uint8)
    n = len(pitch)
    unknown, none = np.full(n, np.nan), np.zeros(n, dtype=np.uint8)
    motion = own.velocity_ned / np.linalg.norm(own.velocity_ned, axis=1, keepdims=True)
    return (
        FbwaCommand(pitch, roll, throttle),
        UnicycleCommand(unknown, np.full((n, 3), np.nan), unknown, motion, none),
        Diagnosis(unknown, unknown, course(motion), flight_path_angle(motion), none, saturations),
    )


@contextmanager
def blamed(file: str) -> Iterator[None]:
    """Whatever the code of a law's file raises inside is told with its line.

    Raises:
        InputError: for every exception.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == file]
        place = f"{file}:{lines[-1]}" if lines else file
        raise InputError(f"{place}: the law raised {type(error).__name__}: {error}") from error


def file_of(law: object) -> str:
    """The file that a law's class is written in."""
    return inspect.getfile(type(law))


def checked(told: object, team: Team, now: float) -> UnicycleCommand | FbwaCommand:
    """What a user's law answered, if it is an answer.

    Raises:
        InputError: naming what is wrong, whose it is and when.
    """
    n = len(team.names)
    if not isinstance(told, UnicycleCommand | FbwaCommand):
        raise InputError(
            f"controller.law: the law answered with {type(told).__name__} at {now:g} s (return a "
            "UnicycleCommand or an FbwaCommand, and the memory)"
        )
    fields = []
    for name, value in zip(told._fields, told, strict=True):
        shape = (n, 3) if name in ("turn", "direction") else (n,)
        kind = np.uint8 if name == "guards" else np.float64
        try:
            array = np.ascontiguousarray(np.broadcast_to(np.asarray(value, dtype=kind), shape))
        except (TypeError, ValueError, OverflowError):
            array = None
        if array is None:
            raise InputError(
                f"controller.law: the law's {name} is not an array of shape {shape} at {now:g} s "
                f"(one row for each of {', '.join(team.names)})"
            )
        wrong = np.flatnonzero(~np.isfinite(array).reshape(n, -1).all(axis=1))
        if len(wrong):
            raise InputError(
                f"controller.law: the law's {name} for {team.names[wrong[0]]} is not a finite "
                f"number at {now:g} s"
            )
        fields.append(array)
    return type(told)(*fields)
