"""The contract of a formation law, tried out before it flies.

Seeded states of flight, some with messages missing or old, are put through a few steps. A law must
answer in the right shape with finite numbers, the same for the same; leave what it is given alone;
carry its memory as a value; and tell follower i nothing that only another follower knows.
"""

from __future__ import annotations

import copy
import pickle
from typing import Any, NoReturn

import numpy as np

from testbed.errors import InputError
from testbed.formation.law import Law, Team
from testbed.sim.control import blamed, checked, file_of
from testbed.state import Array, FbwaCommand, Inbox, UnicycleCommand, VehicleState

SEED = 11
STEPS = 4
Told = UnicycleCommand | FbwaCommand


def check_law(law: Law, team: Team) -> type[Told]:
    """Try a law on made-up flights of its team; what kind of command does it answer with?

    Raises:
        InputError: naming the first point of the contract that it breaks.
    """
    rng = np.random.default_rng(SEED)
    for silence in (0.0, 0.3):
        flight = [_states(team, rng, silence, k * team.dt) for k in range(STEPS)]
        told = _fly(law, team, flight)
        if not _same(told, _fly(law, team, flight)):
            _refuse(
                law,
                "answers the same question differently the second time (keep what it remembers in "
                "the memory, in nothing that lives on between steps)",
            )
        for row in range(len(team.names) if len(team.names) > 1 else 0):
            _check_locality(law, team, flight, told, rng, row)
    for each in told:
        if isinstance(each, UnicycleCommand):
            length = np.linalg.norm(each.direction, axis=1)
            if abs(length - 1.0).max() > 1e-6:
                _refuse(law, f"gives a direction of length {length.max():.4g} (unit vectors)")
    return type(told[0])


def _fly(law: Law, team: Team, flight: list[tuple[float, VehicleState, Inbox]]) -> list[Told]:
    """Answers step by step; memory and inputs must survive each."""
    answers = []
    with blamed(file_of(law)):
        memory = law.start(_locked(flight[0][1]))
    for now, own, inbox in flight:
        before = copy.deepcopy(memory)
        with blamed(file_of(law)):
            try:
                answer = law.step(now, _locked(own), _locked(inbox), memory)
            except ValueError as error:
                if "read-only" not in str(error):
                    raise
                _refuse(law, f"writes into what it is given ({error}; make a copy)")
        if not (isinstance(answer, tuple) and len(answer) == 2):
            _refuse(law, "must return two things from step: the command and the memory")
        told, after = answer
        touched = _bytes(memory) != _bytes(before)
        with blamed(file_of(law)):
            again = law.step(now, _locked(own), _locked(inbox), before)[0]
        told = checked(told, team, now)
        if touched or not _same([told], [checked(again, team, now)]):
            _refuse(
                law,
                "does not carry its memory as a value (return a new memory from step, change no "
                "old one, and keep nothing anywhere else)",
            )
        answers.append(told)
        memory = after
    return answers


def _check_locality(
    law: Law,
    team: Team,
    flight: list[tuple[float, VehicleState, Inbox]],
    told: list[Told],
    rng: np.random.Generator,
    row: int,
) -> None:
    """The follower of this row must not notice what only the others know."""
    moved = []
    for now, own, inbox in flight:
        other_own = VehicleState(*(_shaken(each, rng, row) for each in own))
        other_inbox = Inbox(
            inbox.stamp_s, inbox.received_s, *(_shaken(each, rng, row) for each in inbox[2:])
        )
        moved.append((now, other_own, other_inbox))
    others = [name for name in team.names if name != team.names[row]]
    for before, after in zip(told, _fly(law, team, moved), strict=True):
        for name, one, two in zip(before._fields, _arrays(before), _arrays(after), strict=True):
            if not np.allclose(one[row], two[row], rtol=1e-9, atol=1e-9):
                _refuse(
                    law,
                    f"gives {team.names[row]} another {name} when only {', '.join(others)} know "
                    "something else (row i may use row i of own and inbox alone)",
                )


def _shaken(values: Array, rng: np.random.Generator, row: int) -> Array:
    """The array with everything but one row moved by up to a tenth."""
    out = values * (1.0 + 0.1 * rng.random(values.shape))
    out[row] = values[row]
    return out


def _states(
    team: Team, rng: np.random.Generator, silence: float, now: float
) -> tuple[float, VehicleState, Inbox]:
    """A formation in level flight to the north, more or less in its slots; some do not hear."""
    n, aircraft = len(team.names), len(team.offsets)
    speed = float(np.mean(team.trim_airspeed))
    place = team.offsets + rng.normal(0.0, 3.0, (aircraft, 3)) + np.array([now * speed, 0, -100.0])
    velocity = np.array([speed, 0.0, 0.0]) + rng.normal(0.0, 1.0, (aircraft, 3))
    acceleration = rng.normal(0.0, 0.5, (aircraft, 3))
    euler = rng.normal(0.0, 0.2, (aircraft, 3))
    rates = rng.normal(0.0, 0.1, (aircraft, 3))
    mine = team.agents
    airspeed = np.linalg.norm(velocity, axis=1)
    own = VehicleState(
        place[mine],
        velocity[mine],
        acceleration[mine],
        euler[mine],
        rates[mine],
        airspeed[mine],
        airspeed[mine],
    )
    # a message a second or more old now and then, and some older than anybody should reckon with
    late = rng.random((n, aircraft)) < silence
    limit = np.full(aircraft, team.stale_after)
    limit[0] = team.silent_after
    stamp = now - np.where(late, 2.0 * limit * rng.random((n, aircraft)), 0.0)
    stamp[rng.random((n, aircraft)) < silence] = np.nan
    unheard = np.isnan(stamp)[:, :, np.newaxis]
    content = (place, velocity, acceleration, euler, rates)
    heard = (np.where(unheard, np.nan, np.stack([each] * n)) for each in content)
    return now, own, Inbox(stamp, stamp.copy(), *heard)


def _locked(record: Any) -> Any:  # noqa: ANN401 - a record of arrays
    copies = [each.copy() for each in record]
    for each in copies:
        each.flags.writeable = False
    return type(record)(*copies)


def _bytes(memory: Any) -> bytes:  # noqa: ANN401 - the law's own
    """What can be compared of a memory: nothing, if it cannot be pickled."""
    try:
        return pickle.dumps(memory)
    except (pickle.PicklingError, TypeError, AttributeError):
        return b""


def _arrays(told: Any) -> list[Array]:  # noqa: ANN401 - a record of arrays
    return list(told)


def _same(ours: list[Told], theirs: list[Told]) -> bool:
    return all(
        type(one) is type(two) and all(map(np.array_equal, _arrays(one), _arrays(two)))
        for one, two in zip(ours, theirs, strict=True)
    )


def _refuse(law: Law, text: str) -> NoReturn:
    raise InputError(f"controller.law: {type(law).__name__} {text}")
