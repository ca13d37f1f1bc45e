"""The `sensors` section of an aircraft: sensor errors, the navigation filter, and presets.

A sensor that is left out measures the truth. Drifts and wandering biases are first-order
Gauss-Markov processes.
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
    SMALLEST,
    Degrees,
    Duration,
    Hertz,
    Length,
    Number,
    Seconds,
    Section,
    Speed,
    ZeroOrUsable,
    merge_maps,
)
from testbed.scenario.problems import did_you_mean

_CORRELATION = "Correlation time of the first-order Gauss-Markov process, s."
_SHARED = "Correlation time of the drift common to all aircraft, s."
_OWN = "Correlation time of the drift of this sensor, s."
_RATE = "Measurement rate, at most rates.autopilot_hz, Hz."

PRESETS: Mapping[str, Mapping[str, Any]] = {
    "truth": {},
    # Errors of an INS with a standard GPS receiver: slow position drift, small fast errors of
    # velocity and attitude.
    "gps-ins": {
        "position": {"sigma_m": 0.3, "time_constant_s": 10.0},
        "velocity": {"sigma_mps": 0.05, "time_constant_s": 0.2},
        "attitude": {"sigma_deg": 0.3, "time_constant_s": 0.2},
    },
    # Hobby autopilot with open sky: single-frequency receiver, whose drift is mostly ionospheric
    # and so common to all aircraft, and MEMS sensors on a damped mount.
    "pixhawk": {
        "gps": {
            "rate_hz": 5,
            "latency_s": 0.12,
            "noise_m": [0.1, 0.2],
            "velocity_noise_mps": [0.07, 0.15],
            "shared_drift_m": [1.3, 2.6],
            "shared_time_constant_s": 600.0,
            "own_drift_m": [0.25, 0.5],
            "own_time_constant_s": 60.0,
        },
        "barometer": {
            "noise_m": 0.2,
            "shared_drift_m": 1.0,
            "shared_time_constant_s": 600.0,
            "own_drift_m": 0.3,
            "own_time_constant_s": 300.0,
        },
        "airspeed": {"noise_pa": 2.0, "offset_sigma_pa": 5.0, "scale_sigma": 0.02},
        "gyro": {"noise_dps_rthz": 0.02, "bias_dps": 0.1, "bias_time_constant_s": 1000.0},
        "accelerometer": {
            "noise_mps2_rthz": 0.03,
            "bias_mps2": 0.07,
            "bias_time_constant_s": 300.0,
        },
        "magnetometer": {"noise_deg": 0.5, "offset_sigma_deg": 2.0},
    },
    # Few satellites between trees, an old receiver with more latency than the estimator assumes,
    # strong vibration.
    "degraded": {
        "gps": {
            "rate_hz": 2,
            "latency_s": 0.22,
            "noise_m": [0.5, 1.0],
            "velocity_noise_mps": [0.3, 0.5],
            "shared_drift_m": [2.1, 4.2],
            "shared_time_constant_s": 600.0,
            "own_drift_m": [1.5, 3.0],
            "own_time_constant_s": 60.0,
        },
        "barometer": {
            "noise_m": 0.5,
            "shared_drift_m": 1.0,
            "shared_time_constant_s": 600.0,
            "own_drift_m": 1.0,
            "own_time_constant_s": 300.0,
        },
        "airspeed": {"noise_pa": 5.0, "offset_sigma_pa": 20.0, "scale_sigma": 0.05},
        "gyro": {"noise_dps_rthz": 0.1, "bias_dps": 0.3, "bias_time_constant_s": 1000.0},
        "accelerometer": {
            "noise_mps2_rthz": 0.1,
            "bias_mps2": 0.2,
            "bias_time_constant_s": 300.0,
        },
        "magnetometer": {"noise_deg": 1.0, "offset_sigma_deg": 5.0},
    },
}

MAX_SIGMA = 1e4  # of any sensor, in its unit
MAX_CORRELATION_S = 1e6  # an error is constant over the longest run, a day, far below it
Latency = Annotated[Seconds, Field(ge=0, le=10)]
Correlation = Annotated[Seconds, Field(ge=SMALLEST, le=MAX_CORRELATION_S)]
Sigma = Annotated[Number, Field(ge=0, le=MAX_SIGMA)]
Positive = Annotated[Number, Field(ge=SMALLEST, le=MAX_SIGMA)]
SigmaPair = tuple[Annotated[Length, Field(ge=0)], Annotated[Length, Field(ge=0)]]
SpeedSigmaPair = tuple[Annotated[Speed, Field(ge=0)], Annotated[Speed, Field(ge=0)]]


class PositionNoise(Section):
    """Noise of the estimated position, the same on each NED axis."""

    sigma_m: Length = Field(ge=0, description="Standard deviation, m; 0 is exact.")
    time_constant_s: Duration = Field(ge=SMALLEST, description=_CORRELATION)


class VelocityNoise(Section):
    """Noise of the estimated velocity, the same on each NED axis."""

    sigma_mps: Speed = Field(ge=0, description="Standard deviation, m/s; 0 is exact.")
    time_constant_s: Duration = Field(ge=SMALLEST, description=_CORRELATION)


class AttitudeNoise(Section):
    """Noise of the estimated roll, pitch and yaw, the same on each."""

    sigma_deg: Degrees = Field(ge=0, le=180, description="Standard deviation, degrees; 0 is exact.")
    time_constant_s: Duration = Field(ge=SMALLEST, description=_CORRELATION)


class Gps(Section):
    """GPS receiver: delayed fixes of position and velocity, with common and own errors."""

    rate_hz: Hertz = Field(5, description=_RATE)
    latency_s: Latency = Field(0.12, description="Time from the measurement to its fix, s.")
    noise_m: SigmaPair = Field(
        (0.0, 0.0), description="White noise of a fix, 1 sigma [horizontal per axis, vertical], m."
    )
    velocity_noise_mps: SpeedSigmaPair = Field(
        (0.0, 0.0),
        description="White noise of a fix, 1 sigma [horizontal per axis, vertical], m/s.",
    )
    shared_drift_m: SigmaPair = Field(
        (0.0, 0.0),
        description="Drift common to all receivers, as by the ionosphere: 1 sigma [horizontal per "
        "axis, vertical], m.",
    )
    shared_time_constant_s: Correlation = Field(600.0, description=_SHARED)
    own_drift_m: SigmaPair = Field(
        (0.0, 0.0),
        description="Drift of this receiver, as by multipath: 1 sigma [horizontal per axis, "
        "vertical], m.",
    )
    own_time_constant_s: Correlation = Field(60.0, description=_OWN)


class Barometer(Section):
    """Barometric height, with drifts of the weather and of the sensor."""

    rate_hz: Hertz = Field(10, description=_RATE)
    noise_m: Sigma = Field(0.0, description="White noise of a measurement, 1 sigma, m.")
    shared_drift_m: Sigma = Field(
        0.0, description="Drift common to all aircraft, as by the weather: 1 sigma, m."
    )
    shared_time_constant_s: Correlation = Field(600.0, description=_SHARED)
    own_drift_m: Sigma = Field(
        0.0, description="Drift of this sensor, as by its temperature: 1 sigma, m."
    )
    own_time_constant_s: Correlation = Field(60.0, description=_OWN)


class AirspeedSensor(Section):
    """Airspeed sensor: dynamic pressure with offset and scale errors, behind a filter."""

    rate_hz: Hertz = Field(10, description=_RATE)
    noise_pa: Sigma = Field(0.0, description="White noise of a measurement, 1 sigma, Pa.")
    offset_pa: Number = Field(
        0.0, ge=-MAX_SIGMA, le=MAX_SIGMA, description="Constant error of the pressure, Pa."
    )
    offset_sigma_pa: Sigma = Field(
        0.0, description="Random constant error of the pressure, drawn per aircraft: 1 sigma, Pa."
    )
    scale: Number = Field(
        0.0,
        gt=-1,
        le=10,
        description="Constant error as a share of the dynamic pressure, above -1.",
    )
    scale_sigma: Sigma = Field(
        0.0, description="Random constant error as a share, drawn per aircraft: 1 sigma, no unit."
    )
    smoothing_s: Annotated[Duration, Field(ge=0), ZeroOrUsable] = Field(
        0.28, description="Time constant of the filter behind it, s; 0: no filter."
    )


class Gyro(Section):
    """Gyroscopes: angular rates about the body axes, same error model on each."""

    noise_dps_rthz: Sigma = Field(
        0.0, description="White noise: root of the two-sided density, degrees/s per root hertz."
    )
    bias_dps: Sigma = Field(0.0, description="Wandering bias: 1 sigma, degrees/s.")
    bias_time_constant_s: Correlation = Field(
        1000.0, description="Correlation time of the bias, s."
    )


class Accelerometer(Section):
    """Accelerometers: specific force along the body axes, same error model on each."""

    noise_mps2_rthz: Sigma = Field(
        0.0, description="White noise: root of the two-sided density, m/s² per root hertz."
    )
    bias_mps2: Sigma = Field(0.0, description="Wandering bias: 1 sigma, m/s².")
    bias_time_constant_s: Correlation = Field(300.0, description="Correlation time of the bias, s.")


class Magnetometer(Section):
    """Magnetometer, as a measured heading."""

    rate_hz: Hertz = Field(10, description=_RATE)
    noise_deg: Annotated[Degrees, Field(ge=0, le=180)] = Field(
        0.0, description="White noise of a measurement, 1 sigma, degrees."
    )
    offset_deg: Degrees = Field(
        0.0, ge=-180, le=180, description="Constant error, clockwise positive, degrees."
    )
    offset_sigma_deg: Annotated[Degrees, Field(ge=0, le=180)] = Field(
        0.0, description="Random constant error, drawn per aircraft: 1 sigma, degrees."
    )


class Estimator(Section):
    """Sensor errors assumed by the navigation filter; defaults of ArduPilot's EKF3 for planes."""

    gps_position_noise_m: Positive = Field(0.5, description="1 sigma per axis, m: EK3_POSNE_M_NSE.")
    gps_velocity_noise_mps: tuple[Positive, Positive] = Field(
        (0.5, 0.7),
        description="1 sigma [horizontal per axis, vertical], m/s: EK3_VELNE_M_NSE, "
        "EK3_VELD_M_NSE.",
    )
    barometer_noise_m: Positive = Field(3.0, description="1 sigma, m: EK3_ALT_M_NSE.")
    height_source: Literal["barometer", "gps"] = Field(
        "barometer",
        description="Source of the height: EK3_SRC1_POSZ. GPS height has 1.5 times the horizontal "
        "noise.",
    )
    airspeed_noise_mps: Positive = Field(1.4, description="1 sigma, m/s: EK3_EAS_M_NSE.")
    heading_noise_deg: Positive = Field(
        28.6, description="1 sigma, degrees: EK3_YAW_M_NSE, which is in rad."
    )
    gyro_noise_radps: Sigma = Field(0.015, description="1 sigma, rad/s: EK3_GYRO_P_NSE.")
    accelerometer_noise_mps2: Sigma = Field(0.35, description="1 sigma, m/s²: EK3_ACC_P_NSE.")
    gyro_bias_noise_radps2: Sigma = Field(
        0.001, description="Process noise of the gyro bias, rad/s²: EK3_GBIAS_P_NSE."
    )
    accelerometer_bias_noise_mps3: Sigma = Field(
        0.02, description="Process noise of the accelerometer bias, m/s³: EK3_ABIAS_P_NSE."
    )
    wind_noise_mps2: Sigma = Field(
        0.1, description="Process noise of the wind, m/s²: EK3_WIND_P_NSE."
    )
    gps_delay_s: Latency = Field(0.12, description="Assumed latency of the GPS, s.")
    gate_sigma: Positive = Field(
        5.0,
        description="Measurements farther from their prediction than this many standard deviations "
        "are rejected, a number: EK3_POS_I_GATE and the like / 100.",
    )
    airspeed_gate_sigma: Positive = Field(
        4.0, description="The same for airspeed, a number: EK3_EAS_I_GATE / 100."
    )
    reset_after_s: Positive = Field(
        10.0, description="Time of rejected fixes after which the filter resets to the GPS, s."
    )


class Sensors(Section):
    """Errors of the state estimate of one aircraft; the name of a preset stands for its map."""

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
    airspeed: AirspeedSensor | None = Field(
        None, description="The airspeed sensor; exact if left out."
    )
    gyro: Gyro | None = Field(None, description="The gyroscopes; exact if left out.")
    accelerometer: Accelerometer | None = Field(
        None, description="The accelerometers; exact if left out."
    )
    magnetometer: Magnetometer | None = Field(
        None, description="The magnetometer; exact if left out."
    )
    estimator: Estimator = Field(
        Estimator(), description="Errors that the navigation filter assumes."
    )

    @property
    def measured(self) -> bool:
        """Return whether a sensor is simulated, so that a navigation filter estimates."""
        return not all(getattr(self, name) is None for name in SENSOR_NAMES)

    @property
    def exact(self) -> bool:
        """Return whether the estimate is the truth."""
        added = self.position.sigma_m or self.velocity.sigma_mps or self.attitude.sigma_deg
        return not (added or self.measured)

    @model_validator(mode="before")
    @classmethod
    def _expand_preset(cls, value: Any) -> Any:  # noqa: ANN401 - any YAML value
        if isinstance(value, str):
            return _preset(value, ", or a map of errors")
        if not (isinstance(value, Mapping) and "preset" in value):
            return value
        try:
            preset = _preset(value["preset"])
        except PydanticCustomError as error:
            detail = InitErrorDetails(type=error, loc=("preset",), input=value["preset"])
            raise ValidationError.from_exception_data("Sensors", [detail]) from None
        return merge_maps(preset, {key: value[key] for key in value if key != "preset"})

    @model_serializer(mode="wrap")
    def _truth_by_name(self, handler: Any) -> Any:  # noqa: ANN401 - pydantic's protocol
        return "truth" if self == TRUTH else handler(self)

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Allow the name of a preset beside the map, and as its key preset."""
        schema = dict(handler.resolve_ref_schema(handler(core_schema)))
        preset = {"enum": list(PRESETS), "description": "Preset that the map changes."}
        schema["properties"] = {"preset": preset, **schema["properties"]}
        return {"anyOf": [{"enum": list(PRESETS)}, schema]}


def _preset(name: Any, more: str = "") -> Mapping[str, Any]:  # noqa: ANN401 - any YAML value
    if isinstance(name, str) and name in PRESETS:
        return PRESETS[name]
    known = ", ".join(PRESETS)
    raise PydanticCustomError(
        "preset",
        "{value} is not a preset of sensors{hint} (write one of {known}{more})",
        {
            "value": repr(name),
            "hint": did_you_mean(str(name), PRESETS),
            "known": known,
            "more": more,
        },
    )


SENSOR_NAMES = ("gps", "barometer", "airspeed", "gyro", "accelerometer", "magnetometer")
TRUTH = Sensors()
