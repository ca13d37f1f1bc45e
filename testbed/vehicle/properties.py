"""Properties of JSBSim that are read or set many at once.

Through Python each takes a call of its own: some hundred in a period of four aircraft. Where
JSBSim's library shows the functions behind them, machine code calls these one after the other; the
numbers are the same to the bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain
from typing import Any

from testbed.compiled import ready_of
from testbed.state import Array

Nodes = Sequence[Any]  # of JSBSim's; None: there is none, or it is somebody else's
_ABSURD = 1e9  # ft, ft/s², rad, rpm: nothing that flies reads this


def joined(nodes: Iterable[Nodes]) -> list[Any]:
    """Those of one aircraft after those of the other."""
    return list(chain.from_iterable(nodes))


def sane(nodes: Nodes, numbers: Array) -> list[bool]:
    """Of each property (K,), or the number that stands for it, whether anything flying reads so."""
    said = [
        number if node is None else node.get_double_value()
        for node, number in zip(nodes, numbers.tolist(), strict=True)
    ]
    return [abs(each) < _ABSURD for each in said]


def read(nodes: Nodes, numbers: Array) -> None:
    """Write what properties (K,) are into numbers (K,); where there is none, its number stays."""
    for k, node in enumerate(nodes):
        if node is not None:
            numbers[k] = node.get_double_value()


def write(nodes: Nodes, numbers: Array) -> None:
    """Set properties (K,) to numbers (K,), those that there are."""
    for node, number in zip(nodes, numbers.tolist(), strict=True):
        if node is not None:
            node.set_double_value(number)


READY_READ = ready_of(read, "testbed.vehicle.properties_twin")
READY_WRITE = ready_of(write, "testbed.vehicle.properties_twin")
