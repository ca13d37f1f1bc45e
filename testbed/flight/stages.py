"""The stages of a tick: compiled calls in order, and the Python between them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple, TypeAlias

from testbed.core.call_list import Call, CallList
from testbed.core.errors import InputError
from testbed.core.records import Records
from testbed.flight.schedule import TickActions

Step: TypeAlias = Callable[[float], object]  # of Python, at the time of a tick, s


class Part(StrEnum):
    """Part of a tick; all aircraft finish one before any begins the next."""

    SENSE = "sense"
    CONTROL = "control"
    ACTUATE = "actuate"
    OBSERVE = "observe"


class StageRate(StrEnum):
    """Ticks at which a stage is due."""

    TICK = "every tick"
    AUTOPILOT = "autopilot"
    BETWEEN = "ticks between those of the autopilots"
    BROADCAST = "broadcast"
    CONTROL = "control"
    GUIDANCE = "leader's control"
    LOG = "log"


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage of a flight.

    Attributes:
        part: of the tick.
        rate: when it is due.
        name: what it does.
        call: compiled; None: it is Python.
        then: Python; after a call only where that returns something but 0.
        group: of followers, at whose control it is due; None: at that of any.
    """

    part: Part
    rate: StageRate
    name: str
    call: Call | None = None
    then: Step | None = None
    group: int | None = None

    def is_due(self, due: TickActions) -> bool:
        """Return whether it is due at a tick with these actions."""
        match self.rate:
            case StageRate.TICK:
                return True
            case StageRate.AUTOPILOT:
                return due.autopilot
            case StageRate.BETWEEN:
                return not due.autopilot
            case StageRate.BROADCAST:
                return due.broadcast is not None
            case StageRate.GUIDANCE:
                return due.guidance
            case StageRate.LOG:
                return due.log
        if self.group is None:
            return bool(due.control) or due.guidance
        return self.group in due.control

    @property
    def runs(self) -> str:
        """What runs it."""
        if self.call is None:
            return "Python"
        return "compiled" if self.then is None else "compiled, then Python if due"


class FlightRecords(NamedTuple):
    """The records of a flight, which its stages read and write in place.

    Attributes:
        aircraft: (N,) of AIRCRAFT, the leader first.
        followers: (n,) of FOLLOWER.
        links: (n, N) of LINK.
    """

    aircraft: Records
    followers: Records
    links: Records


class UserStage(NamedTuple):
    """A stage of your own, in Python.

    It runs whenever the stage does after which it is inserted. An exception ends the flight.

    Attributes:
        name: of the stage.
        after: name of a stage of the flight, as `testbed validate --stages` prints it.
        step: called with the time, s, and the `FlightRecords`.
    """

    name: str
    after: str
    step: Callable[[float, FlightRecords], object]


def check_stages(stages: object) -> tuple[UserStage, ...]:
    """Return the stages of a user's call.

    Raises:
        InputError: they are no list of stages.
    """
    if isinstance(stages, list | tuple) and all(map(_is_stage, stages)):
        return tuple(stages)
    raise InputError(
        "stages: write a list of testbed.UserStage(name, after, step): two texts and a function"
    )


def _is_stage(value: object) -> bool:
    if not isinstance(value, UserStage):
        return False
    return isinstance(value.name, str) and isinstance(value.after, str) and callable(value.step)


def insert_stages(
    stages: Sequence[Stage], inserted: Sequence[UserStage], records: FlightRecords
) -> tuple[Stage, ...]:
    """Return the stages of a flight with those of the user.

    Raises:
        InputError: one is to follow a stage that the flight does not have.
    """
    found = list(stages)
    for user in inserted:
        names = [each.name for each in found]
        if user.after not in names:
            known = ", ".join(dict.fromkeys(names))
            raise InputError(
                f"stages: {user.name}: this flight has no stage {user.after!r} (write one of: "
                f"{known})"
            )
        at = len(names) - 1 - names[::-1].index(user.after)

        def step(now: float, user: UserStage = user) -> None:
            user.step(now, records)

        found.insert(at + 1, replace(found[at], name=user.name, call=None, then=step))
    return tuple(found)


def describe_stages(stages: Sequence[Stage]) -> Iterator[tuple[str, str, str, str]]:
    """Yield part, rate, name and what runs it of each stage; equal neighbours once."""
    rows = ((str(each.part), str(each.rate), each.name, each.runs) for each in stages)
    for row, _ in itertools.groupby(rows):
        yield row


def make_stages(
    part: Part, rate: StageRate, name: str, steps: Sequence[Call | Step], group: int | None = None
) -> Iterator[Stage]:
    """Yield a stage for each step, compiled or Python's."""
    for step in steps:
        if isinstance(step, Call):
            yield Stage(part, rate, name, call=step, group=group)
        else:
            yield Stage(part, rate, name, then=step, group=group)


class Program:
    """The stages that are due at one kind of tick.

    Args:
        stages: in order.
    """

    def __init__(self, stages: Sequence[Stage]) -> None:
        """See the class."""
        self._steps = tuple(each.then for each in stages)
        self._calls = CallList([each.call for each in stages])

    def run(self, now: float) -> None:
        """Run all stages at a time, s."""
        number, count = self._calls.run(0, now), len(self._steps)
        while number < count:
            step = self._steps[number]
            if step is not None:
                step(now)
            number = self._calls.run(number + 1, now)


Kind: TypeAlias = tuple[bool, tuple[int, ...], bool, bool, bool]  # of the actions of a tick


class Programs:
    """The programs of a flight, by kind of tick, for some parts of it.

    Args:
        stages: of the flight.
        parts: of a tick.
    """

    def __init__(self, stages: Sequence[Stage], parts: Sequence[Part]) -> None:
        """See the class."""
        self._stages = tuple(each for each in stages if each.part in parts)
        self._programs: dict[Kind, Program] = {}

    def run(self, due: TickActions, now: float) -> None:
        """Run the stages that are due at a time, s."""
        kind = due.broadcast is not None, due.control, due.guidance, due.autopilot, due.log
        program = self._programs.get(kind)
        if program is None:
            program = Program([each for each in self._stages if each.is_due(due)])
            self._programs[kind] = program
        program.run(now)
