"""HTML pages of reports: one file each, without scripts and external resources."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from testbed.core.files import write_text_file
from testbed.reports.figure_spec import Figure
from testbed.reports.style import STYLE
from testbed.reports.svg import embed_svg

FORMATS = ("png", "pdf", "svg")


@dataclass(frozen=True, slots=True)
class Section:
    """A section of a page; it is left out if its content is empty."""

    name: str  # of its anchor
    heading: str
    content: str  # HTML


@dataclass(frozen=True, slots=True)
class Page:
    """A report."""

    title: str  # plain text, of the browser's tab
    head: str  # HTML above the links to the sections
    sections: Sequence[Section]
    footer: str  # plain text


def render_page(page: Page) -> str:
    """Render a page as an HTML document."""
    shown = [section for section in page.sections if section.content]
    links = "".join(f'<a href="#{section.name}">{section.heading}</a>' for section in shown)
    body = "".join(
        f'<section id="{section.name}"><h2>{section.heading}</h2>{section.content}</section>'
        for section in shown
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<link rel="icon" href="data:,">\n'
        f"<title>{escape(page.title)} · report</title>\n<style>\n{STYLE}\n</style>\n</head>\n"
        f"<body>\n<header>{page.head}<nav>{links}</nav></header>\n<main>{body}</main>\n"
        f"<footer>{escape(page.footer)}</footer>\n</body>\n</html>\n"
    )


def write_page(page: Page, path: Path) -> None:
    """Write a page; the same page gives the same bytes.

    Raises:
        OSError: the file cannot be written.
    """
    with write_text_file(path) as file:
        file.write(render_page(page))


def save_figures(figures: Iterable[Figure], folder: Path, ending: str) -> list[Path]:
    """Write figures to a folder, which is made if needed; return the files.

    Args:
        figures: with different names.
        folder: of the files.
        ending: one of `FORMATS`.

    Raises:
        OSError: a file cannot be written.
    """
    from testbed.views.matplotlib_backend import save_figure

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for figure in figures:
        paths.append(folder / f"{figure.name}.{ending}")
        save_figure(figure.grid, paths[-1])
    return paths


def figure_html(figure: Figure) -> str:
    """Make the HTML of a figure, its plot as SVG with text."""
    from testbed.views.matplotlib_backend import figure_svg

    label = escape(f"{figure.title}. {figure.caption}", quote=True)
    return (
        f'<figure id="figure-{figure.name}"><h3>{escape(figure.title)}</h3>'
        f'<div class="wide">{embed_svg(figure_svg(figure.grid), figure.name, label)}</div>'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


def cards_html(cards: Iterable[tuple[str, str, str]]) -> str:
    """Make large numbers, each with HTML of its meaning and the text of a problem or ""."""
    return f'<ul class="cards">{"".join(_card(*each) for each in cards)}</ul>'


def _card(value: str, meaning: str, problem: str) -> str:
    content = f"<b>{value}</b><span>{meaning}</span>"
    if not problem:
        return f"<li>{content}</li>"
    return f'<li class="bad">{content}<em>{escape(problem)}</em></li>'


def download_link(name: str, media_type: str, data: bytes) -> str:
    """Make a link that saves a file, with its data in the link."""
    encoded = base64.b64encode(data).decode()
    return (
        f'<a download="{escape(name, quote=True)}" href="data:{media_type};base64,{encoded}">'
        f"Save {escape(name)}</a>"
    )


def file_html(name: str, media_type: str, data: bytes) -> str:
    """Show a text file, with a link above it that saves it."""
    link = download_link(name, media_type, data)
    text = escape(data.decode("utf-8", "replace"))
    return f'<p class="screen">{link}</p><pre class="file">{text}</pre>'
