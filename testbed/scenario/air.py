"""The `air` section: temperature, mean wind, turbulence, gusts and wakes."""

from typing import Annotated, Literal

from pydantic import Field

from testbed.core.ranges import GUST_SPEED, WIND_FROM, WIND_SPEED
from testbed.scenario.fields import (
    SMALLEST,
    Celsius,
    Degrees,
    Duration,
    Length,
    Metres,
    MetresPerSecond,
    Name,
    Number,
    Seconds,
    Section,
    within,
)
from testbed.scenario.reference_fields import DataReference

_REFERENCE = "Height above the ground at the origin where the wind has speed_mps, m."
_SHAPE = "ramp: rise to velocity_mps as half a cosine and stay; pulse: rise and fall back."
Sigma = Annotated[MetresPerSecond, Field(ge=0, le=30)]
ScaleLength = Annotated[Number, Field(ge=1, le=100_000, json_schema_extra={"unit": "m"})]
GustSpeed = Annotated[MetresPerSecond, within(GUST_SPEED)]
GustVelocity = tuple[GustSpeed, GustSpeed, GustSpeed]


class UniformProfile(Section):
    """Wind that is the same at all heights."""

    kind: Literal["uniform"] = Field(description="The same wind at all heights.")


class LogProfile(Section):
    """Logarithmic profile; MIL-F-8785C 3.7.3.2 uses it with 6.1 m (20 ft) and its roughness."""

    kind: Literal["log"] = Field(description="Wind proportional to ln(height / roughness).")
    height_m: Length = Field(10.0, ge=SMALLEST, description=_REFERENCE)
    roughness_m: Length = Field(
        0.03,
        ge=SMALLEST,
        description="Roughness length of the ground, m: 0.03 is short grass; MIL-F-8785C has "
        "0.046 (0.15 ft) for landing approaches and 0.61 (2 ft) otherwise.",
    )


class PowerProfile(Section):
    """Power-law profile of engineering practice."""

    kind: Literal["power"] = Field(description="Wind proportional to a power of the height.")
    height_m: Length = Field(10.0, ge=SMALLEST, description=_REFERENCE)
    exponent: Number = Field(
        0.143, ge=SMALLEST, le=1, description="Exponent, no unit; 1/7 is typical of open country."
    )


Profile = Annotated[UniformProfile | LogProfile | PowerProfile, Field(discriminator="kind")]


class Wind(Section):
    """Mean wind, constant or recorded; the same at all points of one height."""

    speed_mps: Annotated[MetresPerSecond, within(WIND_SPEED)] = Field(
        0.0, description="Speed at the reference height of the profile, m/s."
    )
    from_deg: Annotated[Degrees, within(WIND_FROM)] = Field(
        0.0,
        description="Direction the wind blows from, degrees clockwise from north.",
    )
    profile: Profile = Field(
        UniformProfile(kind="uniform"), description="Change of the speed with height."
    )
    file: DataReference | None = Field(
        None,
        description="CSV file of a recorded wind in place of speed_mps and from_deg: a path from "
        "this file, or a name in scenarios/data. Its first row is time 0.",
    )
    max_gap_s: Duration = Field(
        10.0, ge=SMALLEST, description="Longest time between two rows of the file, s."
    )


class Turbulence(Section):
    """Continuous turbulence of MIL-F-8785C at the height above the ground at the origin."""

    model: Literal["none", "dryden", "von-karman", "coherent"] = Field(
        "none",
        description="dryden, von-karman: independent for each aircraft; coherent: one frozen von "
        "Karman field, carried past all aircraft by the mean wind.",
    )
    intensity: Literal["light", "moderate", "severe"] = Field(
        "moderate",
        description="At low heights a wind of 15, 30 or 45 knots at 20 ft; above 2000 ft an "
        "exceedance probability of 1e-2, 1e-3 or 1e-5.",
    )
    w20_mps: MetresPerSecond | None = Field(
        None, ge=0, le=60, description="Wind at 20 ft in place of that of intensity, m/s."
    )
    probability: Number | None = Field(
        None,
        ge=1e-6,
        le=0.2,
        description="Exceedance probability in place of that of intensity, 1e-6 to 0.2.",
    )
    sigma_mps: tuple[Sigma, Sigma, Sigma] | None = Field(
        None,
        description="Standard deviations [longitudinal, lateral, vertical] at all heights in "
        "place of those of MIL-F-8785C, m/s.",
    )
    length_m: tuple[ScaleLength, ScaleLength, ScaleLength] | None = Field(
        None,
        description="Scale lengths [longitudinal, lateral, vertical] at all heights in place of "
        "those of MIL-F-8785C and by its definition, m; MIL-HDBK-1797 halves the last two.",
    )
    height_m: Length | None = Field(
        None,
        ge=SMALLEST,
        description="For coherent: height at which intensities and scale lengths are taken, m; by "
        "default that of the leader's start.",
    )


class TimedGust(Section):
    """Gust that reaches all aircraft at the same time, 1 - cos in time."""

    kind: Literal["time"] = Field(description="At all points at the same time.")
    name: Name = Field(description="Name in the events of the log.")
    velocity_mps: GustVelocity = Field(description="Largest added wind [north, east, down], m/s.")
    at_s: Duration = Field(ge=0, description="Time of its beginning, s.")
    ramp_s: Duration = Field(ge=SMALLEST, description="Time from zero to velocity_mps, s.")
    shape: Literal["pulse", "ramp"] = Field("pulse", description=_SHAPE)


class GustFront(Section):
    """Gust behind a plane front, 1 - cos in distance; MIL-F-8785C 3.7.1.3."""

    kind: Literal["front"] = Field(description="Behind a moving or standing front.")
    name: Name = Field(description="Name in the events of the log.")
    velocity_mps: GustVelocity = Field(description="Largest added wind [north, east, down], m/s.")
    at_m: tuple[Metres, Metres] = Field(
        description="A point of the front at at_s [north, east], m from the origin."
    )
    at_s: Duration = Field(0.0, ge=0, description="Time at which the front is at at_m, s.")
    towards_deg: Degrees = Field(
        ge=-360,
        le=360,
        description="Direction of the front's motion, degrees clockwise from north.",
    )
    length_m: Length = Field(
        ge=SMALLEST, description="Distance behind the front over which the gust rises, m."
    )
    speed_mps: MetresPerSecond | None = Field(
        None,
        ge=0,
        le=100,
        description="Ground speed of the front, m/s; by default the component of the mean wind "
        "along towards_deg, negative in a headwind.",
    )
    shape: Literal["pulse", "ramp"] = Field("pulse", description=_SHAPE)


Gust = Annotated[TimedGust | GustFront, Field(discriminator="kind")]


class Wake(Section):
    """Trailing vortices of every flying aircraft, which act on the others."""

    core_spans: Number = Field(
        0.05,
        ge=SMALLEST,
        le=1,
        description="Radius of a vortex core in wing spans of the aircraft that shed it.",
    )
    decay_s: Duration | None = Field(
        None,
        ge=SMALLEST,
        description="Time in which a vortex decays to 1/e, s; no decay by default.",
    )
    memory_s: Seconds = Field(
        10.0,
        ge=SMALLEST,
        le=600,
        description="Length of the trail behind each aircraft, s of flight.",
    )


class Air(Section):
    """Temperature, wind, turbulence, gusts and wakes."""

    temperature_c: Celsius | None = Field(
        None,
        ge=-40,
        le=50,
        description="Temperature at the ground at the origin, °C; by default that of the standard "
        "atmosphere there. The air is warmer or colder by the same amount at all heights.",
    )
    wind: Wind = Field(Wind(), description="Mean wind.")
    turbulence: Turbulence = Field(Turbulence(), description="Continuous turbulence.")
    gusts: tuple[Gust, ...] = Field((), description="Discrete gusts; they add up.")
    wake: Wake | None = Field(None, description="Wakes of the aircraft; none by default.")
