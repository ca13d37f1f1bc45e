"""The channel of a page: what holds on every link, as tables that dice and clocks work on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.csv_table import read_table
from testbed.network import delays
from testbed.network.links import (
    BERNOULLI,
    CORRUPT,
    DELAY,
    DUPLICATE,
    EMPIRICAL,
    FOUR_STATE,
    GILBERT_ELLIOTT,
    LINK,
    LOGNORMAL,
    LOSS,
    NORMAL,
    PARETO,
    PARETONORMAL,
    REORDER,
    UNIFORM,
    Links,
)
from testbed.network.philox import key_of
from testbed.scenario.link import (
    Bernoulli,
    Chance,
    FourState,
    GilbertElliott,
    Jitter,
    Link,
    Reorder,
)
from testbed.scenario.network import Network, Tdma
from testbed.scenario.resolve import find_data
from testbed.state import Array, Truths

JITTERS = {
    "uniform": UNIFORM,
    "normal": NORMAL,
    "lognormal": LOGNORMAL,
    "pareto": PARETO,
    "paretonormal": PARETONORMAL,
    "empirical": EMPIRICAL,
}
WHOLE = 0xFFFFFFFF  # netem's number for always
NETEM_LONGEST_S = 0x7FFFFFFF / delays.NANOSECONDS  # netem has 32 bits for a jitter


class Channel(NamedTuple):
    """The channel between N aircraft and their n followers."""

    names: tuple[str, ...]  # N
    links: Links  # (n, N) of links.LINK
    keys: NDArray[np.uint64]  # (n, N, 2) of their dice
    quantiles: Array  # (T, delays.TABLE_STEPS + 1) s
    tables: NDArray[np.int16]  # (U, delays.NETEM_TABLE)


def make_channel(
    names: Sequence[str], network: Network, seed: int, heeded: Truths | None = None
) -> Channel:
    """The channel of a page's network.

    Args:
        names: N, the leader first, who does not listen.
        network: the section of the page.
        seed: of the run; with the names of a link it makes the key of its dice.
        heeded: (n, N) whose messages followers listen to; None: everyone's.

    Raises:
        InputError: a file of delays cannot be read.
    """
    links = np.zeros((len(names) - 1, len(names)), dtype=LINK)
    keys = np.zeros((*links.shape, 2), dtype=np.uint64)
    quantiles: list[Array] = []
    tables: list[NDArray[np.int16]] = []
    made: dict[tuple[Link, str], Links] = {}  # links that are alike are made once
    for i, receiver in enumerate(names[1:]):
        for m, sender in enumerate(names):
            keys[i, m] = key_of(seed, f"network/{sender}>{receiver}")
            if sender == receiver:
                links[i, m]["own"] = True
                continue
            if heeded is not None and not heeded[i, m]:
                links[i, m]["unheard"] = True
                continue
            link = network.link(sender, receiver)
            alike = link, sender if network.tdma else ""
            if alike not in made:
                made[alike] = _record(network, link, sender, names, quantiles, tables)
            links[i, m] = made[alike]
    return Channel(
        tuple(names),
        links,
        keys,
        np.array(quantiles).reshape(-1, delays.TABLE_STEPS + 1),
        np.array(tables, dtype=np.int16).reshape(-1, delays.NETEM_TABLE),
    )


def _record(
    network: Network,
    link: Link,
    sender: str,
    names: Sequence[str],
    quantiles: list[Array],
    tables: list[NDArray[np.int16]],
) -> Links:
    """The record of one link; tables of delays that it needs are added."""
    record = np.zeros((), dtype=LINK)
    record["gap"] = record["per_slot"] = record["bits"] = 1
    record["netem"] = link.arithmetic == "netem"
    record["delay"] = link.delay_s
    _put_loss(record, link)
    for event, chance in (
        (DUPLICATE, link.duplicate),
        (CORRUPT, link.corrupt),
        (REORDER, link.reorder),
    ):
        _put_chance(record, event, chance)
    if link.corrupt:
        record["bits"] = link.corrupt.bits
    if link.reorder:
        record["gap"] = link.reorder.gap
    if link.jitter:
        _put_jitter(record, link.jitter, quantiles, tables)
    queues = []
    if link.rate and link.rate.bit_per_s:
        bits = 8 * (network.sent_bytes + link.rate.overhead_bytes)
        record["service"] = bits / link.rate.bit_per_s
        queues.append(link.rate.queue_packets)
    if link.slots and link.slots.every_s[1]:
        record["slot"], record["first_slot"] = link.slots.every_s, link.slots.first_s
        record["per_slot"] = link.slots.packets
        queues.append(link.slots.queue_packets)
    elif network.tdma and not link.slots:
        _put_turn(record, network.tdma, names, sender)
        queues.append(network.tdma.queue_packets)
    record["queue"] = min(queues, default=0)
    return record


def _put_loss(record: Links, link: Link) -> None:
    loss = link.loss
    if isinstance(loss, Bernoulli):
        record["loss"] = BERNOULLI if loss.probability else 0
        _put_chance(record, LOSS, loss)
    elif isinstance(loss, GilbertElliott):
        record["loss"] = GILBERT_ELLIOTT
        record["p"][:4] = loss.p, loss.r, loss.loss_bad, loss.loss_good
    elif isinstance(loss, FourState):
        record["loss"] = FOUR_STATE
        record["p"] = loss.p13, loss.p31, loss.p32, loss.p23, loss.p14


def _put_chance(record: Links, event: int, chance: Chance | Reorder | None) -> None:
    """A two-state chain with this share of events and this correlation from one to the next."""
    if chance is None:
        return
    p, rho = chance.probability, chance.correlation
    record["after_none"][event] = p * (1.0 - rho)
    record["after_one"][event] = p + rho * (1.0 - p)
    record["share"][event] = _netem(p)
    record["blend"][event] = _netem(rho)


def _netem(part: float) -> int:
    """A part of one as netem's number of 32 bits."""
    return round(part * WHOLE)


def _put_jitter(
    record: Links, jitter: Jitter, quantiles: list[Array], tables: list[NDArray[np.int16]]
) -> None:
    record["in_order"] = jitter.in_order
    if not (jitter.spread_s or jitter.distribution == "empirical"):
        return
    kind = JITTERS[jitter.distribution]
    record["jitter"], record["spread"] = kind, jitter.spread_s
    if record["netem"]:
        record["spread"] = min(jitter.spread_s, NETEM_LONGEST_S)
    record["blend"][DELAY] = _netem(jitter.correlation)
    delay = float(record["delay"])
    if kind == LOGNORMAL:
        record["shape"] = delays.log_shape(delay, jitter.spread_s)
    if kind == EMPIRICAL and jitter.file:
        table = read_table(find_data(jitter.file))
        samples = table.numbers(["delay_s"])[:, 0]
        if not samples.size:
            raise table.refusal(0, "no rows; write at least one delay_s below the header")
        least = int(samples.argmin())
        if delay + samples[least] < 0.0 and not record["netem"]:
            raise table.refusal(
                least + 1,
                f"delay_s {samples[least]:g} s and the page's {delay:g} s are less than none: "
                "messages would arrive before they are sent (write a longer delay_s on the page)",
            )
        record["table"] = len(quantiles)
        quantiles.append(delays.quantiles(samples))
    one = record.reshape(1).copy()  # as it is now, for netem reads other fields

    def value_of(z: Array) -> Array:
        """Delay less the mean that the page names, before it is cut at 0."""
        return delays.varied(np.broadcast_to(one, z.shape), z, np.array(quantiles))

    record["rho"] = delays.normal_correlation(value_of, jitter.correlation)
    if record["netem"] and kind != UNIFORM:
        mean, deviation = _moments(value_of)
        if kind == EMPIRICAL:
            record["delay"], record["spread"] = delay + mean, deviation

        def standard(z: Array) -> Array:
            return (value_of(z) - mean) / max(deviation, 1e-12)

        record["table"] = len(tables)
        tables.append(delays.netem_table(kind, None if kind == NORMAL else standard))


def _moments(value_of: Callable[[Array], Array]) -> tuple[float, float]:
    """Mean and standard deviation over the quantiles of a table."""
    value = value_of(delays.table_z())
    return float(value.mean()), float(value.std())


def _put_turn(record: Links, tdma: Tdma, names: Sequence[str], sender: str) -> None:
    """The sender's slot of each frame."""
    order = tdma.order or tuple(names)
    record["slot"] = tdma.frame_s
    record["first_slot"] = order.index(sender) * tdma.frame_s / len(order)
    record["per_slot"] = tdma.packets
