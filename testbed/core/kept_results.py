"""Results that are kept on disk, because they cost more than reading a file.

A kept result is data of one type: numbers, texts, arrays, tuples, dictionaries by text, dataclasses
and named tuples of them, to the bit. It is among the kept files of these sources, with a digest of
all else that it depends on. What is damaged, or of another type, is made anew.

The results of one name have `_PLACES` files at most: a result may replace another one, which is
then made anew when it is needed.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import platform
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import distribution, version
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from testbed.core.compile import kept_files
from testbed.core.input_files import ReadError, parse_json_map, read_bounded_text

T = TypeVar("T")
_LIBRARIES = ("jsbsim", "llvmlite", "numba", "numpy")
_PLACES = 4096
_SCALARS = (bool, int, float, str)
# Lines of /proc/cpuinfo on which the choice of instructions depends, and so the last digit.
_PROCESSOR = (
    *("vendor_id", "cpu family", "model", "model name", "stepping", "flags"),
    *("Features", "CPU implementer", "CPU architecture", "CPU variant", "CPU part"),
)


def find_result(kind: type[T], name: str, of: tuple[object, ...], make: Callable[[], T]) -> T:
    """Return a kept result, or make and keep it.

    Args:
        kind: its type.
        name: of what is kept, in letters and hyphens.
        of: what it depends on, besides the testbed's sources, the libraries and the processor;
            values with an exact `repr`.
        make: makes it; an error that it raises is not kept.
    """
    if (found := read_result(kind, name, of)) is None:
        found = make()
        keep_result(name, of, found)
    return found


def read_result(kind: type[T], name: str, of: tuple[object, ...]) -> T | None:
    """Return a kept result; None: there is none. See `find_result`."""
    file, digest = _place(name, of)
    content = kept_files().read(file)
    if content is not None:
        with suppress(ValueError, TypeError, KeyError):
            kept = parse_json_map(content)
            if kept["of"] == digest:
                found: T = _from_plain(kind, kept["result"])
                return found
    return None


def keep_result(name: str, of: tuple[object, ...], result: object) -> None:
    """Keep a result, where that is possible. See `find_result`."""
    file, digest = _place(name, of)
    text = json.dumps({"of": digest, "result": _to_plain(result)}, separators=(",", ":"))
    kept_files().write(file, text.encode())


def _place(name: str, of: tuple[object, ...]) -> tuple[str, str]:
    """Return the file of a result, and the digest of what it depends on."""
    digest = hashlib.sha256(repr((name, *machine_facts(), *of)).encode()).hexdigest()
    return f"result-{name}-{int(digest, 16) % _PLACES:03x}", digest


@functools.cache
def machine_facts() -> tuple[object, ...]:
    """Return the libraries and the processor, on which the last digit of a result may depend."""
    libraries = [(each, version(each)) for each in _LIBRARIES]
    status = [(each.name, each.stat().st_size, each.stat().st_mtime_ns) for each in _binaries()]
    machine = platform.machine(), *platform.libc_ver(), _processor()
    return *libraries, *status, *machine


def _binaries() -> list[Path]:
    """Return JSBSim's machine code: one that is built anew may have the version of before."""
    folder = Path(str(distribution("jsbsim").locate_file("jsbsim")))
    return sorted((*folder.glob("*.so"), *folder.glob("*.pyd")))


def _processor() -> str:
    """Return the lines of the first processor that tell its instructions."""
    try:
        first, _, _ = read_bounded_text(Path("/proc/cpuinfo")).partition("\n\n")
    except ReadError:  # not Linux
        return platform.processor()
    lines = (each.partition(":") for each in first.splitlines())
    return "".join(
        f"{name.strip()}:{value}" for name, _, value in lines if name.strip() in _PROCESSOR
    )


def _to_plain(value: Any) -> Any:  # noqa: ANN401
    """Return what JSON has for a result."""
    if isinstance(value, np.ndarray):
        return [value.dtype.str, value.shape, value.ravel().tolist()]
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value):
        return [_to_plain(getattr(value, each.name)) for each in dataclasses.fields(value)]
    if isinstance(value, tuple):
        return [_to_plain(each) for each in value]
    if isinstance(value, dict):
        return {key: _to_plain(each) for key, each in value.items()}
    return value


def _from_plain(kind: Any, value: Any) -> Any:  # noqa: ANN401
    """Return a result of a type.

    Raises:
        ValueError, TypeError: the value is no such result.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if kind in _SCALARS:
        if type(value) is not kind:
            raise TypeError(f"a {type(value).__name__} in place of a {kind.__name__}")
        return value
    if origin is UnionType:
        (other,) = (each for each in parts if each is not NoneType)
        return None if value is None else _from_plain(other, value)
    if origin is dict:
        return {key: _from_plain(parts[1], each) for key, each in value.items()}
    if origin is np.ndarray:
        dtype, shape, numbers = value
        return np.array(numbers, dtype=dtype).reshape(shape)
    if origin is tuple:
        kinds = (parts[0],) * len(value) if parts[-1] is Ellipsis else parts
        return tuple(_from_plain(*each) for each in zip(kinds, value, strict=True))
    names, hints = _fields(kind)
    found = (_from_plain(hints[name], each) for name, each in zip(names, value, strict=True))
    return kind(*found)


@functools.cache
def _fields(kind: Any) -> tuple[tuple[str, ...], dict[str, Any]]:  # noqa: ANN401
    """Return names and types of the fields of a dataclass or a named tuple."""
    hints = get_type_hints(kind)
    if dataclasses.is_dataclass(kind):
        return tuple(each.name for each in dataclasses.fields(kind)), hints
    return kind._fields, hints
