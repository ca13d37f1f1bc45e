"""The files of a formation law that is an FMU, for `testbed new law --fmu`."""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

STEP_S = 0.04  # default control period
_AXES = ("north", "east", "down")
_SLOT = ("forward", "right", "down")


class LawNumber(NamedTuple):
    """A number of the law: its field in the contract, and its place in C."""

    name: str
    constant: str  # in C; "": behind the one before
    causality: str
    unit: str
    start: float
    meaning: str


def _vector(
    name: str, constant: str, causality: str, unit: str, meaning: str, axes: Sequence[str] = _AXES
) -> Iterator[LawNumber]:
    open_, close = ("", "]") if name.endswith(",") else ("[", "]")
    for k, axis in enumerate(axes):
        own = constant if k == 0 else ""
        text = f"{meaning}, {axis}"
        yield LawNumber(f"{name}{open_}{k + 1}{close}", own, causality, unit, 0.0, text)


VARIABLES = (
    *_vector("own.position_ned", "OWN_POSITION", "input", "m", "own position"),
    *_vector("own.velocity_ned", "OWN_VELOCITY", "input", "m/s", "own velocity over the ground"),
    LawNumber("inbox.age_s[1]", "AGE", "input", "s", 0.0, "time since the leader's message"),
    *_vector("inbox.position_ned[1,", "LEADER_POSITION", "input", "m", "leader's position"),
    *_vector("inbox.velocity_ned[1,", "LEADER_VELOCITY", "input", "m/s", "leader's velocity"),
    *_vector(
        "inbox.acceleration_ned[1,",
        *("LEADER_ACCELERATION", "input", "m/s2", "leader's acceleration"),
    ),
    LawNumber("inbox.turn_rate[1]", "LEADER_TURN_RATE", "input", "rad/s", 0.0, "its course's rate"),
    *_vector("config.slot", "SLOT", "parameter", "m", "own slot from the leader", _SLOT),
    LawNumber(
        *("config.leader_timeout_s", "LEADER_TIMEOUT", "parameter", "s", 1.0),
        "age of a message that is not used",
    ),
    LawNumber("closing_per_s", "CLOSING", "parameter", "1/s", 0.3, "how fast errors are closed"),
    *_vector("velocity_ned", "DESIRED", "output", "m/s", "desired velocity"),
    *_vector(
        "acceleration_ned", "DESIRED_ACCELERATION", "output", "m/s2", "derivative of its value"
    ),
)
_UNITS: Mapping[str, str] = {
    "m": 'm="1"',
    "m/s": 'm="1" s="-1"',
    "m/s2": 'm="1" s="-2"',
    "s": 's="1"',
    "1/s": 's="-1"',
    "rad/s": 's="-1" rad="1"',
}


def guid_of(name: str) -> str:
    """Return the identifier of a new FMU, which changes with the table of variables."""
    digest = hashlib.sha256(f"{name} {VARIABLES}".encode()).hexdigest()
    groups = digest[:8], digest[8:12], digest[12:16], digest[16:20], digest[20:32]
    return f"{{{'-'.join(groups)}}}"


def description(name: str) -> str:
    """Return the text of modelDescription.xml."""
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<fmiModelDescription fmiVersion="2.0" modelName="{name}" guid="{guid_of(name)}"',
        '    variableNamingConvention="structured">',
        f'  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true"',
        '      canGetAndSetFMUstate="true" canSerializeFMUstate="true"/>',
        "  <UnitDefinitions>",
        *(f'    <Unit name="{unit}"><BaseUnit {base}/></Unit>' for unit, base in _UNITS.items()),
        "  </UnitDefinitions>",
        f'  <DefaultExperiment stepSize="{STEP_S:g}"/>',
        "  <ModelVariables>",
    ]
    for k, each in enumerate(VARIABLES):
        kind = {"parameter": ' variability="fixed"'}.get(each.causality, "")
        start = f' start="{each.start:g}"' if each.causality != "output" else ""
        lines += [
            f'    <ScalarVariable name="{each.name}" valueReference="{k}"',
            f'        causality="{each.causality}"{kind} description={quoteattr(each.meaning)}>',
            f'      <Real unit="{each.unit}"{start}/>',
            "    </ScalarVariable>",
        ]
    outputs = [k + 1 for k, each in enumerate(VARIABLES) if each.causality == "output"]
    unknowns = [f'      <Unknown index="{k}"/>' for k in outputs]
    return "\n".join(
        [
            *(*lines, "  </ModelVariables>", "  <ModelStructure>"),
            *("    <Outputs>", *unknowns, "    </Outputs>"),
            *("    <InitialUnknowns>", *unknowns, "    </InitialUnknowns>"),
            *("  </ModelStructure>", "</fmiModelDescription>", ""),
        ]
    )


def table() -> str:
    """Return the variables as a table: name, value reference, causality, unit, start, meaning."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(("name", "value_reference", "causality", "unit", "start", "meaning"))
    for k, each in enumerate(VARIABLES):
        writer.writerow((each.name, k, each.causality, each.unit, f"{each.start:g}", each.meaning))
    return out.getvalue()


def c_words(name: str) -> dict[str, str]:
    """Return what stands in the places of words of the C source."""
    places = [f"  {each.constant} = {k}," for k, each in enumerate(VARIABLES) if each.constant]
    places += [f"  COUNT = {len(VARIABLES)}"]
    values = [f"  [{each.constant}] = {each.start:g}," for each in VARIABLES if each.start]
    return {
        "NAME": name,
        "TOKEN": guid_of(name),
        "ENUM": "\n".join(places),
        "VALUES": "\n".join(values),
        "COMMAND": "\n * ".join(("Build it in this folder's parent:", *build_commands(name))),
    }


def build_commands(name: str, platform: str = "linux64") -> list[str]:
    """Return the commands that build an FMU in the folder of its modelDescription.xml."""
    library = f"binaries/{platform}/{name}.so"
    return [
        f"mkdir -p binaries/{platform}",
        f"cc -O2 -ffp-contract=off -fPIC -shared -o {library} sources/{name}.c -lm",
        f"python -m zipfile -c ../{name}.fmu modelDescription.xml binaries sources",
    ]
