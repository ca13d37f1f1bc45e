"""JSBSim's <function> and <table> elements as expressions."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

from testbed.compiled.elements import XmlNode
from testbed.compiled.source import StepSource, literal

_MOST_PARTS = 1_000  # of an element, as of a sum
_LINE_PARTS = 50  # that are added in one line: more of them are too deep for Python's compiler
_UNROLLED = 64  # rows of a table, or pairs, beyond which they are searched in an array
_INFIX = {"sum": "+", "product": "*", "difference": "-"}
_TRUE = "(abs({}) >= 1e-9)"  # as JSBSim has it of a number
_LOGIC = {"and": "&", "or": "|"}
_COMPARE = {"lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "nq": "!="}
# of one argument
_MATH = {
    **{each: f"{each}({{}})" for each in "exp sin cos tan asin acos atan abs".split()},
    "sqrt": "root({})",
    "ln": "logarithm({})",
    "log10": "logarithm_10({})",
    "log2": f"(logarithm_10({{}}) * {literal(1.0 / math.log10(2.0))})",
    "integer": "np.trunc({})",
    "fraction": "fraction_of({})",
    "floor": "np.floor({})",  # a whole number; of the module math, an integer of limited size
    "ceil": "np.ceil({})",
    "toradians": "({} * pi / 180.0)",
    "todegrees": "({} * 180.0 / pi)",
    "not": f"(0.0 if {_TRUE} else 1.0)",
    "sign": "(-1.0 if {} < 0.0 else 1.0)",
}
_PAIRS = {
    "pow": "power_of({}, {}, one)",
    "atan2": "atan2({}, {})",
    "fmod": "remainder_of({}, {})",
    "mod": "modulo({}, {})",
}


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
    if len(parts) > _MOST_PARTS and not (tag in _LISTS and _all_numbers(parts[1:])):
        node.fail(f"has {len(parts):,} elements; up to {_MOST_PARTS:,} are translated")
    if tag in _LISTS and len(parts) > _UNROLLED and _all_numbers(parts[1:]):
        return _LISTS[tag](node, source)
    values = [expression(each, source) for each in parts]
    if tag in _INFIX:
        # JSBSim's sum begins with 0, which turns the sign of -0
        first = ["0.0"] if tag == "sum" else []
        return _chain(_INFIX[tag], [*first, *values], source)
    if tag in _COMPARE:
        _expect(node, 2)
        return f"(1.0 if {values[0]} {_COMPARE[tag]} {values[1]} else 0.0)"
    if tag in _MATH:
        _expect(node, 1)
        return _MATH[tag].format(values[0])
    if tag in _LOGIC:
        tests = [_TRUE.format(value) for value in values]
        return f"(1.0 if {_chain(_LOGIC[tag], tests, source)} else 0.0)"
    if tag in _PAIRS:
        _expect(node, 2)
        return _PAIRS[tag].format(*values)
    if tag in ("min", "max"):
        return _extreme(tag, values, source)
    write = _OTHERS.get(tag)
    return node.fail("is not translated") if write is None else write(node, values, source)


def _only(node: XmlNode) -> XmlNode:
    _expect(node, 1)
    return node.children[0]


def _expect(node: XmlNode, count: int) -> None:
    if len(node.children) != count:
        node.fail(f"has {len(node.children)} elements; {count} are translated")


def _chain(sign: str, values: Sequence[str], source: StepSource) -> str:
    """Return the sum, product or difference of values, from left to right."""
    found = values[0]
    for first in range(1, max(len(values), 2), _LINE_PARTS):
        if first > 1:
            found = source.assign(found)
        found = f" {sign} ".join([found, *values[first : first + _LINE_PARTS]])
    return f"({found})"


def _all_numbers(nodes: Sequence[XmlNode]) -> bool:
    return all(each.tag in ("value", "v") for each in nodes)


def _extreme(tag: str, values: Sequence[str], source: StepSource) -> str:
    function, first = ("least", "inf") if tag == "min" else ("largest", "(-inf)")
    found = source.assign(first)
    for value in values:
        source.emit(f"{found} = {function}({found}, {value})")
    return found


def _quotient(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    _expect(node, 2)
    divisor = source.assign(values[1])
    return f"({values[0]} / {divisor} if {divisor} != 0.0 else inf)"


def _average(_: XmlNode, values: Sequence[str], source: StepSource) -> str:
    return f"({_chain('+', ['0.0', *values], source)} / {literal(float(len(values)))})"


def _round(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    """Return the nearest multiple of the second number, or of 1, halves away from zero."""
    if len(values) == 1:
        return f"nearest({values[0]})"
    _expect(node, 2)
    divisor = source.assign(values[1])
    return f"(nearest({values[0]} / {divisor}) * {divisor})"


def _switch(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    """Return the value whose number, from 0, is nearest to the first; NaN: there is none."""
    if len(values) < 2:
        node.fail("has no values")
    number, found = source.assign(f"np.floor({values[0]} + 0.5)"), source.assign("nan")
    for k, value in enumerate(values[1:]):
        source.emit(f"{found} = chosen({number}, {literal(float(k))}, {value}, {found})")
    return found


def _switch_of_numbers(node: XmlNode, source: StepSource) -> str:
    variable, *values = node.children
    array = source.array([each.number for each in values], node)
    return f"pick(np.floor({expression(variable, source)} + 0.5), {array})"


def _interpolate(node: XmlNode, values: Sequence[str], source: StepSource) -> str:
    """Interpolate between pairs of a breakpoint and its value, beyond which the value is held."""
    if len(values) < 5 or len(values) % 2 == 0:
        node.fail("has not two pairs or more after its variable")
    if not _all_numbers(node.children[1::2]):
        node.fail("has breakpoints that are not numbers")
    _check_increase([each.number for each in node.children[1::2]], node)
    x, *pairs = (source.assign(value) for value in values)
    points = list(zip(pairs[::2], pairs[1::2], strict=True))
    if len(points) > _UNROLLED:
        node.fail(
            f"has {len(points)} pairs that are not all numbers; up to {_UNROLLED} are translated"
        )
    found = source.name()
    with source.block(f"if {x} <= {points[0][0]}:"):
        source.emit(f"{found} = {points[0][1]}")
    with source.block(f"elif {x} >= {points[-1][0]}:"):
        source.emit(f"{found} = {points[-1][1]}")
    for (x0, y0), (x1, y1) in pairwise(points):
        mixed = f"{y0} + ({x} - {x0}) * ({y1} - {y0}) / ({x1} - {x0})"
        with source.block(f"elif {x} < {x1}:"):
            source.emit(f"{found} = {y0} if {x} == {x0} else {mixed}")
    with source.block("else:"):  # of NaN, where JSBSim's search ends at once
        source.emit(f"{found} = {points[(len(points) - 1) // 2][1] if points[2:] else 'nan'}")
    return found


def _interpolate_numbers(node: XmlNode, source: StepSource) -> str:
    variable, *pairs = node.children
    if len(pairs) % 2:
        node.fail("has not two pairs or more after its variable")
    keys, values = ([each.number for each in part] for part in (pairs[::2], pairs[1::2]))
    _check_increase(keys, node)
    arrays = ", ".join(source.array(each, node) for each in (keys, values))
    return f"interpolate_1({expression(variable, source)}, {arrays})"


# Elements whose numbers after the first are an array where they are many.
_LISTS: dict[str, Callable[[XmlNode, StepSource], str]] = {
    "switch": _switch_of_numbers,
    "interpolate1d": _interpolate_numbers,
}
_OTHERS: dict[str, Callable[[XmlNode, Sequence[str], StepSource], str]] = {
    "quotient": _quotient,
    "switch": _switch,
    "interpolate1d": _interpolate,
    "avg": _average,
    "roundmultiple": _round,
}


def _choose(node: XmlNode, source: StepSource) -> str:
    """Return the variable of an <ifthen>, whose branches are evaluated only when chosen."""
    _expect(node, 3)
    condition, then, otherwise = node.children
    test = expression(condition, source)
    found = source.name()
    with source.block(f"if {_TRUE.format(test)}:"):
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
        look_up = table_function(node.child("tableData"), source)
        return look_up(source.read(variables[0].word, variables[0]))
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
    if len(points) < 2:
        data[0].fail("is the only one of three variables")
    if len(points) > _UNROLLED:
        data[0].fail(f"is one of {len(points)}; up to {_UNROLLED} are translated")
    _check_increase(points, data[0])
    grids = [_grid(each, source) for each in data]
    found = source.name()
    last = len(points) - 2
    for k, (low, high) in enumerate(pairwise(points)):
        # the first breakpoint above, or the last interval
        test = f"{third} <= {literal(high)}" if k < last else "True"
        with source.block(f"{'elif' if k else 'if'} {test}:"):
            share = source.assign(f"({third} - {literal(low)}) / {literal(high - low)}")
            share = source.assign(f"0.0 if {share} < 0.0 else {share}")
            first, other = (
                source.assign(f"table_2({row}, {column}, {grids[n]})") for n in (k, k + 1)
            )
            mixed = f"{share} * ({other} - {first}) + {first}"
            source.emit(f"{found} = {other} if {share} >= 1.0 else {mixed}")
    return found


def _grid(data: XmlNode, source: StepSource) -> str:
    """Write the arrays of a table of two variables, and return their names."""
    lines = data.rows()
    columns, rows = lines[0] if lines else [], lines[1:]
    keys = [row[0] for row in rows]
    if min(len(rows), len(columns)) < 2 or any(len(row) != len(columns) + 1 for row in rows):
        data.fail("is no table of two variables")
    for each in (columns, keys):
        _check_increase(each, data)
    values = [number for row in rows for number in row[1:]]
    parts = source.array(keys, data), source.array(columns, data)
    return ", ".join((*parts, source.array(values, data, f".reshape({len(rows)}, {len(columns)})")))


def _check_increase(points: Sequence[float], node: XmlNode) -> None:
    if not all(a < b for a, b in pairwise(points)):
        node.fail("has breakpoints that do not increase")


def table_function(data: XmlNode, source: StepSource) -> Callable[[str], str]:
    """Write a table of one variable; return what makes the expression that looks a value up."""
    rows = data.rows()
    if not rows or any(len(row) != 2 for row in rows):
        data.fail("has not two numbers in each line")
    points = [(row[0], row[1]) for row in rows]
    keys, values = [row[0] for row in points], [row[1] for row in points]
    _check_increase(keys, data)
    if len(points) == 1:
        return lambda x: f"({literal(values[0])} if {x} == {x} else nan)"
    if len(points) > _UNROLLED:
        arrays = ", ".join(source.array(each, data) for each in (keys, values))
        return lambda x: f"table_1({x}, {arrays})"
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
    return lambda x: f"{name}({x})"


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
