"""Show the comments on a record's fields, with shapes and units, in `help()`."""

from __future__ import annotations

import inspect
import linecache
import re
import sys
from collections.abc import Iterator
from typing import TypeVar

_TypeT = TypeVar("_TypeT", bound=type)
_FIELD = re.compile(r"    (\w+): .*?(?:  # (.*))?$")
_COMMENT = re.compile(r"    # (.*)$")


def document_fields(kind: _TypeT) -> _TypeT:
    """Add the comments on the fields of a named tuple or dataclass to its documentation."""
    fields = dict(_field_comments(kind))
    if fields:
        lines = (f"    {name}: {comment}" for name, comment in fields.items())
        kind.__doc__ = "\n".join([inspect.cleandoc(kind.__doc__ or ""), "", "Fields:", *lines])
    if issubclass(kind, tuple):
        for name, comment in fields.items():
            getattr(kind, name).__doc__ = comment
    return kind


def _field_comments(kind: type) -> Iterator[tuple[str, str]]:
    """Yield each field with the comments above it and at the end of its line."""
    above: list[str] = []
    for line in _class_lines(kind):
        if comment := _COMMENT.match(line):
            above.append(comment[1])
            continue
        if field := _FIELD.match(line):
            yield field[1], " ".join([*above, field[2] or ""]).strip()
        above = []


def _class_lines(kind: type) -> Iterator[str]:
    """Yield the lines of a class at the top of its module; none where there is no source.

    `inspect.getsource` would parse the module once for each class.
    """
    module = sys.modules[kind.__module__]
    lines = linecache.getlines(getattr(module, "__file__", None) or "", vars(module))
    begin = re.compile(rf"class {kind.__name__}\b")
    inside = False
    for line in lines:
        if inside and line[:1].strip():
            return
        if inside:
            yield line.rstrip("\n")
        inside = inside or begin.match(line) is not None
