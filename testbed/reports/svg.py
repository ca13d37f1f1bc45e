"""Figures as SVG elements of an HTML page with a light and a dark style."""

from __future__ import annotations

import re

from testbed.views.palette import ON_WHITE
from testbed.views.panels import BLACK, GREY, GRID, PATH

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
