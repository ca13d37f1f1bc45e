"""Parts that can be used alone: each has a README, and needs no package but those it imports."""

import importlib
import os
import re
from operator import attrgetter

import package_groups as groups
import pytest
from cases import some
from fresh import run_fresh
from places import ROOT, SHARED

PARTS = (
    *("formation", "atmosphere", "network", "mavlink", "autopilot", "sensors", "compiled"),
    *("link", "flight_logs", "linear", "studies", "golden"),
)
# Packages whose modules are imported: the part, and those that its README describes with it.
TOGETHER = {"compiled": ("compiled", "vehicle", "airframes")}
LINES = range(40, 61)
SNIPPET = re.compile(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```$", re.M | re.S)
NAME = re.compile(r"^\| `([\w.]+)` \| `([\w.]+)` \| [^|]+ \|$", re.M)
LINK = re.compile(r"\]\(([^)\s#]+)\)")


def readme(part):
    return (groups.PACKAGE / part / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def alone(tmp_path):
    """Function that runs a part's snippet, or another one, without other packages."""

    def run(part, *, blocked=(), snippet=None):
        text = readme(part)
        given = {
            "blocked": sorted({*blocked, *groups.PACKAGES} - (groups.reachable(part) - {*blocked})),
            "packages": TOGETHER.get(part, (part,)),
            "names": [(module, name) for name, module in NAME.findall(text)],
            "snippet": SNIPPET.search(text)[1] if snippet is None else snippet,
        }
        code = f"import run_part_alone; run_part_alone.main({given!r})"
        return run_fresh(code, folder=tmp_path, paths=[ROOT, SHARED], env=dict(os.environ))

    return run


def trimmed(text):
    return [line.rstrip() for line in text.strip().splitlines()]


@pytest.mark.parametrize("part", some(PARTS, 3))
def test_part_stands_alone(part, alone):
    """In an empty folder its README's snippet prints the pasted output; its names exist."""
    (snippet,) = SNIPPET.findall(readme(part))
    code, output, errors = alone(part)
    assert code == 0, errors
    assert trimmed(output) == trimmed(snippet[1])


@pytest.mark.parametrize("package", ["core", "scenario"])
def test_a_blocked_package_is_missed(package, alone):
    """Control: without a package that it imports, a part fails."""
    code, _, errors = alone("network", blocked=[package], snippet="")
    assert code == 1
    assert f"ImportError: testbed.{package}" in errors
    assert "is blocked" in errors


def test_a_snippet_reaches_no_other_package(alone):
    """Control: the snippet of a part cannot use a package that the part does not import."""
    code, _, errors = alone("golden", snippet="import testbed.studies.plan")
    assert code == 1
    assert "ImportError: testbed.studies is blocked" in errors


@pytest.mark.parametrize("part", PARTS)
def test_readme_states_what_the_table_allows(part):
    text = readme(part)
    assert len(text.splitlines()) in LINES
    flat = " ".join(text.split())
    direct = re.search(r"It imports ((?:`\w+`,? ?)+)\.", flat)[1]
    assert set(re.findall(r"\w+", direct)) == groups.allowed(part) - {part}
    further = re.search(r"With these come ((?:`\w+`,? ?)+)\.", flat)
    indirect = set(re.findall(r"\w+", further[1])) if further else set()
    assert indirect == groups.reachable(part) - groups.allowed(part)
    assert f"`make test PART={part}`" in text and (ROOT / "tests" / part).is_dir()


@pytest.mark.parametrize("part", PARTS)
def test_readme_lists_names_of_the_part(part):
    text = readme(part)
    modules = [module for _, module in NAME.findall(text)]
    assert len(modules) == text.count("\n| `") >= 5
    for name, module in NAME.findall(text):
        attrgetter(name)(importlib.import_module(module))
    reachable = {f"testbed.{each}" for each in groups.reachable(part)}
    assert {".".join(each.split(".")[:2]) for each in modules} <= reachable
    for link in LINK.findall(text):
        assert (groups.PACKAGE / part / link).exists(), link


def test_page_of_packages_links_to_every_readme():
    text = groups.PAGE.read_text(encoding="utf-8")
    linked = set(re.findall(r"\(\.\./\.\./testbed/(\w+)/README\.md\)", text))
    written = {path.parent.name for path in groups.PACKAGE.glob("*/README.md")}
    assert linked == written == set(PARTS)
