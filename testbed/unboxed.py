"""Arguments of compiled functions that are unboxed once and not at every call.

numba looks at each array of a call anew: a tenth of a microsecond, which for the forty arrays of a
formation law is more than the law. What is bound to a function is the same arrays at every call,
so they are laid out in memory as machine code has them, and a call is handed their address.

Only `testbed.compiled` imports this, where numba is.
"""

# numba and llvmlite have no types, and numba compiles what is in here.
# ruff: noqa: ANN001, ANN201, ANN202, F821
# mypy: ignore-errors

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import chain
from types import FunctionType
from typing import Any

import numpy as np
from llvmlite import ir
from numba import typeof, types
from numba.extending import NativeValue, intrinsic, models, register_model, unbox
from numba.np.numpy_support import from_dtype

FORMS = {types.float64: "d", types.int64: "q", types.boolean: "?"}  # of `struct`


class Unboxed(int):
    """The address of arguments as compiled code has them.

    Args:
        kinds: numba's types of the arguments: arrays, numbers, and tuples of such.
        values: the arguments, which live as long as this.

    Raises:
        TypeError: an argument is of another kind.
    """

    def __new__(cls, kinds: Sequence[types.Type], values: Sequence[Any]) -> Unboxed:
        """See the class."""
        parts = [part for pair in zip(kinds, values, strict=True) for part in _laid_out(*pair)]
        forms, numbers = zip(*parts, strict=True)
        data = struct.pack("@" + "".join(forms), *chain.from_iterable(numbers))
        block = np.frombuffer(bytearray(data), np.uint8)
        unboxed = super().__new__(cls, block.ctypes.data)
        unboxed.alive = block, values
        return unboxed


def kind_of(value: Any) -> types.Type:  # noqa: ANN401
    """Numba's type of an argument; its own answer takes long, and loads what knows of masks."""
    if type(value) is np.ndarray:
        flags = value.flags
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return _array(value.dtype, value.ndim, layout, not flags.writeable, flags.aligned)
    if isinstance(value, tuple):
        return _tuple(type(value), tuple(map(kind_of, value)))
    return typeof(value)


@cache
def _array(
    kind: np.dtype, dimensions: int, layout: str, readonly: bool, aligned: bool
) -> types.Array:
    return types.Array(from_dtype(kind), dimensions, layout, readonly=readonly, aligned=aligned)


@cache
def _tuple(kind: type, kinds: tuple[types.Type, ...]) -> types.BaseTuple:
    return types.BaseTuple.from_types(kinds, None if kind is tuple else kind)


def _laid_out(kind: types.Type, value: Any) -> Iterator[tuple[str, tuple[Any, ...]]]:  # noqa: ANN401
    """The numbers of an argument, with their forms."""
    if isinstance(kind, types.BaseTuple):
        for pair in zip(kind, value, strict=True):
            yield from _laid_out(*pair)
    elif isinstance(kind, types.Array):
        # nobody counts references to it, and it has no parent to return
        place, _ = value.__array_interface__["data"]
        whole = 0, 0, value.size, value.itemsize, place, *value.shape, *value.strides
        yield f"{len(whole)}q", whole
    elif kind in FORMS:
        yield FORMS[kind], (value,)
    else:
        raise TypeError(f"an argument of {kind} cannot be bound")


class UnboxedType(types.Type):
    """Addresses of arguments of these types."""

    def __init__(self, kinds: tuple[types.Type, ...]) -> None:
        """See the class."""
        self.kinds = kinds
        super().__init__(name=f"Unboxed({', '.join(map(str, kinds))})")


@register_model(UnboxedType)
class _Address(models.PrimitiveModel):
    def __init__(self, manager, kind) -> None:
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


@unbox(UnboxedType)
def _unbox(_, unboxed, code):
    return NativeValue(code.pyapi.long_as_voidptr(unboxed))


@intrinsic
def arguments(_, unboxed):
    """What is at the address, as a tuple."""
    found = types.Tuple(unboxed.kinds)

    def generate(context, builder, _, args):
        laid_out = context.get_value_type(found)
        return builder.load(builder.bitcast(args[0], laid_out.as_pointer()))

    return found(unboxed), generate


def _none(unboxed):
    return FUNCTION(*arguments(unboxed))


def _one(unboxed, a):
    return FUNCTION(*arguments(unboxed), a)


def _two(unboxed, a, b):
    return FUNCTION(*arguments(unboxed), a, b)


def _three(unboxed, a, b, c):
    return FUNCTION(*arguments(unboxed), a, b, c)


CALLS = _none, _one, _two, _three  # by how many arguments come behind those that are bound


def calling(function: Any, more: int) -> FunctionType:  # noqa: ANN401 - a twin
    """A function to be compiled: it calls a twin with what is at an address and `more` arguments.

    It passes for a function of the twin's own file, beside whose machine code its own is kept.
    """
    own, name = function.py_func.__code__, f"unboxed_{function.py_func.__name__}"
    code = CALLS[more].__code__.replace(
        co_name=name,
        co_qualname=name,
        co_filename=own.co_filename,
        co_firstlineno=own.co_firstlineno,
    )
    known = {"FUNCTION": function, "arguments": arguments, "__name__": function.__module__}
    return FunctionType(code, known, name)
