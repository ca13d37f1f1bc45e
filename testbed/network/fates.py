"""What becomes of a round of broadcasts: fates and arrival times, all links at once.

With arithmetic `exact` a packet waits for its transmitter and its slot, is lost or not, and if it
is not arrives after its delay, perhaps twice. With `netem` the order, the dice and their widths are
those of Linux's net/sched/sch_netem.c: a second copy is made before the loss is decided, and one of
the two is lost with it; delays come before the transmitter.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from testbed.compiled import twin_of
from testbed.network.channel import Channel
from testbed.network.dice import Dice
from testbed.network.links import (
    CORRUPT,
    DUPLICATE,
    OUTCOME,
    PATH,
    REORDER,
    Fate,
    Fates,
)
from testbed.network.philox import unit
from testbed.network.slots import SIMULTANEOUS_S, next_slot
from testbed.network.traffic import Traffic
from testbed.state import Array, Truths

MUTE = int(Fate.MUTE)


def fates(
    channel: Channel,
    traffic: Traffic,
    rows: NDArray[np.int64],
    sequence: NDArray[np.int64],
    sent_s: Array,
    script: Fates,
    replayed: Array,
    faded: Array,
) -> tuple[Array, Fates]:
    """What becomes of one message of each of S aircraft on its way to each of n followers.

    Args:
        channel: what is set.
        traffic: what is going on; changed in place.
        rows: (S,) who sends.
        sequence: (S,) numbers of their messages, from 0, each one more than the last.
        sent_s: (S,) when.
        script: (n, S) `Fate` that a script has for it, 0: none.
        replayed: (n, S) s, delay that a trace has for it; infinite: lost; nan: no trace.
        faded: (n, S) probability of being lost to distance and airframes.

    Returns:
        Arrivals (n, S, 2) s of the packet and a second copy, infinite where there is none, and
        fates (n, S).
    """
    on_air = _Round(channel, traffic, rows, sequence, np.broadcast_to(sent_s, script.shape))
    arrivals, fate = on_air.fly(script, replayed, faded)
    traffic.state[:, rows], traffic.spoiled_s[:, rows] = on_air.state, on_air.spoiled_s
    return arrivals, fate


def befall(
    channel: Channel,
    traffic: Traffic,
    rows: NDArray[np.int64],
    sequence: NDArray[np.int64],
    sent_s: Array,
    script: Fates,
    replayed: Array,
    faded: Array,
    arrivals: Array,
    fate: Fates,
) -> None:
    """As `fates`; arrivals (n, S, 2) and fates (n, S) are written into arrays that are there."""
    arrivals[:], fate[:] = fates(channel, traffic, rows, sequence, sent_s, script, replayed, faded)


BEFALL = twin_of(befall, "testbed.network.fates_twin")


class _Round:
    """One round on its way; every array (n, S)."""

    def __init__(
        self,
        channel: Channel,
        traffic: Traffic,
        rows: NDArray[np.int64],
        sequence: NDArray[np.int64],
        sent_s: Array,
    ) -> None:
        self.ring, self.rows, self.sent_s = traffic.ring, rows, sent_s
        self.state = traffic.state[:, rows]
        self.spoiled_s = np.full((*sent_s.shape, 2), np.inf)
        self.dice = Dice(channel, rows, self.state, np.broadcast_to(sequence, sent_s.shape))
        self.link, self.keys, self.netem = self.dice.link, self.dice.keys, self.dice.netem

    def fly(self, script: Fates, replayed: Array, faded: Array) -> tuple[Array, Fates]:
        """Arrivals (n, S, 2) and fates (n, S)."""
        own, unheard = self.link["own"], self.link["unheard"]
        other, exact = ~(own | unheard), ~self.netem
        words = self.dice.words(0, OUTCOME)
        lost = self.dice.loses(words[0], words[1], other)
        twice = self.dice.happens(DUPLICATE, words[3], other)
        told = ~np.isnan(replayed)
        lost = np.where(told, np.isinf(replayed), lost)
        gone = lost & (told | ~(self.netem & twice))

        sending = other & (script != MUTE)
        departs, full = self.leaves(sending & exact)
        arrivals = np.full((*departs.shape, 2), np.inf)
        alive = sending & ~gone & ~full
        spoiled = self.dice.happens(CORRUPT, self.dice.words(0, PATH)[0], alive)
        full |= alive & self.netem & self.queue_is_full()
        alive &= ~full
        cloned = self.netem & twice & ~lost & alive
        if cloned.any():  # netem's second copy enters the queue before the first
            words_of_clone = self.dice.words(1, OUTCOME)
            cloned &= ~self.dice.loses(words_of_clone[0], words_of_clone[1], cloned & ~told)
            self.travels(1, cloned, self.spoils_second(cloned), departs, replayed, arrivals)
        self.travels(0, alive, spoiled, departs, replayed, arrivals)
        copied = exact & twice & alive
        if copied.any():
            self.travels(1, copied, self.spoils_second(copied), departs, replayed, arrivals)

        arrived = np.isfinite(arrivals).any(axis=2)
        why = np.where(full, Fate.QUEUE, np.where(gone, Fate.LOST, Fate.CORRUPTED))
        fate = np.where(arrived, Fate.DELIVERED, why)
        behind = (unit(words[2]) < faded) & ~np.isin(fate, (Fate.QUEUE, Fate.LOST))
        fate = np.where(behind, Fate.FADED, fate)
        fate = np.where(script > 0, script, fate)
        arrivals[fate != Fate.DELIVERED] = np.inf
        self.spoiled_s[(fate != Fate.DELIVERED) & (fate != Fate.CORRUPTED)] = np.inf
        arrivals[own, 0], fate[own] = self.sent_s[own], Fate.DELIVERED
        fate[unheard] = Fate.UNHEARD
        return arrivals, fate.astype(np.uint8)

    def leaves(self, where: Truths) -> tuple[Array, Truths]:
        """When packets have passed transmitter and slots, s, and which found the queue full."""
        link, state = self.link, self.state
        departs = self.sent_s.copy()
        full = where & self.queue_is_full()
        where = where & ~full
        timed = where & (link["service"] > 0.0)
        departs[timed] = (np.maximum(departs, state["free"]) + link["service"])[timed]
        state["free"][timed] = departs[timed]
        self.takes_slot(departs, where & (link["slot"][..., 1] > 0.0))
        self.queues(departs, where)
        return departs, full

    def spoils_second(self, where: Truths) -> Truths:
        """Whether a second copy (n, S) is corrupted, for those asked about."""
        return self.dice.happens(CORRUPT, self.dice.words(1, PATH)[0], where)

    def travels(
        self,
        copy: int,
        where: Truths,
        spoiled: Truths,
        departs: Array,
        replayed: Array,
        arrivals: Array,
    ) -> None:
        """Put arrival times, s, of packets that come through, apart if they are spoiled."""
        link, state = self.link, self.state
        words = self.dice.words(copy, PATH)
        netem: Truths = where & self.netem
        overtaking = where & (state["passed"] >= link["gap"] - 1)
        overtakes = self.dice.happens(REORDER, words[1], overtaking)
        state["passed"][where] = np.where(overtakes, 0, state["passed"] + 1)[where]
        delay = np.where(self.netem, self.dice.netem_delay(words[2], netem & ~overtakes), 0.0)
        exact = where & ~self.netem
        delay[exact] = self.dice.exact_delay(words[2], words[3], exact)[exact]
        delay = np.where(np.isnan(replayed), delay, replayed)
        delay[overtakes] = 0.0
        arrives = departs + delay
        self.transmits_late(arrives, delay, netem & ~overtakes)
        kept = where & ~overtakes & link["in_order"]
        arrives[kept] = np.maximum(arrives, state["latest"])[kept]
        moved = where & ~overtakes
        state["latest"][moved] = np.maximum(arrives, state["latest"])[moved]
        good, bad = where & ~spoiled, where & spoiled
        arrivals[good, copy], self.spoiled_s[bad, copy] = arrives[good], arrives[bad]

    def transmits_late(self, arrives: Array, delay: Array, where: Truths) -> None:
        """Netem's transmitter and slots come after the delay; changes arrivals (n, S)."""
        link, latest = self.link, self.state["latest"]
        timed = where & (link["service"] > 0.0)
        late = np.maximum(self.sent_s + delay, latest) + link["service"]
        arrives[timed] = late[timed]
        self.takes_slot(arrives, where & (link["slot"][..., 1] > 0.0))
        self.queues(arrives, where)

    def queue_is_full(self) -> Truths:
        """Whether as many packets as may wait have not left yet (n, S)."""
        full: Truths = np.zeros(self.sent_s.shape, dtype=np.bool_)
        for i, s in np.argwhere(self.link["queue"] > 0):
            leaves = self.ring[i, self.rows[s], self.state["place"][i, s]]
            full[i, s] = leaves > self.sent_s[i, s] + SIMULTANEOUS_S
        return full

    def queues(self, leaves: Array, where: Truths) -> None:
        """Remember when packets leave (n, S) s."""
        for i, s in np.argwhere(where & (self.link["queue"] > 0)):
            place = self.state["place"][i, s]
            self.ring[i, self.rows[s], place] = leaves[i, s]
            self.state["place"][i, s] = (place + 1) % self.link["queue"][i, s]

    def takes_slot(self, times: Array, where: Truths) -> None:
        """Move times (n, S) s to the next slot with room."""
        for i, s in np.argwhere(where):
            times[i, s] = next_slot(
                self.link[i, s], self.state[i, s], self.keys[i, s], float(times[i, s])
            )
