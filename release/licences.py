"""Write docs/contributing/licences.md: licences of all installed packages, from their metadata.

usage: python release/licences.py > docs/contributing/licences.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from locked import LOCK, here, needed, pins

# Licence names that are not those of https://spdx.org/licenses.
WORDINGS = {
    "3-Clause BSD License": "BSD-3-Clause",
    "Apache 2.0": "Apache-2.0",
    "Apache Software License": "Apache-2.0",
    "BSD": "BSD",
    "BSD 3-Clause License": "BSD-3-Clause",
    "BSD License": "BSD",
    "GNU Lesser General Public License v2 or later (LGPLv2+)": "LGPL-2.1-or-later",
    "GNU Lesser General Public License v3 (LGPLv3)": "LGPL-3.0",
    "ISC License (ISCL)": "ISC",
    "ISC license": "ISC",
    "LGPLv3": "LGPL-3.0",
    "MIT License": "MIT",
    "any-OSI": "MIT",  # any licence that the Open Source Initiative approves
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
HEAD = """# Licences

The testbed is under the MIT licence. This page lists the packages that pip installs with it
and its extra `all`, with the licence in each package's metadata.
`python release/licences.py > docs/contributing/licences.md` writes it.

| package | licence |
|---|---|
"""
FOOT = """
JSBSim and pymavlink are libraries under the LGPL, used unmodified: each can be replaced by another
version, as that licence requires. Of pymavlink only the generated message tables are imported,
which are under the MIT licence. The sources of the aircraft are in their folders
([Rascal](../../aircraft/rascal110/SOURCE.md), [X8](../../aircraft/skywalker_x8/SOURCE.md)).

The compiled flight models (`testbed/vehicle/compiled`) are this project's own Python under the MIT
licence, written from the equations of flight, JSBSim's documentation and the behaviour of release
1.3.3, with which tests compare them to the bit. No file of JSBSim is part of them: what they
translate are an aircraft's XML files, which keep the licence of their authors.

The functions of FMI 2.0 are declared in `testbed/fmi/aircraft_fmu.c` itself, from the text of the
standard; no header of others is part of an FMU. Its `documentation/licenses` has the testbed's
licence and the licence files of the aircraft's folder. A library that zig links has parts of zig's
run-time (MIT) and, for Windows, of mingw-w64 (public domain; Zope Public License).

Tools for tests and docs are not installed with the testbed and not imported by it. A test compares
this page, and every package of the lock file, with a list of licences compatible with MIT.
"""


def locked() -> list[str]:
    """Return the names of all packages in the lock file, with tools for tests and docs."""
    return sorted({pin.name for pin in pins(LOCK.read_text(encoding="utf-8"))})


def running() -> list[str]:
    """Return the names of the installed runtime packages."""
    return sorted(name for name in needed(here()) if installed(name) is not None)


def installed(name: str) -> Distribution | None:
    """Return an installed package; None if it is for another system."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def licence(package: Distribution) -> str:
    """Return a package's licence, by its SPDX name where known."""
    metadata = package.metadata
    if expression := metadata.get("License-Expression"):
        return str(expression)
    line = str(metadata.get("License") or "").strip().split("\n")[0]
    if line in WORDINGS or re.fullmatch(r"[A-Za-z]+(-[A-Za-z0-9.]+)*", line) and line != "UNKNOWN":
        return WORDINGS.get(line, line)
    named = (each for each in metadata.get_all("Classifier") or () if each.startswith("License ::"))
    kinds = (each.split("::")[-1].strip() for each in named)
    return " AND ".join(WORDINGS.get(each, each) for each in kinds)


def rows() -> Iterator[str]:
    """Return a table row per runtime package."""
    for name in running():
        found = installed(name)
        if found is not None:
            yield f"| [{name}](https://pypi.org/project/{name}/) | {licence(found)} |"


def page() -> str:
    """Return the whole page."""
    return HEAD + "\n".join(rows()) + "\n" + FOOT


if __name__ == "__main__":
    print(page(), end="")
