"""Print the installed size of the testbed with each of its extras, as a table.

usage: python release/sizes.py

Counts the files of the installed packages, with their compiled modules (.pyc), from the metadata of
this environment, which has all of them.
"""

from __future__ import annotations

from pathlib import Path

from licences import installed
from locked import distribution_name, here, needed, requirements_with

VARIANTS = (
    *("", "view", "video", "report", "study", "mavlink", "px4", "notebook", "all"),
    *("rl", "ros2", "dask"),
)
LARGE = 20e6  # bytes, of packages that are named


def size_of(name: str) -> int:
    """Return the size of a package's files, bytes; 0 if it is for another system."""
    package = installed(name)
    files = (Path(str(each.locate())) for each in package.files or ()) if package else ()
    return sum(path.stat().st_size for path in files if path.is_file())


def rows() -> list[str]:
    """Return the rows of the table: variant, packages, size, and what is large in it."""
    plain = needed(here(), requirements_with()).keys()
    found = []
    for extra in VARIANTS:
        names = needed(here(), requirements_with(*filter(None, [extra]))).keys()
        sizes = {name: size_of(name) for name in names}
        added = sorted(sizes if not extra else names - plain, key=lambda name: -sizes[name])
        large = ", ".join(f"{n} {sizes[n] / 1e6:.0f}" for n in added if sizes[n] > LARGE)
        variant = f"{distribution_name()}{f'[{extra}]' if extra else ''}"
        total = sum(sizes.values()) / 1e6
        found.append(f"| `{variant}` | {len(sizes)} | {total:,.0f} | {large} |")
    return found


if __name__ == "__main__":
    print("| installed | packages | MB | the largest, MB |\n|---|---|---|---|")
    print("\n".join(rows()))
