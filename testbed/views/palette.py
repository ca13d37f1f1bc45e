"""The colours of aircraft and curves, on white and on dark backgrounds.

In order: neighbours in the order differ most. All have a contrast of at least 3 to 1 with their
background. The first on each are Okabe and Ito's; each of the others was chosen as far as possible
from those before it, in Oklab as seen with full, without red and without green cones.
"""

from __future__ import annotations

Colour = tuple[int, int, int]  # red, green, blue, 0..255

# on white, by name
ON_WHITE = {
    "blue": "#0072b2",
    "orange": "#d55e00",
    "green": "#009e73",
    "pink": "#a50f5a",
    "violet": "#a078ff",
    "brown": "#5a2800",
    "navy": "#0000b4",
    "purple": "#6900ff",
    "plum": "#4b0069",
    "rust": "#964b00",
}
# on dark, of which a report uses as many as there are on white, by the same names
ON_DARK = (
    "#56b4e9",
    "#e69f00",
    "#009e73",
    "#cc79a7",
    "#8f6bff",
    "#f0e442",
    "#00e1a5",
    "#a54b0f",
    "#b400c3",
    "#f05a3c",
    "#e1c3ff",
    "#96ffa5",
    "#96b478",
    "#782dff",
    "#5a87d2",
    "#c31e5a",
    "#d23ca5",
    "#b4d269",
    "#c3a5b4",
    "#3c9600",
)


def rgb(colour: str) -> Colour:
    """Convert a colour written as #rrggbb."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue
