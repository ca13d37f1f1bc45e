"""Numbers of a law's own in messages: kept by the sender until the message has arrived.

They travel with the message, in a second frame of the same packet: what happens to the packet
happens to them. So a follower looks them up by the number of the newest message that it has.
"""

from __future__ import annotations

import numpy as np

from testbed.core.call_list import NOW, Call
from testbed.core.compile import entry
from testbed.core.records import Array, BoolArray, Records
from testbed.network.links import Numbers
from testbed.network.packet_queue import NO_MESSAGE

KEPT = 1024  # messages of each sender


class Payloads:
    """The numbers of a law's own in the messages between N aircraft and n followers.

    Attributes:
        sent: (N, K) numbers that the next messages carry; the leader, which has no law, sends NaN.
        received: (n, N, K) of the newest message of each aircraft; NaN: none has arrived, or its
            sender has sent `KEPT` later ones.
    """

    def __init__(self, n: int, aircraft: int, count: int) -> None:
        """Begin before the first message.

        Args:
            n: followers.
            aircraft: N.
            count: K.
        """
        self.sent = np.full((aircraft, count), np.nan)
        self.received = np.full((n, aircraft, count), np.nan)
        kept = KEPT if count else 1
        self._kept = np.zeros((aircraft, kept, count))
        self._numbers = np.full((aircraft, kept), NO_MESSAGE)  # of the messages that are kept
        self._newest = np.full((n, aircraft), NO_MESSAGE)

    @property
    def count(self) -> int:
        """K, numbers in each message."""
        return self.sent.shape[1]

    def keep_call(self, senders: BoolArray, transmitters: Records) -> Call:
        """Return the call that keeps what senders (N,) have just sent.

        Args:
            senders: (N,) of the broadcast.
            transmitters: (N,) of TRANSMITTER, with the number of the last message.
        """
        return Call(_keep, self.sent, self._kept, self._numbers, senders, transmitters, NOW)

    def receive_call(self, links: Records) -> Call:
        """Return the call that writes `received` for links (n, N) of LINK."""
        kept = self._kept, self._numbers
        return Call(_receive, *kept, self._newest, self.received, links, NOW)


@entry
def _keep(
    sent: Array,
    kept: Array,
    numbers: Numbers,
    senders: BoolArray,
    transmitters: Records,
    now: float,
) -> None:
    for m in range(len(sent)):
        if senders[m]:
            number = transmitters[m].number
            row = number % kept.shape[1]
            numbers[m, row] = number
            kept[m, row] = sent[m]


@entry
def _receive(
    kept: Array, numbers: Numbers, newest: Numbers, received: Array, links: Records, now: float
) -> None:
    for i in range(len(received)):
        for m in range(len(kept)):
            number = links[i, m].number
            if number == newest[i, m]:
                continue
            newest[i, m] = number
            row = number % kept.shape[1]
            for k in range(received.shape[2]):
                received[i, m, k] = kept[m, row, k] if numbers[m, row] == number else np.nan
