"""Show the comments on a record's fields, with shapes and units, in `help()`.

The source is read when the documentation is asked for, not when the module is imported.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from typing import TypeVar

_TypeT = TypeVar("_TypeT", bound=type)
_FIELD = re.compile(r"    (\w+): .*?(?:  # (.*))?$")
_COMMENT = re.compile(r"    # (.*)$")


class _FieldDocs:
    """The docstring of a class, followed by a section with its fields."""

    def __init__(self, text: str) -> None:
        self._text = inspect.cleandoc(text)
        self._complete = ""

    def __get__(self, instance: object, owner: type) -> str:
        if not self._complete:
            fields = dict(_field_comments(owner))
            lines = (f"    {name}: {comment}" for name, comment in fields.items())
            self._complete = (
                "\n".join([self._text, "", "Fields:", *lines]) if fields else self._text
            )
            if issubclass(owner, tuple):
                for name, comment in fields.items():
                    getattr(owner, name).__doc__ = comment
        return self._complete


def document_fields(kind: _TypeT) -> _TypeT:
    """Add the comments on the fields of a named tuple or dataclass to its documentation."""
    kind.__doc__ = _FieldDocs(kind.__doc__ or "")  # type: ignore[assignment]
    return kind


def _field_comments(kind: type) -> Iterator[tuple[str, str]]:
    """Yield each field with the comments above it and at the end of its line."""
    try:
        lines = inspect.getsource(kind).splitlines()
    except (OSError, TypeError):  # no source files are installed
        return
    above: list[str] = []
    for line in lines:
        if comment := _COMMENT.match(line):
            above.append(comment[1])
            continue
        if field := _FIELD.match(line):
            yield field[1], " ".join([*above, field[2] or ""]).strip()
        above = []
