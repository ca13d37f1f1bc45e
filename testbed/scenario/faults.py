"""What breaks in an aircraft on the page, and when."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from testbed.scenario.fields import Number, Offset, Seconds, Section

Surface = Literal["aileron", "elevator", "rudder", "left-elevon", "right-elevon"]
_SURFACE = "Which surface; the airframe must have it."


class Condition(Section):
    """A state of the aircraft in which a fault begins: the truth's, not what it believes."""

    quantity: Literal["altitude_m", "airspeed_mps", "bank_deg", "state_of_charge"] = Field(
        description="What is watched: altitude above the origin, m; true airspeed, m/s; bank to "
        "either side, degrees; charge, 0 to 1.",
    )
    above: Number | None = Field(None, description="Begin above this, in the quantity's unit.")
    below: Number | None = Field(None, description="Begin below this, in the quantity's unit.")


class Breakdown(Section):
    """What all faults have: when they begin and end, and whether the others are told."""

    DECLARED: ClassVar[bool]  # unless the page says otherwise
    OF_FLIGHT: ClassVar[bool] = False  # needs an airframe that flies by its forces

    kind: str = Field(description="What breaks.")
    at_s: Annotated[Seconds, Field(ge=0)] | None = Field(
        None, description="When it begins, or with when: from when that counts, s."
    )
    when: Condition | None = Field(
        None, description="The state in which it begins; once begun, it does not begin again."
    )
    lasts_s: Annotated[Seconds, Field(gt=0)] | None = Field(
        None, description="How long it lasts, s; by default for good."
    )
    declared: Annotated[bool, Field(strict=True)] | None = Field(
        None,
        description="Whether the aircraft tells the others formation.on_failure.after_s later: "
        "true or false; by default as the kind of fault lets it.",
    )

    @property
    def is_declared(self) -> bool:
        """Whether the aircraft tells the others."""
        return self.DECLARED if self.declared is None else self.declared


class EngineOut(Breakdown):
    """No thrust."""

    DECLARED = OF_FLIGHT = True
    kind: Literal["engine-out"] = Field(description="No thrust.")


class ThrustLoss(Breakdown):
    """Less of the throttle reaches the motor."""

    DECLARED = OF_FLIGHT = True
    kind: Literal["thrust-loss"] = Field(description="Less thrust.")
    left: Number = Field(
        ge=0, le=1, description="Share of the throttle that reaches the motor, 0 to 1."
    )


class SurfaceStuck(Breakdown):
    """A surface does not move."""

    DECLARED = OF_FLIGHT = True
    kind: Literal["surface-stuck"] = Field(description="A surface does not move.")
    surface: Surface = Field(description=_SURFACE)
    position: Annotated[Number, Field(ge=-1, le=1)] | None = Field(
        None,
        description="Where, -1 to 1 of its travel; positive rolls right, pitches up, yaws right, "
        "of an elevon is up; by default where it is at that moment.",
    )


class SurfaceFloating(Breakdown):
    """A surface that nothing holds turns with the flow."""

    DECLARED = OF_FLIGHT = True
    kind: Literal["surface-floating"] = Field(description="Nothing holds a surface.")
    surface: Surface = Field(description=_SURFACE)
    ratio: Number = Field(
        0.5, ge=-1, le=1, description="Deflection per angle of the flow, rad/rad."
    )


class AirspeedBlocked(Breakdown):
    """The opening of the pitot tube is blocked."""

    DECLARED = False
    kind: Literal["airspeed-blocked"] = Field(description="The pitot tube is blocked.")
    drain: Literal["blocked", "open"] = Field(
        "blocked",
        description="blocked keeps the pressure in: the airspeed grows with height; open lets it "
        "out: the airspeed falls to 0.",
    )


class GpsLost(Breakdown):
    """No more fixes."""

    DECLARED = True
    kind: Literal["gps-lost"] = Field(description="No more fixes.")


class GpsJump(Breakdown):
    """Every fix is off by the same."""

    DECLARED = False
    kind: Literal["gps-jump"] = Field(description="Every fix is off by the same.")
    offset_m: Offset = Field(description="By how much [north, east, down], m.")


class AutopilotFrozen(Breakdown):
    """The autopilot hangs: servos keep what they were told last."""

    DECLARED = False
    OF_FLIGHT = True
    kind: Literal["autopilot-frozen"] = Field(description="The autopilot hangs.")


class RadioMute(Breakdown):
    """The transmitter is silent."""

    DECLARED = False
    kind: Literal["radio-mute"] = Field(description="Nothing is sent.")


class BatteryLow(Breakdown):
    """The battery drops to a lower charge, and goes on from there."""

    DECLARED = OF_FLIGHT = True
    kind: Literal["battery-low"] = Field(description="The battery drops to a lower charge.")
    state_of_charge: Number = Field(gt=0, le=1, description="To which it drops, 0 to 1.")


Fault = Annotated[
    EngineOut
    | ThrustLoss
    | SurfaceStuck
    | SurfaceFloating
    | AirspeedBlocked
    | GpsLost
    | GpsJump
    | AutopilotFrozen
    | RadioMute
    | BatteryLow,
    Field(discriminator="kind"),
]
