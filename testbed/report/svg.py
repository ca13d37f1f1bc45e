"""Figures as parts of a page: one that is light or dark, and that has other figures beside."""

from __future__ import annotations

import re

from testbed.views.panels import BLACK, BLUE, GOLD, GREEN, GREY, GRID, ORANGE, PURPLE, SKY

# Colours of the figures, by the names under which the page's style has them by day and by night.
COLOURS = {
    BLACK: "ink",
    GRID: "grid",
    GREY: "grey",
    BLUE: "blue",
    ORANGE: "orange",
    GREEN: "green",
    PURPLE: "purple",
    GOLD: "gold",
    SKY: "sky",
}
_DECIMALS = re.compile(r"(\.\d)\d+")  # a tenth of a point is less than is seen
_CURVE = re.compile(r' d="[^"]{300,}"')  # and no outline of a marker, which would be
_IDS = re.compile(r' id="(?:figure|axes|patch|axis|matplotlib|xtick|ytick|line2d|text|legend|'
                  r'FillBetween|PolyCollection|Poly|Line|pane|grid|Rectangle)[^"]*"')  # fmt: skip
_NAMED = re.compile(r'( id="|href="#|url\(#)')  # what is left of them: clips and markers
_COLOUR = re.compile("|".join(COLOURS), re.IGNORECASE)


def for_page(svg: str, name: str, label: str) -> str:
    """An SVG document as an element of a page.

    Its colours become the page's, curves are cut to tenths of a point, the names of its groups go,
    and those of clips and markers get the figure's before them, so that no two are alike.

    Args:
        svg: the document.
        name: of the figure, unlike all others on the page.
        label: what it shows, in words, for those who do not see it.
    """
    text = svg[svg.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = _NAMED.sub(rf"\1{name}-", _IDS.sub("", text))
    text = _CURVE.sub(lambda curve: _DECIMALS.sub(r"\1", curve[0]), text)
    text = _COLOUR.sub(lambda found: f"var(--{COLOURS[found[0].lower()]})", text)
    text = re.sub(r">\s+<", "><", text)
    box = re.search(r'viewBox="[^"]*"', text)
    assert box
    end = text.index(">")
    return f'<svg {box[0]} role="img" aria-label="{label}" class="plot"{text[end:]}'.strip()
