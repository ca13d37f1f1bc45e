"""Checks of the `network` section: names, windows, and contradictory keys of links."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from testbed.scenario.fields import Finding, KeyPath
from testbed.scenario.network import (
    ANY,
    SHORTEST_SLOT_S,
    Curve,
    FourState,
    GilbertElliott,
    Jitter,
    Link,
    Loss,
    Network,
    TransmitSlots,
)
from testbed.scenario.problems import did_you_mean
from testbed.scenario.sections import Sections

MAX_SYSTEMS = 255  # MAVLink system ids, from 1
_AT: KeyPath = ("network",)
_REPLACED_BY_TRACE = ("loss", "delay_s", "jitter")
_LEAVE_OUT = "(leave one of them out)"
# Reach of a distribution below its mean, in spread_s; normal ones have no bound.
_REACH_BELOW = {"uniform": 1.0, "pareto": 3.0**-0.5}  # pareto: shape 3
_MIN_LOGNORMAL_MEAN = 1e-3  # in spread_s


class Ends(NamedTuple):
    """What a network connects, and its words in errors."""

    names: Sequence[str]  # of senders
    receivers: Sequence[str]
    one: str = "aircraft"
    all_of_them: str = "the aircraft are"
    receiver: str = "follower"
    all_receivers: str = "the fleet has"


def check_network(scenario: Sections) -> Iterator[Finding]:
    """Yield the contradictions of the network section."""
    names = scenario.aircraft_names
    yield from _encoding(scenario)
    yield from _periods(scenario)
    yield from check_links(scenario.network, Ends(names, names[1:]))


def check_links(network: Network, ends: Ends) -> Iterator[Finding]:
    """Yield the contradictions of what acts on packets between some ends."""
    yield from _senders(network, ends)
    yield from _partitions(network, ends)
    yield from _tdma(network, ends)
    yield from _ends(network, ends)
    yield from _links(network, ends)


def _encoding(scenario: Sections) -> Iterator[Finding]:
    network = scenario.network
    if network.encoding == "exact":
        for at, link in link_entries(network):
            if link.corrupt is not None and link.corrupt.bits > 1:
                yield (
                    (*at, "corrupt", "bits"),
                    "applies to messages with a checksum (write "
                    "network.encoding: follow-target, or leave this out)",
                )
        return
    if network.message_bytes != Network.model_fields["message_bytes"].default:
        yield (
            (*_AT, "message_bytes"),
            f"has no effect: a frame of encoding {network.encoding} has {network.sent_bytes} bytes "
            "(leave this out, or write encoding: exact)",
        )
    if len(scenario.aircraft_names) > MAX_SYSTEMS:
        yield (
            (*_AT, "encoding"),
            f"is for at most {MAX_SYSTEMS} aircraft, the number of MAVLink system ids, and here "
            f"are {len(scenario.aircraft_names)} (write exact, or a smaller fleet)",
        )


def _unknown(at: KeyPath, name: str, ends: Ends) -> Iterator[Finding]:
    if name not in ends.names:
        yield (
            at,
            f"no {ends.one} has this name{did_you_mean(name, ends.names)} ({ends.all_of_them} "
            f"{', '.join(ends.names)})",
        )


def _senders(network: Network, ends: Ends) -> Iterator[Finding]:
    for key in ("transmitter_off_s", "broadcast", "clocks"):
        for name in getattr(network, key):
            yield from _unknown((*_AT, key, name), name, ends)
    for name, windows in network.transmitter_off_s.items():
        for index, window in enumerate(windows):
            yield from _check_window((*_AT, "transmitter_off_s", name, index), window)


def _periods(scenario: Sections) -> Iterator[Finding]:
    network, step = scenario.network, 1.0 / scenario.rates.physics_hz
    for name, beat in network.broadcast.items():
        if beat.period_s is not None and beat.period_s < step:
            yield (
                (*_AT, "broadcast", name, "period_s"),
                f"{beat.period_s:g} s is shorter than a simulation step (write at least {step:g}, "
                "or a higher rates.physics_hz)",
            )


def _partitions(network: Network, ends: Ends) -> Iterator[Finding]:
    for index, partition in enumerate(network.partitions):
        at = (*_AT, "partitions", index)
        yield from _check_window((*at, "window_s"), partition.window_s)
        groups = partition.groups
        places = [
            ((*at, "groups", row, column), name)
            for row, group in enumerate(groups)
            for column, name in enumerate(group)
        ]
        for place, name in places:
            yield from _unknown(place, name, ends)
        yield from _twice(places, "is in a group already (write each name once)")
        if any(set(ends.names) <= set(group) for group in groups):
            yield (
                (*at, "groups"),
                f"puts all {_plural(ends)} in one group, which divides nothing (write fewer names)",
            )


def _plural(ends: Ends) -> str:
    return ends.one if ends.one == "aircraft" else f"{ends.one}s"


def _twice(places: Iterable[tuple[KeyPath, str]], text: str) -> Iterator[Finding]:
    seen = set()
    for place, name in places:
        if name in seen:
            yield place, f"{name!r} {text}"
        seen.add(name)


def _tdma(network: Network, ends: Ends) -> Iterator[Finding]:
    names = ends.names
    if network.tdma is None:
        return
    for at, link in link_entries(network):
        if link.slots is not None and link.slots.every_s[1] > 0:
            yield (
                (*at, "slots"),
                "cannot be combined with network.tdma, which sets the slots of all (leave one out)",
            )
    order = network.tdma.order
    if order is None:
        return
    at = (*_AT, "tdma", "order")
    places = [((*at, index), name) for index, name in enumerate(order)]
    for place, name in places:
        yield from _unknown(place, name, ends)
    yield from _twice(places, "has a slot already (write each name once)")
    missing = [name for name in names if name not in order]
    if missing:
        what = f"has no slot for {', '.join(missing)}"
        yield at, f"{what} (write every {ends.one}, or leave order out)"


def _ends(network: Network, ends: Ends) -> Iterator[Finding]:
    """Check that the keys below links are a sender and a receiver."""
    for sender, receivers in network.links.items():
        at = (*_AT, "links", sender)
        if sender != ANY:
            yield from _unknown(at, sender, ends)
        for receiver in receivers:
            if receiver == ANY:
                continue
            if receiver in ends.names and receiver not in ends.receivers:
                yield (
                    (*at, receiver),
                    "is the leader, which receives no messages (write the sender first, then a "
                    "follower or '*')",
                )
            elif receiver == sender:
                yield (*at, receiver), "is sender and receiver (leave this key out)"
            elif receiver not in ends.receivers:
                yield (
                    (*at, receiver),
                    f"no {ends.receiver} has this name{did_you_mean(receiver, ends.receivers)} "
                    f"({ends.all_receivers} {', '.join(ends.receivers)}; '*' is all of them)",
                )


def _links(network: Network, ends: Ends) -> Iterator[Finding]:
    """Check each entry that describes a link, then the resolved links."""
    for at, link in link_entries(network):
        yield from _entry(at, link)
    seen = set()
    for source, destination in _pairs(network, ends):
        for finding in _resolved(network, source, destination):
            if finding[0] not in seen:  # one finding per entry, not per link
                seen.add(finding[0])
                yield finding


def link_entries(network: Network) -> Iterator[tuple[KeyPath, Link]]:
    """Yield entries that describe links with their paths, the common one first."""
    yield _AT, network
    for sender, receivers in network.links.items():
        for receiver, link in receivers.items():
            yield (*_AT, "links", sender, receiver), link


def _check_window(at: KeyPath, window: tuple[float, float]) -> Iterator[Finding]:
    """Check that a window begins before it ends."""
    begin, end = window
    if begin >= end:
        yield at, f"[{begin:g}, {end:g}] is not a window (write [from, to] in s)"


def _entry(at: KeyPath, link: Link) -> Iterator[Finding]:
    if link.loss is not None:
        yield from _loss((*at, "loss"), link.loss)
    if link.jitter is not None:
        yield from _jitter((*at, "jitter"), link.jitter)
    if link.slots is not None:
        yield from _slots((*at, "slots", "every_s"), link.slots)
    if link.range_loss is not None:
        yield from _curve((*at, "range_loss"), link.range_loss, "distances")
    if link.shadowing is not None:
        yield from _curve((*at, "shadowing", "loss"), link.shadowing.loss, "angles")
    for index, window in enumerate(link.blackout_s or ()):
        yield from _check_window((*at, "blackout_s", index), window)


def _loss(at: KeyPath, loss: Loss) -> Iterator[Finding]:
    if isinstance(loss, GilbertElliott) and loss.p == loss.r == 0.0:
        yield at, "p and r are both 0, so that the state never changes (write one above 0)"
    if isinstance(loss, FourState):
        for first, second in (("p13", "p14"), ("p31", "p32")):
            total = getattr(loss, first) + getattr(loss, second)
            if total > 1.0:
                yield (
                    (*at, second),
                    f"{first} + {second} is {total:g}, and both leave state {first[1]} (write at "
                    "most 1 for the sum)",
                )


def _jitter(at: KeyPath, jitter: Jitter) -> Iterator[Finding]:
    if jitter.distribution == "empirical":
        if jitter.file is None:
            yield (*at, "file"), "is missing (write the name of a CSV file with a column delay_s)"
        if jitter.spread_s:
            yield (
                (*at, "spread_s"),
                "has no effect with distribution: empirical (leave this out)",
            )
    elif jitter.file is not None:
        yield (
            (*at, "file"),
            f"is for distribution: empirical, and the distribution is {jitter.distribution} "
            f"{_LEAVE_OUT}",
        )


def _slots(at: KeyPath, slots: TransmitSlots) -> Iterator[Finding]:
    shortest, longest = slots.every_s
    if longest < shortest or shortest == 0.0 < longest:
        yield (
            at,
            f"[{shortest:g}, {longest:g}] is not a range of times (write [shortest, longest], "
            "both above 0)",
        )
    elif 0.0 < shortest < SHORTEST_SLOT_S:
        yield at, f"{shortest:g} s is too short for a slot (write at least {SHORTEST_SLOT_S:g})"


def _curve(at: KeyPath, curve: Curve, what: str) -> Iterator[Finding]:
    for index in range(1, len(curve)):
        before, here = curve[index - 1][0], curve[index][0]
        if here <= before:
            yield (
                (*at, index, 0),
                f"{here:g} is not above {before:g} (write the {what} in rising order)",
            )


def _pairs(network: Network, ends: Ends) -> Iterator[tuple[str, str]]:
    """Yield the links with an entry, and one of those that are alike."""
    names = ends.names
    sources = {*network.links} - {ANY}
    destinations = {receiver for each in network.links.values() for receiver in each} - {ANY}
    others = [name for name in names if name not in sources][:1]
    unnamed = [name for name in ends.receivers if name not in destinations]
    for source in (name for name in names if name in sources or name in others):
        rest = [name for name in unnamed if name != source][:1]
        for destination in ends.receivers:
            if destination != source and (destination in destinations or destination in rest):
                yield source, destination


def _resolved(network: Network, source: str, destination: str) -> Iterator[Finding]:
    """Check one resolved link; a finding is at the entry that decides the key."""
    link = network.link(source, destination)
    last = _deciding_entries(network, source, destination)
    words = f"from {source} to {destination}"
    if link.trace is not None:
        for key in _REPLACED_BY_TRACE:
            # a less specific entry is for the links without trace
            if getattr(link, key) and last[key][0] >= last["trace"][0]:
                yield (
                    (*last[key][1], key),
                    f"has no effect {words}: trace.file sets arrivals and delays {_LEAVE_OUT}",
                )
        return
    delay, jitter, reorder = link.delay_s or 0.0, link.jitter, link.reorder
    if jitter is not None and jitter.spread_s > 0.0:
        at = (*last["jitter"][1], "jitter")
        reach = jitter.spread_s * _REACH_BELOW.get(jitter.distribution, 0.0)
        # netem replaces a negative delay by 0
        if reach > delay and link.arithmetic != "netem":
            yield (
                (*at, "spread_s"),
                f"{jitter.spread_s:g} s reaches {reach:.4g} s below delay_s {words}, {delay:g} s: "
                "messages would arrive before they are sent (write less, or a longer delay_s)",
            )
        if jitter.distribution == "lognormal" and delay < _MIN_LOGNORMAL_MEAN * jitter.spread_s:
            yield (
                (*at, "distribution"),
                f"is lognormal with mean delay_s, and delay_s is {delay:g} s {words} (write a "
                "longer delay_s)",
            )
    if reorder is not None and reorder.probability > 0.0:
        at = (*last["reorder"][1], "reorder")
        if jitter is not None and jitter.in_order:
            yield at, f"lets packets overtake, which jitter.in_order prevents {_LEAVE_OUT}"
        elif jitter is None and delay == 0.0:
            yield (
                at,
                f"lets packets overtake delayed ones, and delay_s is 0 {words} (write a delay_s)",
            )


def _deciding_entries(
    network: Network, source: str, destination: str
) -> dict[str, tuple[int, KeyPath]]:
    """Return rank and path of the most specific entry by key of a link."""
    last = dict.fromkeys(Link.model_fields, (0, _AT))
    ends = ((ANY, ANY), (ANY, destination), (source, ANY), (source, destination))
    for rank, (sender, receiver) in enumerate(ends, start=1):
        special = network.links.get(sender, {}).get(receiver)
        for key in last:
            if getattr(special, key, None) is not None:
                last[key] = (rank, (*_AT, "links", sender, receiver))
    return last
