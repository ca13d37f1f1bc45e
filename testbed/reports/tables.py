"""Tables as HTML: those of the terminal cell by cell, so that they have the same numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from rich.table import Table
from rich.text import Text

STYLES = ("green", "red", "yellow", "dim", "bold")


def to_html(table: Table) -> str:
    """Convert a table of plain or styled text; the first column heads the rows."""
    columns = [list(column.cells) for column in table.columns]
    head = "".join(f'<th scope="col">{_lines(column.header)}</th>' for column in table.columns)
    body = []
    for k, row in enumerate(table.rows):
        cells = [_cell(column[k], first=i == 0) for i, column in enumerate(columns)]
        ends = ' class="ends"' if row.end_section else ""
        body.append(f"<tr{ends}>{''.join(cells)}</tr>")
    return (
        f'<div class="wide"><table><thead><tr>{head}</tr></thead>'
        f"<tbody>{''.join(body)}</tbody></table></div>"
    )


def rows_to_html(rows: Iterable[tuple[str, str | Text]]) -> str:
    """Make a table of names and texts, without a head."""
    body = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td{_classes(text)}>{_lines(text)}</td></tr>'
        for name, text in rows
    )
    return f'<div class="wide"><table class="facts"><tbody>{body}</tbody></table></div>'


def text_table_to_html(headings: Sequence[str], rows: Iterable[str]) -> str:
    """Make a table of left-aligned text; each row is the HTML of its cells."""
    head = "".join(f'<th scope="col">{escape(each)}</th>' for each in headings)
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return (
        f'<div class="wide"><table class="facts"><thead><tr>{head}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(content: Any, *, first: bool) -> str:  # noqa: ANN401 - rich's renderables
    if first:
        return f'<th scope="row"{_classes(content)}>{_lines(content)}</th>'
    return f"<td{_classes(content)}>{_lines(content)}</td>"


def _lines(content: Any) -> str:  # noqa: ANN401 - rich's renderables
    return "<br>".join(escape(line) for line in str(content).split("\n"))


def _classes(content: Any) -> str:  # noqa: ANN401 - rich's renderables
    if not isinstance(content, Text):
        return ""
    styles = " ".join([str(content.style), *(str(span.style) for span in content.spans)]).split()
    found = [style for style in STYLES if style in styles]
    return f' class="{" ".join(found)}"' if found else ""
