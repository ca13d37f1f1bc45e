"""Check a user's formation law before the flight.

The law steps through generated flights, with a fixed seed, in which some messages are missing or
old. It must return commands of the right shape with finite numbers, return the same for the same
input, leave its inputs unchanged, carry its memory as a value, and use in row i only what
follower i has received.
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
SPEED_FACTOR = 2.0  # of the speed bounds, beyond which a commanded speed has another unit
Command = UnicycleCommand | FbwaCommand
Step = tuple[float, VehicleState, Inbox]


def check_law(law: Law, config: FormationConfig) -> type[Command]:
    """Check a law on generated flights of its followers, and return its type of command.

    Raises:
        InputError: naming the first rule that it violates.
    """
    rng = np.random.default_rng(SEED)
    before = _attributes(law)
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
        _check_interleaved(law, config, flight, commands, rng)
        for command in commands:
            if isinstance(command, UnicycleCommand):
                _check_axes(law, command)
    _check_values(law, config)
    _check_attributes(law, before)
    return type(commands[0])


def _check_values(law: Law, config: FormationConfig) -> None:
    """Check units and axes of commands in level flight in the slots at the trim airspeed."""
    rng = np.random.default_rng(SEED)
    calm = [_make_step(config, rng, 0.0, k * config.dt, noise=0.0) for k in range(STEPS)]
    commands = _fly(law, config, calm)
    unicycle = [each for each in commands if isinstance(each, UnicycleCommand)]
    for name in ("speed", "speed_desired") if unicycle else ():
        speeds = np.median([getattr(each, name) for each in unicycle], axis=0)
        for row, speed in enumerate(speeds):
            low, high = config.speed_min[row], config.speed_max[row]
            if not low / SPEED_FACTOR <= speed <= high * SPEED_FACTOR:
                _reject(
                    law,
                    f"returns a {name} of {speed:.4g} for {config.names[row]} near its slot, "
                    f"whose bounds are {low:g} to {high:g} m/s (speeds are in m/s)",
                )
    for each in commands:
        if isinstance(each, FbwaCommand):
            for name in ("pitch", "roll"):
                angle = abs(getattr(each, name)).max()
                if angle > np.pi / 2.0:
                    _reject(law, f"returns a {name} of {angle:.4g} (angles are in rad)")


def _check_axes(law: Law, command: UnicycleCommand) -> None:
    """Check that directions are unit vectors, and that ω has no component along the velocity."""
    length = np.linalg.norm(command.direction, axis=1)
    if abs(length - 1.0).max() > 1e-6:
        _reject(law, f"returns a direction of length {length.max():.4g} (unit vectors)")
    rolling = command.omega[:, 0]
    if rolling.any():
        _reject(
            law,
            f"returns omega with a first component of {rolling[abs(rolling).argmax()]:.4g} rad/s "
            "(write 0: omega is (0, pitch rate, yaw rate), and the velocity frame does not roll)",
        )


def _check_interleaved(
    law: Law,
    config: FormationConfig,
    flight: list[Step],
    commands: list[Command],
    rng: np.random.Generator,
) -> None:
    """Check that a flight is the same while another one is stepped at the same times."""
    other = []
    for now, own, inbox in flight:
        moved = VehicleState(*(each * (1.0 + 0.1 * rng.random(each.shape)) for each in own))
        other.append((now, moved, inbox))
    with user_code_errors(law_file(law)):
        memories = [law.start(_read_only(each[0][1])) for each in (other, flight)]
        for one, two, expected in zip(other, flight, commands, strict=True):
            for k, (now, own, inbox) in enumerate((one, two)):
                result = law.step(now, _read_only(own), _read_only(inbox), memories[k])
                command, memories[k] = result
            if not _same([expected], [validate_command(command, config, two[0])]):
                _reject(
                    law,
                    "returns another command where it also steps another flight (store state in "
                    "the memory, not in attributes or global variables)",
                )


def _attributes(law: Law) -> dict[str, bytes]:
    """Return the attributes of a law as bytes; those that cannot be pickled are left out."""
    found = {name: _pickled(value) for name, value in getattr(law, "__dict__", {}).items()}
    return {name: value for name, value in found.items() if value}


def _check_attributes(law: Law, before: dict[str, bytes]) -> None:
    """Check that no attribute of a law has changed."""
    after = _attributes(law)
    changed = [name for name in after if before.get(name) != after[name]]
    if changed:
        _reject(
            law,
            f"changes its attribute {changed[0]!r} while it steps (store state in the memory, "
            "which step receives and returns)",
        )


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


def _make_step(
    config: FormationConfig, rng: np.random.Generator, share: float, now: float, noise: float = 1.0
) -> Step:
    """Generate estimates and messages of a formation in level flight north, near its slots."""
    n, aircraft = len(config.names), len(config.offsets)
    speed = float(np.mean(config.trim_airspeed))
    centre = np.array([now * speed, 0, -100.0])
    position = config.offsets + noise * rng.normal(0.0, 3.0, (aircraft, 3)) + centre
    velocity = np.array([speed, 0.0, 0.0]) + noise * rng.normal(0.0, 1.0, (aircraft, 3))
    acceleration = noise * rng.normal(0.0, 0.5, (aircraft, 3))
    euler = noise * rng.normal(0.0, 0.2, (aircraft, 3))
    rates = noise * rng.normal(0.0, 0.1, (aircraft, 3))
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
