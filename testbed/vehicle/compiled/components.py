"""JSBSim's components of systems and flight control."""

from __future__ import annotations

from collections.abc import Callable

from testbed.vehicle.compiled.elements import XmlNode
from testbed.vehicle.compiled.functions import expression, table
from testbed.vehicle.compiled.source import StepSource, literal


def component_name(node: XmlNode) -> str:
    """Return the property of a component's output."""
    name = "-".join(node.attributes.get("name", "").split())
    if not name:
        node.fail("has no name")
    return name if "/" in name else f"fcs/{name.lower()}"


def outputs(node: XmlNode) -> list[str]:
    """Return the properties that a component writes."""
    return [component_name(node), *(each.word for each in node.all("output"))]


def component(node: XmlNode, source: StepSource) -> None:
    """Write the lines of a component.

    Raises:
        NotTranslated: a component, or a part of one, that is not translated.
    """
    write = _COMPONENTS.get(node.tag)
    if write is None:
        node.fail("is not translated")
    value = _clip(node, source.assign(write(node, source)), source)
    for name in outputs(node):
        source.write(name, value, node)


def _clip(node: XmlNode, value: str, source: StepSource) -> str:
    """Hold an output between the limits of <clipto>, or turn it by whole ranges into them."""
    limits = node.find("clipto")
    if limits is None:
        return value
    low, high = (_number_or_property(limits.child(each), source) for each in ("min", "max"))
    kind = limits.attributes.get("type", "")
    if kind == "cyclic":
        span = source.assign(f"{high} - {low}")
        turned = source.assign(f"fmod({value} - {low}, {span}) + {low}")
        return source.assign(f"{turned} + {span} if {turned} < {low} else {turned}")
    if kind:
        limits.fail(f"has the type {kind}")
    return source.assign(f"{low} if {value} < {low} else ({high} if {value} > {high} else {value})")


def _number_or_property(node: XmlNode, source: StepSource) -> str:
    try:
        return literal(float(node.word))
    except ValueError:
        return source.assign(source.read(node.word, node))


def _text_value(text: str, node: XmlNode, source: StepSource) -> str:
    """Return a number or a property of an attribute or of a line of text."""
    try:
        return literal(float(text))
    except ValueError:
        return source.read(text, node)


def _inputs(node: XmlNode, source: StepSource) -> list[str]:
    found = [source.read(each.word, each) for each in node.all("input")]
    return found or node.fail("has no <input>")


def _input(node: XmlNode, source: StepSource) -> str:
    found = _inputs(node, source)
    return found[0] if len(found) == 1 else node.fail(f"has {len(found)} inputs")


def _function(node: XmlNode, source: StepSource) -> str:
    function = node.child("function")
    if function.attributes.get("name"):
        function.fail("in a component has a name")
    if node.all("input"):
        node.fail("has a function and an input")
    return expression(function, source)


def _summer(node: XmlNode, source: StepSource) -> str:
    terms = _inputs(node, source)
    bias = node.value("bias", default=0.0)
    return " + ".join([*terms, literal(bias)] if bias else terms)


def _pure_gain(node: XmlNode, source: StepSource) -> str:
    return f"{_gain(node, source)} * {_input(node, source)}"


def _scheduled_gain(node: XmlNode, source: StepSource) -> str:
    value, factor = _input(node, source), _gain(node, source)
    return f"{factor} * {table(node.child('table'), source)} * {value}"


def _gain(node: XmlNode, source: StepSource) -> str:
    gain = node.find("gain")
    return "1.0" if gain is None else _number_or_property(gain, source)


def _deadband(node: XmlNode, source: StepSource) -> str:
    """Return what an input exceeds half of a width by, times a gain."""
    value, gain = source.assign(_input(node, source)), _gain(node, source)
    width = node.find("width")
    half = source.assign(f"{_number_or_property(width, source)} / 2.0") if width else "0.0"
    return (
        f"({value} + {half}) * {gain} if {value} < -{half} else "
        f"(({value} - {half}) * {gain} if {value} > {half} else 0.0)"
    )


def _aerosurface_scale(node: XmlNode, source: StepSource) -> str:
    """Scale an input from its domain to the range of a surface, each side of zero by itself."""
    value = source.assign(_input(node, source))
    extent, domain = node.child("range"), node.find("domain")
    low, high = extent.value("min"), extent.value("max")
    first, last = (-1.0, 1.0) if domain is None else (domain.value("min"), domain.value("max"))
    centred = node.find("zero_centered")
    if centred is not None and centred.word in ("0", "false"):
        share = f"({value} - {literal(first)}) / {literal(last - first)}"
        scaled = f"{literal(low)} + ({share}) * {literal(high - low)}"
    else:
        scaled = (
            f"({value} / {literal(last)} * {literal(high)}) if {value} > 0.0 else "
            f"(({value} / {literal(first)} * {literal(low)}) if {value} != 0.0 else 0.0)"
        )
    gain = node.find("gain")
    return scaled if gain is None else f"({scaled}) * {_number_or_property(gain, source)}"


_SIGNS = {
    **dict.fromkeys(("==", "eq"), "=="),
    **dict.fromkeys(("!=", "ne"), "!="),
    **dict.fromkeys((">", "gt"), ">"),
    **dict.fromkeys((">=", "ge"), ">="),
    **dict.fromkeys(("<", "lt"), "<"),
    **dict.fromkeys(("<=", "le"), "<="),
}


def _switch(node: XmlNode, source: StepSource) -> str:
    """Return the value of the first test that is true."""
    default = node.child("default").attributes.get("value") or node.fail("has no default value")
    value = _text_value(default, node, source)
    for test in reversed(node.all("test")):
        chosen = test.attributes.get("value") or test.fail("has no value")
        value = f"({_text_value(chosen, test, source)} if {_condition(test, source)} else {value})"
    return value


def _condition(test: XmlNode, source: StepSource) -> str:
    """Return the condition of a <test>: its lines, and the tests in it."""
    logic = test.attributes.get("logic", "AND").strip().lower()
    if logic not in ("and", "or"):
        test.fail(f"has the logic {logic}")
    parts = [_condition(each, source) for each in test.all("test")]
    for line in filter(None, map(str.strip, test.text.splitlines())):
        words = line.split()
        if len(words) != 3 or words[1].lower() not in _SIGNS:
            test.fail(f"has the line {line!r}")
        one, other = (_text_value(words[k], test, source) for k in (0, 2))
        parts.append(f"{one} {_SIGNS[words[1].lower()]} {other}")
    return f"({f' {logic} '.join(parts)})" if parts else test.fail("is empty")


_COMPONENTS: dict[str, Callable[[XmlNode, StepSource], str]] = {
    "fcs_function": _function,
    "summer": _summer,
    "pure_gain": _pure_gain,
    "scheduled_gain": _scheduled_gain,
    "deadband": _deadband,
    "aerosurface_scale": _aerosurface_scale,
    "switch": _switch,
}
