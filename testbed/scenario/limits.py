"""When an aircraft counts as lost or upset on the page, and what the run does then."""

from typing import Annotated, Literal

from pydantic import Field

from testbed.scenario.fields import Degrees, Metres, MetresPerSecond, Section

Distance = Annotated[Metres, Field(gt=0)]


class Limits(Section):
    """How close, how fast, how slow and how far is too much, and what follows."""

    collision_m: Distance | None = Field(
        None,
        description="Two whose centres are closer than this have collided, and both are lost, m; "
        "by default nobody looks.",
    )
    separation_m: Distance | None = Field(
        None,
        description="Two whose centres are closer than this are a warning in the log, m; by "
        "default nobody looks.",
    )
    overspeed_mps: Annotated[MetresPerSecond, Field(gt=0)] | None = Field(
        None,
        description="A flight model beyond this equivalent airspeed for half a second is upset, "
        "m/s; by default 1.5 times AIRSPEED_MAX of its autopilot.",
    )
    stall_deg: Annotated[Degrees, Field(gt=0, le=180)] | None = Field(
        None,
        description="A flight model beyond this angle of attack for half a second is upset, "
        "degrees; by default where its lift is largest.",
    )
    formation_m: Distance | None = Field(
        100.0,
        description="A follower that is this much farther from its slot than it has been, for five "
        "seconds, is upset, m; null: nobody looks.",
    )
    when_lost: Literal["stop", "fly-on"] = Field(
        "stop",
        description="When an aircraft is lost, on the ground, broken or collided: stop the run, "
        "or fly on without it.",
    )
    when_upset: Literal["stop", "fly-on"] = Field(
        "fly-on",
        description="When an aircraft is upset, too fast, stalled or far from its slot: stop the "
        "run, or fly on with it.",
    )
