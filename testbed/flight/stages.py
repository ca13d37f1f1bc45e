"""The stages of a tick: compiled calls in order, and the Python between them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import NamedTuple

from testbed.core.call_list import Call, PythonStep, Step
from testbed.core.errors import InputError
from testbed.core.records import Records
from testbed.flight.schedule import TickActions


class Part(StrEnum):
    """Part of a tick; all aircraft finish one before any begins the next."""

    SENSE = "sense"
    CONTROL = "control"
    ACTUATE = "actuate"
    OBSERVE = "observe"
    MOVE = "move"


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
    then: PythonStep | None = None
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
    part: Part,
    rate: StageRate,
    name: str,
    steps: Sequence[Step],
    group: int | None = None,
) -> Iterator[Stage]:
    """Yield a stage for each step, compiled or Python's or both."""
    for step in steps:
        if isinstance(step, tuple):
            yield Stage(part, rate, name, *step, group=group)
        elif isinstance(step, Call):
            yield Stage(part, rate, name, call=step, group=group)
        else:
            yield Stage(part, rate, name, then=step, group=group)
