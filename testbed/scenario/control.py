"""The formation and its control law on the page: what it wants, and with which gains."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Field

from testbed.scenario.fields import (
    Gain,
    MetresPerSecond,
    Name,
    Number,
    Offset,
    PerSecond,
    Section,
)


class PowerControlFunction(Section):
    """μ(z) = (ν₁ + ν₂ z)^(−m). [HBH23] Example 1."""

    example: Literal[1] = Field(description="Number of the example in [HBH23].")
    nu1: Number = Field(50.0, gt=0, description="ν₁, m².")
    nu2: Number = Field(1.0, gt=0, description="ν₂, no unit.")
    m: Number = Field(0.5, ge=0.5, le=1.0, description="Exponent, no unit.")


class SplineControlFunction(Section):
    """μ(z) constant near zero, then a cubic, then z^(−1/2). [HBH23] Examples 2 and 3."""

    example: Literal[2, 3] = Field(description="Number of the example in [HBH23].")


class Barrier(Section):
    """The function h that keeps the speed inside its bounds. [HBH23] Examples 4 to 6."""

    example: Literal[4, 5, 6] = Field(description="Number of the example in [HBH23].")
    nu: Number = Field(
        0.05, gt=0, description="ν: s²/m² in examples 4 and 5, a margin in m/s in example 6."
    )


class NoBarrier(Section):
    """h = 1: the speed command is saturated instead. [HBH23] Section 10."""

    example: Literal[7] = Field(description="7 stands for no barrier, as in the experiments.")


ControlFunction = Annotated[
    PowerControlFunction | SplineControlFunction, Field(discriminator="example")
]
BarrierFunction = Annotated[Barrier | NoBarrier, Field(discriminator="example")]


class Formation(Section):
    """Offsets, graph, gains and bounds of the formation law; defaults are [HBH23] Section 9."""

    offsets_m: Mapping[Name, Offset] = Field(
        description="υ_i by follower: [forward, right, down] in the leader's velocity frame, m."
    )
    leader_gains: Mapping[Name, Gain] = Field(
        {}, description="β_i by follower: a number or [north, east, down], no unit; 0 if missing."
    )
    neighbour_gains: Mapping[Name, Mapping[Name, Gain]] = Field(
        {}, description="β_ij of follower i for neighbour j, no unit; 0 if missing."
    )
    k: Number = Field(3.0, gt=0, description="k_i of the desired velocity (7), m/s.")
    a: PerSecond = Field(1.0, gt=0, description="a_i of the speed law (14), 1/s.")
    b: Number = Field(0.1, ge=0, description="b_i of the speed law (14), s/m².")
    c: PerSecond = Field(0.1, gt=0, description="c_i of the pointing law (15), 1/s.")
    kappa_mps: MetresPerSecond = Field(
        3.6, gt=0, description="κ_i: how far the leader's speed stays from the bounds, m/s."
    )
    speed_mps: tuple[MetresPerSecond, MetresPerSecond] = Field(
        (16.0, 30.0), description="Speed bounds S_i [lowest, highest], m/s."
    )
    speed_pole_per_s: PerSecond = Field(
        0.64, gt=0, description="Pole p of the speed model f = −p s, g = p, 1/s."
    )
    control_function: ControlFunction = Field(
        PowerControlFunction(example=1), description="The function μ_i of (5)."
    )
    barrier: BarrierFunction = Field(Barrier(example=5), description="The function h_i of (14).")


class Controller(Section):
    """Which law flies the followers, and the options the paper leaves open."""

    law: Literal["paper"] = Field("paper", description="The control law: [HBH23] (5) to (21).")
    profile: Name = Field(
        "paper",
        description="Gains of the middle loop: a section of the airframe's middle_loop.yaml.",
    )
    gain_scale: Number = Field(
        1.0, gt=0, description="Multiplies every PID gain of the middle loop, no unit."
    )
    extrapolate_from: Literal["receipt", "timestamp"] = Field(
        "receipt",
        description="From when a neighbour's message is extrapolated: timestamp needs "
        "synchronised clocks and compensates latency.",
    )
    throttle_error: Literal["ground_speed", "airspeed"] = Field(
        "ground_speed",
        description="The speed error of (21): ground_speed is right in wind, airspeed as printed.",
    )
