"""Autopilot of an aircraft, and the source of its commands."""

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

Timeout = Annotated[Seconds, Field(gt=0, le=3600)]


class ByFormation(Section):
    """Commands of the formation controller, or of a leader those of its path."""

    kind: Literal["formation"] = Field("formation", description="The controller of this scenario.")

    @model_serializer
    def _kind(self) -> str:
        return self.kind


class External(Section):
    """Commands of an external program over MAVLink."""

    kind: Literal["external"] = Field(
        "external", description="An external program, over --mavlink."
    )
    failsafe_s: Timeout = Field(
        1.5, description="It loiters at its position after this time without a command, s."
    )
    lockstep: Flag = Field(
        False,
        description="true: the run waits for its command at every control period; false: it goes "
        "on with the last one.",
    )
    timeout_s: Timeout = Field(
        30.0,
        description="In lockstep the run fails after this time without a command, s of wall-clock "
        "time.",
    )


class VirtualAutopilot(Section):
    """The testbed's implementation of ArduPlane's fly-by-wire A."""

    kind: Literal["virtual"] = Field("virtual", description="The testbed's fly-by-wire A.")

    @model_serializer
    def _kind(self) -> str:
        return self.kind


class ArduPlane(Section):
    """ArduPlane as a separate process, with the testbed's flight model as its physics."""

    kind: Literal["ardupilot"] = Field("ardupilot", description="An ArduPlane process.")
    binary: str | None = Field(
        None,
        min_length=1,
        description="Path of arduplane, relative to this file; by default --arduplane or the "
        "environment variable ARDUPLANE.",
    )
    start: Flag = Field(
        True,
        description="true: the run starts the process; false: it waits for one that is started "
        "elsewhere.",
    )
    instance: Annotated[Whole, Field(ge=0, le=250)] | None = Field(
        None,
        description="Its option -I, a number: ports are 9002, 5501 and 5760 plus ten times this; "
        "by default one with free ports, or with start: false the index of the aircraft, the "
        "leader's is 0.",
    )
    timeout_s: Timeout = Field(
        60.0, description="The run fails after this time without an answer, s of wall-clock time."
    )

    def fixed_instance(self, row: int) -> int | None:
        """Return the instance of the aircraft of this row; None: any with free ports."""
        if self.instance is None and not self.start:  # the user needs to know which one to start
            return row
        return self.instance


@dataclass(frozen=True)
class _OrKind:
    """Accept a word for the map of that kind with defaults."""

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
    _OrKind(("formation", "external")),
]
Autopilot = Annotated[
    Annotated[VirtualAutopilot | ArduPlane, Field(discriminator="kind")],
    _OrKind(("virtual", "ardupilot")),
]
