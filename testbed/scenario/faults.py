"""Faults of an aircraft and the conditions under which they begin."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from testbed.scenario.fields import (
    SMALLEST,
    Duration,
    Metres,
    Number,
    Offset,
    Section,
)

Surface = Literal["aileron", "elevator", "rudder", "left-elevon", "right-elevon"]
_SURFACE = "Control surface; the airframe must have it."


class Condition(Section):
    """Condition on the true state of the aircraft under which a fault begins."""

    quantity: Literal["altitude_m", "airspeed_mps", "bank_deg", "state_of_charge"] = Field(
        description="Quantity: altitude above the origin, m; true airspeed, m/s; bank angle to "
        "either side, degrees; state of charge, 0 to 1.",
    )
    above: Metres | None = Field(
        None, description="Begin above this value, in the unit of the quantity."
    )
    below: Metres | None = Field(
        None, description="Begin below this value, in the unit of the quantity."
    )


class Fault(Section):
    """Keys of every fault: beginning, end, and whether the aircraft reports it."""

    DECLARED: ClassVar[bool]  # default of `declared`
    NEEDS_FLIGHT_MODEL: ClassVar[bool] = False

    kind: str = Field(description="Kind of fault.")
    at_s: Annotated[Duration, Field(ge=0)] | None = Field(
        None,
        description="Time of its beginning; with a condition, the time from which it applies, s.",
    )
    when: Condition | None = Field(
        None, description="Condition under which it begins; it begins only once."
    )
    duration_s: Annotated[Duration, Field(ge=SMALLEST)] | None = Field(
        None, description="How long it lasts, s; by default to the end of the run."
    )
    declared: Annotated[bool, Field(strict=True)] | None = Field(
        None,
        description="Whether the aircraft reports the fault, formation.on_failure.declared_after_s "
        "later: true or false; the default depends on the kind of fault.",
    )

    @property
    def is_declared(self) -> bool:
        """Return whether the aircraft reports the fault to the others."""
        return self.DECLARED if self.declared is None else self.declared


class EngineOut(Fault):
    """No thrust."""

    DECLARED = NEEDS_FLIGHT_MODEL = True
    kind: Literal["engine-out"] = Field(description="No thrust.")


class ThrustLoss(Fault):
    """Less thrust: the motor gets a share of the throttle."""

    DECLARED = NEEDS_FLIGHT_MODEL = True
    kind: Literal["thrust-loss"] = Field(description="Less thrust.")
    remaining: Number = Field(
        ge=0, le=1, description="Remaining share of the throttle command, 0 to 1."
    )


class SurfaceStuck(Fault):
    """A control surface does not move."""

    DECLARED = NEEDS_FLIGHT_MODEL = True
    kind: Literal["surface-stuck"] = Field(description="A control surface does not move.")
    surface: Surface = Field(description=_SURFACE)
    position: Annotated[Number, Field(ge=-1, le=1)] | None = Field(
        None,
        description="Position, -1 to 1 of its travel; positive rolls right, pitches up, yaws "
        "right, of an elevon up; by default its position at that time.",
    )


class SurfaceFloating(Fault):
    """A control surface floats: it turns with the flow."""

    DECLARED = NEEDS_FLIGHT_MODEL = True
    kind: Literal["surface-floating"] = Field(description="A control surface floats.")
    surface: Surface = Field(description=_SURFACE)
    ratio: Number = Field(
        0.5, ge=-1, le=1, description="Deflection per angle of the flow, rad/rad."
    )


class AirspeedBlocked(Fault):
    """The inlet of the pitot tube is blocked."""

    DECLARED = False
    kind: Literal["airspeed-blocked"] = Field(description="The pitot tube is blocked.")
    drain: Literal["blocked", "open"] = Field(
        "blocked",
        description="Drain hole. blocked: the pressure is trapped, measured airspeed grows with "
        "height; open: measured airspeed falls to 0.",
    )


class GpsLost(Fault):
    """The GPS receiver gives no fixes."""

    DECLARED = True
    kind: Literal["gps-lost"] = Field(description="The GPS receiver gives no fixes.")


class GpsJump(Fault):
    """Every GPS fix has the same added error."""

    DECLARED = False
    kind: Literal["gps-jump"] = Field(description="Every GPS fix has the same added error.")
    offset_m: Offset = Field(description="Added error [north, east, down], m.")


class AutopilotFrozen(Fault):
    """The autopilot freezes: servos hold the last command."""

    DECLARED = False
    NEEDS_FLIGHT_MODEL = True
    kind: Literal["autopilot-frozen"] = Field(description="The autopilot freezes.")


class TransmitterOff(Fault):
    """The transmitter sends nothing."""

    DECLARED = False
    kind: Literal["transmitter-off"] = Field(description="The transmitter sends nothing.")


class BatteryLow(Fault):
    """The battery drops to a lower charge and discharges from there."""

    DECLARED = NEEDS_FLIGHT_MODEL = True
    kind: Literal["battery-low"] = Field(description="The battery drops to a lower charge.")
    state_of_charge: Number = Field(
        ge=SMALLEST, le=1, description="State of charge to which it drops, 0 to 1."
    )


AnyFault = Annotated[
    EngineOut
    | ThrustLoss
    | SurfaceStuck
    | SurfaceFloating
    | AirspeedBlocked
    | GpsLost
    | GpsJump
    | AutopilotFrozen
    | TransmitterOff
    | BatteryLow,
    Field(discriminator="kind"),
]
