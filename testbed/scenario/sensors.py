"""What an autopilot believes of its own motion: the truth plus noise, per axis and aircraft."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field, GetJsonSchemaHandler, model_serializer, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, PydanticCustomError

from testbed.scenario.fields import Degrees, Metres, MetresPerSecond, Seconds, Section
from testbed.scenario.messages import did_you_mean

_CORRELATION = "Correlation time of the first-order Gauss-Markov process, s."


class PositionNoise(Section):
    """Noise of the estimated position, the same on each NED axis."""

    sigma_m: Metres = Field(ge=0, description="Standard deviation, m; 0 is exact.")
    time_constant_s: Seconds = Field(gt=0, description=_CORRELATION)


class VelocityNoise(Section):
    """Noise of the estimated velocity, the same on each NED axis."""

    sigma_mps: MetresPerSecond = Field(ge=0, description="Standard deviation, m/s; 0 is exact.")
    time_constant_s: Seconds = Field(gt=0, description=_CORRELATION)


class AttitudeNoise(Section):
    """Noise of the estimated roll, pitch and yaw, the same on each."""

    sigma_deg: Degrees = Field(ge=0, description="Standard deviation, degrees; 0 is exact.")
    time_constant_s: Seconds = Field(gt=0, description=_CORRELATION)


# The error an INS with a standard GPS receiver leaves: metres that wander slowly, velocity and
# attitude that are good but jittery.
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "truth": {},
    "gps-ins": {
        "position": {"sigma_m": 0.3, "time_constant_s": 10.0},
        "velocity": {"sigma_mps": 0.05, "time_constant_s": 0.2},
        "attitude": {"sigma_deg": 0.3, "time_constant_s": 0.2},
    },
}


class Sensors(Section):
    """The errors of one aircraft's estimate; a preset's name stands for its numbers."""

    position: PositionNoise = Field(
        default=PositionNoise(sigma_m=0.0, time_constant_s=1.0),
        description="Error of the position, m; exact if left out.",
    )
    velocity: VelocityNoise = Field(
        default=VelocityNoise(sigma_mps=0.0, time_constant_s=1.0),
        description="Error of the velocity, m/s; exact if left out.",
    )
    attitude: AttitudeNoise = Field(
        default=AttitudeNoise(sigma_deg=0.0, time_constant_s=1.0),
        description="Error of roll, pitch and yaw, degrees; exact if left out.",
    )

    @property
    def exact(self) -> bool:
        """True if the estimate is the truth."""
        return not (self.position.sigma_m or self.velocity.sigma_mps or self.attitude.sigma_deg)

    @model_validator(mode="before")
    @classmethod
    def _expand_preset(cls, value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
        if not isinstance(value, str):
            return value
        if value not in PRESETS:
            known = ", ".join(PRESETS)
            raise PydanticCustomError(
                "preset",
                "{value} is not a known sensor set{hint} (write one of {known}, or a map with "
                "position, velocity, attitude)",
                {"value": repr(value), "hint": did_you_mean(value, PRESETS), "known": known},
            )
        return PRESETS[value]

    @model_serializer(mode="wrap")
    def _name_the_truth(self, handler: Any) -> Any:  # noqa: ANN401 - pydantic's protocol
        return "truth" if self == TRUTH else handler(self)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Allow a preset's name beside the map."""
        schema = handler.resolve_ref_schema(handler(core_schema))
        return {"anyOf": [{"enum": list(PRESETS)}, dict(schema)]}


TRUTH = Sensors()
