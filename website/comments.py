"""Lets the reference read the comments behind a record's fields: shapes and units are there."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path
from typing import Any

import griffe

SECTION = re.compile(r"^(Args|Attributes):", re.M)


class Comments(griffe.Extension):
    """Lists the fields of a record with the comments at the ends of their lines."""

    def on_class_members(
        self,
        *,
        cls: griffe.Class,
        **_: Any,  # noqa: ANN401 - griffe passes more than is of use here
    ) -> None:
        """Add a section to the docstring of a class that has no such section of its own."""
        if cls.docstring is None or SECTION.search(cls.docstring.value):
            return
        comments = [(name, behind(field)) for name, field in cls.attributes.items()]
        lines = [f"    {name}: {comment}" for name, comment in comments if comment]
        if lines:
            cls.docstring.value += "\n\nAttributes:\n" + "\n".join(lines)


def behind(field: griffe.Attribute) -> str:
    """The comment on the last line of a field, without its sign."""
    if field.endlineno is None or field.docstring is not None:
        return ""
    line = field.lines_collection[Path(str(field.filepath))][field.endlineno - 1]
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(line.strip()).readline))
    except tokenize.TokenError:  # the end of something longer
        return ""
    return "".join(t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT)
