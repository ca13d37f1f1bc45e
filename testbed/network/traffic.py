"""What is going on on the links, and how it begins."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.network.channel import Channel
from testbed.network.links import FOUR_STATE, GILBERT_ELLIOTT, START, STATE, Links
from testbed.network.philox import Words, philox, unit
from testbed.state import Array


class Traffic(NamedTuple):
    """What is going on on the links; changed in place by every round."""

    state: Links  # (n, N) of links.STATE
    ring: Array  # (n, N, Q) s, when the packets before the next leave the queue
    # (n, N, 2) s, when the copies of the last message arrive that were spoiled on the way;
    # infinite: none was, or it was lost as well
    spoiled_s: Array


def idle(channel: Channel) -> Traffic:
    """Links on which nothing was sent yet.

    Exact chains begin anywhere in their stationary distribution, so that the first packets are lost
    as often as all others; netem's begin in the good state.
    """
    links = channel.links
    state = np.zeros(links.shape, dtype=STATE)
    state["z"] = np.nan
    state["free"] = state["latest"] = -np.inf
    state["slot_at"], state["slot_left"] = links["first_slot"], links["per_slot"]
    key0, key1 = channel.keys[..., 0], channel.keys[..., 1]
    first, last = philox(key0, key1, 0, 0, START), philox(key0, key1, 0, 1, START)
    state["blended"] = np.stack([*first, last[0]], axis=-1)
    exact = ~links["netem"]
    state["had"] = _had(links, np.stack(first, axis=-1)) & exact[..., None]
    state["chain"] = np.where(exact, _chains(links, last[1]), 0)
    longest = int(links["queue"].max(initial=0))
    return Traffic(
        state, np.full((*links.shape, longest), -np.inf), np.full((*links.shape, 2), np.inf)
    )


def _had(links: Links, words: Words) -> Array:
    """Whether the packet before the first had each event (..., 4)."""
    after_none, after_one = links["after_none"], links["after_one"]
    had: Array = unit(words) < after_none / (1.0 - (after_one - after_none))
    return had


def _chains(links: Links, words: Words) -> Array:
    """Where each loss model's chain begins (...); one that would never be good again: good."""
    u, p = unit(words), np.moveaxis(links["p"], -1, 0)
    gilbert = u * (p[0] + p[1]) < p[0]
    p13, p31, p32, p23, p14 = p
    # solves the balance of the four states; see Salsano et al. (2012)
    weights = np.stack([p31 * p23, p13 * p32, p13 * p23, p14 * p31 * p23])
    four = np.sum(u * weights.sum(axis=0) >= np.cumsum(weights, axis=0)[:-1], axis=0)
    chains: Array = np.select(
        [
            (links["loss"] == GILBERT_ELLIOTT) & (p[1] > 0.0),
            (links["loss"] == FOUR_STATE) & (weights[0] > 0.0),
        ],
        [gilbert, four],
        0,
    )
    return chains
