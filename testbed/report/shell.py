"""What all pages share: one HTML file that needs nothing but a browser, and figures as files."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from testbed.metrics.document import replacing
from testbed.report.look import STYLE
from testbed.report.svg import for_page
from testbed.views.panels import Sheet

FORMATS = ("png", "pdf", "svg")


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of a page."""

    name: str  # of its file and its anchor
    title: str
    caption: str  # what is seen, also for those who cannot see it
    sheet: Sheet


def document(
    title: str, *, head: str, parts: Mapping[str, str], titles: Sequence[tuple[str, str]], foot: str
) -> str:
    """A whole page.

    Args:
        title: in the browser's tab, plain text.
        head: HTML above the links to the parts.
        parts: HTML by the part's name; empty ones are left out.
        titles: names and titles of the parts, in order.
        foot: plain text below all.
    """
    shown = [(part, heading) for part, heading in titles if parts[part]]
    links = "".join(f'<a href="#{part}">{heading}</a>' for part, heading in shown)
    body = "".join(
        f'<section id="{part}"><h2>{heading}</h2>{parts[part]}</section>' for part, heading in shown
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<link rel="icon" href="data:,">\n'
        f"<title>{escape(title)} · report</title>\n<style>\n{STYLE}\n</style>\n</head>\n<body>\n"
        f"<header>{head}<nav>{links}</nav></header>\n<main>{body}</main>\n"
        f"<footer>{escape(foot)}</footer>\n</body>\n</html>\n"
    )


def cards(values: Iterable[tuple[str, str, str]]) -> str:
    """A few numbers in large print, each with HTML of what it is and a text of what is ill."""
    return f'<ul class="cards">{"".join(_card(*each) for each in values)}</ul>'


def _card(value: str, what: str, ill: str) -> str:
    """A number; what is ill about it stands there in words, and in a colour."""
    said = f"<b>{value}</b><span>{what}</span>"
    return f'<li class="bad">{said}<em>{escape(ill)}</em></li>' if ill else f"<li>{said}</li>"


def figure_html(figure: Figure) -> str:
    """A figure as a part of a page, its plot as text of an SVG."""
    from testbed.views.figure_door import to_svg

    label = escape(f"{figure.title}. {figure.caption}", quote=True)
    return (
        f'<figure id="figure-{figure.name}"><h3>{escape(figure.title)}</h3>'
        f"{for_page(to_svg(figure.sheet), figure.name, label)}"
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


def saved(name: str, kind: str, data: bytes) -> str:
    """A link that saves a file of this kind, as text/yaml is one."""
    encoded = base64.b64encode(data).decode()
    return (
        f'<a download="{escape(name, quote=True)}" href="data:{kind};base64,{encoded}">'
        f"Save {escape(name)}</a>"
    )


def write_text(text: str, path: Path) -> None:
    """Write a page whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    with replacing(path) as file:
        file.write(text)


def draw_all(figures: Iterable[Figure], folder: Path, ending: str) -> list[Path]:
    """Write figures into a folder, made if need be, and return their files.

    Args:
        figures: with names that differ.
        folder: where.
        ending: one of `FORMATS`.

    Raises:
        OSError: one cannot be written.
    """
    from testbed.views.figure_door import draw

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for figure in figures:
        paths.append(folder / f"{figure.name}.{ending}")
        draw(figure.sheet, paths[-1])
    return paths
