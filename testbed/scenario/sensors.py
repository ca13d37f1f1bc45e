"""What an autopilot measures and makes of it: sensors that err, and the estimator behind them.

Every sensor that is left out measures the truth. The Gauss-Markov processes are of first order.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    GetJsonSchemaHandler,
    ValidationError,
    model_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError

from testbed.scenario.fields import (
    Degrees,
    Hertz,
    Metres,
    MetresPerSecond,
    Number,
    Seconds,
    Section,
)
from testbed.scenario.messages import did_you_mean
from testbed.scenario.sensor_presets import PRESETS, on_top

_CORRELATION = "Correlation time of the first-order Gauss-Markov process, s."
_SHARED = "Correlation time of the drift that all share, s."
_OWN = "Correlation time of the drift of its own, s."
_RATE = "How often it measures, at most rates.autopilot_hz, Hz."

Latency = Annotated[Seconds, Field(ge=0, le=10)]
Correlation = Annotated[Seconds, Field(gt=0)]
Sigma = Annotated[Number, Field(ge=0)]
Positive = Annotated[Number, Field(gt=0)]
Spread = tuple[Annotated[Metres, Field(ge=0)], Annotated[Metres, Field(ge=0)]]
SpeedSpread = tuple[
    Annotated[MetresPerSecond, Field(ge=0)], Annotated[MetresPerSecond, Field(ge=0)]
]


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


class Gps(Section):
    """A receiver: fixes of position and velocity that come late, with errors it shares and owns."""

    rate_hz: Hertz = Field(5, description=_RATE)
    latency_s: Latency = Field(0.12, description="From the measurement to its fix, s.")
    noise_m: Spread = Field(
        (0.0, 0.0), description="White, 1 sigma of a fix [horizontal per axis, vertical], m."
    )
    velocity_noise_mps: SpeedSpread = Field(
        (0.0, 0.0), description="White, 1 sigma of a fix [horizontal per axis, vertical], m/s."
    )
    shared_drift_m: Spread = Field(
        (0.0, 0.0),
        description="Drift that all receivers share, as that of the ionosphere: 1 sigma "
        "[horizontal per axis, vertical], m.",
    )
    shared_time_constant_s: Correlation = Field(600.0, description=_SHARED)
    own_drift_m: Spread = Field(
        (0.0, 0.0),
        description="Drift of this receiver, as that of reflections: 1 sigma [horizontal per "
        "axis, vertical], m.",
    )
    own_time_constant_s: Correlation = Field(60.0, description=_OWN)


class Barometer(Section):
    """Static pressure as a height, with drifts of the weather and of the sensor."""

    rate_hz: Hertz = Field(10, description=_RATE)
    noise_m: Sigma = Field(0.0, description="White, 1 sigma of a measurement, m.")
    shared_drift_m: Sigma = Field(
        0.0, description="Drift that all share, as that of the weather: 1 sigma, m."
    )
    shared_time_constant_s: Correlation = Field(600.0, description=_SHARED)
    own_drift_m: Sigma = Field(
        0.0, description="Drift of this sensor, as that of its temperature: 1 sigma, m."
    )
    own_time_constant_s: Correlation = Field(60.0, description=_OWN)


class AirspeedSensor(Section):
    """A pitot tube: dynamic pressure with an offset and a scale, behind a filter."""

    rate_hz: Hertz = Field(10, description=_RATE)
    noise_pa: Sigma = Field(0.0, description="White, 1 sigma of a measurement, Pa.")
    offset_pa: Number = Field(0.0, description="Known error of the pressure, Pa.")
    offset_sigma_pa: Sigma = Field(
        0.0, description="Error of the pressure drawn once per aircraft: 1 sigma, Pa."
    )
    scale: Number = Field(
        0.0, gt=-1, description="Known error as a share of the dynamic pressure, above -1."
    )
    scale_sigma: Sigma = Field(
        0.0, description="Error as a share drawn once per aircraft: 1 sigma, no unit."
    )
    smoothing_s: Annotated[Seconds, Field(ge=0)] = Field(
        0.28, description="Time constant of the filter behind it, s; 0 has none."
    )


class Gyro(Section):
    """Rates of turn about body axes, the same errors on each."""

    noise_dps_rthz: Sigma = Field(
        0.0, description="White: root of its two-sided density, degrees/s per root hertz."
    )
    bias_dps: Sigma = Field(0.0, description="Bias that wanders: 1 sigma, degrees/s.")
    bias_time_constant_s: Correlation = Field(1000.0, description="Its correlation time, s.")


class Accelerometer(Section):
    """Specific force along body axes, the same errors on each."""

    noise_mps2_rthz: Sigma = Field(
        0.0, description="White: root of its two-sided density, m/s² per root hertz."
    )
    bias_mps2: Sigma = Field(0.0, description="Bias that wanders: 1 sigma, m/s².")
    bias_time_constant_s: Correlation = Field(300.0, description="Its correlation time, s.")


class Magnetometer(Section):
    """The compass, as the heading it gives."""

    rate_hz: Hertz = Field(10, description=_RATE)
    noise_deg: Annotated[Degrees, Field(ge=0)] = Field(
        0.0, description="White, 1 sigma of a measurement, degrees."
    )
    offset_deg: Degrees = Field(
        0.0, ge=-180, le=180, description="Known error, clockwise positive, degrees."
    )
    offset_sigma_deg: Annotated[Degrees, Field(ge=0)] = Field(
        0.0, description="Error drawn once per aircraft: 1 sigma, degrees."
    )


class Estimator(Section):
    """What the estimator takes its sensors to be: defaults of ArduPilot's EKF3 for planes."""

    gps_position_noise_m: Positive = Field(0.5, description="1 sigma per axis, m: EK3_POSNE_M_NSE.")
    gps_velocity_noise_mps: tuple[Positive, Positive] = Field(
        (0.5, 0.7),
        description="1 sigma [horizontal per axis, vertical], m/s: EK3_VELNE_M_NSE, "
        "EK3_VELD_M_NSE.",
    )
    barometer_noise_m: Positive = Field(3.0, description="1 sigma, m: EK3_ALT_M_NSE.")
    height_source: Literal["barometer", "gps"] = Field(
        "barometer",
        description="Where height comes from: EK3_SRC1_POSZ. A GPS counts with 1.5 times its "
        "horizontal noise.",
    )
    airspeed_noise_mps: Positive = Field(1.4, description="1 sigma, m/s: EK3_EAS_M_NSE.")
    heading_noise_deg: Positive = Field(
        28.6, description="1 sigma, degrees: EK3_YAW_M_NSE, which is in rad."
    )
    gyro_noise_radps: Sigma = Field(0.015, description="1 sigma, rad/s: EK3_GYRO_P_NSE.")
    accelerometer_noise_mps2: Sigma = Field(0.35, description="1 sigma, m/s²: EK3_ACC_P_NSE.")
    gyro_bias_noise_radps2: Sigma = Field(
        0.001, description="How fast the gyro's bias may wander, rad/s²: EK3_GBIAS_P_NSE."
    )
    accelerometer_bias_noise_mps3: Sigma = Field(
        0.02, description="How fast the accelerometer's may, m/s³: EK3_ABIAS_P_NSE."
    )
    wind_noise_mps2: Sigma = Field(
        0.1, description="How fast the wind may change, m/s²: EK3_WIND_P_NSE."
    )
    gps_delay_s: Latency = Field(0.12, description="What it takes the GPS's latency to be, s.")
    gate_sigma: Positive = Field(
        5.0,
        description="What is farther from its prediction than this many standard deviations is "
        "refused, a number: EK3_POS_I_GATE and its like over 100.",
    )
    airspeed_gate_sigma: Positive = Field(
        4.0, description="The same of the airspeed, a number: EK3_EAS_I_GATE over 100."
    )
    reset_after_s: Positive = Field(
        10.0, description="Fixes refused for this long: it starts again from the GPS, s."
    )


class Sensors(Section):
    """What errs in one aircraft's estimate; a preset's name stands for its numbers."""

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
    gps: Gps | None = Field(None, description="The GPS receiver; exact if left out.")
    barometer: Barometer | None = Field(None, description="The barometer; exact if left out.")
    airspeed: AirspeedSensor | None = Field(None, description="The pitot tube; exact if left out.")
    gyro: Gyro | None = Field(None, description="The gyros; exact if left out.")
    accelerometer: Accelerometer | None = Field(
        None, description="The accelerometers; exact if left out."
    )
    magnetometer: Magnetometer | None = Field(None, description="The compass; exact if left out.")
    estimator: Estimator = Field(Estimator(), description="What the estimator takes them to be.")

    @property
    def measured(self) -> bool:
        """True if the page has a sensor, so that an estimator is what the autopilot believes."""
        return not all(getattr(self, name) is None for name in MEASURE)

    @property
    def exact(self) -> bool:
        """True if the estimate is the truth."""
        added = self.position.sigma_m or self.velocity.sigma_mps or self.attitude.sigma_deg
        return not (added or self.measured)

    @model_validator(mode="before")
    @classmethod
    def _expand_preset(cls, value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
        if isinstance(value, str):
            return _preset(value, ", or a map of what errs")
        if not (isinstance(value, Mapping) and "like" in value):
            return value
        try:
            preset = _preset(value["like"])
        except PydanticCustomError as error:
            detail = InitErrorDetails(type=error, loc=("like",), input=value["like"])
            raise ValidationError.from_exception_data("Sensors", [detail]) from None
        return on_top(preset, {key: value[key] for key in value if key != "like"})

    @model_serializer(mode="wrap")
    def _name_the_truth(self, handler: Any) -> Any:  # noqa: ANN401 - pydantic's protocol
        return "truth" if self == TRUTH else handler(self)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Allow a preset's name beside the map, and in it."""
        schema = dict(handler.resolve_ref_schema(handler(core_schema)))
        like = {"enum": list(PRESETS), "description": "The preset from which the map differs."}
        schema["properties"] = {"like": like, **schema["properties"]}
        return {"anyOf": [{"enum": list(PRESETS)}, schema]}


def _preset(name: Any, more: str = "") -> Mapping[str, Any]:  # noqa: ANN401 - from the page
    if isinstance(name, str) and name in PRESETS:
        return PRESETS[name]
    known = ", ".join(PRESETS)
    raise PydanticCustomError(
        "preset",
        "{value} is not a known sensor set{hint} (write one of {known}{more})",
        {
            "value": repr(name),
            "hint": did_you_mean(str(name), PRESETS),
            "known": known,
            "more": more,
        },
    )


MEASURE = ("gps", "barometer", "airspeed", "gyro", "accelerometer", "magnetometer")
TRUTH = Sensors()
