"""The variables of an aircraft as an FMU, and its modelDescription.xml by FMI 2.0."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from enum import IntEnum
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from testbed.core.version import __version__

AXES = "north", "east", "down"
_DEGREES = 57.29577951308232  # of a rad

# Base units of the standard, by the exponents of SI units; rad is one of them.
_UNITS: Mapping[str, Mapping[str, int]] = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "1/s": {"s": -1},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
}
_IN_DEGREES = {"rad": "deg", "rad/s": "deg/s"}


class Kind(IntEnum):
    """What a variable is, by the numbers of `aircraft_fmu.c`."""

    OUTPUT = 0
    INPUT = 1
    PARAMETER = 2


class DescribedVariable(NamedTuple):
    """A real variable, which is a number of the block."""

    name: str
    kind: Kind
    field: str  # of the block
    part: int  # of the field
    unit: str
    words: str
    low: float | None = None
    high: float | None = None


class FlightEnd(NamedTuple):
    """A value of the output `ended`."""

    name: str
    status: int
    words: str


ENDINGS = (
    FlightEnd("flying", 0, "it flies"),
    FlightEnd("implausible", 1, "its motion is not a number, or faster than any aircraft"),
    FlightEnd("above_atmosphere", 2, "above 20 km, where the model of the atmosphere ends"),
    FlightEnd("ground", 3, "so low that the ground may touch a part of it"),
)
AIRSPEED, DOWN = "start.airspeed", "start.position_ned[3]"


def list_variables(*, gusts: bool, propeller: bool, battery: bool) -> tuple[DescribedVariable, ...]:
    """Return the variables of an aircraft, in the order of their value references.

    Args:
        gusts: the aircraft has inputs for rotations of the air.
        propeller: it has one.
        battery: it has one.
    """
    found = [
        _input("command.pitch", "command.pitch", "rad", "Pitch command of fly-by-wire A, nose up"),
        _input(
            "command.roll",
            "command.roll",
            "rad",
            "Roll command of fly-by-wire A, right wing down",
        ),
        _input("command.throttle", "command.throttle", "", "Throttle command", 0.0, 1.0),
        *_vector("wind_ned", "wind.wind_ned", Kind.INPUT, "m/s", "Velocity of the air", AXES),
    ]
    if gusts:
        words = "Rotation of the air about the body axis"
        found += _vector(
            "wind_gradient_rates",
            "wind.wind_gradient_rates",
            Kind.INPUT,
            "rad/s",
            words,
            ("forward", "right", "down"),
        )
    words = "Airspeed at the start, one of those that the FMU was made for"
    found.append(DescribedVariable(AIRSPEED, Kind.PARAMETER, "start.airspeed", 0, "m/s", words))
    words = "Position at the start, from the origin"
    found += _vector("start.position_ned", "start.position_ned", Kind.PARAMETER, "m", words, AXES)
    words = "Course over the ground at the start, from north to east"
    found.append(DescribedVariable("start.course", Kind.PARAMETER, "start.course", 0, "rad", words))
    for name, unit, words in (
        ("position_ned", "m", "Position from the origin"),
        ("velocity_ned", "m/s", "Velocity over the ground"),
        ("acceleration_ned", "m/s2", "Derivative of velocity_ned"),
    ):
        found += _vector(name, f"truth.{name}", Kind.OUTPUT, unit, words, AXES)
    angles, axes = ("roll", "pitch", "yaw"), ("p, forward", "q, right", "r, down")
    found += _vector("euler", "truth.euler", Kind.OUTPUT, "rad", "Attitude", angles)
    words = "Angular velocity about the body axis"
    found += _vector("rates_body", "truth.rates_body", Kind.OUTPUT, "rad/s", words, axes)
    outputs = [
        ("airspeed", "truth.airspeed", "m/s", "True airspeed"),
        ("equivalent_airspeed", "truth.equivalent_airspeed", "m/s", "What a pitot tube measures"),
        ("alpha", "air.alpha", "rad", "Angle of attack"),
        ("beta", "air.beta", "rad", "Sideslip"),
        ("surfaces.aileron", "surfaces.aileron", "", "Servo command, positive rolls right"),
        ("surfaces.elevator", "surfaces.elevator", "", "Servo command, positive pitches up"),
        ("surfaces.rudder", "surfaces.rudder", "", "Servo command, positive yaws right"),
        ("surfaces.throttle", "surfaces.throttle", "", "Throttle, 0 to 1"),
    ]
    if propeller:
        words = "Revolutions of the first propeller per second"
        outputs.append(("propeller_rps", "air.propeller_rps", "1/s", words))
    if battery:
        outputs += [
            ("state_of_charge", "air.state_of_charge", "", "Charge of the battery, 0 to 1"),
            ("battery_voltage", "air.battery_voltage", "V", "Voltage at the battery's terminals"),
        ]
    for name, field, unit, words in outputs:
        found.append(DescribedVariable(name, Kind.OUTPUT, f"aircraft.{field}", 0, unit, words))
    return tuple(found)


def _input(
    name: str,
    field: str,
    unit: str,
    words: str,
    low: float | None = None,
    high: float | None = None,
) -> DescribedVariable:
    return DescribedVariable(name, Kind.INPUT, f"aircraft.{field}", 0, unit, words, low, high)


def _vector(
    name: str, field: str, kind: Kind, unit: str, words: str, parts: Sequence[str]
) -> list[DescribedVariable]:
    path = field if kind is Kind.PARAMETER else f"aircraft.{field}"
    return [
        DescribedVariable(f"{name}[{k + 1}]", kind, path, k, unit, f"{words}: {part}")
        for k, part in enumerate(parts)
    ]


def identifier(name: str) -> str:
    """Return the name of the libraries of a model, which the standard wants to be one of C."""
    letters = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{letters}" if letters[:1].isdigit() or not letters else letters


def describe_model(
    name: str,
    guid: str,
    variables: Sequence[DescribedVariable],
    starts: Sequence[float],
    period_s: float,
    words: str,
) -> str:
    """Return modelDescription.xml.

    Args:
        name: of the model.
        guid: of the FMU.
        variables: real ones.
        starts: their values at the default start.
        period_s: of the autopilot, of which steps are multiples.
        words: what the model is.
    """
    rows = [_scalar(k, each, starts[k]) for k, each in enumerate(variables)]
    rows.append(
        '    <ScalarVariable name="ended" valueReference="0" causality="output" '
        'variability="discrete" description="Why the aircraft is not flown on">'
        '<Enumeration declaredType="Ended"/></ScalarVariable>'
    )
    outputs = [k + 1 for k, each in enumerate(variables) if each.kind is Kind.OUTPUT]
    outputs.append(len(rows))
    # outputs are those of the period before: an input acts from its communication point on
    known = "".join(f'      <Unknown index="{k}" dependencies=""/>\n' for k in outputs)
    initial = "".join(f'      <Unknown index="{k}"/>\n' for k in outputs)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="2.0" modelName={quoteattr(name)} guid="{guid}" '
        f'description={quoteattr(words)} generationTool="testbed {__version__}" '
        'variableNamingConvention="structured">\n'
        f'  <CoSimulation modelIdentifier="{identifier(name)}" '
        'canHandleVariableCommunicationStepSize="true" canNotUseMemoryManagementFunctions="true" '
        'canGetAndSetFMUstate="true" canSerializeFMUstate="true"/>\n'
        f"  <UnitDefinitions>\n{_units(variables)}  </UnitDefinitions>\n"
        f"  <TypeDefinitions>\n{_endings()}  </TypeDefinitions>\n"
        '  <LogCategories>\n    <Category name="logStatusError"/>\n'
        '    <Category name="logStatusDiscard"/>\n  </LogCategories>\n'
        f'  <DefaultExperiment startTime="0" stopTime="60" stepSize="{period_s!r}"/>\n'
        "  <ModelVariables>\n" + "\n".join(rows) + "\n  </ModelVariables>\n"
        f"  <ModelStructure>\n    <Outputs>\n{known}    </Outputs>\n"
        f"    <InitialUnknowns>\n{initial}    </InitialUnknowns>\n  </ModelStructure>\n"
        "</fmiModelDescription>\n"
    )


def _scalar(reference: int, variable: DescribedVariable, start: float) -> str:
    causality, variability, initial = {
        Kind.OUTPUT: ("output", "continuous", ""),
        Kind.INPUT: ("input", "continuous", ""),
        Kind.PARAMETER: ("parameter", "fixed", ' initial="exact"'),
    }[variable.kind]
    given = "" if variable.kind is Kind.OUTPUT else f' start="{start!r}"'
    unit = f' unit="{variable.unit}"' if variable.unit else ""
    if shown := _IN_DEGREES.get(variable.unit):
        unit += f' displayUnit="{shown}"'
    bounds = (("min", variable.low), ("max", variable.high))
    range_ = "".join(f' {name}="{value!r}"' for name, value in bounds if value is not None)
    return (
        f'    <ScalarVariable name="{variable.name}" valueReference="{reference}" '
        f'causality="{causality}" variability="{variability}"{initial} '
        f"description={quoteattr(variable.words)}><Real{unit}{range_}{given}/></ScalarVariable>"
    )


def _units(variables: Sequence[DescribedVariable]) -> str:
    return "".join(_unit(name) for name in _UNITS if name in {each.unit for each in variables})


def _unit(name: str) -> str:
    powers = " ".join(f'{base}="{power}"' for base, power in _UNITS[name].items())
    shown = ""
    if also := _IN_DEGREES.get(name):
        shown = f'<DisplayUnit name="{also}" factor="{_DEGREES!r}"/>'
    return f'    <Unit name="{name}"><BaseUnit {powers}/>{shown}</Unit>\n'


def _endings() -> str:
    items = "".join(_items())
    return f'    <SimpleType name="Ended"><Enumeration>\n{items}    </Enumeration></SimpleType>\n'


def _items() -> Iterator[str]:
    for each in ENDINGS:
        yield (
            f'      <Item name="{each.name}" value="{each.status}" '
            f"description={quoteattr(each.words)}/>\n"
        )
