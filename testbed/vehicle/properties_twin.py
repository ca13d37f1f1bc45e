"""The compiled twins of `properties`, which call JSBSim's own functions.

A test holds them to the Python functions, which fly where JSBSim's library does not show its own.
"""

# The Python functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN002, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import types

from testbed.compiled import bound, instructions, twin
from testbed.vehicle import properties
from testbed.vehicle.addresses import address_of, functions

_WORD, _REAL = ir.IntType(64), ir.DoubleType()


@instructions
def _said(_, getter, node):
    """What JSBSim's function at an address says of the property at another."""

    def generate(context, builder, _, args):
        kind = ir.FunctionType(_REAL, [_WORD])
        return builder.call(builder.inttoptr(args[0], kind.as_pointer()), [args[1]])

    return types.float64(types.int64, types.int64), generate


@instructions
def _say(_, setter, node, number):
    """Have JSBSim's function at an address set the property at another."""

    def generate(context, builder, _, args):
        # it answers whether it could; what is left of the register's bits is not looked at
        kind = ir.FunctionType(ir.IntType(8), [_WORD, _REAL])
        builder.call(builder.inttoptr(args[0], kind.as_pointer()), args[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.float64), generate


def reading(compiled, more=()):
    """What binds a twin that reads nodes into the numbers behind them, with JSBSim's own function.

    Where that is hidden, Python reads first, and the twin finds nothing left to read. Who calls
    keeps the aircraft, in whose memory the properties are.
    """

    def ready(nodes, numbers, *fixed):
        getter, places = _places(nodes, "get")
        call = bound(compiled, getter, places, numbers, *fixed, more=more)
        return call if getter else lambda *then: (properties.read(nodes, numbers), call(*then))

    return ready


def setting(compiled):
    """What binds a twin that sets nodes to its last numbers, as `reading` does."""

    def ready(nodes, *fixed):
        setter, places = _places(nodes, "set")
        call = bound(compiled, setter, places, *fixed)
        return call if setter else lambda: (call(), properties.write(nodes, fixed[-1]))

    return ready


def _places(nodes, which):
    """The address of JSBSim's function, and those of properties; 0: left alone."""
    own = functions()
    if own is None:
        return 0, np.zeros(len(nodes), np.int64)
    return own[which], np.array([0 if node is None else address_of(node) for node in nodes])


@twin
def read(getter, nodes, numbers):
    for k in range(nodes.size):
        if nodes[k] != 0:
            numbers[k] = _said(getter, nodes[k])


@twin
def write(setter, nodes, numbers):
    for k in range(nodes.size):
        if nodes[k] != 0:
            _say(setter, nodes[k], numbers[k])


ready_read, ready_write = reading(read), setting(write)
