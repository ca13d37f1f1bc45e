"""Compiled twins: the laws that cost most, written out per agent for numba.

A flight steps a handful of agents, for which numpy's cost is all in its calls. The readable numpy
function stays the definition; a twin of the same name does the same per agent in machine code,
kept beside the bytecode, and a test holds the two together. Without numba, or with TESTBED_NUMPY=1
in the environment, the numpy functions fly: results agree to rounding, not to the bit.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import os
from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])


def engine() -> str:
    """Which flies: "numba", or "numpy" where numba is missing or not wanted."""
    if os.environ.get("TESTBED_NUMPY"):
        return "numpy"
    return "numba" if importlib.util.find_spec("numba") else "numpy"


def twin_of(function: F, module: str) -> F:
    """The compiled function of the same name in a module of twins, or the function itself.

    It is looked up at the first call, because a module of twins imports what it copies.
    """
    chosen: list[Callable[..., Any]] = []

    @functools.wraps(function)
    def call(*args: Any) -> Any:  # noqa: ANN401 - whatever the function takes and gives
        if not chosen:
            twins = importlib.import_module(module) if engine() == "numba" else None
            chosen.append(getattr(twins, function.__name__) if twins else function)
        return chosen[0](*args)

    return call  # type: ignore[return-value]
