"""An airframe's middle_loop.yaml: gains of the middle loop [HBH23] (19) to (21), by profile."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field, RootModel

from testbed.scenario.fields import (
    Degrees,
    MetresPerSecond,
    Name,
    NotNegative,
    Number,
    Seconds,
    Section,
)

Share = Annotated[Number, Field(gt=0, le=1)]


class AngleGains(Section):
    """A PID from an angle error to an angle command."""

    p: NotNegative = Field(description="Proportional, rad per rad.")
    i: NotNegative = Field(0.0, description="Integral, rad per rad s.")
    d: NotNegative = Field(0.0, description="Derivative, rad per rad/s.")


class SpeedGains(Section):
    """A PI from a speed error to throttle."""

    p: NotNegative = Field(description="Proportional, throttle fraction per m/s.")
    i: NotNegative = Field(0.0, description="Integral, throttle fraction per m.")


class Limits(Section):
    """Where the commands saturate."""

    pitch_deg: Degrees = Field(20.0, gt=0, lt=90, description="Largest pitch command, degrees.")
    roll_deg: Degrees = Field(50.0, gt=0, lt=90, description="Largest roll command, degrees.")


class AltitudeGains(Section):
    """A PID from an altitude error to pitch, for the horizontal variant."""

    p: NotNegative = Field(0.026, description="Proportional, rad per m.")
    i: NotNegative = Field(0.0017, description="Integral, rad per m s.")
    d: NotNegative = Field(0.0105, description="Derivative, rad per m/s.")


class Estimators(Section):
    """What a follower makes of the others' messages."""

    leader_acceleration: Literal["broadcast", "turn", "none"] = Field(
        "broadcast",
        description="q̈_g of (10): as the leader measures it; from its bank and differences of its "
        "velocity, as in the paper's experiments; or left out.",
    )
    leader_acceleration_blend: tuple[Share, Share, Share] = Field(
        (1.0, 1.0, 1.0),
        description="For broadcast: share of a new message in the exponential average of the "
        "leader's acceleration: north, east, down; 1 is none.",
    )
    leader_difference_blend: tuple[Share, Share] = Field(
        (1.0, 1.0),
        description="For turn: share of a new difference in the exponential averages of the rates "
        "of the leader's speed and flight-path angle; 1 is none.",
    )
    turn_acceleration: Literal["none", "roll_rate"] = Field(
        "none", description="ω̇_g of (29): neglected as in the paper, or by the leader's roll rate."
    )
    extrapolation: Literal["velocity", "acceleration"] = Field(
        "velocity",
        description="How messages are brought to the present: along the velocity, as in the "
        "paper, or along a parabola.",
    )


class EstimatorChoice(Section):
    """What a page chooses in place of the profile; what is left out is the profile's."""

    leader_acceleration: Literal["broadcast", "turn", "none"] | None = Field(
        None, description="q̈_g of (10), as in the profile."
    )
    leader_acceleration_blend: tuple[Share, Share, Share] | None = Field(
        None, description="For broadcast: shares north, east, down."
    )
    leader_difference_blend: tuple[Share, Share] | None = Field(
        None, description="For turn: shares of speed and flight-path angle."
    )
    turn_acceleration: Literal["none", "roll_rate"] | None = Field(
        None, description="ω̇_g of (29), as in the profile."
    )
    extrapolation: Literal["velocity", "acceleration"] | None = Field(
        None, description="How messages are brought to the present."
    )

    def over(self, profile: Estimators) -> Estimators:
        """The profile's estimators with what is chosen here."""
        return profile.model_copy(update=self.model_dump(exclude_none=True))


class FeedForwards(Section):
    """Additions to (19) to (21) that the paper has not."""

    turn_incidence_deg: Degrees = Field(
        0.0, description="Pitch for one more load factor, by the bank, degrees."
    )
    roll_lead_s: Seconds = Field(
        0.0, ge=0, description="By how much a coordinated turn's bank is commanded early, s."
    )
    lead_filter_s: Seconds = Field(
        0.1, ge=0, description="Time constant of the derivative that this takes, s."
    )
    eta_climb: Number = Field(
        0.0, ge=0, description="Throttle fraction per sine of the desired flight-path angle."
    )


class MiddleLoopGains(Section):
    """One profile: from the formation law's command to fly-by-wire-A commands."""

    flight_path: AngleGains = Field(description="Flight-path angle to pitch (19), rad to rad.")
    course: AngleGains = Field(description="Course to roll (20), rad to rad.")
    speed: SpeedGains = Field(description="Speed to throttle (21), m/s to throttle fraction.")
    eta_speed: NotNegative = Field(
        description="η_s of (21): throttle fraction per m/s of commanded airspeed."
    )
    eta_bank: NotNegative = Field(
        0.0, description="η_φ of (21): throttle fraction for the extra drag of a turn."
    )
    trim_throttle: Number = Field(
        ge=0, le=1, description="η_0 of (21): throttle fraction at the trim airspeed."
    )
    trim_airspeed_mps: MetresPerSecond = Field(gt=0, description="s_a0 of (21), m/s.")
    rate_filter_s: Seconds = Field(
        0.0, ge=0, description="Time constant of the filter on measured rates, s; 0 is none."
    )
    altitude: AltitudeGains = Field(
        AltitudeGains(), description="Altitude to pitch where the law is horizontal, m to rad."
    )
    feed_forwards: FeedForwards = Field(
        FeedForwards(), description="Additions to (19) to (21); none by default."
    )
    estimators: Estimators = Field(
        Estimators(), description="What is made of the others' messages."
    )
    limits: Limits = Field(Limits(), description="Where the commands saturate, degrees.")


GainChanges = Mapping[Name, Number | Mapping[Name, Number]]


class MiddleLoopFile(RootModel[Mapping[Name, MiddleLoopGains]]):
    """The file: a profile by name."""


class Guidance(Section):
    """An airframe's guidance.yaml: how it holds altitude and airspeed when it leads a mission."""

    path: NotNegative = Field(0.5, description="Flight-path angle to pitch, rad per rad.")
    path_integral: NotNegative = Field(0.3, description="The same, integral, rad per rad s.")
    incidence_per_load: NotNegative = Field(
        0.05, description="Pitch for one more load factor in a turn, rad."
    )
    speed: NotNegative = Field(0.15, description="Airspeed to throttle, fraction per m/s.")
    speed_integral: NotNegative = Field(0.035, description="The same, integral, fraction per m.")
    throttle_per_climb: NotNegative = Field(
        0.08, description="Throttle for a climb, fraction per m/s."
    )
    throttle_per_bank: NotNegative = Field(
        0.12, description="Throttle for a turn, fraction times 1/cos² φ − 1."
    )
