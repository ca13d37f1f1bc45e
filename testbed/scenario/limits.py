"""When an aircraft counts as lost on the page, and what the run does then."""

from typing import Annotated, Literal

from pydantic import Field

from testbed.scenario.fields import Metres, Section

Distance = Annotated[Metres, Field(gt=0)]


class Limits(Section):
    """How close is too close, and what follows a loss."""

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
    when_lost: Literal["stop", "fly-on"] = Field(
        "stop",
        description="When an aircraft is lost, on the ground, broken or collided: stop the run, "
        "or fly on without it.",
    )
