"""The compiled twin of `rows.gather`.

A test holds it to the function.
"""

# The function carries the docstring and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils

from testbed.compiled import bound, instructions, twin


@instructions
def _copy(typing, octets, at, address, size):
    """Copy memory from an address into an array of bytes."""

    def generate(context, builder, signature, args):
        octets, at, address, size = args
        to = context.make_array(signature.args[0])(context, builder, octets)
        source = builder.inttoptr(address, ir.IntType(8).as_pointer())
        cgutils.raw_memcpy(builder, builder.gep(to.data, [at]), source, size, 1)
        return context.get_dummy_value()

    return types.void(octets, types.int64, types.int64, types.int64), generate


def ready_gather(arrays, octets):
    if not all(each.flags.c_contiguous for each in arrays):
        raise ValueError("an array of a frame is not contiguous")
    places = np.array([(each.ctypes.data, each.nbytes) for each in arrays])
    call = bound(_gather, places, octets, more=(0,))

    def gather(at, _=arrays):  # which live as long
        call(at)

    return gather


@twin
def _gather(places, octets, at):
    for k in range(len(places)):
        _copy(octets, at, places[k, 0], places[k, 1])
        at += places[k, 1]
