"""What one key of a link demands of another, on the page and where several places meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from testbed.scenario.link import (
    SHORTEST_SLOT_S,
    Curve,
    FourState,
    GilbertElliott,
    Jitter,
    Link,
    Loss,
    Slots,
)
from testbed.scenario.network import ANY, Network

Path = tuple[str | int, ...]
Finding = tuple[Path, str]
AT: Path = ("network",)
_OF_THE_TRACE = ("loss", "delay_s", "jitter")  # what a trace takes the place of
_LEAVE = "(leave one of them out)"
# How far below its mean a distribution reaches, in spread_s; normal ones have no end.
_REACHES_BELOW = {"uniform": 1.0, "pareto": 3.0**-0.5}  # of shape 3
_LEAST_MEAN = 1e-3  # of a lognormal distribution, in spread_s


def check_links(network: Network, names: Sequence[str]) -> Iterator[Finding]:
    """Yield what is wrong at each place that describes a link, and where several of them meet."""
    for at, link in sections(network):
        yield from _alone(at, link)
    seen = set()
    for source, destination in _pairs(network, names):
        for finding in _together(network, source, destination):
            if finding[0] not in seen:  # what many links have in common is said of the first
                seen.add(finding[0])
                yield finding


def sections(network: Network) -> Iterator[tuple[Path, Link]]:
    """Every place of the page that describes a link: first all links, then special ones."""
    yield AT, network
    for sender, receivers in network.links.items():
        for receiver, link in receivers.items():
            yield (*AT, "links", sender, receiver), link


def refuse_window(at: Path, window: tuple[float, float]) -> Iterator[Finding]:
    """Yield a finding unless the window begins before it ends."""
    begin, end = window
    if begin >= end:
        yield at, f"[{begin:g}, {end:g}] is not a window (write [from, to] in s)"


def _alone(at: Path, link: Link) -> Iterator[Finding]:
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
        yield from refuse_window((*at, "blackout_s", index), window)


def _loss(at: Path, loss: Loss) -> Iterator[Finding]:
    if isinstance(loss, GilbertElliott) and loss.p == loss.r == 0.0:
        yield at, "p and r are both 0: the state never changes (write one of them above 0)"
    if isinstance(loss, FourState):
        for first, second in (("p13", "p14"), ("p31", "p32")):
            total = getattr(loss, first) + getattr(loss, second)
            if total > 1.0:
                yield (
                    (*at, second),
                    f"{first} + {second} is {total:g}, and both leave the same state (write at "
                    "most 1 for the sum)",
                )


def _jitter(at: Path, jitter: Jitter) -> Iterator[Finding]:
    if jitter.distribution == "empirical":
        if jitter.file is None:
            yield (*at, "file"), "is missing (write the name of a CSV file with a column delay_s)"
        if jitter.spread_s:
            yield (
                (*at, "spread_s"),
                "is that of the file, for distribution: empirical (leave this out)",
            )
    elif jitter.file is not None:
        yield (
            (*at, "file"),
            f"belongs to distribution: empirical, and the distribution is {jitter.distribution} "
            f"{_LEAVE}",
        )


def _slots(at: Path, slots: Slots) -> Iterator[Finding]:
    shortest, longest = slots.every_s
    if longest < shortest or shortest == 0.0 < longest:
        yield (
            at,
            f"[{shortest:g}, {longest:g}] is not a range of times (write [shortest, longest], "
            "both above 0)",
        )
    elif 0.0 < shortest < SHORTEST_SLOT_S:
        yield at, f"{shortest:g} s is too short for a slot (write at least {SHORTEST_SLOT_S:g})"


def _curve(at: Path, curve: Curve, what: str) -> Iterator[Finding]:
    for index in range(1, len(curve)):
        before, here = curve[index - 1][0], curve[index][0]
        if here <= before:
            yield (
                (*at, index, 0),
                f"{here:g} does not increase from {before:g} (write the {what} in rising order)",
            )


def _pairs(network: Network, names: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Links that stand for all: the page's own, and one of those it does not tell apart."""
    sources = {*network.links} - {ANY}
    destinations = {receiver for each in network.links.values() for receiver in each} - {ANY}
    others = [name for name in names if name not in sources][:1]
    silent = [name for name in names[1:] if name not in destinations]
    for source in (name for name in names if name in sources or name in others):
        rest = [name for name in silent if name != source][:1]
        for destination in names[1:]:
            if destination != source and (destination in destinations or destination in rest):
                yield source, destination


def _together(network: Network, source: str, destination: str) -> Iterator[Finding]:
    """What does not go together on a link, at the place that has the last word on it."""
    link = network.link(source, destination)
    last = _last_words(network, source, destination)
    words = f"from {source} to {destination}"
    if link.trace is not None:
        for key in _OF_THE_TRACE:
            # in a less special place it is for the links that have no trace
            if getattr(link, key) and last[key][0] >= last["trace"][0]:
                yield (
                    (*last[key][1], key),
                    f"has no say {words}: trace.file has all that arrives, and when {_LEAVE}",
                )
        return
    delay, jitter, reorder = link.delay_s or 0.0, link.jitter, link.reorder
    if jitter is not None and jitter.spread_s > 0.0:
        at = (*last["jitter"][1], "jitter")
        reach = jitter.spread_s * _REACHES_BELOW.get(jitter.distribution, 0.0)
        # netem sends at once what its dice would send sooner
        if reach > delay and link.arithmetic != "netem":
            yield (
                (*at, "spread_s"),
                f"{jitter.spread_s:g} s reaches {reach:.4g} s below delay_s {words}, {delay:g} s: "
                "messages would arrive before they are sent (write less, or a longer delay_s)",
            )
        if jitter.distribution == "lognormal" and delay < _LEAST_MEAN * jitter.spread_s:
            yield (
                (*at, "distribution"),
                f"is lognormal, whose mean is delay_s, and that is {delay:g} s {words} (write a "
                "longer delay_s)",
            )
    if reorder is not None and reorder.probability > 0.0:
        at = (*last["reorder"][1], "reorder")
        if jitter is not None and jitter.in_order:
            yield at, f"lets packets overtake, and jitter.in_order does not {_LEAVE}"
        elif jitter is None and delay == 0.0:
            yield (
                at,
                f"lets packets overtake those that wait, and delay_s is 0 {words} (write a "
                "delay_s)",
            )


def _last_words(network: Network, source: str, destination: str) -> dict[str, tuple[int, Path]]:
    """By key, how special the place is that has the last word on a link, and the place."""
    last = dict.fromkeys(Link.model_fields, (0, AT))
    ends = ((ANY, ANY), (ANY, destination), (source, ANY), (source, destination))
    for rank, (sender, receiver) in enumerate(ends, start=1):
        special = network.links.get(sender, {}).get(receiver)
        for key in last:
            if getattr(special, key, None) is not None:
                last[key] = (rank, (*AT, "links", sender, receiver))
    return last
