"""Add the comments after a record's fields, with shapes and units, to the reference."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path
from typing import Any

import griffe

SECTION = re.compile(r"^(Args|Attributes):", re.M)


class Comments(griffe.Extension):
    """List the fields of a record with the comments at the ends of their lines."""

    def on_class_members(
        self,
        *,
        cls: griffe.Class,
        **_: Any,  # noqa: ANN401 - griffe passes further arguments
    ) -> None:
        """Add a section of attributes to the docstring of a class without one."""
        if cls.docstring is None or SECTION.search(cls.docstring.value):
            return
        comments = [(name, comment_after(field)) for name, field in cls.attributes.items()]
        lines = [f"    {name}: {comment}" for name, comment in comments if comment]
        if lines:
            cls.docstring.value += "\n\nAttributes:\n" + "\n".join(lines)


def comment_after(field: griffe.Attribute) -> str:
    """Return the comment on the last line of a field, without `#`."""
    if field.endlineno is None or field.docstring is not None:
        return ""
    line = field.lines_collection[Path(str(field.filepath))][field.endlineno - 1]
    try:
        tokens = list(tokenize.generate_tokens(io.StringIO(line.strip()).readline))
    except tokenize.TokenError:  # the last line of a longer expression
        return ""
    return "".join(t.string.lstrip("# ") for t in tokens if t.type == tokenize.COMMENT)
