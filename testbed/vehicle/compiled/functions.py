"""JSBSim's <function> and <table> elements as expressions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from testbed.vehicle.compiled.elements import XmlNode
from testbed.vehicle.compiled.source import StepSource, literal

_INFIX = {"sum": "+", "product": "*", "difference": "-"}
_COMPARE = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "nq": "!="}
# of one argument
_MATH = {
    **{each: f"{each}({{}})" for each in "sqrt exp sin cos tan asin acos atan abs log10".split()},
    "ln": "log({})",
    "log2": f"(log10({{}}) * {literal(1.0 / math.log10(2.0))})",
    "integer": "whole({})",
    "floor": "np.floor({})",  # a whole number; of the module math, an integer of limited size
    "ceil": "np.ceil({})",
    "toradians": "({} * pi / 180.0)",
    "todegrees": "({} * 180.0 / pi)",
    "not": "(0.0 if {} != 0.0 else 1.0)",
    "sign": "(-1.0 if {} < 0.0 else 1.0)",
}
_PAIRS = {"pow": "pow", "atan2": "atan2", "fmod": "np.fmod"}


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
        return _MATH[tag].format(values[0])
    if tag in ("and", "or"):
        tests = (f"{value} != 0.0" for value in values)
        return f"(1.0 if {f' {tag} '.join(tests)} else 0.0)"
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


def _fraction(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    _expect(node, 1)
    value = source.assign(values[0])
    return f"({value} - whole({value}))"


def _average(_: XmlNode, values: Sequence[str], __: StepSource) -> str:
    return f"(({' + '.join(values)}) / {literal(float(len(values)))})"


def _modulo(node: XmlNode, values: Sequence[str], _: StepSource) -> str:
    """Return the remainder of the whole parts, with the sign of the first."""
    _expect(node, 2)
    return f"np.fmod(whole({values[0]}), whole({values[1]}))"


def _round(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    """Return the nearest multiple of the second number, or of 1, halves away from zero."""
    if len(values) == 1:
        value = source.assign(values[0])
        return f"copysign(np.floor(abs({value}) + 0.5), {value})"
    _expect(node, 2)
    divisor = source.assign(values[1])
    value = source.assign(f"{values[0]} / {divisor}")
    return f"(copysign(np.floor(abs({value}) + 0.5), {value}) * {divisor})"


def _switch(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    """Return the value whose number, from 0, is nearest to the first; NaN: there is none."""
    if len(values) < 2:
        node.fail("has no values")
    number = source.assign(f"np.floor({values[0]} + 0.5)")
    chosen = "nan"
    for k, value in reversed(list(enumerate(values[1:]))):
        chosen = f"({value} if {number} == {literal(float(k))} else {chosen})"
    return chosen


def _interpolate(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    """Interpolate between pairs of a breakpoint and its value, beyond which the value is held."""
    if len(values) < 5 or len(values) % 2 == 0:
        node.fail("has not two pairs or more after its variable")
    x, *pairs = (source.assign(value) for value in values)
    points = list(zip(pairs[::2], pairs[1::2], strict=True))
    found = points[-1][1]
    for (x0, y0), (x1, y1) in reversed(list(pairwise(points))):
        found = f"({y0} + ({x} - {x0}) * ({y1} - {y0}) / ({x1} - {x0}) if {x} <= {x1} else {found})"
    return f"({points[0][1]} if {x} <= {points[0][0]} else {found})"


_OTHERS: dict[str, Callable[[XmlNode, Sequence[str], StepSource], str]] = {
    "quotient": _quotient,
    "switch": _switch,
    "interpolate1d": _interpolate,
    "fraction": _fraction,
    "avg": _average,
    "mod": _modulo,
    "roundmultiple": _round,
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
    """Return the call that looks up a table of one to three variables."""
    variables = node.all("independentVar")
    data = node.all("tableData")
    if not 1 <= len(variables) <= 3 or node.attributes.get("type", "internal") != "internal":
        node.fail(f"has {len(variables)} independent variables")
    if len(variables) == 1:
        function = table_function(node.child("tableData"), source)
        return f"{function}({source.read(variables[0].word, variables[0])})"
    by_lookup = {each.attributes.get("lookup", ""): each for each in variables}
    wanted = ("row", "column", "table")[: len(variables)]
    if set(by_lookup) != set(wanted):
        node.fail(f"looks up {', '.join(by_lookup)}")
    values = [source.read(by_lookup[each].word, by_lookup[each]) for each in wanted]
    if len(variables) == 2:
        return f"table_2({values[0]}, {values[1]}, {_grid(node.child('tableData'), source)})"
    return _table_3(data, values, source)


def _table_3(data: Sequence[XmlNode], values: Sequence[str], source: StepSource) -> str:
    """Interpolate between the tables of two variables of the nearest breakpoints."""
    row, column, third = (source.assign(value) for value in values)
    points = [each.attribute("breakPoint", math.nan) for each in data]
    if len(points) < 2 or not all(a < b for a, b in pairwise(points)):
        data[0].fail("has breakpoints that do not increase")
    grids = [_grid(each, source) for each in data]
    found = source.name()
    last = len(points) - 2
    for k, (low, high) in enumerate(pairwise(points)):
        # the first breakpoint above, or the last interval
        test = f"{third} <= {literal(high)}" if k < last else "True"
        with source.block(f"{'elif' if k else 'if'} {test}:"):
            share = source.assign(f"max(({third} - {literal(low)}) / {literal(high - low)}, 0.0)")
            first, other = (
                source.assign(f"table_2({row}, {column}, {grids[n]})") for n in (k, k + 1)
            )
            mixed = f"{share} * ({other} - {first}) + {first}"
            source.emit(f"{found} = {mixed} if {share} < 1.0 else {other}")
    return found


def _grid(data: XmlNode, source: StepSource) -> str:
    """Write the arrays of a table of two variables, and return their names."""
    lines = data.rows()
    columns, rows = lines[0] if lines else [], lines[1:]
    keys = [row[0] for row in rows]
    if min(len(rows), len(columns)) < 2 or any(len(row) != len(columns) + 1 for row in rows):
        data.fail("is no table of two variables")
    if not all(a < b for each in (columns, keys) for a, b in pairwise(each)):
        data.fail("has breakpoints that do not increase")
    name = source.name("data_")
    values = [row[1:] for row in rows]
    source.helpers.append(
        f"{name}_rows = np.array({keys})\n{name}_columns = np.array({columns})\n"
        f"{name}_data = np.array({values})"
    )
    return f"{name}_rows, {name}_columns, {name}_data"


def table_function(data: XmlNode, source: StepSource) -> str:
    """Write the function of a table of one variable, and return its name."""
    rows = data.rows()
    if not rows or any(len(row) != 2 for row in rows):
        data.fail("has not two numbers in each line")
    points = [(row[0], row[1]) for row in rows]
    if any(one[0] >= other[0] for one, other in pairwise(points)):
        data.fail("has breakpoints that do not increase")
    name = source.name("data_")
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
