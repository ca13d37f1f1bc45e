"""The `network` section: one link for all pairs of aircraft, and differences for some."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Field,
    FieldSerializationInfo,
    GetJsonSchemaHandler,
    WithJsonSchema,
    field_serializer,
    model_validator,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from testbed.core.ranges import DELAY
from testbed.core.reads import derive, unrecorded
from testbed.scenario.fields import (
    MAX_DISTANCE_M,
    SMALLEST,
    Instant,
    Name,
    Number,
    Seconds,
    Section,
    Whole,
    ZeroOrUsable,
    is_number,
    within,
)
from testbed.scenario.reference_fields import DataReference

Probability = Annotated[Number, Field(ge=0, le=1)]
Correlation = Annotated[Number, Field(ge=0, lt=1)]
Span = Annotated[Seconds, Field(ge=0, le=3600)]
Window = tuple[Instant, Instant]
FOLLOW_TARGET_BYTES = 105  # length of the MAVLink 2 frame
_CORRELATION = (
    "Correlation with the previous packet, 0 to 1: the lag-1 autocorrelation; with arithmetic: "
    "netem as tc netem computes it."
)


class PacketEvent(Section):
    """Random event of a packet; a number stands for its probability."""

    probability: Probability = Field(description="Share of the packets, 0 to 1.")
    correlation: Correlation = Field(0.0, description=_CORRELATION)

    @model_validator(mode="before")
    @classmethod
    def _number(cls, value: Any) -> Any:  # noqa: ANN401 - any YAML value
        return {"probability": value} if is_number(value) else value

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Allow a number beside the map."""
        schema = handler.resolve_ref_schema(handler(core_schema))
        return {"anyOf": [{"type": "number", "minimum": 0, "maximum": 1}, dict(schema)]}


class Corrupt(PacketEvent):
    """Packets with inverted bits."""

    probability: Probability = Field(description="Share of the packets, 0 to 1.")
    bits: Annotated[Whole, Field(ge=1, le=8 * FOLLOW_TARGET_BYTES)] = Field(
        1,
        description="Number of inverted bits; above 1 only with encoding: follow-target, whose "
        "checksum may then match by chance.",
    )


class Reorder(PacketEvent):
    """Packets that are sent without delay and overtake those that wait."""

    probability: Probability = Field(description="Share of the packets that may overtake, 0 to 1.")
    gap: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="After gap - 1 delayed packets each further one may overtake, a number."
    )


class Bernoulli(PacketEvent):
    """Independent loss of each packet."""

    kind: Literal["bernoulli"] = Field(
        "bernoulli", description="Independent loss; the default kind."
    )


class GilbertElliott(Section):
    """Bursts of loss: a good and a bad state with own loss; Gilbert 1960, Elliott 1963."""

    kind: Literal["gilbert-elliott"] = Field(description="Bursts of loss: a good and a bad state.")
    p: Probability = Field(
        description="Probability per packet of the change to the bad state, 0 to 1."
    )
    r: Probability = Field(
        description="Probability per packet of the change to the good state, 0 to 1."
    )
    loss_bad: Probability = Field(1.0, description="Loss in the bad state, 1 - h, 0 to 1.")
    loss_good: Probability = Field(0.0, description="Loss in the good state, 1 - k, 0 to 1.")


class FourState(Section):
    """Markov chain of tc netem: gaps with isolated losses, bursts with isolated arrivals.

    States: 1 received in a gap, 2 received in a burst, 3 lost in a burst, 4 lost in a gap.
    """

    kind: Literal["four-state"] = Field(
        description="Bursts and gaps: a Markov chain of four states."
    )
    p13: Probability = Field(description="Probability per packet that a burst begins, 0 to 1.")
    p31: Probability = Field(description="Probability per packet that a burst ends, 0 to 1.")
    p32: Probability = Field(0.0, description="Probability of an arrival in a burst, 0 to 1.")
    p23: Probability = Field(
        1.0, description="Probability of a loss after such an arrival, 0 to 1."
    )
    p14: Probability = Field(0.0, description="Probability of an isolated loss in a gap, 0 to 1.")


def _with_kind(value: Any) -> Any:  # noqa: ANN401 - any YAML value
    """Make a number, and a map of no kind, a Bernoulli loss."""
    if is_number(value):
        return {"kind": "bernoulli", "probability": value}
    if isinstance(value, dict) and not value.keys() & {"kind", "p", "r", "p13", "p31"}:
        return {"kind": "bernoulli", **value}
    return value


Loss = Annotated[
    Annotated[Bernoulli | GilbertElliott | FourState, Field(discriminator="kind")],
    BeforeValidator(_with_kind),
]


class Jitter(Section):
    """Variation of the delay about delay_s."""

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
    file: DataReference | None = Field(
        None,
        description="For empirical: CSV file with a column delay_s: a path from this file, or a "
        "name in scenarios/data.",
    )
    in_order: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="A packet waits for those sent before it: true; or overtakes them: false.",
    )


class Rate(Section):
    """Transmission rate, behind a finite queue that drops the last packet."""

    bit_per_s: Annotated[Number, Field(ge=0, le=1e12), ZeroOrUsable] = Field(
        description="Rate of the transmitter, bit/s; 0 is unlimited."
    )
    overhead_bytes: Annotated[Whole, Field(ge=0, le=65_535)] = Field(
        0, description="Header bytes of each message, a number."
    )
    queue_packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1000, description="Packets waiting or in transmission, a number; more are dropped."
    )


SHORTEST_SLOT_S = 1e-5  # shorter slots would be millions between two messages


def _as_pair(value: Any) -> Any:  # noqa: ANN401 - any YAML value
    return (value, value) if is_number(value) else value


class TransmitSlots(Section):
    """Transmission in slots: a packet waits for the next slot that is not full."""

    every_s: Annotated[
        tuple[Span, Span],
        BeforeValidator(_as_pair),
        WithJsonSchema(
            {
                "anyOf": [
                    {"type": "number", "minimum": 0, "maximum": 3600},
                    {
                        "type": "array",
                        "items": {"type": "number", "minimum": 0, "maximum": 3600},
                        "minItems": 2,
                        "maxItems": 2,
                    },
                ]
            }
        ),
    ] = Field(description="Time between slots [shortest, longest], or one number, s; 0: no slots.")
    first_s: Instant = Field(0.0, description="Time of the first slot, s.")
    packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets per slot, a number."
    )
    queue_packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets waiting for slots, a number; more are dropped."
    )


Curve = tuple[tuple[Annotated[Number, Field(ge=0, le=MAX_DISTANCE_M)], Probability], ...]


class Shadowing(Section):
    """Loss when an airframe is between its antenna and the other aircraft."""

    antenna: Literal["below", "above"] = Field(
        "below", description="Side of the airframe with the antenna."
    )
    loss: Curve = Field(
        description="Loss [[degrees, probability], ...] by the angle of the other aircraft beyond "
        "the plane of the wings, on the side away from the antenna; linear between, constant "
        "outside.",
    )


class Trace(Section):
    """Measured trace, replayed by time of transmission and repeated."""

    file: DataReference = Field(
        description="CSV file with columns sent_s and received_s (empty: lost), and source and "
        "destination if it has several links; a path from this file, or a name in scenarios/data.",
    )
    random_start: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="true: each link begins at a random time of the trace, from the seed; false: "
        "all begin at begin_s.",
    )
    begin_s: Seconds | None = Field(
        None,
        description="sent_s of the file at the start of the run, s; by default the earliest.",
    )


class Link(Section):
    """One directed link; a key that is left out is as for all links."""

    delay_s: Annotated[Seconds, within(DELAY)] | None = Field(
        None, description="Latency of every message, s."
    )
    jitter: Jitter | None = Field(
        None, description="Variation of the latency, as in {spread_s: 0.01}, s."
    )
    loss: Loss | None = Field(
        None, description="Loss: a probability, 0 to 1, or a map with a kind of loss."
    )
    duplicate: PacketEvent | None = Field(
        None, description="Packets that arrive twice: a probability, or a map."
    )
    corrupt: Corrupt | None = Field(
        None, description="Packets whose checksum fails: a probability, or a map."
    )
    reorder: Reorder | None = Field(
        None, description="Packets that overtake others: a probability, or a map."
    )
    rate: Rate | None = Field(None, description="Transmission rate and queue, bit/s.")
    slots: TransmitSlots | None = Field(None, description="Transmission in slots, s.")
    range_loss: Curve | None = Field(
        None,
        description="Loss by distance [[m, probability], ...]; linear between, constant outside.",
    )
    shadowing: Shadowing | None = Field(
        None, description="Loss by bank angle: an airframe blocks its antenna."
    )
    blackout_s: tuple[Window, ...] | None = Field(
        None, description="Windows [from, to] in which nothing that is sent arrives, s."
    )
    drop: tuple[Annotated[Whole, Field(ge=0, lt=2**31)], ...] | None = Field(
        None, description="Sequence numbers of packets that are lost, from 0."
    )
    trace: Trace | None = Field(
        None, description="A measured trace in place of loss, delay_s and jitter."
    )
    arithmetic: Literal["exact", "netem"] | None = Field(
        None,
        description="exact: probabilities and distributions hold for any correlation; netem: the "
        "integer arithmetic of Linux tc netem.",
    )


ANY = "*"
NameOrAny = Annotated[str, Field(pattern=r"^(\*|[A-Za-z0-9][A-Za-z0-9_.-]*)$", max_length=64)]


class Partition(Section):
    """Time window in which groups of aircraft receive nothing from each other."""

    window_s: Window = Field(description="Window [from, to], s.")
    groups: tuple[Annotated[tuple[Name, ...], Field(min_length=1)], ...] = Field(
        min_length=1,
        description="Names of each group; the other aircraft form one more group.",
    )


class Tdma(Section):
    """Frame of equal slots, one per aircraft."""

    frame_s: Seconds = Field(ge=SHORTEST_SLOT_S, le=60, description="Length of the frame, s.")
    order: tuple[Name, ...] | None = Field(
        None, description="Order of the aircraft; by default the leader, then the fleet."
    )
    packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets per slot, a number."
    )
    queue_packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets waiting for slots, a number; more are dropped."
    )


class BroadcastSchedule(Section):
    """Times of messages: phase_s, then every period_s."""

    period_s: Annotated[Seconds, Field(ge=SMALLEST, le=60)] | None = Field(
        None, description="Time between messages; by default that of rates.broadcast_hz, s."
    )
    phase_s: Instant | None = Field(
        None, description="Time of the first message, s; by default as rates.synchronous sets it."
    )


class StampClock(Section):
    """Error of the clock that stamps messages; it moves no tick."""

    offset_s: Annotated[Seconds, Field(ge=-3600, le=3600)] = Field(
        0.0, description="Lead over true time at the start, s."
    )
    drift_ppm: Annotated[Number, Field(ge=-1e5, le=1e5)] = Field(
        0.0, description="Drift in microseconds per second, a number."
    )
    resolution_s: Annotated[Seconds, Field(ge=0, le=10), ZeroOrUsable] = Field(
        0.0, description="Stamps are rounded down to multiples of this, s; 0: not rounded."
    )


class Network(Link):
    """Radio between the aircraft: the link of all pairs, and differences for some."""

    # defaults of every link
    delay_s: Annotated[Seconds, within(DELAY)] = Field(
        0.0, description="Latency of every message, s."
    )
    message_bytes: Annotated[Whole, Field(ge=1, le=65_535)] = Field(
        100, description="Length of a message without headers, bytes."
    )
    encoding: Literal["exact", "follow-target"] = Field(
        "exact",
        description="Content of a message: exact, all digits in message_bytes; or follow-target, "
        f"MAVLink's FOLLOW_TARGET in a frame of {FOLLOW_TARGET_BYTES} bytes.",
    )
    links: Mapping[NameOrAny, Mapping[NameOrAny, Link]] = Field(
        {},
        description="Differences by sender and receiver; '*' is every aircraft. An entry with a "
        "named sender takes precedence over one with a named receiver alone.",
    )
    transmitter_off_s: Mapping[Name, tuple[Window, ...]] = Field(
        {}, description="By aircraft, windows [from, to] in which its transmitter is off, s."
    )
    partitions: tuple[Partition, ...] = Field(
        (), description="Times in which the network is divided."
    )
    receive: Literal["all", "neighbours"] = Field(
        "all",
        description="Messages that a follower receives: all, or neighbours, those of the leader "
        "and of aircraft for which it has a gain.",
    )
    tdma: Tdma | None = Field(None, description="Each aircraft sends in its own slots.")
    broadcast: Mapping[Name, BroadcastSchedule] = Field(
        {}, description="By aircraft, times of its messages if they differ from rates."
    )
    clocks: Mapping[Name, StampClock] = Field(
        {}, description="By aircraft, error of the clock that stamps its messages."
    )

    @property
    def sent_bytes(self) -> int:
        """Return the length of a message on the air without headers, bytes."""
        return FOLLOW_TARGET_BYTES if self.encoding == "follow-target" else self.message_bytes

    @field_serializer("links")
    def _set_keys(
        self, links: Mapping[str, Mapping[str, Link]], info: FieldSerializationInfo
    ) -> dict[str, Any]:
        return {
            sender: {
                receiver: link.model_dump(mode=info.mode, exclude_none=True)
                for receiver, link in receivers.items()
            }
            for sender, receivers in links.items()
        }

    def link(self, source: str, destination: str) -> Link:
        """Return the resolved link between two aircraft; keys not set are None."""
        keys: dict[str, Any] = {}
        sources: dict[str, list[tuple[object, str]]] = {}
        with unrecorded():
            for entry in (self, *self.entries(source, destination)):
                for name in Link.model_fields:
                    value = getattr(entry, name)
                    if value is not None:
                        keys[name], sources[name] = value, [(entry, name)]
        link = Link.model_construct(**(dict.fromkeys(Link.model_fields) | keys))
        derive(link, sources)
        return link

    def entries(self, source: str, destination: str) -> tuple[Link, ...]:
        """Return the entries of `links` for a link; a later one takes precedence."""
        places = ((ANY, ANY), (ANY, destination), (source, ANY), (source, destination))
        found = (self.links.get(sender, {}).get(receiver) for sender, receiver in places)
        return tuple(each for each in found if each is not None)
