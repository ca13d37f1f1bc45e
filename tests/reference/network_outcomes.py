"""Outcomes and arrival times of packets: all links of a broadcast at once, in numpy."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr as probability

from testbed.core.records import Array, BoolArray, Records
from testbed.network.channel import Channel, initial_departures, initial_links
from testbed.network.delays import (
    NANOSECONDS,
    NETEM_PARETO,
    NETEM_SCALE,
    NORMAL_SHARE,
    PARETO_DEVIATION,
    PARETO_MEAN,
    PARETO_SHAPE,
    TABLE_STEPS,
    mixed_deviation,
)
from testbed.network.links import (
    BERNOULLI,
    CORRUPT,
    DELAY,
    DUPLICATE,
    EMPIRICAL,
    FOUR_STATE,
    GILBERT_ELLIOTT,
    LOGNORMAL,
    LOSS,
    NETEM_ONE,
    NETEM_TABLE,
    NO_JITTER,
    NORMAL,
    OUTCOME,
    PARETO,
    PATH,
    REORDER,
    SLOT,
    UNIFORM,
    Numbers,
    Outcomes,
    PacketOutcome,
)
from testbed.network.packet_outcomes import SIMULTANEOUS_S
from testbed.network.philox import Words, philox, unit


class LinkStates(NamedTuple):
    """What all links keep from one packet to the next."""

    state: Records  # (n, N) of LINK_STATE
    departures_s: Array  # (n, N, Q) s
    corrupted_s: Array  # (n, N, 2) s, arrivals of the corrupted copies of the last packet


def initial_states(channel: Channel) -> LinkStates:
    """Return the states before the first packet."""
    links = initial_links(channel)
    corrupted_s = np.array(links["packet"]["corrupted_s"])
    return LinkStates(np.array(links["state"]), initial_departures(channel), corrupted_s)


def packet_outcomes(
    channel: Channel,
    states: LinkStates,
    rows: Numbers,
    numbers: Numbers,
    sent_s: Array,
    scripted: Outcomes,
    trace_delay_s: Array,
    fading: Array,
) -> tuple[Array, Outcomes]:
    """Return arrivals (n, S, 2) s and outcomes (n, S) of one message of each of S senders.

    Args:
        channel: between N aircraft and n followers.
        states: changed in place.
        rows: (S,) of the senders.
        numbers: (S,) sequence numbers.
        sent_s: (S,) s.
        scripted: (n, S) of PacketOutcome, 0: none.
        trace_delay_s: (n, S) s; infinite: lost, nan: no trace.
        fading: (n, S) probability of a loss to distance and airframes.
    """
    times = np.broadcast_to(sent_s, scripted.shape)
    broadcast = _Broadcast(channel, states, rows, np.broadcast_to(numbers, times.shape), times)
    arrivals, outcomes = broadcast.send(scripted, trace_delay_s, fading)
    states.state[:, rows] = broadcast.state
    states.corrupted_s[:, rows] = broadcast.corrupted_s
    return arrivals, outcomes


class _PacketRandom:
    """Random outcomes of one broadcast; every array is (n, S). `state` is changed in place."""

    def __init__(self, channel: Channel, rows: Numbers, state: Records, numbers: Numbers) -> None:
        self.tables = channel.tables["values"]
        self.link, self.state, self.numbers = channel.links[:, rows], state, numbers
        self.key, self.netem = self.link["key"], self.link["netem"]

    def words(self, copy: int, block: int) -> tuple[Words, Words, Words, Words]:
        return philox(self.key[..., 0], self.key[..., 1], self.numbers, copy, block)

    def event(self, event: int, word: Words, where: BoolArray) -> BoolArray:
        """Return whether an event occurs, where asked."""
        share, had = self.link["share"][..., event], self.state["had"][..., event]
        drawn = self.correlated(event, word, where & (share > 0))
        after_one, after_none = (
            self.link[name][..., event] for name in ("after_one", "after_none")
        )
        exact = unit(word) < np.where(had > 0, after_one, after_none)
        occurs: BoolArray = np.where(self.netem, (share > 0) & (share >= drawn), exact) & where
        had[where] = occurs[where]
        return occurs

    def correlated(self, event: int, word: Words, where: BoolArray) -> Words:
        """Return netem's blend of a word with the last one."""
        blend, before = self.link["blend"][..., event], self.state["blended"][..., event]
        rest = np.uint64(NETEM_ONE) - blend  # netem adds one to the blend and has 2^32 for one
        mixed = (word * rest + before * (blend + np.uint64(1))).astype(np.uint64)
        drawn: Words = np.where(blend > 0, mixed >> np.uint64(32), word)
        keep = where & self.netem & (blend > 0)
        before[keep] = drawn[keep]
        return drawn

    def lost(self, word: Words, second: Words, where: BoolArray) -> BoolArray:
        """Return whether the loss model loses a packet, where asked."""
        model, chain = self.link["loss"], self.state["chain"]
        lost = self.event(LOSS, word, where & (model == BERNOULLI))
        u, v = unit(word), unit(second)
        p = np.moveaxis(self.link["p"], -1, 0)
        if (chosen := where & (model == GILBERT_ELLIOTT)).any():
            good = chain == 0
            lost |= chosen & (v < np.where(good, p[3], p[2]))
            chain[chosen] = np.where(u < np.where(good, p[0], p[1]), good, ~good)[chosen]
        if (chosen := where & (model == FOUR_STATE)).any():
            after = _four_state(chain, u, p)
            lost |= chosen & ((after == 2) | (after == 3))
            chain[chosen] = after[chosen]
        return lost

    def exact_delay(self, word: Words, second: Words, where: BoolArray) -> Array:
        """Return delays, s, from the normal process behind them."""
        link, state = self.link, self.state
        normal = np.sqrt(-2.0 * np.log(unit(word))) * np.cos(2.0 * np.pi * unit(second))
        rho = link["rho"]
        z = np.where(
            np.isnan(state["z"]), normal, rho * state["z"] + np.sqrt(1.0 - rho * rho) * normal
        )
        jittery = where & (link["jitter"] != NO_JITTER)
        state["z"][jittery] = z[jittery]
        delay: Array = link["delay"].copy()
        for at in np.argwhere(jittery):
            one, score = link[tuple(at)], z[tuple(at)][np.newaxis]
            quantiles = self.tables[one["table"], : TABLE_STEPS + 1]
            if one["jitter"] == EMPIRICAL:
                more = interpolate_quantiles(quantiles, score)
            else:
                more = jitter_of(one, score, None)
            delay[tuple(at)] = max(one["delay"] + more[0], 0.0)
        return delay

    def netem_delay(self, word: Words, where: BoolArray) -> Array:
        """Return delays, s, as netem's `tabledist` computes them."""
        link = self.link
        where = where & (link["jitter"] != NO_JITTER)
        delay: Array = link["delay"].copy()
        if not where.any():
            return delay
        drawn = self.correlated(DELAY, word, where)
        spread = np.rint(link["spread"] * NANOSECONDS)
        width = np.maximum(2.0 * spread, 1.0).astype(np.uint64)
        more = (drawn % width).astype(np.float64) - spread
        tabled = where & (link["jitter"] != UNIFORM)
        places = (drawn[tabled] % np.uint64(NETEM_TABLE)).astype(np.int64)
        entry = self.tables[link["table"][tabled], places]
        more[tabled] = np.rint(spread[tabled] * entry / NETEM_SCALE)
        delay[where] = np.maximum(delay + more / NANOSECONDS, 0.0)[where]
        return delay


def _four_state(chain: NDArray[np.int64], u: Array, p: Array) -> NDArray[np.int64]:
    """Return the next state: 0 received in a gap, 1 in a burst, 2 lost in a burst, 3 alone."""
    p13, p31, p32, p23, p14 = p
    from_gap = np.where(u < p14, 3, np.where(u < p14 + p13, 2, 0))
    from_received = np.where(u < p23, 2, 1)
    from_burst = np.where(u < p32, 1, np.where(u < p32 + p31, 0, 2))
    after: NDArray[np.int64] = np.choose(chain, [from_gap, from_received, from_burst, 0])
    return after


class _Broadcast:
    """One message of each of S senders on its way; every array is (n, S)."""

    def __init__(
        self, channel: Channel, states: LinkStates, rows: Numbers, numbers: Numbers, sent_s: Array
    ) -> None:
        self.departures_s, self.rows, self.sent_s = states.departures_s, rows, sent_s
        self.state = states.state[:, rows]
        self.corrupted_s = np.full((*sent_s.shape, 2), np.inf)
        self.random = _PacketRandom(channel, rows, self.state, numbers)
        self.link, self.netem = self.random.link, self.random.netem

    def send(
        self, scripted: Outcomes, trace_delay_s: Array, fading: Array
    ) -> tuple[Array, Outcomes]:
        """Return arrivals (n, S, 2) and outcomes."""
        own, unsubscribed = self.link["own"], self.link["unsubscribed"]
        other, exact = ~(own | unsubscribed), ~self.netem
        words = self.random.words(0, OUTCOME)
        lost = self.random.lost(words[0], words[1], other)
        twice = self.random.event(DUPLICATE, words[3], other)
        traced = ~np.isnan(trace_delay_s)
        lost = np.where(traced, np.isinf(trace_delay_s), lost)
        dropped = lost & (traced | ~(self.netem & twice))

        sending = other & (scripted != PacketOutcome.MUTED)
        departs, full = self.leave(sending & exact)
        arrivals = np.full((*departs.shape, 2), np.inf)
        alive = sending & ~dropped & ~full
        corrupt = self.random.event(CORRUPT, self.random.words(0, PATH)[0], alive)
        full |= alive & self.netem & self.queue_is_full()
        alive &= ~full
        cloned = self.netem & twice & ~lost & alive
        if cloned.any():  # netem's second copy enters the queue before the first
            second = self.random.words(1, OUTCOME)
            cloned &= ~self.random.lost(second[0], second[1], cloned & ~traced)
            self.travel(1, cloned, self.second_corrupt(cloned), departs, trace_delay_s, arrivals)
        self.travel(0, alive, corrupt, departs, trace_delay_s, arrivals)
        copied = exact & twice & alive
        if copied.any():
            self.travel(1, copied, self.second_corrupt(copied), departs, trace_delay_s, arrivals)

        arrived = np.isfinite(arrivals).any(axis=2)
        corrupted = PacketOutcome.CORRUPTED
        why = np.where(full, PacketOutcome.QUEUE, np.where(dropped, PacketOutcome.LOST, corrupted))
        outcome = np.where(arrived, PacketOutcome.DELIVERED, why)
        faded = (unit(words[2]) < fading) & ~np.isin(
            outcome, (PacketOutcome.QUEUE, PacketOutcome.LOST)
        )
        outcome = np.where(faded, PacketOutcome.FADED, outcome)
        outcome = np.where(scripted > 0, scripted, outcome)
        arrivals[outcome != PacketOutcome.DELIVERED] = np.inf
        self.corrupted_s[~np.isin(outcome, (PacketOutcome.DELIVERED, corrupted))] = np.inf
        arrivals[own, 0], outcome[own] = self.sent_s[own], PacketOutcome.DELIVERED
        outcome[unsubscribed] = PacketOutcome.UNSUBSCRIBED
        return arrivals, outcome.astype(np.uint8)

    def leave(self, where: BoolArray) -> tuple[Array, BoolArray]:
        """Return when packets have left the queue, s, and which found it full."""
        link, state = self.link, self.state
        departs = self.sent_s.copy()
        full = where & self.queue_is_full()
        where = where & ~full
        timed = where & (link["service"] > 0.0)
        departs[timed] = (np.maximum(departs, state["free"]) + link["service"])[timed]
        state["free"][timed] = departs[timed]
        self.take_slot(departs, where & (link["slot"][..., 1] > 0.0))
        self.queue(departs, where)
        return departs, full

    def second_corrupt(self, where: BoolArray) -> BoolArray:
        """Return whether second copies are corrupted, where asked."""
        return self.random.event(CORRUPT, self.random.words(1, PATH)[0], where)

    def travel(
        self,
        copy: int,
        where: BoolArray,
        corrupt: BoolArray,
        departs: Array,
        trace_delay_s: Array,
        arrivals: Array,
    ) -> None:
        """Write the arrival times, s, of one copy, corrupted ones apart."""
        link, state, random = self.link, self.state, self.random
        words = random.words(copy, PATH)
        netem: BoolArray = where & self.netem
        overtaking = where & (state["passed"] >= link["gap"] - 1)
        overtakes = random.event(REORDER, words[1], overtaking)
        state["passed"][where] = np.where(overtakes, 0, state["passed"] + 1)[where]
        delay = np.where(self.netem, random.netem_delay(words[2], netem & ~overtakes), 0.0)
        exact = where & ~self.netem
        delay[exact] = random.exact_delay(words[2], words[3], exact)[exact]
        delay = np.where(np.isnan(trace_delay_s), delay, trace_delay_s)
        delay[overtakes] = 0.0
        arrives = departs + delay
        self.transmit_late(arrives, delay, netem & ~overtakes)
        kept = where & ~overtakes & link["in_order"]
        arrives[kept] = np.maximum(arrives, state["latest"])[kept]
        moved = where & ~overtakes
        state["latest"][moved] = np.maximum(arrives, state["latest"])[moved]
        good, bad = where & ~corrupt, where & corrupt
        arrivals[good, copy], self.corrupted_s[bad, copy] = arrives[good], arrives[bad]

    def transmit_late(self, arrives: Array, delay: Array, where: BoolArray) -> None:
        """Apply netem's transmitter and slots, which come after the delay, to arrivals."""
        link, latest = self.link, self.state["latest"]
        timed = where & (link["service"] > 0.0)
        late = np.maximum(self.sent_s + delay, latest) + link["service"]
        arrives[timed] = late[timed]
        self.take_slot(arrives, where & (link["slot"][..., 1] > 0.0))
        self.queue(arrives, where)

    def queue_is_full(self) -> BoolArray:
        """Return whether as many packets as may wait have not left yet."""
        full: BoolArray = np.zeros(self.sent_s.shape, dtype=np.bool_)
        for i, s in np.argwhere(self.link["queue"] > 0):
            leaves = self.departures_s[i, self.rows[s], self.state["next_departure"][i, s]]
            full[i, s] = leaves > self.sent_s[i, s] + SIMULTANEOUS_S
        return full

    def queue(self, leaves: Array, where: BoolArray) -> None:
        """Keep when packets leave, s."""
        for i, s in np.argwhere(where & (self.link["queue"] > 0)):
            place = self.state["next_departure"][i, s]
            self.departures_s[i, self.rows[s], place] = leaves[i, s]
            self.state["next_departure"][i, s] = (place + 1) % self.link["queue"][i, s]

    def take_slot(self, times: Array, where: BoolArray) -> None:
        """Move times, s, to the next slot with capacity left."""
        for i, s in np.argwhere(where):
            times[i, s] = _next_slot(self.link[i, s], self.state[i, s], float(times[i, s]))


def _next_slot(link: Records, state: Records, ready_s: float) -> float:
    """Take the first slot with capacity left after a packet is ready; return its time, s."""
    shortest, longest = link["slot"]
    if shortest == longest:
        number = int(np.ceil((ready_s - link["first_slot"]) / longest - SIMULTANEOUS_S))
        number = max(number, int(state["slot_number"]))
        if number > state["slot_number"]:
            state["slot_left"] = link["per_slot"]
        elif state["slot_left"] == 0:
            number, state["slot_left"] = number + 1, link["per_slot"]
        state["slot_number"] = number
        state["slot_at"] = link["first_slot"] + number * longest
    while state["slot_at"] < ready_s - SIMULTANEOUS_S or state["slot_left"] == 0:
        drawn = unit(philox(*link["key"], state["slot_number"], 0, SLOT)[0])
        state["slot_at"] += shortest + (longest - shortest) * drawn
        state["slot_number"] += 1
        state["slot_left"] = link["per_slot"]
    state["slot_left"] -= 1
    return float(state["slot_at"])


def pareto(z: Array) -> Array:
    """Return a Pareto number of mean 0 and standard deviation 1, as a function of z (…)."""
    heavy: Array = probability(-z) ** (-1.0 / PARETO_SHAPE)
    return (heavy - PARETO_MEAN) / PARETO_DEVIATION


def paretonormal(z: Array) -> Array:
    """Return a quarter normal, three quarters Pareto number of mean 0 and standard deviation 1."""
    scale = (1.0 - NORMAL_SHARE) * NETEM_PARETO * PARETO_DEVIATION
    return (NORMAL_SHARE * z + scale * pareto(z)) / mixed_deviation()


def interpolate_quantiles(table: Array, z: Array) -> Array:
    """Return the quantile of a table (TABLE_STEPS + 1,) at Φ(z), for z (…)."""
    out: Array = np.interp(probability(z) * TABLE_STEPS, np.arange(TABLE_STEPS + 1.0), table)
    return out


def jitter_of(parameters: Records, z: Array, quantiles: Array | None) -> Array:
    """Return what the jitter of one link adds to its delay, s.

    Args:
        parameters: () of LINK_PARAMETERS.
        z: (K,) of a standard normal distribution.
        quantiles: (TABLE_STEPS + 1,) s, of an empirical distribution.
    """
    kind, spread = parameters["jitter"], parameters["spread"]
    if kind == LOGNORMAL:
        mean, deviation = parameters["lognormal"]
        return np.asarray(np.exp(mean + deviation * z) - parameters["delay"])
    if kind == EMPIRICAL and quantiles is not None:
        return interpolate_quantiles(quantiles, z)
    if kind == UNIFORM:
        return np.asarray(spread * (2.0 * probability(z) - 1.0))
    if kind == NORMAL:
        return np.asarray(spread * z)
    return np.asarray(spread * (pareto(z) if kind == PARETO else paretonormal(z)))
