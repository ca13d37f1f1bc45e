"""The section `controller.companion.flight`: what a companion computer accepts on an aircraft."""

from typing import Annotated, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from testbed.scenario.fields import (
    SMALLEST,
    Length,
    Metres,
    Number,
    Seconds,
    Section,
    Speed,
)

SpeedBounds = tuple[Annotated[Speed, Field(ge=0)], Annotated[Speed, Field(ge=0)]]
LONGEST_STATE_AGE_S = 3.0  # after which ArduPlane leaves attitudes by itself


class FlightFence(Section):
    """An upright cylinder around scenario.origin; outside it the companion does not command."""

    radius_m: Length = Field(ge=1, description="Horizontal distance from scenario.origin, m.")
    floor_m: Metres = Field(description="Lowest height above scenario.origin, m.")
    ceiling_m: Metres = Field(description="Greatest height above scenario.origin, m.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.floor_m >= self.ceiling_m:
            raise PydanticCustomError(
                "fence",
                "floor_m is {floor} and ceiling_m is {ceiling} (write a floor below the ceiling)",
                {"floor": f"{self.floor_m:g}", "ceiling": f"{self.ceiling_m:g}"},
            )
        return self


class CompanionFlight(Section):
    """Bounds beyond which the command companion does not engage, or leaves the formation."""

    state_age_s: Seconds = Field(
        1.0,
        ge=0.05,
        le=LONGEST_STATE_AGE_S,
        description="Age of the oldest message of the own state, s; ArduPlane itself leaves "
        "attitudes 3 s after the last one.",
    )
    status_age_s: Seconds = Field(
        3.0,
        ge=0.5,
        le=30,
        description="Age of HEARTBEAT, EKF_STATUS_REPORT, GPS_RAW_INT, SYSTEM_TIME and "
        "RC_CHANNELS, s; autopilots send most of them once a second.",
    )
    leader_age_s: Seconds = Field(
        1.0,
        ge=0.1,
        le=60,
        description="Age of the leader's last message, s; before engagement of every aircraft's "
        "that the law uses.",
    )
    pause_s: Seconds = Field(
        0.8,
        ge=0.1,
        le=LONGEST_STATE_AGE_S,
        description="Time between two passes of the companion's own loop, s.",
    )
    frozen_s: Seconds = Field(
        0.5,
        ge=0.1,
        le=LONGEST_STATE_AGE_S,
        description="Time for which the own position is the same although the aircraft flies, s.",
    )
    position_jump_m: Length = Field(
        10.0,
        ge=1,
        description="Distance of a position, own or leader's, from where its velocity leads since "
        "the one before, in addition to ½ a t² of an acceleration of 15 m/s², m.",
    )
    leader_speed_mps: SpeedBounds = Field(
        (3.0, 60.0), description="Ground speed of the leader [lowest, highest], m/s."
    )
    clock_offset_s: Seconds = Field(
        0.2,
        ge=0.01,
        le=10,
        description="Difference of an aircraft's time, by its messages, to the own GPS time, s.",
    )
    clock_jump_s: Seconds = Field(
        0.1,
        ge=0.005,
        le=10,
        description="Change of the own GPS time at boot between two SYSTEM_TIME messages, s.",
    )
    height_difference_m: Length = Field(
        5.0,
        ge=0.5,
        description="Difference of two aircraft's heights above mean sea level while both stand on "
        "the ground, m.",
    )
    ekf_variance: Number = Field(
        0.8,
        ge=SMALLEST,
        le=10,
        description="Variance of EKF_STATUS_REPORT, of its own bound, no unit; 0.8 is red in "
        "ground stations.",
    )
    low_airspeed_mps: Speed | None = Field(
        None,
        ge=1,
        description="Airspeed below which, for 1 s, the companion leaves, m/s; by default the "
        "autopilot's AIRSPEED_MIN.",
    )
    stick_us: Number = Field(
        150.0,
        ge=20,
        le=1000,
        description="Movement of the roll, pitch or yaw stick since engagement, µs of its channel.",
    )
    fence: FlightFence | None = Field(
        None,
        description="Where the companion commands; null: everywhere, which it refuses on a link "
        "that may reach an aircraft.",
    )

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        low, high = self.leader_speed_mps
        if low >= high:
            raise PydanticCustomError(
                "speeds",
                "leader_speed_mps is [{low}, {high}] (write a lower speed and a higher one)",
                {"low": f"{low:g}", "high": f"{high:g}"},
            )
        return self
