"""What a message meets on one directed link: every knob of the channel, each of them optional."""

from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    WithJsonSchema,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from testbed.scenario.fields import Number, Seconds, Section, Whole

Probability = Annotated[Number, Field(ge=0, le=1)]
Correlation = Annotated[Number, Field(ge=0, lt=1)]
Span = Annotated[Seconds, Field(ge=0, le=3600)]
Instant = Annotated[Seconds, Field(ge=0)]
Window = tuple[Instant, Instant]
FOLLOW_TARGET_BYTES = 105  # of a frame of MAVLink 2
_CORRELATION = (
    "Correlation of one packet's with the packet's before, 0 to 1: the lag-1 autocorrelation; with "
    "arithmetic: netem what tc netem makes of that number."
)


def _is_number(value: Any) -> bool:  # noqa: ANN401 - whatever the page holds
    return isinstance(value, int | float) and not isinstance(value, bool)


class Chance(Section):
    """An event that befalls a packet with a probability; a number stands for that alone."""

    probability: Probability = Field(description="Share of the packets, 0 to 1.")
    correlation: Correlation = Field(0.0, description=_CORRELATION)

    @model_validator(mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
        return {"probability": value} if _is_number(value) else value

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Allow a number beside the map."""
        schema = handler.resolve_ref_schema(handler(core_schema))
        return {"anyOf": [{"type": "number", "minimum": 0, "maximum": 1}, dict(schema)]}


class Corrupt(Chance):
    """Packets that are damaged on the way: some of their bits are turned over."""

    probability: Probability = Field(description="Share of the packets, 0 to 1.")
    bits: Annotated[Whole, Field(ge=1, le=8 * FOLLOW_TARGET_BYTES)] = Field(
        1,
        description="Bits turned over, a number; above 1 the encoding is follow-target, whose "
        "checksum may then be right by chance.",
    )


class Reorder(Chance):
    """Packets that overtake: each sent at once, past those that wait for their delay."""

    probability: Probability = Field(description="Share of those that may overtake, 0 to 1.")
    gap: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="At most every gap-th packet may overtake, a number."
    )


class Bernoulli(Chance):
    """Each packet is lost with a probability."""

    kind: Literal["bernoulli"] = Field(
        "bernoulli", description="A probability, the kind meant if none is said."
    )


class GilbertElliott(Section):
    """A good and a bad state with a loss of their own; Gilbert 1960, Elliott 1963."""

    kind: Literal["gilbert-elliott"] = Field(description="A good and a bad state.")
    p: Probability = Field(description="Probability per packet of good turning bad, 0 to 1.")
    r: Probability = Field(description="Probability per packet of bad turning good, 0 to 1.")
    loss_bad: Probability = Field(1.0, description="Loss in the bad state, 1 - h, 0 to 1.")
    loss_good: Probability = Field(0.0, description="Loss in the good state, 1 - k, 0 to 1.")


class FourState(Section):
    """Gaps with lone losses and bursts with lone arrivals: the Markov chain of tc netem.

    1 received in a gap, 2 received in a burst, 3 lost in a burst, 4 lost alone in a gap.
    """

    kind: Literal["four-state"] = Field(description="Bursts and gaps, a Markov chain of four.")
    p13: Probability = Field(description="Probability per packet of a burst beginning, 0 to 1.")
    p31: Probability = Field(description="Probability per packet of a burst ending, 0 to 1.")
    p32: Probability = Field(0.0, description="Of an arrival inside a burst, 0 to 1.")
    p23: Probability = Field(1.0, description="Of loss again after such an arrival, 0 to 1.")
    p14: Probability = Field(0.0, description="Of a lone loss in a gap, 0 to 1.")


def _kind_said(value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
    """A number is a probability, and so is a map that says no kind and has no key of another."""
    if _is_number(value):
        return {"kind": "bernoulli", "probability": value}
    if isinstance(value, dict) and not value.keys() & {"kind", "p", "r", "p13", "p31"}:
        return {"kind": "bernoulli", **value}
    return value


Loss = Annotated[
    Annotated[Bernoulli | GilbertElliott | FourState, Field(discriminator="kind")],
    BeforeValidator(_kind_said),
]


class Jitter(Section):
    """How delays vary about delay_s."""

    distribution: Literal[
        "uniform", "normal", "lognormal", "pareto", "paretonormal", "empirical"
    ] = Field(
        "uniform",
        description="uniform: within spread_s of delay_s; normal, lognormal, pareto (shape 3) and "
        "paretonormal (a quarter normal, three quarters pareto): mean delay_s and standard "
        "deviation spread_s; empirical: the delays of file are added to delay_s.",
    )
    spread_s: Span = Field(
        0.0, description="Standard deviation; of uniform half the width, s. 0 is no jitter."
    )
    correlation: Correlation = Field(0.0, description=_CORRELATION)
    file: str | None = Field(
        None,
        min_length=1,
        description="For empirical: CSV with a column delay_s, relative to this page or a name in "
        "scenarios/data.",
    )
    in_order: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="A packet waits for those sent before it: true; or overtakes them: false.",
    )


class Rate(Section):
    """A transmitter that takes its time, behind a finite queue that drops what comes last."""

    bit_per_s: Number = Field(
        ge=0, le=1e12, description="Of the transmitter, bit/s; 0 has no limit."
    )
    overhead_bytes: Annotated[Whole, Field(ge=0, le=65_535)] = Field(
        0, description="Bytes of headers around each message, a number."
    )
    queue_packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1000, description="Packets waiting or in transmission; one more is dropped, a number."
    )


# Shorter ones would be millions from one message to the next.
SHORTEST_SLOT_S = 1e-5


def _as_pair(value: Any) -> Any:  # noqa: ANN401 - whatever the page holds
    return (value, value) if _is_number(value) else value


class Slots(Section):
    """Sending in slots only: a packet waits for the next slot with room."""

    every_s: Annotated[
        tuple[Span, Span],
        BeforeValidator(_as_pair),
        WithJsonSchema(
            {
                "anyOf": [
                    {"type": "number", "minimum": 0},
                    {
                        "type": "array",
                        "items": {"type": "number", "minimum": 0},
                        "minItems": 2,
                        "maxItems": 2,
                    },
                ]
            }
        ),
    ] = Field(description="From slot to slot [shortest, longest], or one number, s; 0: no slots.")
    first_s: Instant = Field(0.0, description="The first slot, s.")
    packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets that one slot takes, a number."
    )
    queue_packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets waiting for slots; one more is dropped, a number."
    )


Curve = tuple[tuple[Annotated[Number, Field(ge=0)], Probability], ...]


class Shadowing(Section):
    """An airframe in the way of its own antenna, at either end of the link."""

    antenna: Literal["below", "above"] = Field(
        "below", description="On which side of the airframe the antenna is."
    )
    loss: Curve = Field(
        description="Loss [[degrees, probability], ...] by how far the other aircraft is past the "
        "wings' plane, on the far side; linear between, the ends hold.",
    )


class Trace(Section):
    """A measured trace, replayed by the time of sending, over and over."""

    file: str = Field(
        min_length=1,
        description="CSV with columns sent_s and received_s (empty: lost), and source and "
        "destination if it has several links; relative to this page or a name in scenarios/data.",
    )
    shifted: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="Begin at a moment of the trace that each link draws from the seed: true; or "
        "where all others do: false.",
    )
    begin_s: Seconds | None = Field(
        None,
        description="sent_s of the file at the start of the run, s; by default its earliest.",
    )


class Link(Section):
    """One directed link. What is left out is as for all links."""

    delay_s: Annotated[Seconds, Field(ge=0, le=60)] | None = Field(
        None, description="Latency of every message, s."
    )
    jitter: Jitter | None = Field(
        None, description="How latencies vary, as in {spread_s: 0.01}, s."
    )
    loss: Loss | None = Field(
        None, description="Loss: a probability, 0 to 1, or a map with a kind of bursts."
    )
    duplicate: Chance | None = Field(
        None, description="Packets that arrive twice: a probability, or a map."
    )
    corrupt: Corrupt | None = Field(
        None, description="Packets whose checksum fails: a probability, or a map."
    )
    reorder: Reorder | None = Field(
        None, description="Packets that overtake: a probability, or a map."
    )
    rate: Rate | None = Field(None, description="Transmission takes time, bit/s.")
    slots: Slots | None = Field(None, description="Sending in slots only, s.")
    range_loss: Curve | None = Field(
        None,
        description="Loss by distance [[m, probability], ...]; linear between, the ends hold.",
    )
    shadowing: Shadowing | None = Field(None, description="Loss through banking airframes.")
    blackout_s: tuple[Window, ...] | None = Field(
        None, description="Windows [from, to] in which nothing sent arrives, s."
    )
    drop: tuple[Annotated[Whole, Field(ge=0)], ...] | None = Field(
        None, description="Sequence numbers of packets that are lost, from 0."
    )
    trace: Trace | None = Field(
        None, description="A measured trace in place of loss, delay_s and jitter."
    )
    arithmetic: Literal["exact", "netem"] | None = Field(
        None,
        description="exact: probabilities and distributions are what they say, whatever the "
        "correlation; netem: the arithmetic of Linux's tc netem, bit widths and all.",
    )
