"""Gains of an airframe: middle loop, [HBH23] (19) to (21), and guidance."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, RootModel

from testbed.core.ranges import THROTTLE
from testbed.scenario.arguments import with_changes
from testbed.scenario.fields import (
    SMALLEST,
    Degrees,
    Duration,
    LoopGain,
    Name,
    Number,
    Section,
    Speed,
    ZeroOrUsable,
    within,
)

CourseFeedback = Literal["outside_arctangent", "inside_arctangent"]
Share = Annotated[Number, Field(ge=SMALLEST, le=1)]


class AngleGains(Section):
    """PID gains from an angle error to an angle command."""

    p: LoopGain = Field(description="Proportional, rad per rad.")
    i: LoopGain = Field(0.0, description="Integral, rad per rad s.")
    d: LoopGain = Field(0.0, description="Derivative, rad per rad/s.")


class SpeedGains(Section):
    """PI gains from a speed error to throttle."""

    p: LoopGain = Field(description="Proportional, throttle fraction per m/s.")
    i: LoopGain = Field(0.0, description="Integral, throttle fraction per m.")


class CommandLimits(Section):
    """Limits of the commands."""

    pitch_deg: Degrees = Field(
        20.0, ge=SMALLEST, lt=90, description="Largest pitch command, degrees."
    )
    roll_deg: Degrees = Field(
        50.0, ge=SMALLEST, lt=90, description="Largest roll command, degrees."
    )


class AltitudeGains(Section):
    """PID gains from an altitude error to pitch, for the horizontal variant."""

    p: LoopGain = Field(0.026, description="Proportional, rad per m.")
    i: LoopGain = Field(0.0017, description="Integral, rad per m s.")
    d: LoopGain = Field(0.0105, description="Derivative, rad per m/s.")


class Estimators(Section):
    """Estimates of a follower from received messages."""

    leader_acceleration: Literal["broadcast", "coordinated_turn", "none"] = Field(
        "broadcast",
        description="q̈_g of (10): broadcast, measured by the leader; coordinated_turn, from its "
        "bank and differences of its velocity as in the paper's experiments; or none.",
    )
    leader_acceleration_blend: tuple[Share, Share, Share] = Field(
        (1.0, 1.0, 1.0),
        description="For broadcast: weight of a new message in the exponential average of the "
        "leader's acceleration (north, east, down); 1: no averaging.",
    )
    leader_difference_blend: tuple[Share, Share] = Field(
        (1.0, 1.0),
        description="For coordinated_turn: weight of a new difference in the exponential averages "
        "of the rates of the leader's speed and flight-path angle; 1: no averaging.",
    )
    leader_angular_acceleration: Literal["none", "roll_rate", "difference"] = Field(
        "none",
        description="ω̇_g of (29): neglected as in the paper; from the leader's roll rate; or from "
        "differences of its turn rates, which the authors also tried.",
    )
    leader_turn_rate_blend: Share = Field(
        1.0,
        description="For difference: weight of a new difference in the exponential average of "
        "ω̇_g; 1: no averaging.",
    )
    extrapolation: Literal["velocity", "acceleration"] = Field(
        "velocity",
        description="Extrapolation of messages to the present: at constant velocity as in the "
        "paper, or at constant acceleration.",
    )


class EstimatorChanges(Section):
    """Changes of a scenario to the estimators of a profile."""

    leader_acceleration: Literal["broadcast", "coordinated_turn", "none"] | None = Field(
        None, description="q̈_g of (10), as in the profile."
    )
    leader_acceleration_blend: tuple[Share, Share, Share] | None = Field(
        None, description="For broadcast: weights north, east, down."
    )
    leader_difference_blend: tuple[Share, Share] | None = Field(
        None, description="For coordinated_turn: weights of speed and flight-path angle."
    )
    leader_angular_acceleration: Literal["none", "roll_rate", "difference"] | None = Field(
        None, description="ω̇_g of (29), as in the profile."
    )
    leader_turn_rate_blend: Share | None = Field(
        None, description="For difference: weight of a new one."
    )
    extrapolation: Literal["velocity", "acceleration"] | None = Field(
        None, description="Extrapolation of messages, as in the profile."
    )

    def over(self, profile: Estimators) -> Estimators:
        """Return the estimators of the profile with these changes."""
        return with_changes(profile, **self.model_dump(exclude_none=True))


class FeedForwards(Section):
    """Feed-forward terms added to (19) to (21)."""

    turn_incidence_deg: Degrees = Field(
        0.0, ge=-90, le=90, description="Pitch per unit of load factor above 1 in a turn, degrees."
    )
    roll_lead_s: Duration = Field(
        0.0, ge=0, description="Lead time of the bank command of a coordinated turn, s."
    )
    lead_filter_s: Annotated[Duration, Field(ge=0), ZeroOrUsable] = Field(
        0.1, description="Time constant of the derivative for roll_lead_s, s."
    )
    eta_climb: LoopGain = Field(
        0.0, description="Throttle fraction per sine of the desired flight-path angle."
    )


class MiddleLoopGains(Section):
    """One profile: gains from the law's command to fly-by-wire-A commands."""

    flight_path: AngleGains = Field(description="Flight-path angle to pitch (19), rad to rad.")
    course: AngleGains = Field(description="Course to roll (20), rad to rad.")
    course_feedback: CourseFeedback = Field(
        "outside_arctangent",
        description="Where the course gains act in (20): outside its arctangent as in the paper, "
        "or inside it, where the loop's gain is the same at every bank.",
    )
    speed: SpeedGains = Field(description="Speed to throttle (21), m/s to throttle fraction.")
    eta_speed: LoopGain = Field(
        description="η_s of (21): throttle fraction per m/s of commanded airspeed."
    )
    eta_bank: LoopGain = Field(
        0.0, description="η_φ of (21): throttle fraction for the added drag of a turn."
    )
    trim_throttle: Annotated[Number, within(THROTTLE)] = Field(
        description="η_0 of (21): throttle fraction at the trim airspeed."
    )
    trim_airspeed_mps: Speed = Field(ge=SMALLEST, description="s_a0 of (21), m/s.")
    rate_filter_s: Annotated[Duration, Field(ge=0), ZeroOrUsable] = Field(
        0.0, description="Time constant of the filter of measured rates, s; 0: no filter."
    )
    altitude: AltitudeGains = Field(
        AltitudeGains(), description="Altitude to pitch in the horizontal variant, m to rad."
    )
    feed_forwards: FeedForwards = Field(
        FeedForwards(), description="Feed-forward terms added to (19) to (21); none by default."
    )
    estimators: Estimators = Field(Estimators(), description="Estimates from received messages.")
    limits: CommandLimits = Field(CommandLimits(), description="Limits of the commands, degrees.")


GainChanges = Mapping[Name, Number | CourseFeedback | Mapping[Name, Number]]


class MiddleLoopFile(RootModel[Mapping[Name, MiddleLoopGains]]):
    """The file middle_loop.yaml: profiles by name."""


class Guidance(Section):
    """The file guidance.yaml: gains with which a leader holds altitude and airspeed."""

    path: LoopGain = Field(0.5, description="Flight-path angle to pitch, rad per rad.")
    path_integral: LoopGain = Field(0.3, description="Integral of the same, rad per rad s.")
    incidence_per_load: LoopGain = Field(
        0.05, description="Pitch per unit of load factor above 1 in a turn, rad."
    )
    speed: LoopGain = Field(0.15, description="Airspeed to throttle, fraction per m/s.")
    speed_integral: LoopGain = Field(0.035, description="Integral of the same, fraction per m.")
    throttle_per_climb: LoopGain = Field(
        0.08, description="Throttle per climb rate, fraction per m/s."
    )
    throttle_per_bank: LoopGain = Field(
        0.12, description="Throttle for a turn, fraction per 1/cos² φ − 1."
    )
