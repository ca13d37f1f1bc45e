"""Parts that can be used alone: each has a README, and needs no package but those it imports."""

import json
import re
import subprocess
import sys

import package_groups as groups
import pytest
from places import ROOT
from waiting import TIMEOUT_S

PARTS = (
    *("formation", "atmosphere", "network", "mavlink", "autopilot", "sensors", "compiled"),
    *("link", "flight_logs", "linear", "studies", "golden"),
)
# Packages whose modules are imported: the part, and those that its README describes with it.
TOGETHER = {"compiled": ("compiled", "vehicle", "airframes")}
LINES = range(40, 61)
PROGRAM = ROOT / "tests" / "shared" / "run_part_alone.py"
SNIPPET = re.compile(r"^```python\n(.*?)^```\n\n```text\n(.*?)^```$", re.M | re.S)
NAME = re.compile(r"^\| `([\w.]+)` \| `([\w.]+)` \| [^|]+ \|$", re.M)
LINK = re.compile(r"\]\(([^)\s#]+)\)")


def readme(part):
    return (groups.PACKAGE / part / "README.md").read_text(encoding="utf-8")


def run_alone(part, folder, *, blocked=(), snippet=None):
    """Run the program for a part in a folder; return the process."""
    text = readme(part)
    given = {
        "blocked": sorted({*blocked, *groups.PACKAGES} - (groups.reachable(part) - {*blocked})),
        "packages": TOGETHER.get(part, (part,)),
        "names": [(module, name) for name, module in NAME.findall(text)],
        "snippet": SNIPPET.search(text)[1] if snippet is None else snippet,
    }
    return subprocess.run(
        (sys.executable, str(PROGRAM)),
        input=json.dumps(given),
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )


def trimmed(text):
    return [line.rstrip() for line in text.strip().splitlines()]


@pytest.mark.parametrize("part", PARTS)
def test_part_stands_alone(part, tmp_path):
    """In an empty folder its README's snippet prints the pasted output; its names exist."""
    (snippet,) = SNIPPET.findall(readme(part))
    done = run_alone(part, tmp_path)
    assert done.returncode == 0, done.stderr
    assert trimmed(done.stdout) == trimmed(snippet[1])


@pytest.mark.parametrize("package", ["core", "scenario"])
def test_a_blocked_package_is_missed(package, tmp_path):
    """Control: without a package that it imports, a part fails."""
    done = run_alone("network", tmp_path, blocked=[package], snippet="")
    assert done.returncode == 1
    assert f"ImportError: testbed.{package}" in done.stderr
    assert "is blocked" in done.stderr


def test_a_snippet_reaches_no_other_package(tmp_path):
    """Control: the snippet of a part cannot use a package that the part does not import."""
    done = run_alone("golden", tmp_path, snippet="import testbed.studies.plan")
    assert done.returncode == 1
    assert "ImportError: testbed.studies is blocked" in done.stderr


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
    reachable = {f"testbed.{each}" for each in groups.reachable(part)}
    assert {".".join(each.split(".")[:2]) for each in modules} <= reachable
    for link in LINK.findall(text):
        assert (groups.PACKAGE / part / link).exists(), link


def test_page_of_packages_links_to_every_readme():
    text = groups.PAGE.read_text(encoding="utf-8")
    linked = set(re.findall(r"\(\.\./\.\./testbed/(\w+)/README\.md\)", text))
    written = {path.parent.name for path in groups.PACKAGE.glob("*/README.md")}
    assert linked == written == set(PARTS)
