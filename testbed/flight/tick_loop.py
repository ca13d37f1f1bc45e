"""Run the ticks of a flight from compiled code, up to a stage that asks for Python."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import nan
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from testbed.core.call_list import Call, Words, call_words
from testbed.core.compile import entry, is_interpreted
from testbed.core.errors import InputError
from testbed.core.records import Array, BoolArray, Indices, Records, allocate
from testbed.flight.schedule import Scheduled, TickActions
from testbed.flight.stages import Part, Stage

LOOK_TICKS = 64  # that are run without a look at what may end the flight
ANY_TICKS = 2**62  # more than any flight has
PAUSED = 2  # returned by the call of a stage at which the flight waits for its caller

# A tick of a block.
TICK = np.dtype(
    [
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
PLACE = np.dtype(
    [
        ("row", "i8"),  # of the block
        ("rows", "i8"),  # their number
        ("offset", "i8"),  # in ticks, from the block's
        ("period", "i8"),  # in ticks, at which the block repeats; 0: it does not
        ("stage", "i8"),
        ("left", "i8"),  # ticks to be run
        ("last", "i8"),  # tick of the flight
        ("rate_hz", "f8"),  # of the ticks
        ("now", "f8"),  # time of the last tick that was begun, s
        ("until", "f8"),  # time of the next pause, s
        ("waiting", "?"),  # for Python, at the stage
        ("ending", "?"),  # the tick is the last one
        ("done", "?"),  # that was the last one
    ],
    align=True,
)

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
        place: (1,) of PLACE, to be used; None: a new one.
    """

    def __init__(
        self,
        stages: Sequence[Stage],
        inputs: TickInputs,
        base_rate_hz: int,
        place: Records | None = None,
    ) -> None:
        """See the class; nothing is compiled or called yet."""
        self._stages, self._inputs = tuple(stages), inputs
        self._block, self._due = allocate(TICK, 0), list[TickActions]()
        self._planned_s = np.zeros((0, n := len(inputs.senders)))
        self._count = 0  # of actions
        self._actions = allocate(ACTION, _MIN_ACTIONS)
        self._senders, self._needed = np.zeros((2, _MIN_ACTIONS, n), dtype=bool)
        self._addresses: Words = np.zeros((0, len(stages)), dtype=np.uint64)
        self._place = allocate(PLACE, 1) if place is None else place
        self._place["rate_hz"] = base_rate_hz
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

    def load(self, rows: Sequence[Scheduled], period: int, last: int) -> None:
        """Set the ticks that `run` runs next.

        Args:
            rows: a block of `Clock.blocks`.
            period: of its repetitions, in ticks; 0: it does not repeat.
            last: tick of the flight, at which vehicles do not move on.
        """
        self._block, self._due = allocate(TICK, len(rows)), [due for _, due, *_ in rows]
        self._planned_s = np.full((len(rows), len(self._inputs.senders)), np.nan)
        for k, (tick, due, steps, needed) in enumerate(rows):
            if due.sent_s is not None:
                self._planned_s[k] = due.sent_s
            planned = -1 if due.sent_s is None else k
            self._block[k] = tick, self._action(due, steps, needed), planned
        place = self._place
        place["row"] = place["offset"] = place["stage"] = 0
        place["ending"] = place["done"] = place["waiting"] = False
        place["rows"], place["period"], place["last"] = len(rows), period, last
        self._call.rebind(*self._arguments)

    def seek(self, tick: int, behind: Callable[[Stage], bool]) -> bool:
        """Begin at a tick of the block, behind its stages of a kind; false: the tick is later.

        Raises:
            InputError: nothing happens at the tick.
        """
        place, ticks = self._place, self._block["tick"]
        period, last = int(place["period"][0]), int(ticks[-1])
        offset = max(0, -(-(tick - last) // period) * period) if period else 0
        row = int(np.searchsorted(ticks + offset, tick))
        if row == len(ticks):
            place["row"] = row
            return False
        if ticks[row] + offset != tick:
            raise InputError(f"nothing happens at tick {tick}")
        place["row"], place["offset"] = row, offset
        stages = self._programs[int(self._actions["program"][self._block["action"][row]])]
        place["stage"] = sum(behind(each) for each in stages)
        return True

    def limit(self, ticks: int) -> None:
        """Let `run` end after some ticks."""
        self._place["left"] = ticks

    def bind(self) -> None:
        """Write down the addresses, after `compile.prepare`; see `Call.bind`."""
        self._call.bind()

    @property
    def address(self) -> int:
        """Address of the words of the call that `run` makes, which returns what `run` is given."""
        return self._call.address

    def run(self, found: int | None = None) -> Stage | None:
        """Run on, up to a stage that asks for Python.

        None: the limit, the end of a block that does not repeat, or that of the flight is reached.

        Args:
            found: what the call at `address` has returned, made by another; None: make it.
        """
        if found is None:
            found = self._call(0.0)
        while found:
            stage = self._at
            if stage.call is None or not is_interpreted() or stage.call(self.time_s):
                return stage
            found = self._call(0.0)
        return None

    def end(self) -> None:
        """Let the present tick be the last one."""
        self._place["ending"] = True

    @property
    def done(self) -> bool:
        """Whether the flight is at its end."""
        return bool(self._place["done"][0])

    @property
    def in_block(self) -> bool:
        """Whether there are more ticks in this block, and in the flight."""
        place = self._place[0]
        return bool(place["row"] < place["rows"] and not place["done"])

    @property
    def due(self) -> TickActions:
        """What happens at the present tick."""
        return self._due[int(self._place["row"][0])]

    @property
    def time_s(self) -> float:
        """Time of the present tick, s, or of the next one between two ticks."""
        place = self._place[0]
        tick = int(self._block["tick"][place["row"]] + place["offset"])
        return tick / float(place["rate_hz"])

    @property
    def begun_s(self) -> float:
        """Time of the last tick that was begun, s."""
        return float(self._place["now"][0])

    @property
    def _at(self) -> Stage:
        place = self._place[0]
        action = self._actions[self._block["action"][place["row"]]]
        return self._programs[int(action["program"])][int(place["stage"])]

    def _action(self, due: TickActions, steps: int, needed: tuple[int, ...] | None) -> int:
        """Return the row of ACTION of a tick."""
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
            if self._count == len(self._actions):
                self._grow()
            self._actions[self._count] = (
                *(program, len(stages), before_move, steps),
                due.broadcast is not None,
            )
            self._senders[self._count], self._needed[self._count] = senders, rows
            self._actions_of[key] = self._count
            self._count += 1
        return self._actions_of[key]

    def _grow(self) -> None:
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
def pause(place: Records, observed: Words, now: float) -> int:
    """Return `PAUSED` at a time, s, if it is that of the next pause.

    Args:
        place: (1,) of PLACE.
        observed: addresses of calls that come before it.
        now: s.
    """
    if now < place[0].until:
        return 0
    for address in observed:
        call_words(address, now)
    return PAUSED


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
) -> int:
    """Run on from a place, up to a stage that asks for Python; return what its call has returned.

    0: the limit or the end of the block is reached; 1 also where the stage has no call.

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
    if at.waiting:
        at.waiting = False
        at.stage += 1
    while at.left > 0 and at.row < at.rows and not at.done:
        row = block[at.row]
        tick, action = row.tick + at.offset, actions[row.action]
        if tick > at.last:
            at.done = True
            break
        steps[0] = action.steps
        for i in range(len(senders)):
            needed[i] = needed_of[row.action, i]
            if action.broadcasts:
                senders[i] = senders_of[row.action, i]
                planned_s[i] = planned_rows[row.planned, i] if row.planned >= 0 else nan
        at.now = now = tick / at.rate_hz
        moves = tick + action.steps <= at.last and not at.ending
        while at.stage < (action.stages if moves else action.before_move):
            address = addresses[action.program, at.stage]
            found = 1 if address == 0 else call_words(address, now)
            if found != 0:
                at.waiting = True
                return found
            at.stage += 1
        at.stage = 0
        at.left -= 1
        if not moves:
            at.done = True
            return 0
        at.row += 1
        if at.row == at.rows and at.period > 0:
            at.row = 0
            at.offset += at.period
    return 0
