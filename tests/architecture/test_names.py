"""Names: of tests short enough for a list of failures, of classes with one meaning each."""

import re
from pathlib import Path

import testbed

MAX_CHARACTERS = 50
ROOT = Path(__file__).parents[2]
PACKAGE = Path(testbed.__file__).parent


def test_names_of_tests_are_short():
    names = [
        (path.name, name)
        for folder in ("tests", "paper")
        for path in (ROOT / folder).rglob("test_*.py")
        for name in re.findall(r"^ *def (test_\w*)", path.read_text(encoding="utf-8"), re.M)
    ]
    assert len(names) > 1_000
    assert not [(file, name) for file, name in names if len(name) > MAX_CHARACTERS]


def test_no_two_classes_have_the_same_name():
    """A name that means two things is two names."""
    places = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in re.findall(r"^ *class (\w+)[(:]", path.read_text(encoding="utf-8"), re.M):
            places.setdefault(name, []).append(f"{path.relative_to(PACKAGE)}")
    assert {name: each for name, each in places.items() if each[1:]} == {}
