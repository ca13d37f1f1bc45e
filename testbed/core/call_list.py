"""Call entries one after the other from compiled code, until one asks for Python.

From Python an entry costs 0.04 µs per call and up to 0.2 µs for each array that it takes; from
compiled code some nanoseconds. The addresses of its arguments are written down once, when the entry
is bound.
"""

from __future__ import annotations

import functools
import hashlib
from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from testbed.core.compile import address_of, entry, is_interpreted, register, types_of

Words = NDArray[np.uint64]
NOW: Final = object()  # the time of the tick, s; the last argument of a call


class Call:
    """An entry with all of its arguments, which it reads and writes in place.

    It returns 0, false or nothing where Python has nothing to do after it.

    Args:
        function: an entry.
        args: arrays, numbers, tuples of numbers; the last may be `NOW`.
    """

    def __init__(self, function: Callable[..., Any], *args: Any) -> None:  # noqa: ANN401
        """See the class."""
        self._function, self._takes_time = function, bool(args) and args[-1] is NOW
        self._args = args[:-1] if self._takes_time else args
        if not is_interpreted():
            self._compiled = _compiled(function, self._takes_time)
            register(self._compiled, *self._args)

    @functools.cached_property
    def words(self) -> Words:
        """Address of the machine code, then the arguments; each has words of 8 bytes."""
        return np.array(self._list_words(), dtype=np.uint64)

    def _list_words(self) -> list[int]:
        types = types_of(self._args)
        words = [self._compiled.compile(types)]
        for value, kind in zip(self._args, types, strict=True):
            words += _to_words(value, kind)
        return words

    def bind(self) -> None:
        """Write down the addresses, which else the first call does; after `compile.prepare`."""
        if not is_interpreted():
            _ = self.words

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


class CallList:
    """Calls in order; None stands for a step of Python's.

    Attributes:
        found: what the call returned at which `run` ended, (1,); 0: a step of Python's.
    """

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
        found = (0 if each is None else each.words.ctypes.data for each in self._calls)
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


class CalledByAddress:
    """An entry as machine code that takes its arguments as words.

    Attributes:
        function: the entry.
    """

    def __init__(self, function: Any, takes_time: bool) -> None:  # noqa: ANN401 - numba's
        """Start without machine code."""
        self.__module__, self.__qualname__ = function.__module__, f"{function.__qualname__}/words"
        self.function, self._takes_time = function, takes_time
        self._addresses: dict[tuple[Any, ...], int] = {}

    @property
    def types(self) -> list[tuple[Any, ...]]:
        """Types of the arguments for which there is machine code, numba's."""
        return list(self._addresses)

    def compile(self, types: tuple[Any, ...]) -> int:
        """Compile or load it for arguments of these types, numba's; return its address."""
        if types not in self._addresses:
            numba_types = _numba_types()
            words = numba_types.CPointer(numba_types.uint64)
            returns, time = numba_types.int64, numba_types.float64
            self._addresses[types] = address_of(self._wrapper(types), returns, words, time)
        return self._addresses[types]

    def _wrapper(self, types: tuple[Any, ...]) -> Callable[..., int]:
        """Return the function of words and time; its name tells entry and types."""
        import numba

        njit: Any = numba.njit
        plain = self.function.py_func
        inner = njit(error_model="numpy", no_cpython_wrapper=True)(plain)
        returns = plain.__annotations__["return"] not in ("None", None)
        wrapper = _make_wrapper(inner, _loader(types), self._takes_time, returns)
        digest = hashlib.sha256(str(types).encode()).hexdigest()[:16]
        name = f"{plain.__module__.replace('.', '_')}_{plain.__name__}_{digest}"
        wrapper.__name__ = wrapper.__qualname__ = name
        return wrapper


def _make_wrapper(
    inner: Any,  # noqa: ANN401 - numba's
    load: Any,  # noqa: ANN401
    takes_time: bool,
    returns: bool,
) -> Callable[..., int]:
    """Return the function of words and time that calls another one."""

    def found_at(words: Any, now: float) -> int:  # noqa: ANN401
        return int(inner(*load(words), now))

    def found(words: Any, now: float) -> int:  # noqa: ANN401, ARG001
        return int(inner(*load(words)))

    def nothing_at(words: Any, now: float) -> int:  # noqa: ANN401
        inner(*load(words), now)
        return 0

    def nothing(words: Any, now: float) -> int:  # noqa: ANN401, ARG001
        inner(*load(words))
        return 0

    if returns:
        return found_at if takes_time else found
    return nothing_at if takes_time else nothing


def _numba_types() -> Any:  # noqa: ANN401
    import numba

    return numba.types


@functools.cache
def _compiled(function: Any, takes_time: bool) -> CalledByAddress:  # noqa: ANN401 - numba's
    return CalledByAddress(function, takes_time)


def _to_words(value: Any, kind: Any) -> list[int]:  # noqa: ANN401 - numba's
    """Return an argument of a type as words, in the order of `_load`."""
    types = _numba_types()

    if isinstance(kind, types.Array):
        return [value.ctypes.data, *value.shape, *(stride % 2**64 for stride in value.strides)]
    if isinstance(kind, types.BaseTuple):
        return [word for each, of in zip(value, kind, strict=True) for word in _to_words(each, of)]
    as_float = isinstance(kind, types.Float)
    return [int(np.array(value, dtype=np.float64 if as_float else np.int64).view(np.uint64))]


def _loader(kinds: tuple[Any, ...]) -> Any:  # noqa: ANN401 - numba's
    """Return the function of words, for kernels, that returns arguments of these types."""
    types = _numba_types()
    from numba import extending

    intrinsic: Any = extending.intrinsic

    @intrinsic  # type: ignore[untyped-decorator]
    def load(typing_context: Any, words: Any) -> Any:  # noqa: ANN401, ARG001 - numba's protocol
        signature = types.Tuple(kinds)(types.CPointer(types.uint64))

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401
            reader = _WordReader(context, builder, args[0])
            values = [reader.read(kind) for kind in kinds]
            return context.make_tuple(builder, signature.return_type, values)

        return signature, generate

    return load


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


def _make_run_calls() -> Callable[[Words, int, float, NDArray[np.int64]], int]:
    from llvmlite import ir

    types = _numba_types()
    from numba import extending

    intrinsic: Any = extending.intrinsic

    @intrinsic  # type: ignore[untyped-decorator]
    def call(typing_context: Any, words: Any, now: Any) -> Any:  # noqa: ANN401, ARG001
        signature = types.int64(types.uint64, types.float64)

        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:  # noqa: ANN401, ARG001
            word, time = ir.IntType(64), ir.DoubleType()
            kind = ir.FunctionType(word, [word.as_pointer(), time])
            words = builder.inttoptr(args[0], word.as_pointer())
            function = builder.inttoptr(builder.load(words), kind.as_pointer())
            return builder.call(function, [words, args[1]])

        return signature, generate

    @entry
    def run_calls(addresses: Words, first: int, now: float, found: NDArray[np.int64]) -> int:
        """Run the calls at these addresses; see `CallList.run`."""
        for number in range(first, len(addresses)):
            found[0] = 0
            if addresses[number] != 0:
                found[0] = call(addresses[number], now)
                if found[0] == 0:
                    continue
            return number
        return len(addresses)

    return run_calls


_run_calls = _make_run_calls()
