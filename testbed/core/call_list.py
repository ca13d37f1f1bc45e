"""Call entries one after the other from compiled code, until one asks for Python.

From Python an entry costs 0.04 µs per call and up to 0.2 µs for each array that it takes; from
compiled code some nanoseconds. The addresses of its arguments are written down once, when the entry
is bound.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import (
    address_of,
    entry_beside_python,
    is_interpreted,
    prepare,
    register,
    types_of,
)

Words = NDArray[np.uint64]
NOW: Final = object()  # the time of the tick, s; the last argument of a call


class Call:
    """An entry with all of its arguments, which it reads and writes in place.

    It returns 0, false or nothing where Python has nothing to do after it.

    Args:
        function: an entry.
        args: arrays, numbers, tuples of numbers; the last may be `NOW`.
    """

    ADDRESSES = "words", "_alone"

    def __init__(self, function: Callable[..., Any], *args: Any) -> None:  # noqa: ANN401
        self._function, self._takes_time = function, bool(args) and args[-1] is NOW
        self._args = args[:-1] if self._takes_time else args
        if not is_interpreted():
            self._compiled = _compiled(function, self._takes_time)
            register(self._compiled, *self._args)

    @functools.cached_property
    def words(self) -> Words:
        """Addresses of a caller and of the entry, then the arguments, as words of 8 bytes."""
        return np.array(self._list_words(), dtype=np.uint64)

    def _list_words(self) -> list[int]:
        types = types_of(self._args)
        words = [*self._compiled.compile(types)]
        for value, kind in zip(self._args, types, strict=True):
            words += _to_words(value, kind)
        return words

    @property
    def address(self) -> int:
        """Address of the words, for `call_words`."""
        return int(self.words.ctypes.data)

    def bind(self) -> None:
        """Write down the addresses, which else the first call does; after `compile.prepare`."""
        if not is_interpreted():
            _ = self.words

    def prepare(self) -> None:
        """Compile or load it now, with the progress of `compile.reporting`, and bind it."""
        if not is_interpreted():
            prepare([(self._compiled, self._args)])
        self.bind()

    def rebind(self, *args: Any) -> None:  # noqa: ANN401
        """Replace all arguments but `NOW` by others of the same types."""
        self._args = args
        if "words" in self.__dict__:
            self.words[:] = self._list_words()

    def __call__(self, now: float) -> int:
        """Call the entry from Python at a time, s."""
        if is_interpreted():
            time = (now,) if self._takes_time else ()
            return int(self._function(*self._args, *time) or 0)
        alone = self._alone
        alone.run(0, now)
        return int(alone.found[0])

    @functools.cached_property
    def _alone(self) -> CallList:
        return CallList([self])


PythonStep: TypeAlias = Callable[[float], object]  # of the time of a tick, s
# In a pair the step of Python runs where the call returns something but 0.
Step: TypeAlias = Call | PythonStep | tuple[Call, PythonStep]
Steps: TypeAlias = tuple[Step, ...]


def run_steps(steps: Sequence[Step], now: float) -> None:
    """Run steps from Python at a time, s."""
    for step in steps:
        if not isinstance(step, tuple):
            step(now)
        elif step[0](now):
            step[1](now)


def steps_if(condition: Call, steps: Sequence[Step]) -> Iterator[Step]:
    """Yield steps of which those in Python run only where a call returns something but 0."""
    for step in steps:
        yield step if isinstance(step, Call | tuple) else (condition, step)


class CallList:
    """Calls in order; None stands for a step of Python's.

    Attributes:
        found: what the call returned at which `run` ended, (1,); 0: a step of Python's.
    """

    ADDRESSES = ("_addresses",)

    def __init__(self, calls: Sequence[Call | None]) -> None:
        """See the class; nothing is compiled or called yet."""
        self._calls = tuple(calls)
        self.found = np.zeros(1, dtype=np.int64)
        self._run = self._run_interpreted if is_interpreted() else self._run_compiled
        if not is_interpreted():
            register(_run_calls, np.zeros(0, dtype=np.uint64), 0, 0.0, self.found)  # type: ignore[arg-type]

    def run(self, first: int, now: float) -> int:
        """Call from number `first` on, at a time, s, up to the first that asks for Python.

        Returns:
            The number of that one, or that of all calls.
        """
        return self._run(first, now)

    @functools.cached_property
    def _addresses(self) -> Words:
        """Address of the words of each call; 0: none."""
        found = (0 if each is None else each.address for each in self._calls)
        return np.fromiter(found, dtype=np.uint64, count=len(self._calls))

    def _run_compiled(self, first: int, now: float) -> int:
        return _run_calls(self._addresses, first, now, self.found)

    def _run_interpreted(self, first: int, now: float) -> int:
        for number in range(first, len(self._calls)):
            call = self._calls[number]
            self.found[0] = 0 if call is None else call(now)
            if call is None or self.found[0]:
                return number
        return len(self._calls)


class StepList:
    """Steps in order, as of `run_steps`; calls that follow one another run from compiled code."""

    def __init__(self, steps: Sequence[Step]) -> None:
        """See the class; nothing is compiled or called yet."""
        self._steps = tuple(each if isinstance(each, tuple) else (each, None) for each in steps)
        firsts = [first for first, _ in self._steps]
        self._calls = CallList([each if isinstance(each, Call) else None for each in firsts])

    def run(self, now: float) -> None:
        """Run them at a time, s."""
        number = -1
        while (number := self._calls.run(number + 1, now)) < len(self._steps):
            step, then = self._steps[number]
            if then is not None:
                then(now)
            elif not isinstance(step, Call):
                step(now)


class CalledByAddress:
    """An entry, whose machine code is called by its address.

    Attributes:
        function: the entry.
    """

    CONSTANT = True  # for a flight

    def __init__(self, function: Any, takes_time: bool) -> None:  # noqa: ANN401 - numba's
        self.__module__, self.__qualname__ = function.__module__, function.__qualname__
        self.function, self._takes_time = function, takes_time
        self._addresses: dict[tuple[Any, ...], tuple[int, int]] = {}

    def has(self, types: tuple[Any, ...]) -> bool:
        """Return whether there is machine code for arguments of these types, numba's."""
        return types in self._addresses

    def compile(self, types: tuple[Any, ...]) -> tuple[int, int]:
        """Compile or load the entry for arguments of these types, numba's.

        Returns:
            Address of a function of words and time, and that of the entry, which it calls.
        """
        if types not in self._addresses:
            time = (_numba_types().float64,) if self._takes_time else ()
            self.function.compile((*types, *time))
            compiled = self.function.overloads[(*types, *time)]
            name = compiled.fndesc.llvm_func_name
            address = int(compiled.library.get_pointer_to_function(name))
            caller = _caller_address(types, compiled.signature.return_type, self._takes_time)
            self._addresses[types] = caller, address
        return self._addresses[types]


@functools.cache
def _caller_address(kinds: tuple[Any, ...], returns: Any, takes_time: bool) -> int:  # noqa: ANN401
    """Return the address of a function of words and time that calls entries of these types.

    Args:
        kinds: types of the arguments but the time, numba's.
        returns: type of the result.
        takes_time: the time is the last argument.
    """
    types = _numba_types()
    call = _make_call_entry(kinds, returns, takes_time)

    def call_entry(words: Any, now: float) -> int:  # noqa: ANN401
        return int(call(words, now))

    text = f"{kinds} {returns} {takes_time}"
    name = f"call_entry_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    call_entry.__name__ = call_entry.__qualname__ = name
    return address_of(call_entry, types.int64, types.CPointer(types.uint64), types.float64)


def _make_call_entry(kinds: tuple[Any, ...], returns: Any, takes_time: bool) -> Any:  # noqa: ANN401
    """Return the function for kernels that calls an entry, whose address is word 1."""
    from llvmlite import ir
    from numba import extending

    types, intrinsic = _numba_types(), extending.intrinsic

    @intrinsic
    def call(typing_context: Any, words: Any, now: Any) -> Any:  # noqa: ANN401, ARG001
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401, ARG001
            word = ir.IntType(64)
            reader = _WordReader(context, builder, args[0])
            address = reader.read(types.uint64)
            values = [reader.read(kind) for kind in kinds]
            all_kinds = (*kinds, types.float64) if takes_time else kinds
            values += [args[1]] if takes_time else []
            function = context.call_conv.get_function_type(returns, all_kinds)
            callee = builder.inttoptr(address, function.as_pointer())
            _, found = context.call_conv.call_function(builder, callee, returns, all_kinds, values)
            if returns == types.none:
                return ir.Constant(word, 0)
            return found if found.type == word else builder.zext(found, word)

        return types.int64(types.CPointer(types.uint64), types.float64), generate

    return call


@functools.cache
def _compiled(function: Any, takes_time: bool) -> CalledByAddress:  # noqa: ANN401 - numba's
    return CalledByAddress(function, takes_time)


def _numba_types() -> Any:  # noqa: ANN401
    import numba

    return numba.types


def _to_words(value: Any, kind: Any) -> list[int]:  # noqa: ANN401 - numba's
    """Return an argument of a type as words, in the order of `_WordReader`."""
    types = _numba_types()

    if isinstance(kind, types.Array):
        return [value.ctypes.data, *value.shape, *(stride % 2**64 for stride in value.strides)]
    if isinstance(kind, types.BaseTuple):
        return [word for each, of in zip(value, kind, strict=True) for word in _to_words(each, of)]
    as_float = isinstance(kind, types.Float)
    return [int(np.array(value, dtype=np.float64 if as_float else np.int64).view(np.uint64))]


class _WordReader:
    """Generates the code that turns words into numba's values; the first word is skipped."""

    def __init__(self, context: Any, builder: Any, words: Any) -> None:  # noqa: ANN401 - numba's
        self._context, self._builder, self._words, self._at = context, builder, words, 0

    def read(self, kind: Any) -> Any:  # noqa: ANN401 - numba's
        """Return the next argument, of a type."""
        types = _numba_types()
        from numba.np import arrayobj

        arrays: Any = arrayobj
        context, builder = self._context, self._builder
        if isinstance(kind, types.Array):
            array = arrays.make_array(kind)(context, builder)
            pointer = context.get_data_type(kind.dtype).as_pointer()
            item = context.get_abi_sizeof(context.get_data_type(kind.dtype))
            arrays.populate_array(
                array,
                data=builder.inttoptr(self._word(), pointer),
                shape=[self._word() for _ in range(kind.ndim)],
                strides=[self._word() for _ in range(kind.ndim)],
                itemsize=context.get_constant(types.intp, item),
                meminfo=None,
            )
            return array._getvalue()
        if isinstance(kind, types.BaseTuple):
            return context.make_tuple(builder, kind, [self.read(each) for each in kind])
        if isinstance(kind, types.Float):
            return builder.bitcast(self._word(), context.get_value_type(kind))
        return builder.trunc(self._word(), context.get_value_type(kind))

    def _word(self) -> Any:  # noqa: ANN401 - numba's
        types = _numba_types()

        self._at += 1
        index = self._context.get_constant(types.intp, self._at)
        return self._builder.load(self._builder.gep(self._words, [index]))


def _make_call() -> Any:  # noqa: ANN401 - numba's
    """Return the function for kernels that calls machine code by the address of its words."""
    from llvmlite import ir
    from numba import extending

    types, intrinsic = _numba_types(), extending.intrinsic

    @intrinsic
    def call(typing_context: Any, words: Any, now: Any) -> Any:  # noqa: ANN401, ARG001
        signature = types.int64(types.uint64, types.float64)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401, ARG001
            word, time = ir.IntType(64), ir.DoubleType()
            kind = ir.FunctionType(word, [word.as_pointer(), time])
            words = builder.inttoptr(args[0], word.as_pointer())
            function = builder.inttoptr(builder.load(words), kind.as_pointer())
            return builder.call(function, [words, args[1]])

        return signature, generate

    return call


# Calls an entry by the address of the words of its `Call`, at a time; of the module: in a closure,
# machine code on disk would not be found.
call_words = _make_call()


@entry_beside_python
def _run_calls(addresses: Words, first: int, now: float, found: NDArray[np.int64]) -> int:
    """Run the calls at these addresses; see `CallList.run`."""
    for number in range(first, len(addresses)):
        found[0] = 0
        if addresses[number] != 0:
            found[0] = call_words(addresses[number], now)
            if found[0] == 0:
                continue
        return number
    return len(addresses)


@entry_beside_python
def run_each(addresses: Words, found: NDArray[np.int64]) -> None:
    """Run the calls at these addresses (K,), and write what each returns."""
    for k in range(len(addresses)):
        found[k] = call_words(addresses[k], 0.0)
