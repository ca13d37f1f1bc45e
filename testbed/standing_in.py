"""Modules that others import and that nothing here uses: they take long to load."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType


class _StandIn(ModuleType):
    """A module in which every name is an empty class."""

    def __getattr__(self, name: str) -> type:
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (), {})


@contextmanager
def standing_in(*modules: str) -> Iterator[None]:
    """Let stand-ins be imported for these modules in the block, unless they are there already.

    What asks for them later gets the real ones; what asked in the block keeps the stand-ins' names,
    and must not use them.
    """
    absent = {name: _StandIn(name) for name in modules if name not in sys.modules}
    sys.modules.update(absent)
    try:
        yield
    finally:
        for name, module in absent.items():
            if sys.modules.get(name) is module:
                del sys.modules[name]
