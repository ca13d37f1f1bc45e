"""The licences of all that is installed with the testbed, from what packages say of themselves.

usage: python release/licences.py > docs/licences.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution

from locked import LOCK, here, needed, pins

# As packages word it, where they do not use the names of https://spdx.org/licenses.
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
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
    "Python Software Foundation License": "PSF-2.0",
}
HEAD = """# Licences

The testbed is under the MIT licence. What `pip install` brings along with it, by what each
package says of itself:

| package | licence |
|---|---|
"""
FOOT = """
JSBSim and pymavlink are libraries under the LGPL, used as they are installed: each may be replaced
by another version, which is what that licence asks for. Of pymavlink only the generated tables of
messages are imported, which are under the MIT licence. Aircraft have sources of their own, in
their folders ([Rascal](../aircraft/rascal110/SOURCE.md), [X8](../aircraft/skywalker_x8/SOURCE.md)).

Tools that only tests and pages need are in no installation of the testbed, and none of them is
imported by it. A test holds this page and every package of the lock file to a list of licences
that go with MIT.
"""


def locked() -> list[str]:
    """Names of all packages in the lock file, tools for tests and pages too."""
    return sorted({pin.name for pin in pins(LOCK.read_text(encoding="utf-8"))})


def running() -> list[str]:
    """Names of those among them that the testbed needs to run, as they are installed here."""
    return sorted(name for name in needed(here()) if installed(name) is not None)


def installed(name: str) -> Distribution | None:
    """A package; None: of another system, or not here."""
    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def licence(package: Distribution) -> str:
    """What a package says its licence is, by the names of SPDX where they are known."""
    told = package.metadata
    if expression := told.get("License-Expression"):
        return str(expression)
    line = str(told.get("License") or "").strip().split("\n")[0]
    if line in WORDINGS or re.fullmatch(r"[A-Za-z]+(-[A-Za-z0-9.]+)*", line) and line != "UNKNOWN":
        return WORDINGS.get(line, line)
    named = (each for each in told.get_all("Classifier") or () if each.startswith("License ::"))
    kinds = (each.split("::")[-1].strip() for each in named)
    return " AND ".join(WORDINGS.get(each, each) for each in kinds)


def rows() -> Iterator[str]:
    """One for each package that runs."""
    for name in running():
        found = installed(name)
        if found is not None:
            yield f"| [{name}](https://pypi.org/project/{name}/) | {licence(found)} |"


def page() -> str:
    """The whole page."""
    return HEAD + "\n".join(rows()) + "\n" + FOOT


if __name__ == "__main__":
    print(page(), end="")
