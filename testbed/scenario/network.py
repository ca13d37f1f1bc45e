"""The radio between the aircraft on the page: one link for all, and what is different for some."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, FieldSerializationInfo, field_serializer

from testbed.scenario.fields import Name, Number, Seconds, Section, Whole
from testbed.scenario.link import FOLLOW_TARGET_BYTES, SHORTEST_SLOT_S, Instant, Link, Window

ANY = "*"
Somebody = Annotated[str, Field(pattern=r"^(\*|[A-Za-z0-9][A-Za-z0-9_.-]*)$", max_length=64)]


class Partition(Section):
    """A time in which groups do not hear each other."""

    window_s: Window = Field(description="[from, to], s.")
    groups: tuple[Annotated[tuple[Name, ...], Field(min_length=1)], ...] = Field(
        min_length=1,
        description="Names by group; those that are in none form one more group.",
    )


class Tdma(Section):
    """A frame of equal slots, one for each aircraft in turn."""

    frame_s: Seconds = Field(ge=SHORTEST_SLOT_S, le=60, description="Length of the frame, s.")
    order: tuple[Name, ...] | None = Field(
        None, description="Who has which slot; by default the leader, then the fleet in order."
    )
    packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets that one slot takes, a number."
    )
    queue_packets: Annotated[Whole, Field(ge=1, le=10_000)] = Field(
        1, description="Packets waiting for slots; one more is dropped, a number."
    )


class Beat(Section):
    """When an aircraft sends: at phase_s, and every period_s from there."""

    period_s: Annotated[Seconds, Field(gt=0, le=60)] | None = Field(
        None, description="From message to message; by default that of rates.broadcast_hz, s."
    )
    phase_s: Instant | None = Field(
        None, description="The first message, s; by default as rates.synchronous says."
    )


class StampClock(Section):
    """How a clock is wrong that stamps messages; no tick moves."""

    offset_s: Annotated[Seconds, Field(ge=-3600, le=3600)] = Field(
        0.0, description="Ahead of true time at the start, s."
    )
    drift_ppm: Annotated[Number, Field(ge=-1e5, le=1e5)] = Field(
        0.0, description="Gains this many microseconds per second, a number."
    )
    resolution_s: Annotated[Seconds, Field(ge=0, le=10)] = Field(
        0.0, description="Stamps are cut to multiples of this, s; 0 does not."
    )


class Network(Link):
    """The radio between the aircraft: the link that all share, and what is different for some."""

    # what a link has if nobody says otherwise
    delay_s: Annotated[Seconds, Field(ge=0, le=60)] = Field(
        0.0, description="Latency of every message, s."
    )
    message_bytes: Annotated[Whole, Field(ge=1, le=65_535)] = Field(
        100, description="Length of a message without headers, bytes."
    )
    encoding: Literal["exact", "follow-target"] = Field(
        "exact",
        description="What is in a message: exact, all digits in message_bytes; or follow-target, "
        f"MAVLink's FOLLOW_TARGET in a frame of {FOLLOW_TARGET_BYTES} bytes.",
    )
    links: Mapping[Somebody, Mapping[Somebody, Link]] = Field(
        {},
        description="By sender, by receiver: what is different there. '*' is everyone; what names "
        "the sender comes before what names the receiver alone.",
    )
    mute_s: Mapping[Name, tuple[Window, ...]] = Field(
        {}, description="By aircraft, windows [from, to] in which it sends nothing, s."
    )
    partitions: tuple[Partition, ...] = Field((), description="Times of a divided network.")
    hears: Literal["all", "heeded"] = Field(
        "all",
        description="Whom each follower listens to: all, or heeded, the leader and those for "
        "whom it has a gain.",
    )
    tdma: Tdma | None = Field(None, description="Everyone sends in slots of its own.")
    broadcast: Mapping[Name, Beat] = Field(
        {}, description="By aircraft, when it sends if not with all others."
    )
    clocks: Mapping[Name, StampClock] = Field(
        {}, description="By aircraft, how the clock is wrong that stamps its messages."
    )

    @property
    def sent_bytes(self) -> int:
        """Length of a message on the air, less what is around it."""
        return FOLLOW_TARGET_BYTES if self.encoding == "follow-target" else self.message_bytes

    @field_serializer("links")
    def _what_is_said(
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
        """What holds from one aircraft to another: every key that somebody set, the rest None."""
        told: dict[str, Any] = {name: getattr(self, name) for name in Link.model_fields}
        for sender, receiver in ((ANY, ANY), (ANY, destination), (source, ANY)):
            told |= self._told(sender, receiver)
        return Link.model_construct(**(told | self._told(source, destination)))

    def _told(self, sender: str, receiver: str) -> dict[str, Any]:
        special = self.links.get(sender, {}).get(receiver)
        if special is None:
            return {}
        values = ((name, getattr(special, name)) for name in Link.model_fields)
        return {name: value for name, value in values if value is not None}
