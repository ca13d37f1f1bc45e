"""Check that `testbed/formation/paper.md` maps the paper to the code completely and correctly."""

import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import numpy as np
import pytest

import testbed
from testbed import formation

PAGE = Path(formation.__file__).with_name("paper.md")
TESTS = Path(__file__).parents[1]
EQUATIONS = range(1, 32)
CITATION = "[HBH23]"


def table_rows():
    """Yield every row of every table as {column: cell}."""
    columns = None
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if not line.startswith("|"):
            columns = None
        elif columns is None:
            columns = cells
        elif not set(line) <= set("|-"):
            yield dict(zip(columns, cells, strict=True))


def code_names(cell):
    return re.findall(r"`([^`]+)`", cell)


ROWS = list(table_rows())
NAMES = sorted(
    {name for row in ROWS for key in ("name", "function") for name in code_names(row.get(key, ""))}
)
CLAIMED_TESTS = sorted({name for row in ROWS for name in code_names(row.get("test", ""))})


def resolve(name):
    """Find the object of a dotted name; its field or argument must exist too."""
    path, _, argument = name.removesuffix(")").partition("(")
    module, rest = testbed, path.split(".")
    while rest:
        try:
            module = importlib.import_module(f"{module.__name__}.{rest[0]}")
        except ModuleNotFoundError:
            break
        rest = rest[1:]
    found = module
    for part in rest:
        if isinstance(found, np.dtype):
            assert part in found.names, f"{name}: no field {part}"
            found = found[part]
        else:
            found = getattr(found, part)
    if argument:
        assert argument in inspect.signature(found).parameters, name
    return found


@pytest.mark.parametrize("name", NAMES)
def test_named_object_exists(name):
    assert resolve(name) is not None


@pytest.mark.parametrize("name", CLAIMED_TESTS)
def test_named_test_exists(name):
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


def test_every_equation_has_a_function_and_a_test():
    for row in ROWS:
        if "function" in row:
            assert code_names(row["function"]), row
            assert code_names(row["test"]), row


def citing_functions():
    """Yield the public functions that cite the paper, themselves or in their module."""
    for info in pkgutil.iter_modules(formation.__path__):
        module = importlib.import_module(f"{formation.__name__}.{info.name}")
        for name, found in vars(module).items():
            ours = getattr(found, "__module__", None) == module.__name__
            if name.startswith("_") or not ours:
                continue
            own = CITATION in (inspect.getdoc(found) or "")
            # a kernel is a dispatcher of numba, or a function where compiling is disabled
            is_function = inspect.isfunction(getattr(found, "py_func", found))
            if own or (is_function and CITATION in (module.__doc__ or "")):
                yield f"formation.{info.name}.{name}"


def test_every_citing_function_is_on_the_map():
    known = {name.partition("(")[0] for name in NAMES}
    found = set(citing_functions())
    assert len(found) > 10
    assert not found - known, sorted(found - known)


def test_every_symbol_has_shape_unit_and_frame():
    symbols = [row for row in ROWS if "symbol" in row]
    assert len(symbols) > 30
    for row in symbols:
        assert len(code_names(row["name"])) == 1, row
        assert all(row.values()), row
        assert re.search(r"\bNED\b|\bL\b|\bV\b|–", row["frame"]), row
