"""Shapes of plain data from outside: types and keys, checked before use."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

_LARGEST = 2**63  # of whole numbers; larger ones overflow in arrays


@dataclass(frozen=True, slots=True)
class Number:
    """A number; NaN and infinity only where they are allowed.

    Args:
        whole: no fraction.
        least: smallest value.
        most: largest value.
        finite: NaN and infinity are wrong.
    """

    whole: bool = False
    least: float = -math.inf
    most: float = _LARGEST
    finite: bool = True


@dataclass(frozen=True, slots=True)
class Optional:
    """Null, or a value of a shape."""

    shape: Shape


@dataclass(frozen=True, slots=True)
class Each:
    """A map of any keys, whose values have one shape."""

    shape: Shape


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list whose elements have one shape; `count`: their number, None for any."""

    shape: Shape
    count: int | None = None


# str and bool stand for values of the type; a map has at least the keys of the shape
Shape = Number | Optional | Each | ListOf | type[str] | type[bool] | Mapping[str, Any]


def check_shape(value: Any, shape: Shape, path: str = "") -> None:  # noqa: ANN401 - any plain data
    """Check plain data against a shape.

    Args:
        value: of JSON.
        shape: expected.
        path: of the value, for errors.

    Raises:
        ValueError: with the path and the type or range of the first wrong value.
    """
    where = f"{path}: " if path else ""
    if isinstance(shape, Optional):
        if value is not None:
            check_shape(value, shape.shape, path)
    elif isinstance(shape, Number):
        _check_number(value, shape, where)
    elif isinstance(shape, type):
        if not isinstance(value, shape):
            raise ValueError(f"{where}is {_kind(value)}, not {_kind(shape())}")
    elif isinstance(shape, ListOf):
        if not isinstance(value, list):
            raise ValueError(f"{where}is {_kind(value)}, not a list")
        if shape.count is not None and len(value) != shape.count:
            raise ValueError(f"{where}has {len(value)} elements, not {shape.count}")
        for index, each in enumerate(value):
            check_shape(each, shape.shape, f"{path}[{index}]")
    else:
        if not isinstance(value, dict):
            raise ValueError(f"{where}is {_kind(value)}, not a map")
        keys = dict.fromkeys(value, shape.shape) if isinstance(shape, Each) else shape
        for key, of_key in keys.items():
            inner = f"{path}.{key[:60]}" if path else key[:60]
            if key not in value:
                raise ValueError(f"{inner}: is missing")
            check_shape(value[key], of_key, inner)


def _check_number(value: Any, shape: Number, where: str) -> None:  # noqa: ANN401 - any plain data
    expected = "a whole number" if shape.whole else "a number"
    good = isinstance(value, int) if shape.whole else isinstance(value, int | float)
    if isinstance(value, bool) or not good:
        raise ValueError(f"{where}is {_kind(value)}, not {expected}")
    if isinstance(value, float) and not math.isfinite(value):
        if shape.finite:
            raise ValueError(f"{where}is {value}, not a finite number")
    elif not shape.least <= value <= shape.most:
        raise ValueError(f"{where}is not from {shape.least:g} to {shape.most:g}")


def _kind(value: object) -> str:
    names: Sequence[tuple[type, str]] = (
        (bool, "true or false"), (str, "text"), (int, "a number"), (float, "a number"),
        (list, "a list"), (dict, "a map"),
    )  # fmt: skip
    return next((name for kind, name in names if isinstance(value, kind)), "null")
