"""A whole control step of the paper's law: the law, the middle loop behind it, and what it used.

As `paper_law.paper_step`, `middle_loop.middle_step` and `measurement.ages` one after the other have
it, for who steps often: everything is written into arrays that are there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import ready_of
from testbed.formation.law import Diagnosis
from testbed.formation.leader import Memory
from testbed.formation.measurement import ages
from testbed.formation.middle_loop import MiddleLoop, MiddleLoopMemory, middle_step
from testbed.formation.paper_law import PaperLaw, paper_step
from testbed.state import Array, FbwaCommand, Inbox, Truths, UnicycleCommand, VehicleState

Rows = NDArray[np.intp]


class Remembered(NamedTuple):
    """What m followers remember, of `leader.Memory` and `MiddleLoopMemory`; written in place."""

    acceleration: Array  # (m, 3) m/s²
    leader: Array  # (7, m) from time_s to silent_course
    place: Array  # (m, N, 3) m
    place_time_s: Array  # (m, N) s
    middle: Array  # (8, m)


class Said(NamedTuple):
    """What the control of all n followers says; the rows of those that step are written."""

    command: FbwaCommand  # (n)
    unicycle: UnicycleCommand  # (n)
    diagnosis: Diagnosis  # (n); its speed_desired is the array of unicycle
    age_s: Array  # (n, N) s, of what each used of each aircraft; nan: nothing


def silent(told: Array, aircraft: int) -> Said:
    """What n followers say before they have been asked.

    Args:
        told: (3, n) pitch, roll, throttle: where their commands are to be.
        aircraft: N.
    """
    n = told.shape[1]
    speed, airspeed, course, climb = np.full((4, n), np.nan)
    none = np.zeros((3, n), dtype=np.uint8)
    unicycle = UnicycleCommand(np.zeros(n), np.zeros((n, 3)), speed, np.zeros((n, 3)), none[0])
    diagnosis = Diagnosis(speed, airspeed, course, climb, none[1], none[2])
    return Said(FbwaCommand(*told), unicycle, diagnosis, np.full((n, aircraft), np.nan))


def begun(law: PaperLaw, loop: MiddleLoop, own: VehicleState) -> Remembered:
    """What m followers remember before their first step."""
    memory = law.start(own)
    return Remembered(
        memory.acceleration.copy(),
        np.array(memory[1:-2]),
        memory.place.copy(),
        memory.place_time_s.copy(),
        np.array(loop.start()),
    )


def together(
    law: PaperLaw,
    loop: MiddleLoop,
    unheeded: Truths,
    patience: Array,
    rows: Rows,
    own: VehicleState,
    inbox: Inbox,
    measured_s: Array,
    memory: Remembered,
    said: Said,
    now: float,
) -> None:
    """Step m of n followers.

    Args:
        law: of the m.
        loop: of the m.
        unheeded: (m, N) whose messages they do not use.
        patience: (N,) s since the arrival of news, after which it is not used.
        rows: (m,) which of the n they are.
        own: (n) estimates.
        inbox: (n, N) what they heard.
        measured_s: (n, N) s, when that was true.
        memory: of the m; changed in place.
        said: of the n; the rows of the m are written.
        now: s.
    """
    mine, heard = _of(own, rows), _of(inbox, rows)
    remembered: Any = (*memory.leader, memory.place, memory.place_time_s)
    last = Memory(memory.acceleration, *remembered)
    told, after = paper_step(law, now, mine, heard, last)
    command, held, diagnosis = middle_step(loop, mine, told, MiddleLoopMemory(*memory.middle))
    used = ages(now, measured_s[rows], heard.received_s, unheeded, patience, True)
    memory.leader[:], memory.middle[:] = after[1:-2], held
    memory.acceleration[:] = after.acceleration
    memory.place[:], memory.place_time_s[:] = after.place, after.place_time_s
    for whole, part in zip(said[:3], (command, told, diagnosis), strict=True):
        put(whole, rows, part)
    said.age_s[rows] = used


def put(whole: Any, rows: Rows, part: Any) -> None:  # noqa: ANN401 - two records of a kind
    """Write these rows of every array of a record."""
    for old, new in zip(whole, part, strict=True):
        old[rows] = new


def _of(record: Any, rows: Rows) -> Any:  # noqa: ANN401 - any record of arrays
    return type(record)(*(each[rows] for each in record))


READY = ready_of(together, "testbed.formation.together_twin")
