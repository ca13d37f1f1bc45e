"""The channel of a scenario: parameters, tables and initial state of every link."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import NamedTuple

import numpy as np

from testbed.core import ranges
from testbed.core.csv_table import read_table
from testbed.core.reads import unrecorded
from testbed.core.records import Array, BoolArray, Records, allocate
from testbed.network import delays
from testbed.network.clocks import CLOCK
from testbed.network.links import (
    BERNOULLI,
    CORRUPT,
    DELAY,
    DELAY_TABLE,
    DUPLICATE,
    EMPIRICAL,
    FOUR_STATE,
    GILBERT_ELLIOTT,
    JITTERS,
    LINK_PARAMETERS,
    LINK_STATE,
    LOGNORMAL,
    LOSS,
    NETEM_ONE,
    NORMAL,
    PACKET,
    REORDER,
    START,
    UNIFORM,
    PairLinks,
)
from testbed.network.packet_random import jitter_values
from testbed.network.philox import Words, key_of, philox, unit
from testbed.scenario.network import (
    Bernoulli,
    FourState,
    GilbertElliott,
    Jitter,
    Link,
    Network,
    PacketEvent,
    Reorder,
    Tdma,
)
from testbed.scenario.references import find_data

COLUMNS: Mapping[str, ranges.Range] = {"delay_s": ranges.ADDED_DELAY}  # of a file of delays
NETEM_LONGEST_S = 0x7FFFFFFF / delays.NANOSECONDS  # netem has 32 bits for a jitter


class Channel(NamedTuple):
    """The channel between N aircraft and their n followers."""

    names: tuple[str, ...]  # N
    links: Records  # (n, N) of LINK_PARAMETERS
    tables: Records  # (T,) of DELAY_TABLE, one at least


def make_channel(
    pairs: PairLinks, seed: int, subscribed: BoolArray | None = None, payload_bytes: int = 0
) -> Channel:
    """Make the channel of a scenario's network.

    Args:
        pairs: the links of N aircraft.
        seed: of the run; with the names of a link it gives the key of its random numbers.
        subscribed: (n, N) whether followers use the messages of aircraft; None: all.
        payload_bytes: of a law's own in each packet, in a second message.

    Raises:
        InputError: a file of delays cannot be read.
    """
    names, network = pairs.names, pairs.network
    links = allocate(LINK_PARAMETERS, len(names) - 1, len(names))
    tables: list[Array] = []
    made: dict[tuple[int, str, bool], Records] = {}  # equal links are made once
    for i, receiver in enumerate(names[1:]):
        for m, sender in enumerate(names):
            if sender == receiver:
                links["own"][i, m] = True
            elif subscribed is not None and not subscribed[i, m]:
                links["unsubscribed"][i, m] = True
            else:
                number = int(pairs.numbers[i, m])
                same = number, sender if network.tdma else "", m == 0
                if same not in made:
                    link = pairs.distinct[number]
                    added = payload_bytes if m else 0  # the leader has no law
                    made[same] = _parameters(network, link, sender, names, tables, added)
                links[i, m] = made[same]
            links["key"][i, m] = key_of(seed, f"network/{sender}>{receiver}")
    records = allocate(DELAY_TABLE, max(len(tables), 1))
    for record, values in zip(records, tables, strict=False):
        record["values"][: len(values)] = values
    return Channel(names, links, records)


def _parameters(
    network: Network,
    link: Link,
    sender: str,
    names: Sequence[str],
    tables: list[Array],
    added_bytes: int,
) -> Records:
    """Return the parameters () of one link; tables that it needs are added."""
    record = np.zeros((), dtype=LINK_PARAMETERS)
    record["gap"] = record["per_slot"] = record["bits"] = 1
    random = link.loss, link.duplicate, link.corrupt, link.reorder, link.jitter
    with nullcontext() if any(each is not None for each in random) else unrecorded():
        record["netem"] = link.arithmetic == "netem"
    record["delay"] = link.delay_s
    _set_loss(record, link)
    for event, chance in (
        (DUPLICATE, link.duplicate),
        (CORRUPT, link.corrupt),
        (REORDER, link.reorder),
    ):
        _set_event(record, event, chance)
    if link.corrupt and link.corrupt.probability:
        record["bits"] = link.corrupt.bits
    if link.reorder and link.reorder.probability:
        record["gap"] = link.reorder.gap
    if link.jitter:
        _set_jitter(record, link.jitter, tables)
    events = record["after_none"].any() or record["after_one"].any()
    record["random"] = events or record["loss"] or record["jitter"]
    queues = []
    if link.rate and link.rate.bit_per_s:
        bits = 8 * (network.sent_bytes + added_bytes + link.rate.overhead_bytes)
        record["service"] = bits / link.rate.bit_per_s
        queues.append(link.rate.queue_packets)
    if link.slots and link.slots.every_s[1]:
        record["slot"], record["first_slot"] = link.slots.every_s, link.slots.first_s
        record["per_slot"] = link.slots.packets
        queues.append(link.slots.queue_packets)
    elif network.tdma and not link.slots:
        _set_tdma_slot(record, network.tdma, names, sender)
        queues.append(network.tdma.queue_packets)
    record["queue"] = min(queues, default=0)
    return record


def _set_loss(record: Records, link: Link) -> None:
    loss = link.loss
    if isinstance(loss, Bernoulli):
        record["loss"] = BERNOULLI if loss.probability else 0
        _set_event(record, LOSS, loss)
    elif isinstance(loss, GilbertElliott):
        record["loss"] = GILBERT_ELLIOTT
        record["p"][:4] = loss.p, loss.r, loss.loss_bad, loss.loss_good
    elif isinstance(loss, FourState):
        record["loss"] = FOUR_STATE
        record["p"] = loss.p13, loss.p31, loss.p32, loss.p23, loss.p14


def _set_event(record: Records, event: int, chance: PacketEvent | Reorder | None) -> None:
    """Set a two-state Markov chain with this probability and lag-1 correlation."""
    if chance is None:
        return
    p = chance.probability
    with nullcontext() if 0.0 < p else unrecorded():  # nothing is correlated with it
        rho = chance.correlation
    record["after_none"][event] = p * (1.0 - rho)
    record["after_one"][event] = p + rho * (1.0 - p)
    record["share"][event] = _netem_number(p)
    record["blend"][event] = _netem_number(rho)


def _netem_number(part: float) -> int:
    """Return a probability or correlation as netem's number of 32 bits."""
    return round(part * NETEM_ONE)


def _set_jitter(record: Records, jitter: Jitter, tables: list[Array]) -> None:
    varies = jitter.spread_s or jitter.distribution == "empirical"
    # packets with one delay overtake each other by `reorder` alone
    with nullcontext() if varies or record["share"][REORDER] else unrecorded():
        record["in_order"] = jitter.in_order
    if not varies:
        return
    kind = JITTERS.index(jitter.distribution)
    record["jitter"], record["spread"] = kind, jitter.spread_s
    if record["netem"]:
        record["spread"] = min(jitter.spread_s, NETEM_LONGEST_S)
    record["blend"][DELAY] = _netem_number(jitter.correlation)
    delay = float(record["delay"])
    if kind == LOGNORMAL:
        record["lognormal"] = delays.log_moments(delay, jitter.spread_s)
    quantiles = None
    if kind == EMPIRICAL and jitter.file:
        quantiles = _read_quantiles(jitter.file, delay, netem=bool(record["netem"]))
    parameters, table = allocate(LINK_PARAMETERS, 1), allocate(DELAY_TABLE, 1)
    parameters[0] = record  # as it is now; netem uses other fields
    if quantiles is not None:
        table["values"][0, : len(quantiles)] = quantiles

    def value_of(z: Array) -> Array:
        """Return the delay, minus the scenario's mean, before it is limited to 0."""
        return jitter_values(parameters, z, table)

    record["rho"] = delays.normal_correlation(value_of, jitter.correlation)
    if record["netem"] and kind != UNIFORM:
        mean, deviation = _moments(value_of)
        if kind == EMPIRICAL:
            record["delay"], record["spread"] = delay + mean, deviation

        def standard(z: Array) -> Array:
            return (value_of(z) - mean) / max(deviation, 1e-12)

        entries = delays.netem_table(kind, None if kind == NORMAL else standard)
        record["table"] = len(tables)
        tables.append(entries.astype(float))
    elif quantiles is not None:
        record["table"] = len(tables)
        tables.append(quantiles)


def _read_quantiles(file: str, delay: float, *, netem: bool) -> Array:
    """Return the quantiles (TABLE_STEPS + 1,) s of a file of delays.

    Raises:
        InputError: it cannot be read, has no rows, or gives negative or too long delays.
    """
    table = read_table(find_data(file))
    samples = table.numbers(COLUMNS)[:, 0]
    if not samples.size:
        raise table.error_at(0, "no rows; write at least one delay_s below the header")
    least = int(samples.argmin())
    if delay + samples[least] < 0.0 and not netem:
        raise table.error_at(
            least + 1,
            f"delay_s {samples[least]:g} s plus the scenario's {delay:g} s is negative: "
            "messages would arrive before they are sent (write a longer delay_s in the scenario)",
        )
    most = int(samples.argmax())
    if delay + samples[most] > ranges.DELAY.high:
        raise table.error_at(
            most + 1,
            f"delay_s {samples[most]:g} s plus the scenario's {delay:g} s is above "
            f"{ranges.DELAY.high:g} s, the most that {ranges.DELAY.key} allows (write s, or remove "
            "the row)",
        )
    return delays.quantiles(samples)


def _moments(value_of: Callable[[Array], Array]) -> tuple[float, float]:
    """Return mean and standard deviation over the quantiles of a table."""
    value = value_of(delays.table_z())
    return float(value.mean()), float(value.std())


def _set_tdma_slot(record: Records, tdma: Tdma, names: Sequence[str], sender: str) -> None:
    order = tdma.order or tuple(names)
    record["slot"] = tdma.frame_s
    record["first_slot"] = order.index(sender) * tdma.frame_s / len(order)
    record["per_slot"] = tdma.packets


# One directed link.
CHANNEL_LINK = np.dtype(
    [("parameters", LINK_PARAMETERS), ("state", LINK_STATE), ("packet", PACKET)], align=True
)
# One aircraft's transmitter.
TRANSMITTER = np.dtype(
    [
        ("clock", CLOCK),
        ("number", "i8"),  # sequence number of the last message; -1: none
        ("stamp_s", "f8"),  # its time stamp, by the clock
        ("sender", "i8"),  # in element k: row of the k-th aircraft that sends now
    ],
    align=True,
)


def initial_links(channel: Channel) -> Records:
    """Return the links (n, N) of CHANNEL_LINK before the first packet.

    Exact Markov chains start in their stationary distribution, so that the first packets are lost
    as often as all others; those of netem start in the good state.
    """
    links = allocate(CHANNEL_LINK, *channel.links.shape)
    parameters = channel.links
    links["parameters"] = parameters
    state, packet = links["state"], links["packet"]
    state["z"] = packet["trace_delay_s"] = np.nan
    state["free"] = state["latest"] = -np.inf
    state["slot_at"], state["slot_left"] = parameters["first_slot"], parameters["per_slot"]
    key0, key1 = parameters["key"][..., 0], parameters["key"][..., 1]
    first, last = philox(key0, key1, 0, 0, START), philox(key0, key1, 0, 1, START)
    state["blended"] = np.stack([*first, last[0]], axis=-1)
    exact = ~parameters["netem"]
    state["had"] = _initial_events(parameters, np.stack(first, axis=-1)) & exact[..., None]
    state["chain"] = np.where(exact, _initial_chains(parameters, last[1]), 0)
    packet["arrival_s"] = packet["corrupted_s"] = np.inf
    return links


def initial_departures(channel: Channel) -> Array:
    """Return the rings (n, N, Q) of the times of the last departures, s."""
    longest = int(channel.links["queue"].max(initial=0))
    return np.full((*channel.links.shape, longest), -np.inf)


def initial_transmitters(aircraft: int, clocks: Records | None = None) -> Records:
    """Return the transmitters (N,) of aircraft before the first message.

    Args:
        aircraft: N.
        clocks: (N,) of CLOCK; None: all are exact.
    """
    transmitters = allocate(TRANSMITTER, aircraft)
    transmitters["number"] = -1
    if clocks is not None:
        transmitters["clock"] = clocks
    return transmitters


def _initial_events(parameters: Records, words: Words) -> Array:
    """Return whether the packet before the first had each event (..., 4)."""
    after_none, after_one = parameters["after_none"], parameters["after_one"]
    had: Array = unit(words) < after_none / (1.0 - (after_one - after_none))
    return had


def _initial_chains(parameters: Records, words: Words) -> Array:
    """Return the initial states (...) of the loss models.

    They are good where the good state would not recur.
    """
    u, p = unit(words), np.moveaxis(parameters["p"], -1, 0)
    gilbert = u * (p[0] + p[1]) < p[0]
    p13, p31, p32, p23, p14 = p
    # the stationary distribution of the four states; see Salsano et al. (2012)
    weights = np.stack([p31 * p23, p13 * p32, p13 * p23, p14 * p31 * p23])
    four = np.sum(u * weights.sum(axis=0) >= np.cumsum(weights, axis=0)[:-1], axis=0)
    chains: Array = np.select(
        [
            (parameters["loss"] == GILBERT_ELLIOTT) & (p[1] > 0.0),
            (parameters["loss"] == FOUR_STATE) & (weights[0] > 0.0),
        ],
        [gilbert, four],
        0,
    )
    return chains
