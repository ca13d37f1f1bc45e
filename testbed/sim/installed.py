"""Whether a module is installed, and not just in the way: here, or in a folder of PYTHONPATH."""

from __future__ import annotations

import importlib.util
import json
import site
import sysconfig
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path
from urllib.parse import unquote, urlsplit


def is_installed(name: str) -> bool:
    """Whether the package that a module is of was installed, a copy to be edited among them.

    Nothing is imported. What comes with Python is not counted: none of it is anybody's law.
    """
    try:
        spec = importlib.util.find_spec(name.partition(".")[0])
    except (ImportError, ValueError):
        return False
    if spec is None:
        return False
    places = [spec.origin, *(spec.submodule_search_locations or ())]
    found = [Path(place).resolve() for place in places if place]
    return any(place.is_relative_to(home) for home in _homes() for place in found)


def _homes() -> Iterator[Path]:
    """Where what is installed lies."""
    for each in (*map(sysconfig.get_path, ("purelib", "platlib")), site.getusersitepackages()):
        yield Path(each).resolve()
    for package in distributions():
        told = json.loads(package.read_text("direct_url.json") or "{}")
        if told.get("dir_info", {}).get("editable"):
            yield Path(unquote(urlsplit(told["url"]).path)).resolve()
