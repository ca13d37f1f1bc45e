"""The state of all links of a channel, and its initial values."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array, Records, allocate
from testbed.network.channel import Channel
from testbed.network.clocks import CLOCK
from testbed.network.links import (
    FOUR_STATE,
    GILBERT_ELLIOTT,
    LINK_PARAMETERS,
    LINK_STATE,
    PACKET,
    START,
)
from testbed.network.philox import Words, philox, unit

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
    """Return the rings (n, N, Q) of the times, s, at which the last Q packets left their queue."""
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
    """Return the initial states (...) of the loss models; good if they would never be again."""
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
