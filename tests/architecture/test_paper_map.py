"""The map from the paper to the code, `testbed/formation/paper.md`, is true and complete."""

import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import pytest

import testbed
from testbed import formation

PAGE = Path(formation.__file__).with_name("paper.md")
TESTS = Path(__file__).parents[1]
EQUATIONS = range(1, 32)
CITATION = "[HBH23]"


def tables():
    """Every row of every table as {column: cell}."""
    columns = None
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            columns = None
        elif columns is None:
            columns = cells
        elif not set(line) <= set("|-"):
            yield dict(zip(columns, cells, strict=True))


def quoted(cell):
    return re.findall(r"`([^`]+)`", cell)


ROWS = list(tables())
NAMES = sorted(
    {name for row in ROWS for key in ("name", "function") for name in quoted(row.get(key, ""))}
)
CLAIMED_TESTS = sorted({name for row in ROWS for name in quoted(row.get("test", ""))})


def resolve(name):
    """The object a dotted name stands for; its field or argument must exist too."""
    path, _, argument = name.removesuffix(")").partition("(")
    parts = path.split(".")
    module, rest = testbed, parts
    while rest:
        try:
            module = importlib.import_module(f"{module.__name__}.{rest[0]}")
        except ModuleNotFoundError:
            break
        rest = rest[1:]
    found = module
    for part in rest:
        if inspect.isclass(found):
            assert part in fields(found), f"{name}: {found.__name__} has no {part}"
            found = part
        else:
            found = getattr(found, part)
    if argument:
        assert argument in inspect.signature(found).parameters, name
    return found


def fields(kind):
    return {name for each in kind.__mro__ for name in vars(each).get("__annotations__", {})}


@pytest.mark.parametrize("name", NAMES)
def test_what_is_named_exists(name):
    assert resolve(name) is not None


@pytest.mark.parametrize("name", CLAIMED_TESTS)
def test_a_test_that_is_named_exists(name):
    file, _, test = name.partition("::")
    tree = ast.parse((TESTS / file).read_text(encoding="utf-8"))
    found = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert test.startswith("test_")
    assert test in found


def test_every_equation_has_one_row():
    seen = []
    for row in ROWS:
        cell = row.get("equation")
        if cell is not None:
            first, last = re.fullmatch(r"\((\d+)\)(?:-\((\d+)\))?", cell).groups()
            seen += range(int(first), int(last or first) + 1)
    assert seen == list(EQUATIONS)


def test_what_is_implemented_is_tested_and_what_is_not_is_said():
    page = PAGE.read_text(encoding="utf-8")
    missing = "".join(re.findall(r"^Not yet: (.*?)\n\n", page, re.MULTILINE | re.DOTALL))
    for row in ROWS:
        if "function" not in row:
            continue
        assert bool(quoted(row["function"])) == bool(quoted(row["test"])), row
        if not quoted(row["function"]):
            assert row["equation"] in missing


def cited():
    """Every public function and class of the room that cites the paper, itself or in its module."""
    for info in pkgutil.iter_modules(formation.__path__):
        if info.name.endswith("twin"):
            continue  # says what the others say
        module = importlib.import_module(f"{formation.__name__}.{info.name}")
        for name, found in vars(module).items():
            ours = getattr(found, "__module__", None) == module.__name__
            alias = getattr(found, "__name__", name) != name  # a function that picks its twin
            if name.startswith("_") or alias or not ours:
                continue
            own = CITATION in (inspect.getdoc(found) or "")
            if own or (inspect.isfunction(found) and CITATION in (module.__doc__ or "")):
                yield f"formation.{info.name}.{name}"


def test_everything_that_cites_the_paper_is_on_the_map():
    known = {name.partition("(")[0] for name in NAMES}
    found = set(cited())
    assert len(found) > 10
    assert not found - known, sorted(found - known)


def test_every_symbol_has_a_shape_a_unit_and_a_frame():
    symbols = [row for row in ROWS if "symbol" in row]
    assert len(symbols) > 30
    for row in symbols:
        assert len(quoted(row["name"])) == 1, row
        assert all(row.values()), row
        assert re.search(r"\bNED\b|\bL\b|\bV\b|–", row["frame"]), row
