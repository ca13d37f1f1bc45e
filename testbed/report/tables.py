"""Tables of the terminal as tables of a page: the same cells, so the same numbers."""

from __future__ import annotations

from html import escape
from typing import Any

from rich.table import Table
from rich.text import Text

STYLES = ("green", "red", "yellow", "dim", "bold")


def to_html(table: Table) -> str:
    """A table whose cells are plain or styled text; the first column names the rows."""
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


def rows_to_html(rows: list[tuple[str, str | Text]]) -> str:
    """Names and texts."""
    body = "".join(
        f'<tr><th scope="row">{escape(name)}</th><td{_classes(text)}>{_lines(text)}</td></tr>'
        for name, text in rows
    )
    return f'<div class="wide"><table class="facts"><tbody>{body}</tbody></table></div>'


def _cell(content: Any, *, first: bool) -> str:  # noqa: ANN401 - rich's renderables
    if first:
        return f'<th scope="row"{_classes(content)}>{_lines(content)}</th>'
    return f"<td{_classes(content)}>{_lines(content)}</td>"


def _lines(content: Any) -> str:  # noqa: ANN401 - rich's renderables
    return "<br>".join(escape(line) for line in str(content).split("\n"))


def _classes(content: Any) -> str:  # noqa: ANN401 - rich's renderables
    if not isinstance(content, Text):
        return ""
    said = " ".join([str(content.style), *(str(span.style) for span in content.spans)]).split()
    found = [style for style in STYLES if style in said]
    return f' class="{" ".join(found)}"' if found else ""
