"""What dice decide of a round of packets: events, loss, delay; the numbers that correlate them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.network.channel import WHOLE, Channel
from testbed.network.delays import NANOSECONDS, NETEM_SCALE, NETEM_TABLE, varied
from testbed.network.links import (
    BERNOULLI,
    DELAY,
    FOUR_STATE,
    GILBERT_ELLIOTT,
    LOSS,
    NO_JITTER,
    UNIFORM,
    Links,
)
from testbed.network.philox import Words, philox, unit
from testbed.state import Array, Truths


class Dice:
    """The dice of one round; every array (n, S). What links remember of theirs changes in place."""

    def __init__(
        self, channel: Channel, rows: NDArray[np.int64], state: Links, sequence: NDArray[np.int64]
    ) -> None:
        """Of the messages with these numbers (n, S) that `rows` (S,) send."""
        self.channel, self.state, self.sequence = channel, state, sequence
        self.link, self.keys = channel.links[:, rows], channel.keys[:, rows]
        self.netem = self.link["netem"]

    def words(self, copy: int, block: int) -> tuple[Words, Words, Words, Words]:
        """Dice of this round's packets."""
        return philox(self.keys[..., 0], self.keys[..., 1], self.sequence, copy, block)

    def happens(self, event: int, word: Words, where: Truths) -> Truths:
        """Whether an event befalls each packet (n, S), for those asked about."""
        share, had = self.link["share"][..., event], self.state["had"][..., event]
        dice = self.blended(event, word, where & (share > 0))
        after_one, after_none = (
            self.link[name][..., event] for name in ("after_one", "after_none")
        )
        exact = unit(word) < np.where(had > 0, after_one, after_none)
        happened: Truths = np.where(self.netem, (share > 0) & (share >= dice), exact) & where
        had[where] = happened[where]
        return happened

    def blended(self, event: int, word: Words, where: Truths) -> Words:
        """Netem's dice: a blend of this word with what came out before."""
        blend, before = self.link["blend"][..., event], self.state["blended"][..., event]
        rest = np.uint64(WHOLE) - blend  # netem adds one to the blend and has 2^32 for one
        mixed = (word * rest + before * (blend + np.uint64(1))).astype(np.uint64)
        dice: Words = np.where(blend > 0, mixed >> np.uint64(32), word)
        keep = where & self.netem & (blend > 0)
        before[keep] = dice[keep]
        return dice

    def loses(self, word: Words, second: Words, where: Truths) -> Truths:
        """Whether the loss model takes each packet (n, S), for those asked about."""
        model, chain = self.link["loss"], self.state["chain"]
        lost = self.happens(LOSS, word, where & (model == BERNOULLI))
        u, v = unit(word), unit(second)
        p = np.moveaxis(self.link["p"], -1, 0)
        if (chosen := where & (model == GILBERT_ELLIOTT)).any():
            good = chain == 0
            lost |= chosen & (v < np.where(good, p[3], p[2]))
            chain[chosen] = np.where(u < np.where(good, p[0], p[1]), good, ~good)[chosen]
        if (chosen := where & (model == FOUR_STATE)).any():
            after = _four_state(chain, u, p)
            # of the states only 2 and 3 are losses: in a burst, and alone in a gap
            lost |= chosen & ((after == 2) | (after == 3))
            chain[chosen] = after[chosen]
        return lost

    def exact_delay(self, word: Words, second: Words, where: Truths) -> Array:
        """Delay, s, from the normal process behind it (Box and Muller's normals)."""
        link, state = self.link, self.state
        normal = np.sqrt(-2.0 * np.log(unit(word))) * np.cos(2.0 * np.pi * unit(second))
        rho = link["rho"]
        z = np.where(
            np.isnan(state["z"]), normal, rho * state["z"] + np.sqrt(1.0 - rho * rho) * normal
        )
        jittery = where & (link["jitter"] != NO_JITTER)
        state["z"][jittery] = z[jittery]
        delay: Array = link["delay"].copy()
        if jittery.any():
            some = link[jittery]
            more = varied(some, z[jittery], self.channel.quantiles)
            delay[jittery] = np.maximum(some["delay"] + more, 0.0)
        return delay

    def netem_delay(self, word: Words, where: Truths) -> Array:
        """Delay, s, as netem's `tabledist` finds it."""
        link = self.link
        where = where & (link["jitter"] != NO_JITTER)
        delay: Array = link["delay"].copy()
        if not where.any():
            return delay
        dice = self.blended(DELAY, word, where)
        spread = np.rint(link["spread"] * NANOSECONDS)
        width = np.maximum(2.0 * spread, 1.0).astype(np.uint64)
        more = (dice % width).astype(np.float64) - spread
        tabled = where & (link["jitter"] != UNIFORM)
        places = (dice[tabled] % np.uint64(NETEM_TABLE)).astype(np.int64)
        entry = self.channel.tables[link["table"][tabled], places]
        more[tabled] = np.rint(spread[tabled] * entry / NETEM_SCALE)
        delay[where] = np.maximum(delay + more / NANOSECONDS, 0.0)[where]
        return delay


def _four_state(chain: NDArray[np.int64], u: Array, p: Array) -> NDArray[np.int64]:
    """Next state: 0 received in a gap, 1 received in a burst, 2 lost in a burst, 3 lost alone."""
    p13, p31, p32, p23, p14 = p
    from_gap = np.where(u < p14, 3, np.where(u < p14 + p13, 2, 0))
    from_received = np.where(u < p23, 2, 1)
    from_burst = np.where(u < p32, 1, np.where(u < p32 + p31, 0, 2))
    after: NDArray[np.int64] = np.choose(chain, [from_gap, from_received, from_burst, 0])
    return after
