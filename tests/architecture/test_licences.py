"""Everything that is installed has a licence that goes with ours, and the page says which."""

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
# Libraries that are used as they are; and a list of certificates, and a matcher of paths, of tools.
AS_THEY_ARE = {"jsbsim": "LGPL-2.1-or-later", "pymavlink": "LGPL-3.0"}
OF_TOOLS = {"MPL-2.0"}


@pytest.fixture
def licences(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "release"))
    return importlib.import_module("licences")


def test_every_locked_package_has_a_licence_that_goes_with_mit(licences):
    runs, seen = set(licences.running()), 0
    assert {"jsbsim", "numpy", "pymavlink", "mcap", "rerun-sdk"} <= runs < set(licences.locked())
    for name in licences.locked():
        package = licences.installed(name)
        if package is None:  # of another system
            continue
        said = licences.licence(package)
        if AS_THEY_ARE.get(name) == said:
            continue
        allowed = FREE if name in runs else FREE | OF_TOOLS
        assert set(re.split(" AND | OR ", said)) <= allowed, f"{name}: {said or 'says none'}"
        seen += 1
    assert seen > 80


def test_the_page_is_what_packages_say(licences):
    page = (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")
    missing = set(licences.rows()) - set(page.splitlines())  # on another Python there may be fewer
    assert not missing, "write it anew: python release/licences.py > docs/licences.md"
    assert page.startswith(licences.HEAD) and page.endswith(licences.FOOT)
