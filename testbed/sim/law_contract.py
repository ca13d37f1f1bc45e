"""Check a user's formation law before the flight.

The law steps through generated flights, with a fixed seed, in which some messages are missing or
old. It must return commands of the right shape with finite numbers, return the same for the same
input, leave its inputs unchanged, carry its memory as a value, and use in row i only what
follower i knows.
"""

from __future__ import annotations

import copy
import pickle
from typing import Any, NoReturn

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Array, FbwaCommand, Inbox, UnicycleCommand, VehicleState
from testbed.formation.law import FormationConfig, Law
from testbed.sim.control import law_file, user_code_errors, validate_command

SEED = 11
STEPS = 4
MISSING_SHARES = (0.0, 0.3)  # of messages that are missing, and of those that are old
Command = UnicycleCommand | FbwaCommand
Step = tuple[float, VehicleState, Inbox]


def check_law(law: Law, config: FormationConfig) -> type[Command]:
    """Check a law on generated flights of its followers, and return its type of command.

    Raises:
        InputError: naming the first rule that it violates.
    """
    rng = np.random.default_rng(SEED)
    for share in MISSING_SHARES:
        flight = [_make_step(config, rng, share, k * config.dt) for k in range(STEPS)]
        commands = _fly(law, config, flight)
        if not _same(commands, _fly(law, config, flight)):
            _reject(
                law,
                "returns another command for the same input (store state in the memory, not in "
                "attributes or global variables)",
            )
        for row in range(len(config.names) if len(config.names) > 1 else 0):
            _check_locality(law, config, flight, commands, rng, row)
    for command in commands:
        if isinstance(command, UnicycleCommand):
            length = np.linalg.norm(command.direction, axis=1)
            if abs(length - 1.0).max() > 1e-6:
                _reject(law, f"returns a direction of length {length.max():.4g} (unit vectors)")
    return type(commands[0])


def _fly(law: Law, config: FormationConfig, flight: list[Step]) -> list[Command]:
    """Return the command of each step; memory and inputs must not be modified."""
    commands = []
    with user_code_errors(law_file(law)):
        memory = law.start(_read_only(flight[0][1]))
    for now, own, inbox in flight:
        before = copy.deepcopy(memory)
        with user_code_errors(law_file(law)):
            try:
                result = law.step(now, _read_only(own), _read_only(inbox), memory)
            except ValueError as error:
                if "read-only" not in str(error):
                    raise
                _reject(law, f"writes into its inputs ({error}; make a copy)")
        if not (isinstance(result, tuple) and len(result) == 2):
            _reject(law, "must return two values from step: the command and the memory")
        command, after = result
        modified = _pickled(memory) != _pickled(before)
        with user_code_errors(law_file(law)):
            again = law.step(now, _read_only(own), _read_only(inbox), before)[0]
        command = validate_command(command, config, now)
        if modified or not _same([command], [validate_command(again, config, now)]):
            _reject(
                law,
                "does not carry its memory as a value (return a new memory from step, do not "
                "modify the old one, and store state nowhere else)",
            )
        commands.append(command)
        memory = after
    return commands


def _check_locality(
    law: Law,
    config: FormationConfig,
    flight: list[Step],
    commands: list[Command],
    rng: np.random.Generator,
    row: int,
) -> None:
    """Check that a follower's command does not depend on the inputs of the others."""
    changed = []
    for now, own, inbox in flight:
        other_own = VehicleState(*(_perturb_others(each, rng, row) for each in own))
        content = (_perturb_others(each, rng, row) for each in inbox[2:])
        changed.append((now, other_own, Inbox(inbox.stamp_s, inbox.received_s, *content)))
    others = [name for name in config.names if name != config.names[row]]
    for before, after in zip(commands, _fly(law, config, changed), strict=True):
        for field, one, two in zip(before._fields, _arrays(before), _arrays(after), strict=True):
            if not np.allclose(one[row], two[row], rtol=1e-9, atol=1e-9):
                _reject(
                    law,
                    f"returns another {field} for {config.names[row]} when only inputs of "
                    f"{', '.join(others)} change (row i may use row i of own and inbox only)",
                )


def _perturb_others(values: Array, rng: np.random.Generator, row: int) -> Array:
    """Return a copy with all rows but one increased by up to 10 %."""
    out = values * (1.0 + 0.1 * rng.random(values.shape))
    out[row] = values[row]
    return out


def _make_step(config: FormationConfig, rng: np.random.Generator, share: float, now: float) -> Step:
    """Generate estimates and messages of a formation in level flight north, near its slots."""
    n, aircraft = len(config.names), len(config.offsets)
    speed = float(np.mean(config.trim_airspeed))
    centre = np.array([now * speed, 0, -100.0])
    position = config.offsets + rng.normal(0.0, 3.0, (aircraft, 3)) + centre
    velocity = np.array([speed, 0.0, 0.0]) + rng.normal(0.0, 1.0, (aircraft, 3))
    acceleration = rng.normal(0.0, 0.5, (aircraft, 3))
    euler = rng.normal(0.0, 0.2, (aircraft, 3))
    rates = rng.normal(0.0, 0.1, (aircraft, 3))
    rows = config.agents
    airspeed = np.linalg.norm(velocity, axis=1)
    own = VehicleState(
        position[rows],
        velocity[rows],
        acceleration[rows],
        euler[rows],
        rates[rows],
        airspeed[rows],
        airspeed[rows],
    )
    # some messages are missing, and some are older than the time-out
    old = rng.random((n, aircraft)) < share
    limit = np.full(aircraft, config.neighbour_timeout_s)
    limit[0] = config.leader_timeout_s
    stamp = now - np.where(old, 2.0 * limit * rng.random((n, aircraft)), 0.0)
    stamp[rng.random((n, aircraft)) < share] = np.nan
    missing = np.isnan(stamp)[:, :, np.newaxis]
    content = (position, velocity, acceleration, euler, rates)
    received = (np.where(missing, np.nan, np.stack([each] * n)) for each in content)
    return now, own, Inbox(stamp, stamp.copy(), *received)


def _read_only(record: Any) -> Any:  # noqa: ANN401 - a record of arrays
    copies = [each.copy() for each in record]
    for each in copies:
        each.flags.writeable = False
    return type(record)(*copies)


def _pickled(memory: Any) -> bytes:  # noqa: ANN401 - any type
    """Return the memory as bytes for a comparison; empty if it cannot be pickled."""
    try:
        return pickle.dumps(memory)
    except (pickle.PicklingError, TypeError, AttributeError):
        return b""


def _arrays(command: Any) -> list[Array]:  # noqa: ANN401 - a record of arrays
    return list(command)


def _same(ours: list[Command], theirs: list[Command]) -> bool:
    return all(
        type(one) is type(two) and all(map(np.array_equal, _arrays(one), _arrays(two)))
        for one, two in zip(ours, theirs, strict=True)
    )


def _reject(law: Law, text: str) -> NoReturn:
    raise InputError(f"controller.law: {type(law).__name__} {text}")
