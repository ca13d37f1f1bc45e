"""Where JSBSim keeps its properties, and the functions of its own that get and set them.

For machine code, which calls them as JSBSim does. This is known of one release on compilers other
than Microsoft's; of any other JSBSim nothing is, and Python reads and sets its properties.
"""

from __future__ import annotations

import ctypes
import sys
from functools import cache
from importlib.util import find_spec
from typing import Any

RELEASE = "1.3.3"
# `double SGPropertyNode::getDoubleValue() const` and `bool SGPropertyNode::setDoubleValue(double)`
_SYMBOLS = {
    "get": "_ZNK14SGPropertyNode14getDoubleValueEv",
    "set": "_ZN14SGPropertyNode14setDoubleValueEd",
}
_WORD = ctypes.sizeof(ctypes.c_void_p)
_FIELD = 3 * _WORD  # of a property as Python has it, behind Python's own: where JSBSim's is


@cache
def functions() -> dict[str, int] | None:
    """Addresses of the functions that "get" and "set"; None: they are not known, or hidden."""
    jsbsim, library = sys.modules.get("jsbsim"), find_spec("jsbsim._jsbsim")
    if jsbsim is None or library is None or jsbsim.__version__ != RELEASE:
        return None
    if jsbsim.FGPropertyNode.__basicsize__ != _FIELD + _WORD:
        return None
    try:
        exported = ctypes.CDLL(library.origin)
        found = {name: getattr(exported, symbol) for name, symbol in _SYMBOLS.items()}
    except (AttributeError, OSError):
        return None
    return {name: ctypes.cast(each, ctypes.c_void_p).value or 0 for name, each in found.items()}


def address_of(node: Any) -> int:  # noqa: ANN401 - untyped
    """Where JSBSim keeps a property; it stays there as long as its aircraft."""
    return ctypes.c_size_t.from_address(id(node) + _FIELD).value
