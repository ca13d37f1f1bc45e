"""Plant faults in the code, one at a time, and count those that the tests find.

usage: python tests/planted_faults.py [--seed S] [--count N] [--packages a,b] [--list]

Faults are drawn by a seed: an operator, a comparison, a number or a statement is changed. Each is
tested by the test files that import its module, those that import its package, and the survivors
together by all tests; a test that then fails is run again with each survivor alone. A survivor that
changes no number, text or file is no fault: look at it, and draw another with a larger --count.

The tests run in a copy of the tree, with the interpreter that runs this program.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = tuple(sorted(each.parent.name for each in ROOT.glob("testbed/*/__init__.py")))
COMPARISONS = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
}
OPERATORS = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
LONGEST_S = 1200.0  # of the tests of one fault


@dataclass(frozen=True)
class Fault:
    """A change of one place of a file."""

    file: str  # below the root
    line: int
    begin: int  # of the replaced characters
    end: int
    new: str

    def apply(self, root):
        path = root / self.file
        text = path.read_text("utf-8")
        path.write_text(text[: self.begin] + self.new + text[self.end :], "utf-8")

    def __str__(self):
        old = (ROOT / self.file).read_text("utf-8")[self.begin : self.end]
        shown = (" ".join(each.split())[:60] for each in (old, self.new))
        return f"{self.file}:{self.line}: {' -> '.join(shown)}"


def faults_of(file):
    """Yield every fault of a file."""
    text = (ROOT / file).read_text("utf-8")
    starts = [0]
    for line in text.splitlines(keepends=True):
        starts.append(starts[-1] + len(line.encode()))
    data = text.encode()

    def at(line, column):
        return len(data[: starts[line - 1] + column].decode())

    def fault(node, new, begin=None, end=None):
        first = at(node.lineno, node.col_offset) if begin is None else begin
        last = at(node.end_lineno, node.end_col_offset) if end is None else end
        return Fault(file, node.lineno, first, last, new)

    def source(node):
        return text[at(node.lineno, node.col_offset) : at(node.end_lineno, node.end_col_offset)]

    def between(left, right, node, new, pattern):
        begin = at(left.end_lineno, left.end_col_offset)
        end = at(right.lineno, right.col_offset)
        found = re.search(pattern, text[begin:end])
        if found:
            yield fault(node, new, begin + found.start(), begin + found.end())

    tree = ast.parse(text)
    functions = [
        each for each in ast.walk(tree) if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    skipped = set()
    for function in functions:
        for node in (function.args, function.returns, *function.decorator_list):
            skipped |= {id(each) for each in ast.walk(node)} if node is not None else set()
        for node in ast.walk(function):  # Python 3.11 gives no places within these
            if isinstance(node, ast.JoinedStr):
                skipped |= {id(each) for each in ast.walk(node)}
    seen = set()
    for function in functions:
        for node in ast.walk(function):
            if id(node) in seen or id(node) in skipped or not hasattr(node, "lineno"):
                continue
            seen.add(id(node))
            if isinstance(node, ast.Compare) and len(node.ops) == 1:
                if new := COMPARISONS.get(type(node.ops[0])):
                    yield from between(node.left, node.comparators[0], node, new, r"[<>=!]=?")
            elif isinstance(node, ast.BinOp) and (new := OPERATORS.get(type(node.op))):
                yield from between(node.left, node.right, node, new, r"[-+*/]")
            elif isinstance(node, ast.BoolOp):
                new = "or" if isinstance(node.op, ast.And) else "and"
                yield from between(*node.values[:2], node, new, r"\b(and|or)\b")
            elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
                yield fault(node, f"({source(node.operand)})")
            elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
                yield fault(node, f"{node.value * 2 if node.value else 1}")
            elif isinstance(node, ast.Call) and source(node.func) in (
                "min",
                "max",
                "np.abs",
                "abs",
            ):
                other = {"min": "max", "max": "min"}.get(source(node.func), "")
                end = at(node.func.end_lineno, node.func.end_col_offset)
                yield fault(node, other, end=end)
            elif isinstance(node, ast.AugAssign) or (
                isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)
            ):
                yield fault(node, "pass")


def draw(packages, count, seed):
    """Draw faults: packages in turn, then a file, then a place."""
    chance, drawn = random.Random(seed), []
    while len(drawn) < count:
        package = packages[len(drawn) % len(packages)]
        files = sorted((ROOT / "testbed" / package).glob("*.py"))
        file = chance.choice([each for each in files if each.name != "__init__.py"])
        found = list(faults_of(str(file.relative_to(ROOT))))
        if found and (fault := chance.choice(found)) not in drawn:
            drawn.append(fault)
    return drawn


def test_files(fault):
    """Return the test files that import the fault's module, then those that import its package."""
    module = fault.file.removesuffix(".py").replace("/", ".")
    package, _, name = module.rpartition(".")
    narrow = re.compile(rf"{re.escape(module)}\b|from {re.escape(package)} import .*\b{name}\b")
    near, wide = [], []
    for path in sorted([*ROOT.glob("tests/**/test_*.py"), *ROOT.glob("paper/tests/test_*.py")]):
        text = path.read_text("utf-8")
        place = str(path.relative_to(ROOT))
        if narrow.search(text):
            near.append(place)
        elif re.search(rf"{re.escape(package)}\b", text):
            wide.append(place)
    return near, wide


def run_tests(root, tests, workers, *, first=True):
    """Return the tests that fail: the first ones, or all."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--no-header"]
    command += ["--tb=no", "-n", str(workers), *(["-x"] if first else []), *tests]
    environment = {**os.environ, "PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"}
    environment |= {"NUMBA_CACHE_DIR": str(root / "build" / "kernels")}
    try:
        done = subprocess.run(
            command, cwd=root, env=environment, capture_output=True, text=True,
            timeout=LONGEST_S if first else 6 * LONGEST_S,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return ["did not end"]
    failed = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.M)
    return failed or ([] if done.returncode in (0, 5) else [f"exit code {done.returncode}"])


def copy_tree(into):
    """Copy what the tests need; kernels that are compiled there stay there."""
    keep = ("testbed", "tests", "paper", "scenarios", "aircraft", "docs", "examples", "benchmarks")
    more = ("website", "release", "logs", ".github", ".ci", ".devcontainer", "Dockerfile")
    files = [each.name for each in ROOT.iterdir() if each.is_file()]
    for name in (*keep, *more, *files):
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, into / name, ignore=shutil.ignore_patterns("__pycache__"))
        elif source.exists():
            shutil.copy2(source, into / name)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--packages", default=",".join(PACKAGES))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--list", action="store_true", help="print the faults, and run nothing")
    args = parser.parse_args()
    drawn = draw(args.packages.split(","), args.count, args.seed)
    if args.list:
        print(*drawn, sep="\n")
        return
    survivors = []
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "tree"
        root.mkdir()
        copy_tree(root)
        for number, fault in enumerate(drawn, start=1):
            fault.apply(root)
            killed = []
            for tests in test_files(fault):
                killed = killed or (run_tests(root, tests, args.workers) if tests else [])
            shutil.copy2(ROOT / fault.file, root / fault.file)
            survivors += [] if killed else [fault]
            print(f"{number} {killed[0] if killed else 'not yet'}: {fault}", flush=True)
        if survivors:
            for fault in sorted(survivors, key=lambda each: -each.begin):  # later places first
                fault.apply(root)
            failed = run_tests(root, [], args.workers, first=False)
            for fault in survivors:
                shutil.copy2(ROOT / fault.file, root / fault.file)
            remaining = []
            for fault in survivors:
                fault.apply(root)
                killed = run_tests(root, failed, args.workers) if failed else []
                shutil.copy2(ROOT / fault.file, root / fault.file)
                remaining += [] if killed else [fault]
                print(f"all tests: {killed[0] if killed else 'SURVIVED'}: {fault}", flush=True)
            survivors = remaining
    print(f"{args.count - len(survivors)} of {args.count} faults of seed {args.seed} found")


if __name__ == "__main__":
    main()
