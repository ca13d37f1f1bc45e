"""Who flies an aircraft: what its autopilot is, and where its commands come from."""

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import (
    Field,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    model_serializer,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from testbed.scenario.fields import Flag, Seconds, Section, Whole

Patience = Annotated[Seconds, Field(gt=0, le=3600)]


class ByFormation(Section):
    """Commands of its controller: the formation's law, or of a leader its path."""

    kind: Literal["formation"] = Field("formation", description="The page's own controller.")

    @model_serializer
    def _word(self) -> str:
        return self.kind


class External(Section):
    """Commands of a program outside, which speaks MAVLink."""

    kind: Literal["external"] = Field("external", description="A program outside, over --mavlink.")
    failsafe_s: Patience = Field(
        1.5, description="Without commands for this long it circles where it is, s."
    )
    lockstep: Flag = Field(
        False,
        description="The run waits at every control period for its command: true; or goes on with "
        "the last one: false.",
    )
    patience_s: Patience = Field(
        30.0,
        description="In lockstep the run fails when it has waited this long, s of wall-clock time.",
    )


class VirtualAutopilot(Section):
    """ArduPlane's fly-by-wire A as the testbed has it."""

    kind: Literal["virtual"] = Field("virtual", description="The testbed's fly-by-wire A.")

    @model_serializer
    def _word(self) -> str:
        return self.kind


class ArduPlane(Section):
    """The real ArduPlane, a process of its own with our flight model as its physics."""

    kind: Literal["ardupilot"] = Field("ardupilot", description="The real ArduPlane.")
    binary: str | None = Field(
        None,
        min_length=1,
        description="Path of arduplane, relative to this page; by default --arduplane or the "
        "environment's ARDUPLANE.",
    )
    start: Flag = Field(
        True, description="Start the process: true; or wait for one that somebody starts: false."
    )
    instance: Annotated[Whole, Field(ge=0, le=250)] | None = Field(
        None,
        description="Its -I, a number: ports 9002 and 5760, plus ten times this; by default its "
        "place among the aircraft, the leader's 0.",
    )
    patience_s: Patience = Field(
        60.0, description="The run fails when it is silent for this long, s of wall-clock time."
    )


@dataclass(frozen=True)
class _OrWord:
    """A map, or the word that stands for the map of that kind with nothing else in it."""

    words: tuple[str, ...]

    def __get_pydantic_core_schema__(
        self, source: object, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(
            lambda value: {"kind": value} if isinstance(value, str) else value, handler(source)
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        return {"anyOf": [{"enum": list(self.words)}, handler(schema)]}


CommandedBy = Annotated[
    Annotated[ByFormation | External, Field(discriminator="kind")],
    _OrWord(("formation", "external")),
]
Autopilot = Annotated[
    Annotated[VirtualAutopilot | ArduPlane, Field(discriminator="kind")],
    _OrWord(("virtual", "ardupilot")),
]
