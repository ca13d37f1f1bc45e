"""JSBSim's <function> and <table> elements as expressions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from testbed.vehicle.compiled.elements import XmlNode
from testbed.vehicle.compiled.source import StepSource, literal

_DEGREES = 180.0 / math.pi
_INFIX = {"sum": "+", "product": "*", "difference": "-"}
_COMPARE = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "nq": "!="}
_MATH = {
    **{each: each for each in "sqrt exp sin cos tan asin acos atan floor ceil".split()},
    "ln": "log",
}
_PAIRS = {"pow": "pow", "atan2": "atan2"}


def expression(node: XmlNode, source: StepSource) -> str:
    """Return the expression of an element of a function; lines before it go to the source.

    Raises:
        NotTranslated: the element is none that is translated.
    """
    tag, parts = node.tag, node.children
    if tag in ("property", "p"):
        return source.read(node.word, node)
    if tag in ("value", "v"):
        return literal(node.number)
    if tag in ("table", "t"):
        return table(node, source)
    if tag == "pi":
        return "pi"
    if tag == "ifthen":
        return _choose(node, source)
    if not parts:
        node.fail("is empty")
    if tag == "function":
        return expression(_only(node), source)
    values = [expression(each, source) for each in parts]
    if tag in _INFIX:
        return f"({f' {_INFIX[tag]} '.join(values)})"
    if tag in _COMPARE:
        _expect(node, 2)
        return f"(1.0 if {values[0]} {_COMPARE[tag]} {values[1]} else 0.0)"
    if tag in _MATH:
        _expect(node, 1)
        return f"{_MATH[tag]}({values[0]})"
    if tag in _PAIRS:
        _expect(node, 2)
        return f"{_PAIRS[tag]}({values[0]}, {values[1]})"
    if tag in ("min", "max"):
        return _extreme("<" if tag == "min" else ">", values, source)
    write = _OTHERS.get(tag)
    return node.fail("is not translated") if write is None else write(node, values, source)


def _only(node: XmlNode) -> XmlNode:
    _expect(node, 1)
    return node.children[0]


def _expect(node: XmlNode, count: int) -> None:
    if len(node.children) != count:
        node.fail(f"has {len(node.children)} elements; {count} are translated")


def _extreme(sign: str, values: Sequence[str], source: StepSource) -> str:
    found = source.assign(values[0])
    for value in values[1:]:
        other = source.assign(value)
        found = source.assign(f"{other} if {other} {sign} {found} else {found}")
    return found


def _quotient(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    _expect(node, 2)
    divisor = source.assign(values[1])
    return f"({values[0]} / {divisor} if {divisor} != 0.0 else inf)"


def _absolute(node: XmlNode, values: Sequence[str], _: StepSource) -> str:
    _expect(node, 1)
    return f"abs({values[0]})"


def _to_radians(node: XmlNode, values: Sequence[str], _: StepSource) -> str:
    _expect(node, 1)
    return f"({values[0]} * {literal(math.pi / 180.0)})"


def _to_degrees(node: XmlNode, values: Sequence[str], _: StepSource) -> str:
    _expect(node, 1)
    return f"({values[0]} * {literal(_DEGREES)})"


_OTHERS: dict[str, Callable[[XmlNode, Sequence[str], StepSource], str]] = {
    "quotient": _quotient,
    "abs": _absolute,
    "toradians": _to_radians,
    "todegrees": _to_degrees,
}


def _choose(node: XmlNode, source: StepSource) -> str:
    """Return the variable of an <ifthen>, whose branches are evaluated only when chosen."""
    _expect(node, 3)
    condition, then, otherwise = node.children
    test = expression(condition, source)
    found = source.name()
    with source.block(f"if {test} != 0.0:"):
        source.emit(f"{found} = {expression(then, source)}")
    with source.block("else:"):
        source.emit(f"{found} = {expression(otherwise, source)}")
    return found


def table(node: XmlNode, source: StepSource) -> str:
    """Return the call that looks up a table."""
    variables = node.all("independentVar")
    if len(variables) != 1:
        node.fail(f"has {len(variables)} independent variables")
    function = table_function(node.child("tableData"), source)
    return f"{function}({source.read(variables[0].word, variables[0])})"


def table_function(data: XmlNode, source: StepSource) -> str:
    """Write the function of a table of one variable, and return its name."""
    rows = data.rows()
    if not rows or any(len(row) != 2 for row in rows):
        data.fail("has not two numbers in each line")
    points = [(row[0], row[1]) for row in rows]
    if any(one[0] >= other[0] for one, other in zip(points, points[1:], strict=False)):
        data.fail("has breakpoints that do not increase")
    name = source.name("table_")
    lines = [
        "@kernel",
        f"def {name}(x):",
        f"    if x <= {literal(points[0][0])}:",
        f"        return {literal(points[0][1])}",
        f"    if x >= {literal(points[-1][0])}:",
        f"        return {literal(points[-1][1])}",
    ]
    _search(points, 0, len(points) - 1, 1, lines)
    source.helpers.append("\n".join(lines))
    return name


def _search(
    points: Sequence[tuple[float, float]], low: int, high: int, depth: int, lines: list[str]
) -> None:
    """Write the binary search of the interval that x is in, between two points."""
    indent = "    " * depth
    if high - low == 1:
        (x0, y0), (x1, y1) = points[low], points[high]
        span, rise = literal(x1 - x0), literal(y1 - y0)
        lines.append(f"{indent}return (x - {literal(x0)}) / {span} * {rise} + {literal(y0)}")
        return
    middle = (low + high) // 2
    lines.append(f"{indent}if x <= {literal(points[middle][0])}:")
    _search(points, low, middle, depth + 1, lines)
    lines.append(f"{indent}else:")
    _search(points, middle, high, depth + 1, lines)
