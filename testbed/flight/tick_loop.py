"""Run the ticks of a flight from compiled code, up to a stage that asks for Python."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import nan
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from testbed.core.call_list import Call, Words, call_words
from testbed.core.compile import entry, is_interpreted
from testbed.core.records import Array, BoolArray, Indices, Records, allocate
from testbed.flight.schedule import TickActions
from testbed.flight.stages import Part, Stage

BLOCK = 64  # ticks that are run without a look at what may end the flight

# A tick of a block.
TICK = np.dtype(
    [
        ("time_s", "f8"),
        ("tick", "i8"),  # of the base rate
        ("action", "i8"),  # row of ACTION
        ("planned", "i8"),  # row of transmission times; -1: at the tick
    ],
    align=True,
)
# What happens at ticks of one kind.
ACTION = np.dtype(
    [
        ("program", "i8"),  # row of addresses
        ("stages", "i8"),  # how many there are
        ("before_move", "i8"),  # of these before the flight models move
        ("steps", "i8"),  # to the next tick, of the base rate
        ("broadcasts", "?"),  # some aircraft transmit
    ],
    align=True,
)
_MIN_ACTIONS = 8
# Where `run` goes on.
PLACE = np.dtype([("tick", "i8"), ("stage", "i8"), ("ticks", "i8"), ("ending", "?")], align=True)

Row: TypeAlias = tuple[int, TickActions, int, tuple[int, ...] | None]  # of `Clock.schedule`
Kind: TypeAlias = tuple[bool, tuple[int, ...], bool, bool, bool]  # of the actions of a tick


class TickInputs(NamedTuple):
    """What the schedule sets at each tick, and stages read.

    Attributes:
        senders: (N,) aircraft that transmit.
        planned_s: (N,) s, their transmission times; NaN: at the tick.
        steps: (1,) of the base rate to the next tick.
        needed: (N,) aircraft whose motion is read there.
    """

    senders: BoolArray
    planned_s: Array
    steps: Indices
    needed: BoolArray


class TickLoop:
    """The stages of a flight over blocks of ticks.

    Args:
        stages: in order.
        inputs: that each tick writes.
        base_rate_hz: of the ticks.
    """

    def __init__(self, stages: Sequence[Stage], inputs: TickInputs, base_rate_hz: int) -> None:
        """See the class; nothing is compiled or called yet."""
        self._stages, self._inputs, self._rate = tuple(stages), inputs, base_rate_hz
        n = len(inputs.senders)
        self._block = allocate(TICK, BLOCK)
        self._planned_s = np.full((BLOCK, n), np.nan)
        self._count = 0  # of actions
        self._actions = allocate(ACTION, _MIN_ACTIONS)
        self._senders, self._needed = np.zeros((2, _MIN_ACTIONS, n), dtype=bool)
        self._addresses: Words = np.zeros((0, len(stages)), dtype=np.uint64)
        self._place = allocate(PLACE, 1)
        self._programs: list[tuple[Stage, ...]] = []
        self._programs_of: dict[Kind, int] = {}
        self._actions_of: dict[tuple[object, ...], int] = {}
        self._regular: dict[tuple[object, ...], tuple[int, TickActions]] = {}
        self._call = Call(_run_ticks, *self._arguments)

    @property
    def _arguments(self) -> tuple[Any, ...]:
        return (
            *(self._block, self._planned_s, self._actions, self._senders, self._needed),
            *(self._addresses, self._place, *self._inputs),
        )

    def load(self, rows: Iterable[Row], last: int) -> int:
        """Set the ticks that `run` runs next, at most `BLOCK`.

        Args:
            rows: of `Clock.schedule`.
            last: tick, at which the flight models do not move on.

        Returns:
            Their number.
        """
        block, place, count = self._block, self._place, 0
        known = self._count
        for count, (tick, due, steps, needed) in enumerate(rows, start=1):
            moves = tick + steps <= last
            planned = -1
            if due.sent_s is not None:
                planned = count - 1
                self._planned_s[planned] = due.sent_s
            action = self._action(due, steps if moves else 0, needed)
            block[count - 1] = tick / self._rate, tick, action, planned
        if self._count > known:
            self._call.rebind(*self._arguments)
        place[0] = 0, 0, count, False
        return count

    def run(self) -> Stage | None:
        """Run on, up to a stage that asks for Python; None: all ticks have been run."""
        while self._call(0.0):
            stage = self._at
            if stage.call is None or not is_interpreted() or stage.call(self.time_s):
                return stage
            self.resume()
        return None

    def resume(self, *, ending: bool = False) -> None:
        """Go on with the next stage in `run`; `ending`: up to the end of the tick."""
        self._place["stage"] += 1
        self._place["ending"] |= ending

    @property
    def tick(self) -> int:
        """The present tick, of the base rate."""
        return int(self._block["tick"][self._place["tick"][0]])

    @property
    def time_s(self) -> float:
        """Its time, s."""
        return float(self._block["time_s"][self._place["tick"][0]])

    @property
    def _at(self) -> Stage:
        place = self._place[0]
        action = self._actions[self._block["action"][place["tick"]]]
        return self._programs[int(action["program"])][int(place["stage"])]

    def _action(self, due: TickActions, steps: int, needed: tuple[int, ...] | None) -> int:
        """Return the row of ACTION of a tick; `steps`: 0 at the last one."""
        if due.sent_s is not None:
            return self._find_action(due, steps, needed)
        regular = id(due), steps, needed  # these repeat; `due` is held, which keeps its id
        if regular not in self._regular:
            self._regular[regular] = self._find_action(due, steps, needed), due
        return self._regular[regular][0]

    def _find_action(self, due: TickActions, steps: int, needed: tuple[int, ...] | None) -> int:
        n, program = len(self._inputs.senders), self._program(due)
        stages = self._programs[program]
        senders = np.zeros(n, dtype=bool) if due.broadcast is None else due.broadcast
        rows = np.ones(n, dtype=bool)
        if needed is not None:
            rows[:] = False
            rows[list(needed)] = True
        key = program, steps, senders.tobytes(), rows.tobytes()
        if key not in self._actions_of:
            before_move = sum(each.part is not Part.MOVE for each in stages)
            count = len(stages) if steps else before_move
            broadcasts = due.broadcast is not None
            if self._count == len(self._actions):
                self._grow()
            self._actions[self._count] = program, count, before_move, steps, broadcasts
            self._senders[self._count], self._needed[self._count] = senders, rows
            self._actions_of[key] = self._count
            self._count += 1
        return self._actions_of[key]

    def _grow(self) -> None:
        """Double the space for actions."""
        actions = allocate(ACTION, 2 * self._count)
        actions[: self._count] = self._actions
        self._actions = actions
        self._senders, self._needed = (
            np.concatenate((each, np.zeros_like(each))) for each in (self._senders, self._needed)
        )

    def _program(self, due: TickActions) -> int:
        """Return the number of the program of a tick."""
        kind = due.broadcast is not None, due.control, due.guidance, due.autopilot, due.log
        if kind not in self._programs_of:
            stages = tuple(each for each in self._stages if each.is_due(due))
            addresses = np.zeros((1, len(self._stages)), dtype=np.uint64)
            if not is_interpreted():
                addresses[0, : len(stages)] = [
                    each.call.address if each.call else 0 for each in stages
                ]
            self._programs_of[kind] = len(self._programs)
            self._programs.append(stages)
            self._addresses = np.concatenate((self._addresses, addresses))
        return self._programs_of[kind]


@entry
def _run_ticks(
    block: Records,
    planned_rows: Array,
    actions: Records,
    senders_of: BoolArray,
    needed_of: BoolArray,
    addresses: Words,
    place: Records,
    senders: BoolArray,
    planned_s: Array,
    steps: Indices,
    needed: BoolArray,
) -> bool:
    """Run on from a place, up to a stage that asks for Python; false: to the end of the block.

    Args:
        block: (K,) of TICK.
        planned_rows: (K, N) s, transmission times.
        actions: (A,) of ACTION.
        senders_of: (A, N) aircraft that transmit.
        needed_of: (A, N) aircraft whose motion is read at the next tick.
        addresses: (P, S) of calls; 0: a stage of Python's.
        place: (1,) of PLACE; written.
        senders: see `TickInputs`, as what follows; all are written.
        planned_s: see there.
        steps: see there.
        needed: see there.
    """
    at = place[0]
    while at.tick < at.ticks:
        row = block[at.tick]
        action = actions[row.action]
        if at.stage == 0:
            steps[0] = action.steps
            for i in range(len(senders)):
                needed[i] = needed_of[row.action, i]
                if action.broadcasts:
                    senders[i] = senders_of[row.action, i]
                    planned_s[i] = planned_rows[row.planned, i] if row.planned >= 0 else nan
        while at.stage < (action.before_move if at.ending else action.stages):
            address = addresses[action.program, at.stage]
            if address == 0 or call_words(address, row.time_s) != 0:
                return True
            at.stage += 1
        at.stage = 0
        at.tick = at.ticks if at.ending else at.tick + 1
    return False
