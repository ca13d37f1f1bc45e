"""Digest of all that the machine code of a user's kernel consists of."""

from __future__ import annotations

import builtins
import dis
import hashlib
from collections.abc import Callable
from types import CodeType, ModuleType
from typing import Any

import numpy as np

# Packages whose text does not change with a user's code. The machine code is in a folder of the
# testbed's own text, and numba discards that of its other versions.
_FIXED = ("builtins", "math", "cmath", "numba", "numpy", "testbed")
_LAWS = "testbed.laws."  # but for those of the library, which are no part of that text
_NUMBERS = (bool, int, float, complex, str, bytes, type(None), np.generic, np.dtype)


class UnknownValueError(ValueError):
    """A kernel reads a variable whose value has no digest; the text is the variable's name."""


def code_digest(function: Callable[..., Any]) -> str:
    """Return a SHA-256 of a function and of all that is compiled into it.

    These are its bytecode, the functions that it calls, and the values of the global and enclosing
    variables that it reads, which numba takes as constants.

    Args:
        function: compiled by numba, or plain.

    Raises:
        UnknownValueError: it reads a variable that is no number, text, array, tuple, NamedTuple,
            compiled function or part of Python, numpy, numba or testbed.
    """
    found = _Digest()
    found.add_value("", function)
    return found.hexdigest()


class _Digest:
    def __init__(self) -> None:
        self._sha256 = hashlib.sha256()
        self._seen: set[int] = set()  # functions that call themselves

    def hexdigest(self) -> str:
        return self._sha256.hexdigest()

    def _add(self, *words: object) -> None:
        self._sha256.update(f"{words!r}\0".encode())

    def add_value(self, name: str, value: Any) -> None:  # noqa: ANN401
        """Add what a variable stands for."""
        function = getattr(value, "py_func", value)
        if isinstance(value, _NUMBERS):
            self._add(type(value).__name__, value)
        elif isinstance(value, np.ndarray) and not value.dtype.hasobject:
            self._add(value.dtype, value.shape, value.strides)
            self._sha256.update(value.tobytes())
        elif isinstance(value, tuple):
            self._add(type(value).__name__, len(value))
            for each in value:
                self.add_value(name, each)
        elif (fixed := _fixed_name(value)) is not None:
            self._add(fixed)
        elif hasattr(function, "__code__"):
            self._add(sorted(getattr(value, "targetoptions", {}).items()))
            self._add_function(name, function)
        elif isinstance(value, type) and issubclass(value, tuple) and hasattr(value, "_fields"):
            self._add(value.__name__, value._fields)
        else:
            raise UnknownValueError(name)

    def _add_variable(self, name: str, value: Any, code: CodeType) -> None:  # noqa: ANN401
        """Add a variable that a code reads; of a module of the user's what the code may read."""
        if not isinstance(value, ModuleType) or _fixed_name(value) is not None:
            self.add_value(name, value)
            return
        for each in code.co_names:
            if each != name and hasattr(value, each):
                self._add_variable(each, getattr(value, each), code)

    def _add_function(self, name: str, function: Any) -> None:  # noqa: ANN401
        if id(function) in self._seen:
            return
        self._seen.add(id(function))
        self.add_value(name, function.__defaults__)
        for variable, cell in zip(
            function.__code__.co_freevars, function.__closure__ or (), strict=True
        ):
            self.add_value(variable, cell.cell_contents)
        self._add_code(function.__code__, function.__globals__)

    def _add_code(self, code: CodeType, variables: dict[str, Any]) -> None:
        inner = [each for each in code.co_consts if isinstance(each, CodeType)]
        self._add(code.co_code, [each for each in code.co_consts if each not in inner])
        self._add(code.co_names, code.co_varnames, code.co_argcount)
        for name in _global_names(code):
            self._add(name, hasattr(builtins, name))
            if name in variables:
                self._add_variable(name, variables[name], code)
        for each in inner:
            self._add_code(each, variables)


def _global_names(code: CodeType) -> list[str]:
    names = (each.argval for each in dis.get_instructions(code) if each.opname == "LOAD_GLOBAL")
    return sorted(set(names))


def _fixed_name(value: Any) -> str | None:  # noqa: ANN401
    """Return the full name of a module, function or class of Python, numpy, numba or testbed."""
    if isinstance(value, ModuleType):
        name = module = value.__name__
    elif isinstance(value, np.ufunc):
        module, name = "numpy", value.__name__
    elif hasattr(value, "__qualname__"):  # an instance has none
        module = str(value.__module__)
        name = f"{module}.{value.__qualname__}"
    else:
        return None
    fixed = module.partition(".")[0] in _FIXED and not module.startswith(_LAWS)
    return name if fixed else None


def names_in_kernel(function: Callable[..., Any]) -> set[str]:
    """Return the names that a function and those that it calls read: attributes and variables.

    Args:
        function: compiled by numba, or plain.
    """
    names, seen = set[str](), set[int]()
    waiting: list[Any] = [function]
    while waiting:
        one = waiting.pop()
        one = getattr(one, "py_func", one)
        if id(one) in seen or not hasattr(one, "__code__") or _fixed_name(one) is not None:
            continue
        seen.add(id(one))
        codes = [one.__code__]
        cells = (each.cell_contents for each in one.__closure__ or ())
        waiting += [each for each in cells if callable(each)]
        while codes:
            code = codes.pop()
            codes += [each for each in code.co_consts if isinstance(each, CodeType)]
            names.update(code.co_names)
            values = [one.__globals__.get(name) for name in code.co_names]
            modules = [each for each in values if isinstance(each, ModuleType)]
            values += [getattr(each, name, None) for each in modules for name in code.co_names]
            waiting += [each for each in values if callable(each)]
    return names
