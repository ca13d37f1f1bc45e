"""Step a law that is an FMU from compiled code: its functions are called by their addresses.

Addresses, value references and places are data, so one kernel steps every FMU. The state of the FMU
is bytes in the law's memory: it is set before a step and got after it.

Source of the functions: FMI 2.0.4, section 4.2, and FMI 3.0.1, section 4.2.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from math import isnan
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from testbed.core.compile import is_interpreted
from testbed.core.compile import kernel as core_kernel
from testbed.core.records import (
    Array,
    FbwaCommand,
    Inbox,
    Indices,
    OwnState,
    UnicycleCommand,
    Values,
)
from testbed.formation.compiled_law import kernel
from testbed.formation.velocity_command import command_from_velocity

# Places of the inputs: the time, the own estimate, then the message of each of N aircraft.
NOW = 0
POSITION, VELOCITY, ACCELERATION, EULER, RATES, WIND = 1, 4, 7, 10, 13, 16
AIRSPEED, EQUIVALENT_AIRSPEED = 19, 20
FIRST_MESSAGE, MESSAGE_SIZE = 21, 20
STAMP, RECEIVED, AGE, TURN_RATE, FAILED = 0, 1, 2, 3, 4  # of a message
MESSAGE_POSITION, MESSAGE_VELOCITY, MESSAGE_ACCELERATION = 5, 8, 11
MESSAGE_EULER, MESSAGE_EULER_RATES = 14, 17
NEVER_S = 1e9  # age of a message that has not arrived; its times are minus this
COMMAND_SIZE = 8  # numbers of a command; of fly-by-wire A 3, of a velocity 6

# Places of the addresses of functions, and numbers of calls in a report.
SET_REAL, SET_BOOLEAN, DO_STEP, GET_REAL = 0, 1, 2, 3
DESERIALIZE, SET_STATE, GET_STATE, STATE_SIZE, SERIALIZE, FREE_STATE = 4, 5, 6, 7, 8, 9
STOPPED, OTHER_SIZE, NOT_FINITE = 10, 11, 12  # what else ends a step
WARNING, DISCARD = 1, 2  # the largest status of a call that has worked; that of an FMU that ends
WORD = 8  # bytes


# Columns of the words of a follower.
VERSION, STATE_BYTES, AIRCRAFT, FUNCTIONS = 0, 1, 2, 3  # of FMI; 0: no state; of whose messages
INPUT_REFS, INPUT_COUNT, INPUT_VALUES = 13, 14, 15  # address of value references, their number
FLAG_REFS, FLAG_COUNT, FLAG_VALUES = 16, 17, 18
OUTPUT_REFS, OUTPUT_COUNT, OUTPUT_VALUES = 19, 20, 21
INITIAL = 22  # address of the state before the first step
VALUES_AT, FOUND_AT, COMMAND_AT = 23, 24, 25  # columns of the numbers
STATE, SIZE, RETURNED, INSTANCES, FLAGS_AT = 26, 27, 28, 32, 35  # scratch; addresses; flags
TIME_S, ROW, CALL, STATUS, STOP_S = 0, 1, 2, 3, 4  # places of a report


class FmuStep(NamedTuple):
    """What steps of an FMU need, for N aircraft; rows of those that are no followers are empty.

    Few arrays: each one costs time in each call of a kernel.
    """

    words: NDArray[np.int64]  # (N, K) counts and addresses, and scratch
    places: Indices  # (P,) of the values of real inputs, Boolean inputs, and outputs
    numbers: Array  # (N, F) scratch: inputs, their values, outputs, and the command
    report: Array  # (5,) of the present call; and the time of a step that is not made, s


def memory_fields(state_bytes: int) -> list[tuple[Any, ...]]:
    """Return the fields of the memory of a law."""
    state = ("state", np.uint64, (state_words(state_bytes),))
    return [("steps", np.int64), ("instance", np.int64), state]


def state_words(state_bytes: int) -> int:
    """Return how many words hold a state: at least 64, a power of two: few sizes are compiled."""
    words = 64
    while words * WORD < state_bytes:
        words *= 2
    return words


def _generate(kinds: str) -> tuple[Any, Callable[..., Any]]:
    """Return type and code of a call of a C function: of words (L) and floats (D), to int32."""
    from llvmlite import ir

    of_kind = {"L": (types.int64, ir.IntType(64)), "D": (types.float64, ir.DoubleType())}
    signature = types.int32(types.int64, *(of_kind[each][0] for each in kinds))

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401, ARG001
        kind = ir.FunctionType(ir.IntType(32), [of_kind[each][1] for each in kinds])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])

    return signature, generate


def _two(context: Any, f: Any, a: Any, b: Any) -> Any:  # noqa: ANN401, ARG001
    return _generate("LL")


def _three(context: Any, f: Any, a: Any, b: Any, c: Any) -> Any:  # noqa: ANN401, ARG001
    return _generate("LLL")


def _four(context: Any, f: Any, a: Any, b: Any, c: Any, d: Any) -> Any:  # noqa: ANN401, ARG001
    return _generate("LLLL")


def _five(
    context: Any,  # noqa: ANN401, ARG001
    f: Any,  # noqa: ANN401, ARG001
    a: Any,  # noqa: ANN401, ARG001
    b: Any,  # noqa: ANN401, ARG001
    c: Any,  # noqa: ANN401, ARG001
    d: Any,  # noqa: ANN401, ARG001
    e: Any,  # noqa: ANN401, ARG001
) -> Any:  # noqa: ANN401
    return _generate("LLLLL")


def _of_step_2(context: Any, f: Any, a: Any, t: Any, h: Any, b: Any) -> Any:  # noqa: ANN401, ARG001
    return _generate("LDDL")


def _of_step_3(
    context: Any,  # noqa: ANN401, ARG001
    f: Any,  # noqa: ANN401, ARG001
    a: Any,  # noqa: ANN401, ARG001
    t: Any,  # noqa: ANN401, ARG001
    h: Any,  # noqa: ANN401, ARG001
    b: Any,  # noqa: ANN401, ARG001
    c: Any,  # noqa: ANN401, ARG001
    d: Any,  # noqa: ANN401, ARG001
    e: Any,  # noqa: ANN401, ARG001
    g: Any,  # noqa: ANN401, ARG001
) -> Any:  # noqa: ANN401
    return _generate("LDDLLLLL")


def _make_call(kinds: str, of_numba: Callable[..., Any]) -> Any:  # noqa: ANN401 - numba's
    """Return the function for kernels, or for Python where kernels run as Python."""
    if not is_interpreted():
        return intrinsic(of_numba)
    of_kind: dict[str, Any] = {"L": ctypes.c_int64, "D": ctypes.c_double}
    kind = ctypes.CFUNCTYPE(ctypes.c_int, *(of_kind[each] for each in kinds))
    plain = [float if each == "D" else int for each in kinds]

    def call(function: int, *args: float) -> int:
        values = (make(each) for make, each in zip(plain, args, strict=True))
        return int(kind(int(function))(*values))

    return call


_call_2, _call_3 = _make_call("LL", _two), _make_call("LLL", _three)
_call_4, _call_5 = _make_call("LLLL", _four), _make_call("LLLLL", _five)
_step_2, _step_3 = _make_call("LDDL", _of_step_2), _make_call("LDDLLLLL", _of_step_3)


@core_kernel
def _begin(report: Array, call: int) -> None:
    """Report a call before it is made: it may not return."""
    report[CALL] = call


@core_kernel
def _check(report: Array, status: int) -> None:
    """Raise an error unless a call has worked."""
    report[STATUS] = status
    if status < 0 or status > WARNING:
        raise ValueError("a function of the FMU has failed")


@core_kernel
def _refuse(report: Array, reason: int) -> None:
    report[CALL] = reason
    raise ValueError("the FMU cannot be stepped")


@core_kernel
def _copy_three(values: Array, numbers: Array, place: int) -> None:
    for k in range(3):
        numbers[place + k] = values[k]


@core_kernel
def write_numbers(now: float, own: OwnState, inbox: Inbox, aircraft: int, numbers: Array) -> None:
    """Write the inputs of a follower; of a message that has not arrived all but its age is zero.

    Args:
        now: s.
        own: its estimate.
        inbox: its messages (N).
        aircraft: of which messages are inputs, the first ones.
        numbers: (F,) written.
    """
    numbers[NOW] = now
    _copy_three(own.position_ned, numbers, POSITION)
    _copy_three(own.velocity_ned, numbers, VELOCITY)
    _copy_three(own.acceleration_ned, numbers, ACCELERATION)
    _copy_three(own.euler, numbers, EULER)
    _copy_three(own.rates_body, numbers, RATES)
    _copy_three(own.wind_ned, numbers, WIND)
    numbers[AIRSPEED] = own.airspeed
    numbers[EQUIVALENT_AIRSPEED] = own.equivalent_airspeed
    for j in range(aircraft):
        at = FIRST_MESSAGE + MESSAGE_SIZE * j
        if isnan(inbox.received_s[j]) or isnan(inbox.stamp_s[j]):
            for k in range(MESSAGE_SIZE):
                numbers[at + k] = 0.0
            numbers[at + STAMP] = numbers[at + RECEIVED] = -NEVER_S
            numbers[at + AGE] = NEVER_S
            continue
        numbers[at + STAMP], numbers[at + RECEIVED] = inbox.stamp_s[j], inbox.received_s[j]
        numbers[at + AGE] = now - inbox.received_s[j]
        turn_rate = inbox.turn_rate[j]
        numbers[at + TURN_RATE] = 0.0 if isnan(turn_rate) else turn_rate
        numbers[at + FAILED] = 1.0 if inbox.failed[j] else 0.0
        _copy_three(inbox.position_ned[j], numbers, at + MESSAGE_POSITION)
        _copy_three(inbox.velocity_ned[j], numbers, at + MESSAGE_VELOCITY)
        _copy_three(inbox.acceleration_ned[j], numbers, at + MESSAGE_ACCELERATION)
        _copy_three(inbox.euler[j], numbers, at + MESSAGE_EULER)
        _copy_three(inbox.euler_rates[j], numbers, at + MESSAGE_EULER_RATES)


@core_kernel
def _restore(words: NDArray[np.int64], instance: int, source: int, report: Array) -> None:
    """Set the state of an instance to the bytes at an address."""
    words[STATE] = 0
    at = words.ctypes.data
    _begin(report, DESERIALIZE)
    f, size = words[FUNCTIONS + DESERIALIZE], words[STATE_BYTES]
    _check(report, _call_4(f, instance, source, size, at + STATE * WORD))
    _begin(report, SET_STATE)
    _check(report, _call_2(words[FUNCTIONS + SET_STATE], instance, words[STATE]))


@core_kernel
def _keep(words: NDArray[np.int64], instance: int, target: int, report: Array) -> None:
    """Write the state of an instance to an address."""
    at = words.ctypes.data
    _begin(report, GET_STATE)
    _check(report, _call_2(words[FUNCTIONS + GET_STATE], instance, at + STATE * WORD))
    _begin(report, STATE_SIZE)
    f, state = words[FUNCTIONS + STATE_SIZE], words[STATE]
    _check(report, _call_3(f, instance, state, at + SIZE * WORD))
    size = words[STATE_BYTES]
    if words[SIZE] != size:
        _refuse(report, OTHER_SIZE)
    _begin(report, SERIALIZE)
    _check(report, _call_4(words[FUNCTIONS + SERIALIZE], instance, state, target, size))
    _begin(report, FREE_STATE)
    _check(report, _call_2(words[FUNCTIONS + FREE_STATE], instance, at + STATE * WORD))


@core_kernel
def _set_inputs(
    words: NDArray[np.int64], instance: int, places: Indices, numbers: Array, report: Array
) -> None:
    of_2, count, flagged = words[VERSION] == 2, words[INPUT_VALUES], words[FLAG_VALUES]
    if count:
        first = words[VALUES_AT]
        for k in range(count):
            numbers[first + k] = numbers[places[k]]
        f, refs, n = words[FUNCTIONS + SET_REAL], words[INPUT_REFS], words[INPUT_COUNT]
        at = numbers.ctypes.data + first * WORD
        _begin(report, SET_REAL)
        if of_2:
            _check(report, _call_4(f, instance, refs, n, at))
        else:
            _check(report, _call_5(f, instance, refs, n, at, count))
    if flagged:
        size, flags = (4 if of_2 else 1), words[FLAGS_AT:].view(np.uint8)  # little-endian
        for k in range(flagged):
            flags[size * k] = 1 if numbers[places[count + k]] != 0.0 else 0
        f, refs, n = words[FUNCTIONS + SET_BOOLEAN], words[FLAG_REFS], words[FLAG_COUNT]
        at = words.ctypes.data + FLAGS_AT * WORD
        _begin(report, SET_BOOLEAN)
        if of_2:
            _check(report, _call_4(f, instance, refs, n, at))
        else:
            _check(report, _call_5(f, instance, refs, n, at, flagged))


@core_kernel
def _do_step(
    words: NDArray[np.int64], instance: int, begin_s: float, dt: float, report: Array
) -> None:
    f, keeps = words[FUNCTIONS + DO_STEP], 0 if words[STATE_BYTES] else 1
    _begin(report, DO_STEP)
    if words[VERSION] == 2:
        _check(report, _step_2(f, instance, begin_s, dt, keeps))
        return
    at = words.ctypes.data + RETURNED * WORD
    for k in range(4):
        words[RETURNED + k] = 0
    event, ends, early, last = at, at + WORD, at + 2 * WORD, at + 3 * WORD
    _check(report, _step_3(f, instance, begin_s, dt, keeps, event, ends, early, last))
    if (words[RETURNED + 1] & 0xFF) or (
        words[RETURNED + 2] & 0xFF
    ):  # it ends, or has returned early
        _check(report, DISCARD)


@core_kernel
def _get_outputs(
    words: NDArray[np.int64], instance: int, places: Indices, numbers: Array, report: Array
) -> None:
    first, count, command = words[FOUND_AT], words[OUTPUT_VALUES], words[COMMAND_AT]
    f, refs, n = words[FUNCTIONS + GET_REAL], words[OUTPUT_REFS], words[OUTPUT_COUNT]
    at = numbers.ctypes.data + first * WORD
    _begin(report, GET_REAL)
    if words[VERSION] == 2:
        _check(report, _call_4(f, instance, refs, n, at))
    else:
        _check(report, _call_5(f, instance, refs, n, at, count))
    skipped = words[INPUT_VALUES] + words[FLAG_VALUES]
    for k in range(count):
        value = numbers[first + k]
        numbers[command + places[skipped + k]] = value
        if not abs(value) < np.inf:
            _refuse(report, NOT_FINITE)


@core_kernel
def step_fmu(
    now: float, own: OwnState, inbox: Inbox, memory: Values, config: Values, fmu: FmuStep
) -> Array:
    """Step the FMU of one follower, and return its outputs (COMMAND_SIZE,).

    Raises:
        ValueError: a call has failed; the report has which.
    """
    report, row = fmu.report, config.agents
    words, numbers, places = fmu.words[row], fmu.numbers[row], fmu.places
    report[TIME_S], report[ROW], report[STATUS] = now, row, 0.0
    if now >= report[STOP_S]:
        _refuse(report, STOPPED)
    instance, kept = words[INSTANCES + memory.instance], memory.state.ctypes.data
    if words[STATE_BYTES]:
        source = kept if memory.steps > 0 else words[INITIAL]
        _restore(words, instance, source, report)
    write_numbers(now, own, inbox, words[AIRCRAFT], numbers)
    _set_inputs(words, instance, places, numbers, report)
    _do_step(words, instance, memory.steps * config.dt, config.dt, report)
    _get_outputs(words, instance, places, numbers, report)
    if words[STATE_BYTES]:
        _keep(words, instance, kept, report)
    memory.steps += 1
    report[CALL] = -1.0
    first = words[COMMAND_AT]
    command: Array = numbers[first : first + COMMAND_SIZE]
    return command


def fly_by_wire(
    now: float, own: OwnState, inbox: Inbox, memory: Values, config: Values, fmu: FmuStep
) -> FbwaCommand[float]:
    """Return outputs that are pitch, roll and throttle."""
    command = step_fmu(now, own, inbox, memory, config, fmu)
    return FbwaCommand(command[0], command[1], command[2])


def desired_velocity(
    now: float, own: OwnState, inbox: Inbox, memory: Values, config: Values, fmu: FmuStep
) -> UnicycleCommand:
    """Return the command of outputs that are a velocity and its derivative."""
    command = step_fmu(now, own, inbox, memory, config, fmu)
    return command_from_velocity(config, own, command[0:3], command[3:6])


def unicycle(
    now: float, own: OwnState, inbox: Inbox, memory: Values, config: Values, fmu: FmuStep
) -> UnicycleCommand:
    """Return outputs that are u, ω, s_d and y_d."""
    command = step_fmu(now, own, inbox, memory, config, fmu)
    flags: Any = 0  # one number of one follower
    return UnicycleCommand(command[0], command[1:4], command[4], command[5:8], flags)


LAWS: dict[str, Callable[..., Any]] = {
    "fly-by-wire": fly_by_wire,
    "velocity": desired_velocity,
    "unicycle": unicycle,
}


def law_of_kind(kind: str, state_bytes: int) -> Any:  # noqa: ANN401 - numba's dispatcher
    """Return the law whose outputs are of a kind, one of `LAWS`, with a memory for the state."""
    return kernel(memory=memory_fields(state_bytes))(LAWS[kind])
