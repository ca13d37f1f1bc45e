"""What the network on the page demands: of the fleet, of the rates, and of itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from testbed.scenario.link_checks import AT, Finding, Path, check_links, refuse_window, sections
from testbed.scenario.messages import did_you_mean
from testbed.scenario.network import ANY, Network

if TYPE_CHECKING:
    from testbed.scenario.schema import Scenario

MOST_SYSTEMS = 255  # ids of MAVLink, from 1


def check_network(page: Scenario) -> Iterator[Finding]:
    """Yield every contradiction of the network: where, and what to write instead."""
    yield from _encoding(page)
    yield from _senders(page)
    yield from _partitions(page)
    yield from _tdma(page)
    yield from _ends(page)
    yield from check_links(page.network, page.aircraft_names)


def _encoding(page: Scenario) -> Iterator[Finding]:
    network = page.network
    if network.encoding == "exact":
        for at, link in sections(network):
            if link.corrupt is not None and link.corrupt.bits > 1:
                yield (
                    (*at, "corrupt", "bits"),
                    "has a meaning where messages are frames with a checksum (write "
                    "network.encoding: follow-target, or leave this out)",
                )
        return
    if network.message_bytes != Network.model_fields["message_bytes"].default:
        yield (
            (*AT, "message_bytes"),
            f"is the encoding's: a frame of {network.encoding} has {network.sent_bytes} bytes "
            "(leave this out, or write encoding: exact)",
        )
    if len(page.aircraft_names) > MOST_SYSTEMS:
        yield (
            (*AT, "encoding"),
            f"is for {MOST_SYSTEMS} aircraft, each with a system id of MAVLink, and these are "
            f"{len(page.aircraft_names)} (write exact, or a smaller fleet)",
        )


def _unknown(at: Path, name: str, names: Sequence[str]) -> Iterator[Finding]:
    if name not in names:
        yield (
            at,
            f"no aircraft has this name{did_you_mean(name, names)} (the run has "
            f"{', '.join(names)})",
        )


def _senders(page: Scenario) -> Iterator[Finding]:
    network, names = page.network, page.aircraft_names
    for key in ("mute_s", "broadcast", "clocks"):
        for name in getattr(network, key):
            yield from _unknown((*AT, key, name), name, names)
    for name, windows in network.mute_s.items():
        for index, window in enumerate(windows):
            yield from refuse_window((*AT, "mute_s", name, index), window)
    step = 1.0 / page.rates.physics_hz
    for name, beat in network.broadcast.items():
        if beat.period_s is not None and beat.period_s < step:
            yield (
                (*AT, "broadcast", name, "period_s"),
                f"{beat.period_s:g} s is less than a step of the run (write at least {step:g}, or "
                "a higher rates.physics_hz)",
            )


def _partitions(page: Scenario) -> Iterator[Finding]:
    for index, partition in enumerate(page.network.partitions):
        at = (*AT, "partitions", index)
        yield from refuse_window((*at, "window_s"), partition.window_s)
        groups = partition.groups
        places = [
            ((*at, "groups", row, column), name)
            for row, group in enumerate(groups)
            for column, name in enumerate(group)
        ]
        for place, name in places:
            yield from _unknown(place, name, page.aircraft_names)
        yield from _twice(places, "is in a group already (write each name once)")
        if any(set(page.aircraft_names) <= set(group) for group in groups):
            yield (*at, "groups"), "has everyone in one group: nothing is divided (write fewer)"


def _twice(places: Iterable[tuple[Path, str]], text: str) -> Iterator[Finding]:
    seen = set()
    for place, name in places:
        if name in seen:
            yield place, f"{name!r} {text}"
        seen.add(name)


def _tdma(page: Scenario) -> Iterator[Finding]:
    network, names = page.network, page.aircraft_names
    if network.tdma is None:
        return
    for at, link in sections(network):
        if link.slots is not None and link.slots.every_s[1] > 0:
            yield (
                (*at, "slots"),
                "are slots of this link alone, and network.tdma has everyone's (leave one out)",
            )
    order = network.tdma.order
    if order is None:
        return
    at = (*AT, "tdma", "order")
    places = [((*at, index), name) for index, name in enumerate(order)]
    for place, name in places:
        yield from _unknown(place, name, names)
    yield from _twice(places, "has a slot already (write each name once)")
    left = [name for name in names if name not in order]
    if left:
        yield at, f"has no slot for {', '.join(left)} (write every aircraft, or leave order out)"


def _ends(page: Scenario) -> Iterator[Finding]:
    """Whether the keys under links are a sender and one who listens."""
    names = page.aircraft_names
    leader, *followers = names
    for sender, receivers in page.network.links.items():
        at = (*AT, "links", sender)
        if sender != ANY:
            yield from _unknown(at, sender, names)
        for receiver in receivers:
            if receiver == ANY:
                continue
            if receiver == leader:
                yield (
                    (*at, receiver),
                    "is the leader, which does not listen (write the sender first, then a "
                    "follower or '*')",
                )
            elif receiver == sender:
                yield (*at, receiver), "an aircraft hears itself at once (leave this key out)"
            elif receiver not in names:
                yield (
                    (*at, receiver),
                    f"no follower has this name{did_you_mean(receiver, followers)} (the fleet has "
                    f"{', '.join(followers)}; '*' is all of them)",
                )
