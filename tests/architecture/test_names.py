"""Names of tests: short enough to be read in a list of failures."""

import ast
from pathlib import Path

MAX_CHARACTERS = 50
TESTS = Path(__file__).parents[1]


def test_names_of_tests_are_short():
    nodes = [
        (path.name, node)
        for path in TESTS.rglob("test_*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    ]
    names = [
        (file, node.name)
        for file, node in nodes
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
    ]
    assert len(names) > 1_000
    assert not [(file, name) for file, name in names if len(name) > MAX_CHARACTERS]
