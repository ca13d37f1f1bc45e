"""Sizes of an aircraft as its file gives them, read without JSBSim."""

from __future__ import annotations

import math
from pathlib import Path
from xml.parsers import expat

from testbed.airframes.airframe_validation import MAX_BYTES
from testbed.airframes.powerplant import AircraftError
from testbed.core.input_files import read_bounded

_METRES = {"FT": 0.3048, "M": 1.0, "IN": 0.0254}
_PATH = ["fdm_config", "metrics", "wingspan"]


def read_wingspan(folder: Path) -> float:
    """Return the wingspan that the main file of an aircraft's folder gives, m.

    Raises:
        AircraftError: the file cannot be read, or gives no wingspan.
    """
    folder = Path(folder).resolve()
    file = folder / f"{folder.name}.xml"
    open_elements, units, text = list[str](), list[str](), list[str]()

    def begin(name: str, attributes: dict[str, str]) -> None:
        open_elements.append(name)
        if open_elements == _PATH:
            units.append(attributes.get("unit", "FT"))

    def characters(data: str) -> None:
        if open_elements == _PATH:
            text.append(data)

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.CharacterDataHandler = begin, characters
    parser.EndElementHandler = lambda name: open_elements.pop()
    parser.DefaultHandler = lambda data: None  # with which entities are not expanded
    try:
        parser.Parse(read_bounded(file, MAX_BYTES, error=AircraftError), True)
        span = float("".join(text)) * _METRES[units[0]]
    except expat.ExpatError as error:
        raise AircraftError(f"{file}:{error.lineno}: is not XML: {error}") from error
    except (IndexError, KeyError, ValueError):
        span = math.nan
    if not 0.0 < span < math.inf:
        raise AircraftError(f'{file}: no wingspan (write <wingspan unit="M"> in <metrics>)')
    return span
