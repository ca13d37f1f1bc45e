"""Numbers that a run will have in metrics.json, known from its aircraft and windows alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union

from typing_extensions import NotRequired, get_args, get_origin, get_type_hints, is_typeddict

from testbed.core.flags import LimiterFlag, Saturation, flag_names
from testbed.metrics.facts import LOSSES
from testbed.metrics.model import Metrics, key_kind

_Names = Mapping[str, Sequence[str]]


def run_numbers(
    names: Sequence[str], windows: Sequence[str], *, begins: bool, expects: bool
) -> dict[str, Any]:
    """Return a document with every number that a run can have, all of them 0.

    Args:
        names: of the aircraft, the leader first.
        windows: of the scenario.
        begins: whether the flight begins as another one.
        expects: whether the scenario has bounds.
    """
    kinds = {
        "names": names,
        "followers": names[1:],
        "windows": windows,
        "limiter_flags": flag_names(LimiterFlag),
        "saturations": flag_names(Saturation),
        "losses": tuple(LOSSES),
    }
    document: dict[str, Any] = _blank(Metrics, kinds)
    optional = {"begin_s": begins, "expect": expects}
    return {key: value for key, value in document.items() if optional.get(key, True)}


def _blank(kind: Any, names: _Names) -> Any:  # noqa: ANN401 - types and JSON
    """Return a value of a type of the document, with zeros for numbers."""
    origin: Any = get_origin(kind)
    if is_typeddict(kind):
        hints = get_type_hints(kind, include_extras=True)
        return {key: _blank(each, names) for key, each in hints.items()}
    if origin is Annotated:
        plain, *notes = get_args(kind)
        keys = next((names[k] for note in notes if (k := key_kind(note))), None)
        if keys is not None:
            return {key: _blank(get_args(plain)[1], names) for key in keys}
        inside: Any = get_origin(plain)
        if inside is list:
            return [_blank(get_args(plain)[0], names)] * _length(notes)
        return _blank(plain, names)
    if origin in (Union, UnionType):
        return _blank(next(each for each in get_args(kind) if each is not NoneType), names)
    if origin is NotRequired:
        return _blank(get_args(kind)[0], names)
    return "" if origin is Literal else (origin or kind)()


def _length(notes: Sequence[Any]) -> int:
    """Return the length of a list, by the notes of its type; 0 if it may have any."""
    lengths = [getattr(each, "min_length", 0) for note in notes for each in note.metadata]
    return max(lengths, default=0)
