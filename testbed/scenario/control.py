"""The formation and its control law on the page: what it wants, and with which gains."""

import re
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    Field,
    GetJsonSchemaHandler,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from testbed.scenario.fields import (
    Gain,
    Metres,
    MetresPerSecond,
    Name,
    Number,
    Offset,
    PerSecond,
    Seconds,
    Section,
)
from testbed.scenario.gains import EstimatorChoice, GainChanges


def _law_name(value: str) -> str:
    """Let through the paper's law and module:Class."""
    if not re.fullmatch(r"paper|[^:]+:[A-Za-z_]\w*", value):
        raise PydanticCustomError("law", "must be paper, or module:Class for a law of your own")
    return value


LawName = Annotated[str, Field(max_length=500), AfterValidator(_law_name)]
Option = str | int | float | bool | tuple[float, ...]


class PowerControlFunction(Section):
    """μ(z) = (ν₁ + ν₂ z)^(−m). [HBH23] Example 1."""

    example: Literal[1] = Field(description="Number of the example in [HBH23].")
    nu1: Number = Field(50.0, gt=0, description="ν₁, m².")
    nu2: Number = Field(1.0, gt=0, description="ν₂, no unit.")
    m: Number = Field(0.5, ge=0.5, le=1.0, description="Exponent, no unit.")


class SplineControlFunction(Section):
    """μ(z) constant near zero, then a cubic, then z^(−1/2). [HBH23] Examples 2 and 3."""

    example: Literal[2, 3] = Field(description="Number of the example in [HBH23].")


class Barrier(Section):
    """The function h that keeps the speed inside its bounds. [HBH23] Examples 4 to 6."""

    example: Literal[4, 5, 6] = Field(description="Number of the example in [HBH23].")
    nu: Number = Field(
        0.05, gt=0, description="ν: s²/m² in examples 4 and 5, a margin in m/s in example 6."
    )


class NoBarrier(Section):
    """h = 1: the speed command is saturated instead. [HBH23] Section 10."""

    example: Literal[7] = Field(description="7 stands for no barrier, as in the experiments.")


class TurnGain(Section):
    """c_i(t) = constant + per_speed_squared s_d²; a number stands for the constant alone."""

    constant: PerSecond = Field(0.0, ge=0, description="Constant part, 1/s.")
    per_speed_squared: Number = Field(
        0.0, ge=0, description="Times the square of the desired speed s_d, s/m²."
    )

    @model_validator(mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
        number = isinstance(value, int | float) and not isinstance(value, bool)
        return {"constant": value} if number else value

    @model_validator(mode="after")
    def _positive(self) -> Self:
        if not (self.constant or self.per_speed_squared):
            raise PydanticCustomError("turn", "must be above 0 (write 0.1, say, in 1/s)")
        return self

    @model_serializer(mode="wrap")
    def _as_number(self, handler: Any) -> Any:  # noqa: ANN401 - pydantic's protocol
        return handler(self) if self.per_speed_squared else self.constant

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Allow a number beside the map."""
        schema = handler.resolve_ref_schema(handler(core_schema))
        return {"anyOf": [{"type": "number", "exclusiveMinimum": 0}, dict(schema)]}


ControlFunction = Annotated[
    PowerControlFunction | SplineControlFunction, Field(discriminator="example")
]
BarrierFunction = Annotated[Barrier | NoBarrier, Field(discriminator="example")]
SpeedRange = tuple[MetresPerSecond, MetresPerSecond]


class Agent(Section):
    """What one follower has different from the rest; what is left out is the formation's."""

    k: Number | None = Field(None, gt=0, description="k_i of (7), m/s.")
    a: PerSecond | None = Field(None, gt=0, description="a_i of (14), 1/s.")
    b: Number | None = Field(None, ge=0, description="b_i of (14), s/m².")
    c: TurnGain | None = Field(None, description="c_i of (15), 1/s, or a map.")
    kappa_mps: MetresPerSecond | None = Field(None, gt=0, description="κ_i, m/s.")
    speed_mps: SpeedRange | None = Field(None, description="Bounds S_i [lowest, highest], m/s.")
    speed_desired_mps: SpeedRange | None = Field(
        None, description="Bounds of s_d [lowest, highest], m/s."
    )
    speed_pole_per_s: PerSecond | None = Field(
        None, gt=0, description="Pole p of the speed model, 1/s."
    )
    control_function: ControlFunction | None = Field(None, description="The function μ_i of (5).")
    barrier: BarrierFunction | None = Field(None, description="The function h_i of (14).")


class OnFailure(Section):
    """What the formation does when an aircraft tells that it has failed."""

    answer: Literal["fly-on", "drop", "re-slot"] = Field(
        "fly-on",
        description="fly-on: nothing; drop: leave it out of (6); re-slot: leave it out, and the "
        "followers that are left take the first offsets in the order of the fleet.",
    )
    after_s: Seconds = Field(2.0, ge=0, description="From the failure to its being told, s.")
    clear_m: Metres = Field(
        30.0,
        gt=0,
        description="A place is filled once who failed has told that it is this far from it, m.",
    )


class Formation(Section):
    """Offsets, graph, gains and bounds of the formation law; defaults are [HBH23] Section 9."""

    offsets_m: Mapping[Name, Offset] = Field(
        description="υ_i by follower: [forward, right, down] in the leader's velocity frame, m."
    )
    altitudes_m: Mapping[Name, Metres] = Field(
        {},
        description="Followers that fly the horizontal variant: the law sees the plane, and pitch "
        "holds this altitude above the origin, m.",
    )
    leader_gains: Mapping[Name, Gain] = Field(
        {},
        description="β_i by follower: a number, [north, east, down], or a diagonal matrix, no "
        "unit; 0 if missing.",
    )
    neighbour_gains: Mapping[Name, Mapping[Name, Gain]] = Field(
        {}, description="β_ij of follower i for neighbour j, no unit; 0 if missing."
    )
    k: Number = Field(3.0, gt=0, description="k_i of the desired velocity (7), m/s.")
    a: PerSecond = Field(1.0, gt=0, description="a_i of the speed law (14), 1/s.")
    b: Number = Field(0.1, ge=0, description="b_i of the speed law (14), s/m².")
    c: TurnGain = Field(
        TurnGain(constant=0.1),
        description="c_i of the pointing law (15): 1/s, or a map of how it grows with s_d.",
    )
    kappa_mps: MetresPerSecond = Field(
        3.6, gt=0, description="κ_i: how far the leader's speed stays from the bounds, m/s."
    )
    speed_mps: SpeedRange = Field(
        (16.0, 30.0), description="Speed bounds S_i [lowest, highest], m/s."
    )
    speed_desired_mps: SpeedRange | None = Field(
        None,
        description="Bounds of the desired speed s_d [lowest, highest], m/s; by default the speed "
        "bounds less κ − k ρ̄.",
    )
    speed_pole_per_s: PerSecond = Field(
        0.64, gt=0, description="Pole p of the speed model f = −p s, g = p, 1/s."
    )
    control_function: ControlFunction = Field(
        PowerControlFunction(example=1), description="The function μ_i of (5)."
    )
    barrier: BarrierFunction = Field(Barrier(example=5), description="The function h_i of (14).")
    agents: Mapping[Name, Agent] = Field(
        {}, description="By follower, what it has different from the values above."
    )
    on_failure: OnFailure = Field(
        OnFailure(), description="What the others do when an aircraft has failed."
    )


class Silence(Section):
    """What a follower does when its leader falls silent."""

    after_s: Seconds = Field(
        5.0, gt=0, description="Without news of its leader for this long, a follower is alone, s."
    )
    then: Literal["straight", "loiter"] = Field(
        "straight",
        description="Without its leader a follower flies level at its trim airspeed: straight on, "
        "or round in a circle.",
    )
    bank_deg: Number = Field(
        20.0, ge=-60, le=60, description="Bank of that circle, degrees; right is positive."
    )


class Staleness(Section):
    """What a follower does when a neighbour falls silent."""

    after_s: Seconds | None = Field(
        None,
        gt=0,
        description="Without news of a neighbour for this long, what was known of it is too old; "
        "by default silence.after_s, s.",
    )
    then: Literal["drop", "hold"] = Field(
        "drop",
        description="Leave the neighbour out of (6), or take it to hold the place in the leader's "
        "velocity frame that it had when its last message was new.",
    )


class Controller(Section):
    """Which law flies the followers, and the options the paper leaves open."""

    law: LawName = Field(
        "paper",
        description="The control law: paper is [HBH23] (5) to (15); module:Class is your own, from "
        "a module.py beside this page or an installed package.",
    )
    options: Mapping[Name, Option] = Field(
        {}, description="Keyword arguments of your own law's class."
    )
    profile: Name = Field(
        "paper",
        description="Gains of the middle loop: a section of the airframe's middle_loop.yaml.",
    )
    middle_loop: str | None = Field(
        None,
        min_length=1,
        description="A file like the airframe's middle_loop.yaml in its place: a path, relative to "
        "this page; for fleets of one airframe.",
    )
    gains: GainChanges = Field(
        {},
        description="What is different from the profile, for all followers: its keys with other "
        "numbers, as in course: {p: 3}.",
    )
    gain_scale: Number = Field(
        1.0, gt=0, description="Multiplies every PID gain of the middle loop, no unit."
    )
    estimators: EstimatorChoice = Field(
        EstimatorChoice(),
        description="What is made of the others' messages; what is left out is as in the profile.",
    )
    extrapolate_from: Literal["receipt", "timestamp"] = Field(
        "receipt",
        description="From when a neighbour's message is extrapolated: timestamp needs "
        "synchronised clocks and compensates latency.",
    )
    throttle_error: Literal["ground_speed", "airspeed"] = Field(
        "ground_speed",
        description="The speed error of (21): ground_speed is right in wind, airspeed as printed.",
    )
    pitch_feedforward: Literal["none", "incidence"] = Field(
        "none",
        description="Add nothing to (19), or the incidence θ − γ, as the authors' code does.",
    )
    bounds_of: Literal["ground_speed", "airspeed"] = Field(
        "ground_speed",
        description="What the speed bounds bound: ground_speed is the paper's, airspeed shifts "
        "them by the wind, as the authors' code does.",
    )
    silence: Silence = Field(Silence(), description="What happens without news of the leader.")
    staleness: Staleness = Field(
        Staleness(), description="What happens without news of a neighbour."
    )
