"""The `formation` and `controller` sections: offsets, graph, gains and control law."""

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

from testbed.scenario.companion_flight import CompanionFlight
from testbed.scenario.fields import (
    MAX_LOOP_GAIN,
    MAX_RATE_PER_S,
    MAX_SPEED_MPS,
    MAX_WEIGHT,
    SMALLEST,
    Degrees,
    Duration,
    Gain,
    Length,
    Metres,
    Name,
    Number,
    Offset,
    PerSecond,
    Seconds,
    Section,
    Speed,
    is_number,
)
from testbed.scenario.middle_loop import EstimatorChanges, GainChanges
from testbed.scenario.reference_fields import BUILT_IN as BUILT_IN
from testbed.scenario.reference_fields import CODE, GainsReference


def _law_name(value: str) -> str:
    """Accept a name of the library's, and module:Class."""
    if not re.fullmatch(r"[^:]+(:[A-Za-z_]\w*)?", value):
        raise PydanticCustomError(
            "law", "must be the name of a law as hbh23, or module:Class or a .fmu for your own law"
        )
    return value


def _function_name(value: str) -> str:
    """Accept module:function."""
    if not re.fullmatch(r"[^:]+:[A-Za-z_]\w*", value):
        raise PydanticCustomError("function", "must be module:function, with module.py beside it")
    return value


FunctionName = Annotated[str, Field(max_length=500), AfterValidator(_function_name), CODE]
LawName = Annotated[str, Field(max_length=500), AfterValidator(_law_name), CODE]
FmuName = Annotated[str, Field(min_length=1, max_length=300)]
LawOption = str | int | float | bool | tuple[float, ...]


class PowerControlFunction(Section):
    """μ(z) = (ν₁ + ν₂ z)^(−m), [HBH23] Example 1."""

    example: Literal[1] = Field(description="Number of the example in [HBH23].")
    nu1: Number = Field(50.0, ge=SMALLEST, le=MAX_WEIGHT, description="ν₁, m².")
    nu2: Number = Field(1.0, ge=SMALLEST, le=MAX_WEIGHT, description="ν₂, no unit.")
    m: Number = Field(0.5, ge=0.5, le=1.0, description="Exponent, no unit.")


class SplineControlFunction(Section):
    """μ(z) constant near zero, then a cubic, then z^(−1/2); [HBH23] Examples 2 and 3."""

    example: Literal[2, 3] = Field(description="Number of the example in [HBH23].")


class OwnControlFunction(Section):
    """A μ(z) of your own."""

    example: Literal["own"] = Field(description="own: a function of your own.")
    function: FunctionName = Field(
        description="module:function, from module.py in the folder of this file or from an "
        "installed package; μ of an array z, m²."
    )


class Barrier(Section):
    """Function h that keeps the speed within its bounds; [HBH23] Examples 4 to 6."""

    example: Literal[4, 5, 6] = Field(description="Number of the example in [HBH23].")
    nu: Number = Field(
        0.05,
        ge=SMALLEST,
        le=MAX_SPEED_MPS,
        description="ν: s²/m² in examples 4 and 5, a margin in m/s in example 6.",
    )


class NoBarrier(Section):
    """h = 1, with a saturated speed command; [HBH23] Section 10."""

    example: Literal[7] = Field(description="7: no barrier, as in the experiments.")


class OwnBarrier(Section):
    """An h(s) of your own."""

    example: Literal["own"] = Field(description="own: a function of your own.")
    function: FunctionName = Field(
        description="module:function, as in control_function; h of an array s and the bounds "
        "s_min and s_max, m/s."
    )


class SpeedModel(Section):
    """f and g of your own in the speed model ṡ = f + g u, (2), of ideal vehicles and their law."""

    f: FunctionName = Field(
        description="module:function, as in control_function; f in m/s² of an array s, m/s."
    )
    g: FunctionName = Field(
        description="module:function, the same for g; u has the unit that makes g u m/s²."
    )


class PointingGain(Section):
    """c_i(t) = constant + per_speed_squared s_d²; a number stands for the constant."""

    constant: PerSecond = Field(0.0, ge=0, description="Constant part, 1/s.")
    per_speed_squared: Number = Field(
        0.0,
        ge=0,
        le=MAX_RATE_PER_S,
        description="Factor of the square of the desired speed s_d, s/m².",
    )

    @model_validator(mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:  # noqa: ANN401 - any YAML value
        return {"constant": value} if is_number(value) else value

    @model_validator(mode="after")
    def _positive(self) -> Self:
        if max(self.constant, self.per_speed_squared) < SMALLEST:
            raise PydanticCustomError("turn", "must be above 0 (write 0.1, for example, in 1/s)")
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
        return {
            "anyOf": [
                {"type": "number", "minimum": SMALLEST, "maximum": MAX_RATE_PER_S},
                dict(schema),
            ]
        }


ControlFunction = Annotated[
    PowerControlFunction | SplineControlFunction | OwnControlFunction,
    Field(discriminator="example"),
]
BarrierFunction = Annotated[Barrier | NoBarrier | OwnBarrier, Field(discriminator="example")]
SpeedRange = tuple[Annotated[Speed, Field(ge=0)], Annotated[Speed, Field(ge=0)]]


class Agent(Section):
    """Parameters of one follower; those that are left out are the formation's."""

    k: Speed | None = Field(None, ge=SMALLEST, description="k_i of (7), m/s.")
    a: PerSecond | None = Field(None, ge=SMALLEST, description="a_i of (14), 1/s.")
    b: Number | None = Field(None, ge=0, le=MAX_RATE_PER_S, description="b_i of (14), s/m².")
    c: PointingGain | None = Field(None, description="c_i of (15), 1/s, or a map.")
    kappa_mps: Speed | None = Field(None, ge=SMALLEST, description="κ_i, m/s.")
    speed_mps: SpeedRange | None = Field(None, description="Bounds S_i [lowest, highest], m/s.")
    speed_desired_mps: SpeedRange | None = Field(
        None, description="Bounds of s_d [lowest, highest], m/s."
    )
    speed_pole_per_s: PerSecond | None = Field(
        None, ge=SMALLEST, description="Pole p of the speed model, 1/s."
    )
    speed_model: SpeedModel | None = Field(
        None, description="f_i and g_i of (2), for an ideal vehicle."
    )
    control_function: ControlFunction | None = Field(None, description="The function μ_i of (5).")
    barrier: BarrierFunction | None = Field(None, description="The function h_i of (14).")


class OnFailure(Section):
    """Response of the followers to an aircraft that declares a fault."""

    response: Literal["ignore", "drop", "reassign-slots"] = Field(
        "ignore",
        description="ignore: no response; drop: leave it out of (6); reassign-slots: also assign "
        "the first offsets to the remaining followers, in fleet order.",
    )
    declared_after_s: Duration = Field(
        2.0, ge=0, description="Time from a failure to its declaration, s."
    )
    clearance_m: Length = Field(
        30.0,
        ge=SMALLEST,
        description="A slot is reassigned once the failed aircraft reports to be this far from "
        "it, m.",
    )


class Formation(Section):
    """Offsets, graph, gains and bounds of the formation; defaults are of [HBH23] Section 9."""

    offsets_m: Mapping[Name, Offset] = Field(
        description="υ_i by follower: [forward, right, down] in the leader's velocity frame, m."
    )
    altitudes_m: Mapping[Name, Metres] = Field(
        {},
        description="Followers with the horizontal variant: the law acts in the horizontal plane, "
        "and pitch holds this altitude above the origin, m.",
    )
    leader_gains: Mapping[Name, Gain] = Field(
        {},
        description="β_i by follower: a number, [north, east, down], or a diagonal matrix, no "
        "unit; 0 if missing.",
    )
    neighbour_gains: Mapping[Name, Mapping[Name, Gain]] = Field(
        {}, description="β_ij of follower i for neighbour j, no unit; 0 if missing."
    )
    k: Speed = Field(3.0, ge=SMALLEST, description="k_i of the desired velocity (7), m/s.")
    a: PerSecond = Field(1.0, ge=SMALLEST, description="a_i of the speed law (14), 1/s.")
    b: Number = Field(0.1, ge=0, le=MAX_RATE_PER_S, description="b_i of the speed law (14), s/m².")
    c: PointingGain = Field(
        PointingGain(constant=0.1),
        description="c_i of the pointing law (15): 1/s, or a map with its growth with s_d.",
    )
    kappa_mps: Speed = Field(
        3.6, ge=SMALLEST, description="κ_i: margin of the slot's speed to the speed bounds, m/s."
    )
    speed_mps: SpeedRange = Field(
        (16.0, 30.0), description="Speed bounds S_i [lowest, highest], m/s."
    )
    speed_desired_mps: SpeedRange | None = Field(
        None,
        description="Bounds of the desired speed s_d [lowest, highest], m/s; by default the speed "
        "bounds, narrowed by κ − k ρ̄.",
    )
    speed_pole_per_s: PerSecond = Field(
        0.64, ge=SMALLEST, description="Pole p of the speed model f = −p s, g = p, 1/s."
    )
    speed_model: SpeedModel | None = Field(
        None,
        description="f_i and g_i of (2) in place of −p s and p, for followers that are ideal "
        "vehicles (vehicle: unicycle).",
    )
    control_function: ControlFunction = Field(
        PowerControlFunction(example=1), description="The function μ_i of (5)."
    )
    barrier: BarrierFunction = Field(Barrier(example=5), description="The function h_i of (14).")
    agents: Mapping[Name, Agent] = Field(
        {}, description="By follower, parameters that differ from those above."
    )
    on_failure: OnFailure = Field(
        OnFailure(), description="Response to an aircraft that declares a fault."
    )


class SeparationBarrier(Section):
    """A filter behind the law that limits how fast followers close towards other aircraft."""

    kind: Literal["barrier"] = Field(
        description="barrier: a bound on the desired velocity, proportional to the distance left."
    )
    separation_m: Length = Field(
        ge=SMALLEST, description="Distance to other aircraft that is kept, m."
    )
    margin_m: Length = Field(
        3.5,
        ge=0,
        description="Distance in addition that errors of tracking may use up, m; of the Rascal "
        "3.5 m in turns of 45°.",
    )
    rate_per_s: PerSecond = Field(
        0.3,
        ge=SMALLEST,
        description="Share of the distance left that may be closed in a second, 1/s.",
    )


Latency = Annotated[Seconds, Field(ge=0, le=2)]


class Companion(Section):
    """Link between each follower's autopilot and the computer that runs its controller."""

    state_latency_s: Latency = Field(
        0.0,
        description="Age of the own state at its arrival at the controller, s; delays of messages "
        "are those of the network.",
    )
    command_latency_s: Latency = Field(
        0.0,
        description="Time from a control step to the arrival of its command at the autopilot, s.",
    )
    link: Literal["direct", "mavlink"] = Field(
        "direct",
        description="How states and commands pass between autopilot and controller: direct is with "
        "every digit; mavlink is rounded as in MAVLink's messages, with the command as an attitude "
        "target in GUIDED, which acts at the autopilot's next tick, and needs network.encoding: "
        "follow-target.",
    )
    acceleration: Literal["velocity", "imu"] = Field(
        "velocity",
        description="Source of the own acceleration with link: mavlink: differences of the "
        "velocity, or the accelerometers of SCALED_IMU.",
    )
    flight: CompanionFlight = Field(
        CompanionFlight(),
        description="Bounds of the command companion on an aircraft; without effect in a run.",
    )


class Controller(Section):
    """Control law of the followers, and options that the paper leaves open."""

    law: LawName = Field(
        "hbh23",
        description="Control law: hbh23 is [HBH23] (5) to (15); leader-follower and others are of "
        "the library of laws; module:Class is your own law, or module:function if it is compiled, "
        "from module.py in the folder of this file or from an installed package; or the path of an "
        "FMU in or below that folder, FILE.fmu.",
    )
    options: Mapping[Name, LawOption] = Field(
        {},
        description="Keyword arguments of the class or function of the law; of an FMU values of "
        "its parameters.",
    )
    map: Mapping[FmuName, FmuName] = Field(
        {},
        description="Of an FMU: names of its variables, with the fields of a law that they are, or "
        "none for one that is not used.",
    )
    profile: Name = Field(
        "tuned",
        description="Gains of the middle loop: a section of the airframe's middle_loop.yaml.",
    )
    middle_loop: GainsReference | None = Field(
        None,
        description="File in place of the airframe's middle_loop.yaml: a path from this file; for "
        "fleets of one airframe.",
    )
    gains: GainChanges = Field(
        {},
        description="Changes to the profile for all followers, as in course: {p: 3}.",
    )
    gain_scale: Number = Field(
        1.0,
        ge=SMALLEST,
        le=MAX_LOOP_GAIN,
        description="Factor of every PID gain of the middle loop, no unit.",
    )
    estimators: EstimatorChanges = Field(
        EstimatorChanges(),
        description="Estimates from received messages; keys that are left out are the profile's.",
    )
    extrapolate_from: Literal["receipt", "timestamp"] | None = Field(
        None,
        description="Time from which a message is extrapolated: timestamp compensates latency and "
        "needs synchronised clocks; by default receipt with hbh23, and a law of your own receives "
        "messages as they are.",
    )
    throttle_error: Literal["ground_speed", "airspeed"] = Field(
        "ground_speed",
        description="Speed error of (21): ground_speed, which is correct in wind, or airspeed, as "
        "printed.",
    )
    pitch_feedforward: Literal["none", "incidence"] = Field(
        "none",
        description="Addition to (19): none, or the angle of attack θ − γ as in the authors' code.",
    )
    bounded_speed: Literal["ground_speed", "airspeed"] | None = Field(
        None,
        description="Speed to which the speed bounds apply: ground_speed as in the paper, or "
        "airspeed (bounds shifted by the wind) as in the authors' code; by default airspeed where "
        "air.wind blows, else ground_speed.",
    )
    safety: SeparationBarrier | None = Field(
        None, description="Filter that keeps a separation, behind laws that desire a velocity."
    )
    companion: Companion = Field(
        Companion(), description="Latencies of a controller beside the autopilot."
    )
    leader_timeout_s: Duration = Field(
        5.0,
        ge=SMALLEST,
        description="Time without a message from the leader after which a follower leaves the "
        "formation, s.",
    )
    on_leader_timeout: Literal["straight", "loiter"] = Field(
        "straight",
        description="Then it flies level at its trim airspeed: straight, or in a circle.",
    )
    loiter_bank_deg: Degrees = Field(
        20.0, ge=-60, le=60, description="Bank angle of that circle, degrees; right is positive."
    )
    neighbour_timeout_s: Duration | None = Field(
        None,
        ge=SMALLEST,
        description="Time without a message from a neighbour after which it is not extrapolated, "
        "s; by default leader_timeout_s.",
    )
    on_neighbour_timeout: Literal["drop", "hold-relative-position"] = Field(
        "drop",
        description="drop: leave the neighbour out of (6); hold-relative-position: hold its "
        "position in the leader's velocity frame at its last message.",
    )
