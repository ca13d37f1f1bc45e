"""Every installed package has a compatible licence, and docs/contributing/licences.md lists it."""

import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FREE = {
    "0BSD",
    "Apache-2.0",
    "Apache-2.0 WITH LLVM-exception",
    "BSD",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "CC0-1.0",
    "ISC",
    "MIT",
    "MIT-CMU",
    "PSF-2.0",
    "Zlib",
}
# Libraries that are used unmodified; licences of tools only.
UNMODIFIED = {"jsbsim": "LGPL-2.1-or-later", "pymavlink": "LGPL-3.0"}
TOOLS = {"MPL-2.0"}


@pytest.fixture
def licences(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "release"))
    return importlib.import_module("licences")


def test_locked_packages_have_compatible_licences(licences):
    runs, seen = set(licences.running()), 0
    assert {"jsbsim", "numpy", "pymavlink", "mcap", "rerun-sdk"} <= runs < set(licences.locked())
    for name in licences.locked():
        package = licences.installed(name)
        if package is None:  # for another system
            continue
        licence = licences.licence(package)
        if UNMODIFIED.get(name) == licence:
            continue
        allowed = FREE if name in runs else FREE | TOOLS
        assert set(re.split(" AND | OR ", licence)) <= allowed, f"{name}: {licence or 'no licence'}"
        seen += 1
    assert seen > 80


def test_licences_page_matches_the_packages(licences):
    page = (ROOT / "docs" / "contributing" / "licences.md").read_text(encoding="utf-8")
    missing = set(licences.rows()) - set(page.splitlines())  # another Python may have fewer
    assert not missing, "run python release/licences.py > docs/contributing/licences.md"
    assert page.startswith(licences.HEAD) and page.endswith(licences.FOOT)
