"""JSBSim's components of systems and flight control."""

from __future__ import annotations

from collections.abc import Callable

from testbed.vehicle.compiled.elements import XmlNode
from testbed.vehicle.compiled.functions import expression
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
    value = _clip(node, write(node, source), source)
    for name in outputs(node):
        source.write(name, value, node)


def _clip(node: XmlNode, value: str, source: StepSource) -> str:
    """Hold an output between the limits of <clipto>."""
    limits = node.find("clipto")
    if limits is None:
        return source.assign(value)
    if "type" in limits.attributes:
        limits.fail("has a type")
    low, high = (_number_or_property(limits.child(each), source) for each in ("min", "max"))
    value = source.assign(value)
    return source.assign(f"{low} if {value} < {low} else ({high} if {value} > {high} else {value})")


def _number_or_property(node: XmlNode, source: StepSource) -> str:
    try:
        return literal(float(node.word))
    except ValueError:
        return source.assign(source.read(node.word, node))


def _inputs(node: XmlNode, source: StepSource) -> list[str]:
    found = [source.read(each.word, each) for each in node.all("input")]
    return found or node.fail("has no <input>")


def _function(node: XmlNode, source: StepSource) -> str:
    function = node.child("function")
    if function.attributes.get("name"):
        function.fail("in a component has a name")
    return expression(function, source)


def _summer(node: XmlNode, source: StepSource) -> str:
    terms = _inputs(node, source)
    bias = node.value("bias", default=0.0)
    return " + ".join([*terms, literal(bias)] if bias else terms)


def _pure_gain(node: XmlNode, source: StepSource) -> str:
    return f"{_gain(node, source)} * {_inputs(node, source)[0]}"


def _gain(node: XmlNode, source: StepSource) -> str:
    gain = node.find("gain")
    return "1.0" if gain is None else _number_or_property(gain, source)


def _aerosurface_scale(node: XmlNode, source: StepSource) -> str:
    """Scale an input from its domain to the range of a surface, each side of zero by itself."""
    value = _inputs(node, source)[0]
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


_COMPONENTS: dict[str, Callable[[XmlNode, StepSource], str]] = {
    "fcs_function": _function,
    "summer": _summer,
    "pure_gain": _pure_gain,
    "aerosurface_scale": _aerosurface_scale,
}
