"""One period of all that an autopilot senses: errors move on, tubes are read, filters step."""

from __future__ import annotations

from typing import Any, NamedTuple

from testbed.compiled import ready_of
from testbed.sensing.belief import believe
from testbed.sensing.errors import Offsets, SensorErrors
from testbed.sensing.fusion import navigate
from testbed.sensing.navigation import Memory, Rows, Sensed, Settings
from testbed.sensing.pitot import Pitots
from testbed.state import Array, Truths, VehicleState


class Senses(NamedTuple):
    """The sensors of N aircraft, and the filters of those M among them that have one.

    All that changes is written in place.
    """

    errors: SensorErrors
    offsets: Offsets
    pitots: Pitots
    rows: Rows  # (M,) who has a filter
    settings: Settings  # (M)
    memory: Memory  # (M)
    flown: Array  # (M, 9) errors of attitude, velocity, position as they are flown on
    vectors: Array  # (5, N, 3) what is believed, in the order of a VehicleState
    speeds: Array  # (2, N)


class Broken(NamedTuple):
    """What is broken in the sensors of N aircraft, as `state.Failing` has it."""

    gps_lost: Truths  # (N,)
    gps_jump: Array  # (N, 3) m NED
    pitot_blocked: Truths  # (N,)
    pitot_drained: Truths  # (N,)


def sense(senses: Senses, truth: VehicleState, broken: Broken, step: int, fresh: bool) -> None:
    """Write what N aircraft believe of their motion.

    Args:
        senses: theirs; changed.
        truth: of N aircraft.
        broken: now.
        step: number of the period.
        fresh: a period begins; else errors and filters stay as they are.
    """
    errors, pitots, rows = senses.errors, senses.pitots, senses.rows
    if fresh:
        errors.advance()
        pitots.read(step, truth, errors.now, senses.offsets, broken)
        equivalent, true = pitots.told
        sensed = Sensed(
            errors=errors.now,
            heading=senses.offsets.heading,
            equivalent_airspeed=equivalent,
            airspeed=true,
            airspeed_new=pitots.sampled(step),
            gps_lost=broken.gps_lost,
            gps_jump=broken.gps_jump,
        )
        seen = of_rows(truth, rows), of_rows(sensed, rows)
        senses.flown[:] = navigate(senses.memory, senses.settings, step, *seen)
    senses.vectors[:], senses.speeds[:] = truth[:5], pitots.now(truth)[::-1]
    out = VehicleState(*senses.vectors, *senses.speeds)
    believe(out, rows, senses.flown, senses.memory.states, errors.now)


def of_rows(record: Any, rows: Rows) -> Any:  # noqa: ANN401 - any record of arrays
    """These rows of each of its arrays, copied."""
    return type(record)(*(each[rows] for each in record))


READY_SENSE = ready_of(sense, "testbed.sensing.senses_twin")
