"""Read modelDescription.xml of an FMU: its capabilities and its variables.

Source: FMI 2.0.4, section 2.2 and 4.3, and FMI 3.0.1, section 2.4 and 4.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NoReturn
from xml.parsers import expat

from testbed.core.errors import InputError
from testbed.fmi.archive import DESCRIPTION, MAX_DESCRIPTION_BYTES, Archive

MAX_DEPTH = 30
MAX_VARIABLES = 100_000
_TYPES_2 = {
    "Real": "Float64",
    "Integer": "Int32",
    "Boolean": "Boolean",
    "String": "String",
    "Enumeration": "Int32",
}
_INTEGERS = tuple(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))
_TYPES_3 = {
    **{each: each for each in ("Float64", "Float32", "Boolean", "String", "Binary", "Clock")},
    **{each: each for each in _INTEGERS},
    "Enumeration": "Int64",
}
_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@dataclass(slots=True)
class _Element:
    tag: str
    attributes: Mapping[str, str]
    line: int
    children: list[_Element] = field(default_factory=list)

    def first(self, tag: str) -> _Element | None:
        return next((each for each in self.children if each.tag == tag), None)


@dataclass(frozen=True, slots=True)
class Dimension:
    """One dimension of an array: a size, or the value reference of a structural parameter."""

    size: int | None
    reference: int | None


@dataclass(frozen=True, slots=True)
class Variable:
    """A scalar, or in FMI 3.0 an array.

    Attributes:
        name: of it.
        reference: its value reference.
        causality: "input", "output", "parameter", "structuralParameter", "local", …
        variability: "fixed", "tunable", "discrete", "continuous", …
        type: as in FMI 3.0: "Float64", "Int32", "Boolean", "String", …
        unit: "": it has none.
        start: its numbers or text, as written; None: it has none.
        minimum: of its values; −inf: no bound.
        maximum: of its values; inf: no bound.
        dimensions: of an array; of a scalar empty.
        line: of the file.
    """

    name: str
    reference: int
    causality: str
    variability: str
    type: str
    unit: str
    start: tuple[str, ...] | None
    minimum: float
    maximum: float
    dimensions: tuple[Dimension, ...]
    line: int


@dataclass(frozen=True, slots=True)
class ModelDescription:
    """Capabilities and variables of an FMU.

    Attributes:
        file: path of the FMU, for messages.
        version: of FMI, 2 or 3.
        name: of the model.
        token: guid, or instantiationToken.
        identifier: modelIdentifier, by which the binary is named.
        single: no more than one instance can be made in a process.
        has_state: its state can be got, set and serialised.
        step_s: default or fixed step, s; None: it names none.
        variables: by name.
        units: by name: exponents of kg, m, s, A, K, mol, cd, rad, then factor and offset.
    """

    file: str
    version: int
    name: str
    token: str
    identifier: str
    single: bool
    has_state: bool
    step_s: float | None
    variables: Mapping[str, Variable]
    units: Mapping[str, tuple[float, ...]]

    def refuse(self, variable: Variable, text: str) -> NoReturn:
        """Raise an error about a variable.

        Raises:
            InputError: always; with file, line and name.
        """
        raise InputError(
            f"{self.file}: {DESCRIPTION}:{variable.line}: {variable.name[:80]!r} {text}"
        )


def read_description(archive: Archive) -> ModelDescription:
    """Read the description of an FMU.

    Raises:
        InputError: it is damaged, of another version, no co-simulation FMU, or needs the tool that
            has written it.
    """
    file = str(archive.path)
    root = _parse(archive.read(DESCRIPTION, MAX_DESCRIPTION_BYTES), file)
    text = root.attributes.get("fmiVersion", "")
    version = {"2.0": 2, "3.0": 3}.get(text[:3])
    if root.tag != "fmiModelDescription" or version is None:
        raise InputError(f"{file}: is of FMI {text[:20] or 'no version'} (export it as 2.0 or 3.0)")
    part = root.first("CoSimulation")
    if part is None:
        raise InputError(
            f"{file}: is no co-simulation FMU (export it for co-simulation, not model exchange)"
        )
    state = "FMUstate" if version == 2 else "FMUState"
    flags = {
        name: part.attributes.get(name) in ("true", "1")
        for name in (
            "needsExecutionTool",
            "canBeInstantiatedOnlyOncePerProcess",
            f"canGetAndSet{state}",
            f"canSerialize{state}",
        )
    }
    if flags["needsExecutionTool"]:
        raise InputError(
            f"{file}: needs the program that has written it (needsExecutionTool; export it with "
            "its code, without tool coupling)"
        )
    identifier = part.attributes.get("modelIdentifier", "")
    if not identifier.isascii() or not identifier.isidentifier() or len(identifier) > 200:
        raise InputError(f"{file}: modelIdentifier {identifier[:40]!r} is no name of C")
    token = root.attributes.get("guid" if version == 2 else "instantiationToken", "")
    return ModelDescription(
        file=file,
        version=version,
        name=root.attributes.get("modelName", ""),
        token=token,
        identifier=identifier,
        single=flags["canBeInstantiatedOnlyOncePerProcess"],
        has_state=flags[f"canGetAndSet{state}"] and flags[f"canSerialize{state}"],
        step_s=_step(root, part, file),
        variables=_variables(root, version, file),
        units=_units(root, file),
    )


def _parse(data: bytes, file: str) -> _Element:
    """Return the root of a document, without its texts.

    Raises:
        InputError: it is no XML, has a document type, or is nested too deeply.
    """
    parser = expat.ParserCreate()
    top = _Element("", {}, 0)
    stack = [top]

    def begin(tag: str, attributes: dict[str, str]) -> None:
        if len(stack) > MAX_DEPTH:
            raise InputError(f"{file}: {DESCRIPTION} is nested deeper than {MAX_DEPTH} elements")
        element = _Element(tag, attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def refuse(*_: object) -> None:
        raise InputError(f"{file}: {DESCRIPTION} has a document type (remove <!DOCTYPE>)")

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise InputError(f"{file}: {DESCRIPTION} is no XML: {error}") from error
    return top.children[0]


def _number(element: _Element, name: str, file: str, default: float) -> float:
    text = element.attributes.get(name)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise InputError(
            f"{file}: {DESCRIPTION}:{element.line}: {name} is {text[:40]!r} (write a number)"
        )
    return value


def _whole(element: _Element, name: str, file: str) -> int:
    text = element.attributes.get(name, "")
    if text.isascii() and text.isdigit() and len(text) < 11 and int(text) < 2**32:
        return int(text)
    raise InputError(
        f"{file}: {DESCRIPTION}:{element.line}: {name} is {text[:40]!r} (write a whole number)"
    )


def _step(root: _Element, part: _Element, file: str) -> float | None:
    experiment = root.first("DefaultExperiment")
    fixed = _number(part, "fixedInternalStepSize", file, 0.0)
    default = 0.0 if experiment is None else _number(experiment, "stepSize", file, 0.0)
    step = fixed or default
    if not step:
        return None
    if not 0.0 < step < math.inf:
        raise InputError(
            f"{file}: {DESCRIPTION}: its default step is {step:g} s (write one above 0)"
        )
    return step


def _variables(root: _Element, version: int, file: str) -> dict[str, Variable]:
    model = root.first("ModelVariables")
    elements = [] if model is None else model.children
    if len(elements) > MAX_VARIABLES:
        raise InputError(f"{file}: has {len(elements)} variables (at most {MAX_VARIABLES})")
    types = {} if version == 3 else _simple_units(root)
    found: dict[str, Variable] = {}
    for each in elements:
        variable = _variable_2(each, types, file) if version == 2 else _variable_3(each, file)
        if variable.name in found:
            raise InputError(
                f"{file}: {DESCRIPTION}:{each.line}: has two variables {variable.name[:80]!r}"
            )
        found[variable.name] = variable
    return found


def _simple_units(root: _Element) -> dict[str, str]:
    """Return the units of the types that variables of FMI 2.0 may have as declaredType."""
    definitions, found = root.first("TypeDefinitions"), dict[str, str]()
    for each in [] if definitions is None else definitions.children:
        real = each.first("Real")
        if real is not None and "name" in each.attributes:
            found[each.attributes["name"]] = real.attributes.get("unit", "")
    return found


def _variable_2(each: _Element, types: Mapping[str, str], file: str) -> Variable:
    kind = next((one for one in each.children if one.tag in _TYPES_2), None)
    if kind is None:
        raise InputError(f"{file}: {DESCRIPTION}:{each.line}: a variable without a type")
    start = kind.attributes.get("start")
    declared = types.get(kind.attributes.get("declaredType", ""), "")
    return _make(
        each, kind, _TYPES_2[kind.tag], None if start is None else (start,), declared, (), file
    )


def _variable_3(each: _Element, file: str) -> Variable:
    if each.tag not in _TYPES_3:
        raise InputError(f"{file}: {DESCRIPTION}:{each.line}: unknown type <{each.tag[:40]}>")
    kind = _TYPES_3[each.tag]
    start: tuple[str, ...] | None = None
    if kind == "String":
        starts = [one.attributes.get("value", "") for one in each.children if one.tag == "Start"]
        start = tuple(starts) or None
    elif "start" in each.attributes:
        start = tuple(each.attributes["start"].split())
    dimensions = tuple(
        Dimension(_whole(one, "start", file), None)
        if "start" in one.attributes
        else Dimension(None, _whole(one, "valueReference", file))
        for one in each.children
        if one.tag == "Dimension"
    )
    return _make(each, each, kind, start, "", dimensions, file)


def _make(
    each: _Element,
    kind: _Element,
    type_: str,
    start: tuple[str, ...] | None,
    unit: str,
    dimensions: tuple[Dimension, ...],
    file: str,
) -> Variable:
    return Variable(
        name=each.attributes.get("name", ""),
        reference=_whole(each, "valueReference", file),
        causality=each.attributes.get("causality", "local"),
        variability=each.attributes.get("variability", "continuous"),
        type=type_,
        unit=kind.attributes.get("unit", unit),
        start=start,
        minimum=_bound(kind, "min", -math.inf, type_, file),
        maximum=_bound(kind, "max", math.inf, type_, file),
        dimensions=dimensions,
        line=each.line,
    )


def _bound(kind: _Element, name: str, default: float, type_: str, file: str) -> float:
    return default if type_ in ("String", "Boolean") else _number(kind, name, file, default)


def _units(root: _Element, file: str) -> dict[str, tuple[float, ...]]:
    """Return the units that are defined by base units: exponents, factor and offset."""
    definitions, found = root.first("UnitDefinitions"), dict[str, tuple[float, ...]]()
    for each in [] if definitions is None else definitions.children:
        base = each.first("BaseUnit")
        if base is not None:
            exponents = tuple(_number(base, name, file, 0.0) for name in _BASE)
            scale = _number(base, "factor", file, 1.0), _number(base, "offset", file, 0.0)
            found[each.attributes.get("name", "")] = (*exponents, *scale)
    return found
