"""HTML pages of reports: one file each, without scripts and external resources.

Figures are SVG elements with a light and a dark style; tables are those of the terminal, cell by
cell, so that they have the same numbers.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from testbed.core.files import write_text_file
from testbed.reports.figure_spec import Figure
from testbed.views.figure_style import DEFAULT_STYLE, FigureStyle
from testbed.views.panels import BLACK, GREY, GRID, ON_DARK, ON_WHITE, PATH

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


def _curve_colours(colours: Iterable[str]) -> str:
    """Set the CSS variables of the colours of curves."""
    return " ".join(f"--{name}: {each};" for name, each in zip(ON_WHITE, colours, strict=False))


STYLE = (
    """
:root {
  color-scheme: light dark;
  --paper: #ffffff; --ink: #16191d; --soft: #555d66; --rule: #d9dde2; --wash: #f5f6f8;
  --grid: #e3e5e8; --grey: #7f858c; --path: #c4c4c4; --good: #00704f; --bad: #b03a00;
  --shade: rgb(0 0 0 / 22%); --stripe: rgb(90 105 125 / 6%); CURVES ON WHITE
}
@media (prefers-color-scheme: dark) {
  :root {
    --paper: #14171a; --ink: #e7eaed; --soft: #a3abb3; --rule: #373d43; --wash: #1c2024;
    --grid: #2d3237; --grey: #8f979f; --path: #454c54; --good: #4fd0a5; --bad: #ff9d66;
    --shade: rgb(255 255 255 / 28%); --stripe: rgb(160 180 200 / 6%); CURVES ON DARK
  }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body {
  margin: 0 auto; max-width: 68rem; padding: 2.2rem 1.4rem 4rem; background: var(--paper);
  color: var(--ink); font: 1rem/1.55 system-ui, "Segoe UI", "DejaVu Sans", Arial, sans-serif;
}
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .7rem; padding-top: .9rem;
  border-top: 1px solid var(--rule); }
h3 { font-size: 1.05rem; margin: 1.9rem 0 .3rem; }
p { max-width: 46rem; margin: .5rem 0; }
a { color: var(--blue); }
.question { font-size: 1.12rem; color: var(--soft); }
.meta { color: var(--soft); margin: .2rem 0 1rem; }
.outcome { font-weight: 600; color: var(--ink); border: 1px solid currentColor;
  border-radius: .3rem; padding: .05rem .45rem; }
.outcome.completed { color: var(--good); }
.outcome.lost, .outcome.envelope_exceeded, .outcome.formation_lost,
.outcome.separation_lost, .outcome.bound_violated, .outcome.failed { color: var(--bad); }
nav { display: flex; flex-wrap: wrap; gap: .2rem 1rem; margin: .6rem 0 1.4rem; font-size: .95rem; }
nav a { white-space: nowrap; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: .8rem;
  margin: 1.2rem 0; padding: 0; list-style: none; }
.cards li { background: var(--wash); border: 1px solid var(--rule); border-radius: .5rem;
  padding: .7rem .9rem; }
.cards b { display: block; font-size: 1.45rem; font-weight: 650;
  font-variant-numeric: tabular-nums; }
.cards span { color: var(--soft); font-size: .88rem; overflow-wrap: anywhere; }
.cards li.bad { border: 2px solid var(--bad); }
.cards .bad b, .cards em { color: var(--bad); }
.cards em { display: block; font-size: .88rem; font-style: normal; font-weight: 600; }
summary { cursor: pointer; color: var(--soft); font-size: .92rem; }
/* What scrolls sideways has a shadow at each end that is cut off: covers scroll, shadows stay. */
.wide { overflow-x: auto; margin: .8rem 0; background:
  linear-gradient(to right, var(--paper) 40%, transparent) left / 2.5rem 102% no-repeat local,
  linear-gradient(to left, var(--paper) 40%, transparent) right / 2.5rem 102% no-repeat local,
  linear-gradient(to right, var(--shade), transparent) left / 1rem 100% no-repeat scroll,
  linear-gradient(to left, var(--shade), transparent) right / 1rem 100% no-repeat scroll; }
figure .wide { margin: 0; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; font-size: .94rem; }
th, td { padding: .28rem .8rem; text-align: right; vertical-align: bottom; }
thead th { border-bottom: 1.5px solid var(--soft); font-weight: 600; line-height: 1.3; }
th:first-child { text-align: left; padding-left: .2rem; }
tbody th { font-weight: 500; }
table:not(.facts) th:first-child { white-space: nowrap; }
tbody tr:nth-child(even) { background: var(--stripe); }
tr.ends > * { border-bottom: 1px solid var(--rule); }
.facts th, .facts td { text-align: left; vertical-align: top; }
.green { color: var(--good); } .red { color: var(--bad); } .yellow { color: var(--bad); }
.dim { color: var(--soft); } .bold { font-weight: 650; }
figure { margin: .4rem 0 2rem; break-inside: avoid; }
figcaption { color: var(--soft); font-size: .92rem; max-width: 50rem; margin-top: .3rem; }
.plot { width: 100%; height: auto; display: block; }
.plot text { fill: var(--ink); font-family: inherit; }
@media screen { .plot { min-width: 44rem; } } /* text stays readable: narrow screens scroll */
pre { background: var(--wash); border: 1px solid var(--rule); border-radius: .5rem;
  padding: .8rem 1rem; overflow: auto;
  font: .84rem/1.45 ui-monospace, "DejaVu Sans Mono", monospace; }
pre.file { max-height: 26rem; }
code { font: .9em ui-monospace, "DejaVu Sans Mono", monospace; }
footer { margin-top: 3rem; color: var(--soft); font-size: .85rem; }
@page { size: A4; margin: 14mm; }
@media print {
  :root {
    --paper: #ffffff; --ink: #000000; --soft: #444444; --rule: #bbbbbb; --wash: #ffffff;
    --grid: #dddddd; --grey: #777777; --path: #c4c4c4; --good: #005c41; --bad: #8f2f00;
    CURVES ON WHITE
  }
  body { max-width: none; padding: 0; font-size: 9.5pt; }
  nav, .screen { display: none; }
  .wide, pre, pre.file { overflow: visible; max-height: none; background: none; }
  pre { white-space: pre-wrap; font-size: 7.5pt; }
  h2, h3 { break-after: avoid; }
  tr, .cards li { break-inside: avoid; }
}
""".strip()
    .replace("CURVES ON WHITE", _curve_colours(ON_WHITE.values()))
    .replace("CURVES ON DARK", _curve_colours(ON_DARK))
)


# Colours of the figures, and the CSS variables of the page that replace them.
COLOURS = {
    BLACK: "ink",
    GRID: "grid",
    GREY: "grey",
    PATH: "path",
    **{colour: name for name, colour in ON_WHITE.items()},
}
_DECIMALS = re.compile(r"(\.\d)\d+")  # tenths of a point are precise enough to draw
_CURVE = re.compile(r' d="[^"]{300,}"')  # long paths only: outlines of markers need their digits
_IDS = re.compile(r' id="(?:figure|axes|patch|axis|matplotlib|xtick|ytick|line2d|text|legend|'
                  r'FillBetween|PolyCollection|Poly|Line|pane|grid|Rectangle)[^"]*"')  # fmt: skip
_REFERENCES = re.compile(r'( id="|href="#|url\(#)')  # of clip paths and markers
_COLOUR = re.compile("|".join(COLOURS), re.IGNORECASE)


def embed_svg(svg: str, name: str, label: str) -> str:
    """Convert an SVG document to an element of a page.

    Colours become CSS variables, curves are rounded to tenths of a point, ids of groups are
    removed, and ids of clip paths and markers get the name of the figure as a prefix.

    Args:
        svg: the document.
        name: of the figure, unique on the page.
        label: text description for screen readers.
    """
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = _REFERENCES.sub(rf"\1{name}-", _IDS.sub("", text))
    text = _CURVE.sub(lambda curve: _DECIMALS.sub(r"\1", curve[0]), text)
    text = _COLOUR.sub(lambda found: f"var(--{COLOURS[found[0].lower()]})", text)
    text = re.sub(r">\s+<", "><", text)
    box = re.search(r'viewBox="[^"]*"', text)
    assert box
    end = text.index(">")
    return f'<svg {box[0]} role="img" aria-label="{label}" class="plot"{text[end:]}'.strip()


FORMATS = ("png", "pdf", "svg")


@dataclass(frozen=True, slots=True)
class PageSection:
    """A section of a page; it is left out if its content is empty."""

    name: str  # of its anchor
    heading: str
    content: str  # HTML


@dataclass(frozen=True, slots=True)
class Page:
    """A report."""

    title: str  # plain text, of the browser's tab
    head: str  # HTML above the links to the sections
    sections: Sequence[PageSection]
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


def figure_file(figure: Figure, ending: str) -> str:
    """Return the name of the file of a figure in one of `FORMATS`."""
    return f"{figure.name}.{ending}"


def save_figures(
    figures: Iterable[Figure], folder: Path, ending: str, style: FigureStyle = DEFAULT_STYLE
) -> list[Path]:
    """Write figures to a folder, which is made if needed; return the files.

    Args:
        figures: with different names.
        folder: of the files.
        ending: one of `FORMATS`.
        style: of all figures.

    Raises:
        OSError: a file cannot be written.
    """
    from testbed.views.matplotlib_backend import save_figure

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for figure in figures:
        paths.append(folder / figure_file(figure, ending))
        save_figure(figure.grid, paths[-1], style)
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
