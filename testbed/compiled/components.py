"""JSBSim's components of systems and flight control."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np

from testbed.compiled.elements import XmlNode
from testbed.compiled.functions import expression, table
from testbed.compiled.source import StepSource, literal

LOADING_DT = 1.0 / 120.0  # s, of JSBSim while it loads an aircraft


def component_name(node: XmlNode) -> str:
    """Return the property of a component's output."""
    name = "-".join(node.attributes.get("name", "").split())
    if not name:
        node.fail("has no name")
    return name if "/" in name else f"fcs/{name.lower()}"


def _state_name(node: XmlNode, source: StepSource) -> str:
    """Return the property of a component's output, by which JSBSim shows its state."""
    name = component_name(node)
    if name in source.shared:
        node.fail(f"has the output {name}, which another component writes")
    return name


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
        turned = source.assign(f"np.fmod({value} - {low}, {span}) + {low}")
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
    """Return the value of the first test that is true, or else the default, or 0."""
    default = node.find("default")
    if default is None:
        value = "0.0"
    else:
        text = default.attributes.get("value") or default.fail("has no value")
        value = _text_value(text, default, source)
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


def _filter(node: XmlNode, source: StepSource) -> str:
    """Return the output of a linear filter, of Tustin's transform of its transfer function.

    JSBSim's filters keep the step that it has when it loads an aircraft, whatever the step flown.
    """
    if node.find("trigger"):
        node.fail("has a trigger")
    numerator, denominator = _TRANSFER[node.tag](node)
    scale = denominator[0]
    inputs = node.all("input")
    if len(inputs) != 1:
        node.fail(f"has {len(inputs)} inputs")
    owner, limits = _state_name(node, source), node.find("clipto")
    low, high = -math.inf, math.inf
    if limits is not None:
        low, high = limits.child("min").number, limits.child("max").number
    order = len(denominator) - 1
    past_inputs = [
        source.recall_input(owner, inputs[0].word, inputs[0], age) for age in range(1, order + 1)
    ]
    past_outputs = [source.recall_output(owner, age, low, high) for age in range(1, order + 1)]
    value = source.assign(source.read(inputs[0].word, inputs[0]))
    a, b = ([literal(_divide(each, scale)) for each in part] for part in (numerator, denominator))
    found = source.assign(_FILTERS[node.tag](a, b, value, past_inputs, past_outputs))
    for newest, past in ((value, past_inputs), (found, past_outputs)):
        for newer, old in reversed(list(zip((newest, *past), past, strict=False))):
            source.emit(f"{old} = {newer}")
    return found


def _divide(one: float, other: float) -> float:
    """Return a quotient as JSBSim has it: infinite or NaN where the divisor is 0."""
    with np.errstate(all="ignore"):
        return float(np.float64(one) / np.float64(other))


def _coefficients(node: XmlNode, *names: str) -> list[float]:
    return [node.value(each) for each in names]


def _lag_transfer(node: XmlNode) -> tuple[list[float], list[float]]:
    """C1 / (s + C1)."""
    return _lag_of(node.value("c1"))


def _lag_of(c1: float) -> tuple[list[float], list[float]]:
    return [LOADING_DT * c1], [2.0 + LOADING_DT * c1, 2.0 - LOADING_DT * c1]


def _lead_lag_transfer(node: XmlNode) -> tuple[list[float], list[float]]:
    """(C1 s + C2) / (C3 s + C4)."""
    c1, c2, c3, c4 = _coefficients(node, "c1", "c2", "c3", "c4")
    dt = LOADING_DT
    return (
        [2.0 * c1 + dt * c2, dt * c2 - 2.0 * c1],
        [2.0 * c3 + dt * c4, 2.0 * c3 - dt * c4],
    )


def _second_order_transfer(node: XmlNode) -> tuple[list[float], list[float]]:
    """(C1 s² + C2 s + C3) / (C4 s² + C5 s + C6)."""
    c1, c2, c3, c4, c5, c6 = _coefficients(node, "c1", "c2", "c3", "c4", "c5", "c6")
    dt = LOADING_DT
    return (
        [
            4.0 * c1 + 2.0 * c2 * dt + c3 * dt * dt,
            2.0 * c3 * dt * dt - 8.0 * c1,
            4.0 * c1 - 2.0 * c2 * dt + c3 * dt * dt,
        ],
        [
            4.0 * c4 + 2.0 * c5 * dt + c6 * dt * dt,
            2.0 * c6 * dt * dt - 8.0 * c4,
            4.0 * c4 - 2.0 * c5 * dt + c6 * dt * dt,
        ],
    )


def _washout_transfer(node: XmlNode) -> tuple[list[float], list[float]]:
    """S / (s + C1)."""
    (c1,) = _coefficients(node, "c1")
    return [2.0], [2.0 + LOADING_DT * c1, 2.0 - LOADING_DT * c1]


def _integrator_transfer(node: XmlNode) -> tuple[list[float], list[float]]:
    """C1 / s."""
    (c1,) = _coefficients(node, "c1")
    return [LOADING_DT * c1 / 2.0], [1.0, 1.0]


def _kinematic(node: XmlNode, source: StepSource) -> str:
    """Return the position of a device that travels between settings, each in a time."""
    settings = node.child("traverse").all("setting")
    positions = [each.value("position") for each in settings]
    times = [each.value("time") for each in settings]
    if len(positions) < 2 or not all(a < b for a, b in pairwise(positions)):
        node.fail("has positions that do not increase")
    name, now = source.name("settings_"), source.carry(_state_name(node, source))
    source.helpers.append(f"{name} = np.array({positions})\n{name}_times = np.array({times})")
    target = _input(node, source)
    if node.find("noscale") is None:
        target = f"{target} * {literal(positions[-1])}"
    return f"travel({now}, {target}, {LOADING_DT!r}, {name}, {name}_times)"


_STATES = ("lag", "rate_limit", "hysteresis_width")  # parts of an actuator with a memory
_OTHERS = ("deadband_width", "bias")


def _actuator(node: XmlNode, source: StepSource) -> str:
    """Return the output of lag, rate limit, deadband, hysteresis and bias, in this order.

    JSBSim does not show the memories of the parts: they are known where the output is that of the
    part, so some combinations are not translated.
    """
    states = [each for each in _STATES if node.all(each)]
    if states and ("hysteresis_width" in states[:-1] or any(node.all(each) for each in _OTHERS)):
        node.fail("has a combination of lag, limits and bias that is not translated")
    if states[1:] and "hysteresis_width" in states:
        node.fail("has a hysteresis after another part")
    owner, limits = _state_name(node, source), node.find("clipto")
    low, high = -math.inf, math.inf
    if limits is not None:
        low, high = limits.child("min").number, limits.child("max").number
    value = source.assign(_input(node, source))
    rates = {each.attributes.get("sense", ""): each.number for each in node.all("rate_limit")}
    slowest = min(rates.values(), default=math.inf) * LOADING_DT
    if node.find("lag"):
        value = _lag(node, owner, value, low, high, slowest, source)
    if rates:
        value = _rate_limit(node, rates, owner, value, low, high, source)
    if width := node.find("deadband_width"):
        half = f"{_number_or_property(width, source)} / 2.0"
        value = source.assign(
            f"{value} + {half} if {value} < -({half}) else "
            f"({value} - {half} if {value} > {half} else 0.0)"
        )
    if node.find("hysteresis_width"):
        half_width = literal(0.5 * node.value("hysteresis_width"))
        last = source.recall_limited(owner, "hysteresis", low, high, math.inf)
        source.emit(
            f"{last} = max({last}, {value} - {half_width}) if {value} > {last} else "
            f"min({last}, {value} + {half_width})"
        )
        value = last
    if bias := node.find("bias"):
        value = source.assign(f"{value} + {_number_or_property(bias, source)}")
    return value


def _lag(
    node: XmlNode,
    owner: str,
    value: str,
    low: float,
    high: float,
    step: float,
    source: StepSource,
) -> str:
    numerator, (scale, decay) = _lag_of(node.value("lag"))
    inputs = node.all("input")
    past = source.recall_input(owner, inputs[0].word, inputs[0], 1)
    last = source.recall_limited(owner, "lag", low, high, step)
    a, b = literal(_divide(numerator[0], scale)), literal(_divide(decay, scale))
    source.emit(f"{last} = {a} * ({value} + {past}) + {last} * {b}")
    source.emit(f"{past} = {value}")
    return last


def _rate_limit(
    node: XmlNode,
    rates: dict[str, float],
    owner: str,
    value: str,
    low: float,
    high: float,
    source: StepSource,
) -> str:
    last = source.recall_limited(owner, "rate-limit", low, high, math.inf)
    up, down = (rates.get(sense, rates.get("")) for sense in ("incr", "decr"))
    if len(rates) > 1 and "" in rates:
        node.fail("has a rate limit with and one without a sense")
    limited = value
    if down is not None:
        most = literal(down * LOADING_DT)
        limited = f"({last} - {most} if {value} - {last} < -{most} else {limited})"
    if up is not None:
        most = literal(up * LOADING_DT)
        limited = f"({last} + {most} if {value} - {last} > {most} else {limited})"
    source.emit(f"{last} = {limited}")
    return last


# The transfer function of each filter, and its output; the order of the terms is that of JSBSim.
_TRANSFER: dict[str, Callable[[XmlNode], tuple[list[float], list[float]]]] = {
    "lag_filter": _lag_transfer,
    "lead_lag_filter": _lead_lag_transfer,
    "second_order_filter": _second_order_transfer,
    "washout_filter": _washout_transfer,
    "integrator": _integrator_transfer,
}
_FILTERS: dict[str, Callable[[list[str], list[str], str, list[str], list[str]], str]] = {
    "lag_filter": lambda a, b, u, us, ys: f"({u} + {us[0]}) * {a[0]} + {ys[0]} * {b[1]}",
    "lead_lag_filter": lambda a, b, u, us, ys: (
        f"{u} * {a[0]} + {us[0]} * {a[1]} + {ys[0]} * {b[1]}"
    ),
    "second_order_filter": lambda a, b, u, us, ys: (
        f"{u} * {a[0]} + {us[0]} * {a[1]} + {us[1]} * {a[2]} - {ys[0]} * {b[1]} - {ys[1]} * {b[2]}"
    ),
    "washout_filter": lambda a, b, u, us, ys: f"{u} * {a[0]} - {us[0]} * {a[0]} + {ys[0]} * {b[1]}",
    "integrator": lambda a, b, u, us, ys: f"({u} + {us[0]}) * {a[0]} + {ys[0]}",
}


_COMPONENTS: dict[str, Callable[[XmlNode, StepSource], str]] = {
    "fcs_function": _function,
    "summer": _summer,
    "pure_gain": _pure_gain,
    "scheduled_gain": _scheduled_gain,
    "deadband": _deadband,
    "aerosurface_scale": _aerosurface_scale,
    "switch": _switch,
    **dict.fromkeys(_TRANSFER, _filter),
    "kinematic": _kinematic,
    "actuator": _actuator,
}
