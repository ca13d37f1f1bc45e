"""An airframe's middle_loop.yaml: gains of the middle loop [HBH23] (19) to (21), by profile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

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


Share = Annotated[Number, Field(gt=0, le=1)]


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
    leader_acceleration_blend: tuple[Share, Share, Share] = Field(
        (1.0, 1.0, 1.0),
        description="Share of a new sample in the exponential average of the leader's "
        "acceleration: north, east, down; 1 is none.",
    )
    limits: Limits = Field(Limits(), description="Where the commands saturate, degrees.")


class MiddleLoopFile(RootModel[Mapping[Name, MiddleLoopGains]]):
    """The file: a profile by name."""
