"""The files that come with the testbed: `aircraft/` and `scenarios/`."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def library() -> Path:
    """Return the folder that holds `aircraft/` and `scenarios/`.

    A checkout has both beside the package, an installed wheel inside it.
    """
    checkout = _PACKAGE.parent
    if (checkout / "aircraft").is_dir() and (checkout / "scenarios").is_dir():
        return checkout
    return _PACKAGE / "_data"
