"""Step a law that is an FMU from compiled code: its functions are called by their addresses.

Addresses, value references and places are data, so one kernel steps every FMU. The state of the FMU
is bytes in the law's memory: it is set before a step and got after it.

Source of the functions: FMI 2.0.4, section 4.2, and FMI 3.0.1, section 4.2.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from math import isnan
from typing import Any, Final, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from testbed.core.call_list import Words
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
WARNING: Final = 1  # the largest status of a call that has worked
WORD = 8  # bytes


class FmuStep(NamedTuple):
    """What a step of an FMU needs, for n followers of N aircraft."""

    functions: Words  # (10,) addresses
    instances: Words  # (S, n) addresses of instances; S: sets of them, 1 where there is a state
    rows: Indices  # (N,) row of an aircraft among the followers
    inputs: NDArray[np.uint32]  # (k,) value references of real inputs
    input_places: Indices  # (v,) places of their values
    flags: NDArray[np.uint32]  # (b,) value references of Boolean inputs
    flag_places: Indices  # (c,) places of their values
    outputs: NDArray[np.uint32]  # (o,) value references of outputs
    output_places: Indices  # (w,) places of their values in the command
    numbers: Array  # (n, F) inputs, scratch
    values: Array  # (n, v) scratch
    flag_values: NDArray[np.uint8]  # (n, 4 c) scratch
    found: Array  # (n, w) scratch
    command: Array  # (n, COMMAND_SIZE) scratch
    words: Words  # (n, 8) scratch: the state, its size, what a step says
    initial: Words  # (n, W) state before the first step
    report: Array  # (4,) time, row among the N aircraft, call and status of the present call
    stop_s: Array  # (1,) time of the step that is not made, s
    version: int  # of FMI
    state_bytes: int  # 0: the state is in the instances
    aircraft: int  # of which messages are inputs


def memory_fields(state_bytes: int) -> list[tuple[Any, ...]]:
    """Return the fields of the memory of a law."""
    state = ("state", np.uint64, (state_words(state_bytes),))
    return [("steps", np.int64), ("instance", np.int64), state]


def state_words(state_bytes: int) -> int:
    """Return how many words hold a state: a power of two, so that few sizes are compiled."""
    words = 8
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
def _begin(fmu: FmuStep, call: int) -> None:
    """Report a call before it is made: it may not return."""
    fmu.report[2] = call


@core_kernel
def _check(fmu: FmuStep, status: int) -> None:
    """Raise an error unless a call has worked."""
    fmu.report[3] = status
    if status < 0 or status > WARNING:
        raise ValueError("a function of the FMU has failed")


@core_kernel
def _refuse(fmu: FmuStep, reason: int) -> None:
    fmu.report[2] = reason
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
def _restore(fmu: FmuStep, i: int, instance: int, memory: Values) -> None:
    """Set the state of an instance to that of the memory, or to the one before the first step."""
    words = fmu.words[i]
    source = memory.state if memory.steps > 0 else fmu.initial[i]
    words[0] = 0
    _begin(fmu, DESERIALIZE)
    _check(
        fmu,
        _call_4(
            fmu.functions[DESERIALIZE],
            instance,
            source.ctypes.data,
            fmu.state_bytes,
            words.ctypes.data,
        ),
    )
    _begin(fmu, SET_STATE)
    _check(fmu, _call_2(fmu.functions[SET_STATE], instance, words[0]))


@core_kernel
def _keep(fmu: FmuStep, i: int, instance: int, memory: Values) -> None:
    """Write the state of an instance into the memory."""
    words = fmu.words[i]
    at = words.ctypes.data
    _begin(fmu, GET_STATE)
    _check(fmu, _call_2(fmu.functions[GET_STATE], instance, at))
    _begin(fmu, STATE_SIZE)
    _check(fmu, _call_3(fmu.functions[STATE_SIZE], instance, words[0], at + WORD))
    if words[1] != fmu.state_bytes:
        _refuse(fmu, OTHER_SIZE)
    _begin(fmu, SERIALIZE)
    _check(
        fmu,
        _call_4(
            fmu.functions[SERIALIZE], instance, words[0], memory.state.ctypes.data, fmu.state_bytes
        ),
    )
    _begin(fmu, FREE_STATE)
    _check(fmu, _call_2(fmu.functions[FREE_STATE], instance, at))


@core_kernel
def _set_inputs(fmu: FmuStep, i: int, instance: int) -> None:
    numbers, values, flags = fmu.numbers[i], fmu.values[i], fmu.flag_values[i]
    count, flagged = len(fmu.input_places), len(fmu.flag_places)
    if count:
        for k in range(count):
            values[k] = numbers[fmu.input_places[k]]
        f, refs, at = fmu.functions[SET_REAL], fmu.inputs.ctypes.data, values.ctypes.data
        _begin(fmu, SET_REAL)
        if fmu.version == 2:
            _check(fmu, _call_4(f, instance, refs, len(fmu.inputs), at))
        else:
            _check(fmu, _call_5(f, instance, refs, len(fmu.inputs), at, count))
    if flagged:
        size = 4 if fmu.version == 2 else 1  # of a Boolean, little-endian
        for k in range(flagged):
            flags[size * k] = 1 if numbers[fmu.flag_places[k]] != 0.0 else 0
        f, refs, at = fmu.functions[SET_BOOLEAN], fmu.flags.ctypes.data, flags.ctypes.data
        _begin(fmu, SET_BOOLEAN)
        if fmu.version == 2:
            _check(fmu, _call_4(f, instance, refs, len(fmu.flags), at))
        else:
            _check(fmu, _call_5(f, instance, refs, len(fmu.flags), at, flagged))


@core_kernel
def _do_step(fmu: FmuStep, i: int, instance: int, begin_s: float, dt: float) -> None:
    f, keeps = fmu.functions[DO_STEP], 0 if fmu.state_bytes else 1
    _begin(fmu, DO_STEP)
    if fmu.version == 2:
        _check(fmu, _step_2(f, instance, begin_s, dt, keeps))
        return
    at = fmu.words[i].ctypes.data
    for k in range(2, 6):
        fmu.words[i, k] = 0
    _check(
        fmu,
        _step_3(
            f, instance, begin_s, dt, keeps,
            at + 2 * WORD, at + 3 * WORD, at + 4 * WORD, at + 5 * WORD,
        ),
    )  # fmt: skip
    if (fmu.words[i, 3] & 0xFF) or (fmu.words[i, 4] & 0xFF):  # it terminates, or has returned early
        fmu.report[3] = 2
        raise ValueError("the FMU has ended")


@core_kernel
def _get_outputs(fmu: FmuStep, i: int, instance: int) -> None:
    found, command = fmu.found[i], fmu.command[i]
    count = len(fmu.output_places)
    f, refs, at = fmu.functions[GET_REAL], fmu.outputs.ctypes.data, found.ctypes.data
    _begin(fmu, GET_REAL)
    if fmu.version == 2:
        _check(fmu, _call_4(f, instance, refs, len(fmu.outputs), at))
    else:
        _check(fmu, _call_5(f, instance, refs, len(fmu.outputs), at, count))
    for k in range(count):
        command[fmu.output_places[k]] = found[k]
        if not abs(found[k]) < np.inf:
            _refuse(fmu, NOT_FINITE)


@core_kernel
def step_fmu(
    now: float, own: OwnState, inbox: Inbox, memory: Values, config: Values, fmu: FmuStep
) -> Array:
    """Step the FMU of one follower, and return its outputs (COMMAND_SIZE,).

    Raises:
        ValueError: a call has failed; the report has which.
    """
    i = fmu.rows[config.agents]
    report = fmu.report
    report[0], report[1], report[3] = now, config.agents, 0.0
    if now >= fmu.stop_s[0]:
        _refuse(fmu, STOPPED)
    instance = fmu.instances[memory.instance, i]
    if fmu.state_bytes:
        _restore(fmu, i, instance, memory)
    write_numbers(now, own, inbox, fmu.aircraft, fmu.numbers[i])
    _set_inputs(fmu, i, instance)
    _do_step(fmu, i, instance, memory.steps * config.dt, config.dt)
    _get_outputs(fmu, i, instance)
    if fmu.state_bytes:
        _keep(fmu, i, instance, memory)
    memory.steps += 1
    report[2] = -1.0
    command: Array = fmu.command[i]
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
