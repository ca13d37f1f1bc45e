"""The air of the page: mean wind, turbulence, gusts and wakes."""

from typing import Annotated, Literal

from pydantic import Field

from testbed.scenario.fields import (
    Degrees,
    Metres,
    MetresPerSecond,
    Name,
    Number,
    Seconds,
    Section,
)

_REFERENCE = "Height above the origin's ground where the wind has its speed, m."
_SHAPE = "A ramp rises to velocity_mps as half a cosine and stays; a pulse falls back the same way."
Spread = Annotated[MetresPerSecond, Field(ge=0, le=30)]
Length = Annotated[Metres, Field(ge=1, le=100_000)]
Blast = Annotated[MetresPerSecond, Field(ge=-60, le=60)]
Velocity = tuple[Blast, Blast, Blast]


class UniformProfile(Section):
    """The same wind at all heights."""

    kind: Literal["uniform"] = Field(description="The same at all heights.")


class LogProfile(Section):
    """The logarithmic law; MIL-F-8785C 3.7.3.2 has it with 6.1 m (20 ft) and its roughness."""

    kind: Literal["log"] = Field(description="Logarithm of the height over the roughness.")
    height_m: Metres = Field(10.0, gt=0, description=_REFERENCE)
    roughness_m: Metres = Field(
        0.03,
        gt=0,
        description="Roughness length of the ground, m: 0.03 is short grass; MIL-F-8785C has "
        "0.046 (0.15 ft) for landing approaches and 0.61 (2 ft) else.",
    )


class PowerProfile(Section):
    """The power law of engineering practice."""

    kind: Literal["power"] = Field(description="A power of the height.")
    height_m: Metres = Field(10.0, gt=0, description=_REFERENCE)
    exponent: Number = Field(
        0.143, gt=0, le=1, description="Exponent, no unit: 1/7 is open country."
    )


Profile = Annotated[UniformProfile | LogProfile | PowerProfile, Field(discriminator="kind")]


class Wind(Section):
    """The mean wind: steady or recorded, the same at all places of one height."""

    speed_mps: MetresPerSecond = Field(
        0.0, ge=0, le=60, description="Speed at the height that the profile names, m/s."
    )
    from_deg: Degrees = Field(
        0.0, ge=-360, le=360, description="Where it blows from, degrees clockwise from north."
    )
    profile: Profile = Field(
        UniformProfile(kind="uniform"), description="How the speed grows with height."
    )
    file: str | None = Field(
        None,
        min_length=1,
        description="CSV of a recorded wind in place of speed_mps and from_deg: relative to this "
        "page, or a name in scenarios/data. Its first row is time 0.",
    )
    longest_gap_s: Seconds = Field(
        10.0, gt=0, description="Rows of the file may be no farther apart than this, s."
    )


class Turbulence(Section):
    """Continuous turbulence of MIL-F-8785C, at the height above the origin's ground."""

    model: Literal["none", "dryden", "von-karman", "coherent"] = Field(
        "none",
        description="dryden and von-karman: each aircraft feels its own; coherent: one frozen von "
        "Karman field that the mean wind carries past all of them.",
    )
    intensity: Literal["light", "moderate", "severe"] = Field(
        "moderate",
        description="A wind of 15, 30 or 45 knots at 20 ft for low heights, and a probability of "
        "exceedance of 1e-2, 1e-3 or 1e-5 above 2000 ft.",
    )
    w20_mps: MetresPerSecond | None = Field(
        None, ge=0, le=60, description="Wind at 20 ft in place of the intensity's, m/s."
    )
    probability: Number | None = Field(
        None,
        ge=1e-6,
        le=0.2,
        description="Probability of exceedance in place of the intensity's, 1e-6 to 0.2.",
    )
    sigma_mps: tuple[Spread, Spread, Spread] | None = Field(
        None,
        description="Standard deviations [longitudinal, lateral, vertical] at all heights in "
        "place of the standard's, m/s.",
    )
    length_m: tuple[Length, Length, Length] | None = Field(
        None,
        description="Scale lengths [longitudinal, lateral, vertical] at all heights in place of "
        "the standard's, m, as MIL-F-8785C counts them: MIL-HDBK-1797 halves the last two.",
    )
    height_m: Metres | None = Field(
        None,
        gt=0,
        description="For coherent: the height whose intensities and lengths the field has, m; by "
        "default that of the leader's start.",
    )


class TimedGust(Section):
    """A gust that everyone feels at once, 1 - cos in time."""

    kind: Literal["time"] = Field(description="Everywhere at once.")
    name: Name = Field(description="Name in the events of the run.")
    velocity_mps: Velocity = Field(description="What it adds at most [north, east, down], m/s.")
    at_s: Seconds = Field(ge=0, description="When it begins, s.")
    ramp_s: Seconds = Field(gt=0, description="How long it takes to rise, s.")
    shape: Literal["pulse", "ramp"] = Field("pulse", description=_SHAPE)


class PlacedGust(Section):
    """A gust behind a plane front, 1 - cos in depth; MIL-F-8785C 3.7.1.3."""

    kind: Literal["place"] = Field(description="Behind a front that moves or stands.")
    name: Name = Field(description="Name in the events of the run.")
    velocity_mps: Velocity = Field(description="What it adds at most [north, east, down], m/s.")
    at_m: tuple[Metres, Metres] = Field(
        description="A point of the front at at_s [north, east], m from the origin."
    )
    at_s: Seconds = Field(0.0, ge=0, description="When the front is at at_m, s.")
    towards_deg: Degrees = Field(
        ge=-360,
        le=360,
        description="Where the front faces and speed_mps takes it, degrees clockwise from north.",
    )
    length_m: Metres = Field(gt=0, description="Depth over which the gust rises, m.")
    speed_mps: MetresPerSecond | None = Field(
        None,
        ge=0,
        le=100,
        description="Speed of the front over the ground, m/s; by default the mean wind's: "
        "backwards if that blows against it, not at all in a calm.",
    )
    shape: Literal["pulse", "ramp"] = Field("pulse", description=_SHAPE)


Gust = Annotated[TimedGust | PlacedGust, Field(discriminator="kind")]


class Wake(Section):
    """The vortices that every flying aircraft trails and the others feel."""

    core_spans: Number = Field(
        0.05, gt=0, le=1, description="Radius of a vortex core, spans of the wing that shed it."
    )
    decay_s: Seconds | None = Field(
        None, gt=0, description="Time in which a vortex falls to 1/e, s; by default it does not."
    )
    memory_s: Seconds = Field(
        10.0, gt=0, le=600, description="How much of each trail is kept, s of flight."
    )


class Air(Section):
    """The air the aircraft fly in."""

    wind: Wind = Field(Wind(), description="The mean wind.")
    turbulence: Turbulence = Field(Turbulence(), description="Continuous turbulence.")
    gusts: tuple[Gust, ...] = Field((), description="Discrete gusts; several add up.")
    wake: Wake | None = Field(None, description="The wakes of the aircraft; none by default.")
