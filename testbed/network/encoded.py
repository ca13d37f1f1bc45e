"""Messages as frames of bytes: what is on the air, and what a receiver makes of damaged ones."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from testbed.network.channel import Channel
from testbed.network.links import PLACES, Fate, Fates
from testbed.network.philox import philox, unit
from testbed.state import Array, Broadcast, Truths

Frames = NDArray[np.uint8]
Numbers = NDArray[np.int64]


class Encoding(Protocol):
    """How messages are written."""

    def pack(self, message: Broadcast, rows: Numbers, numbers: Numbers) -> Frames:
        """Frames (S, L) of what S aircraft say (S); `rows` (S,) are they, `numbers` (S,) theirs.

        Stamps are what the senders' clocks show.
        """

    def unpack(self, frames: Frames) -> tuple[Broadcast, Numbers, Truths]:
        """What K frames say, the rows they say they are from (K,), and whether they are good (K,).

        A receiver throws away a frame that is not good without looking at what it says.
        """


class Believed(NamedTuple):
    """Copies of messages, B of them, that are read although bits of them are wrong."""

    at: Numbers  # (B, 3) follower, which of the round's senders, copy
    content: Array  # (B, 5, 3) as in post.RECORD
    stamp_s: Array  # (B,) by the sender's clock


class Coder:
    """What N aircraft put on the air, a round at a time, and how damaged frames are taken.

    Attributes:
        refused: damaged copies whose checksum says so, or that are another message.
        discarded: that pass, with a sender who is not theirs or with what is not a number.
        believed: that pass and are read.
    """

    def __init__(self, encoding: Encoding, channel: Channel) -> None:
        """Nothing was said yet."""
        self._encoding, self._channel = encoding, channel
        aircraft = len(channel.names)
        self._heard = Broadcast(
            np.zeros(aircraft), *(np.zeros((aircraft, 3)) for _ in Broadcast._fields[1:])
        )
        self._frames: Frames = np.zeros((0, 0), np.uint8)
        self.refused = self.discarded = self.believed = 0

    def says(
        self, message: Broadcast, shown_s: Array, rows: Numbers, numbers: Numbers
    ) -> tuple[Broadcast, Array]:
        """Pack a round of messages, and read the frames as one does who gets them whole.

        Args:
            message: of all N; its stamps are the true time of its content.
            shown_s: (S,) what the clocks of those who send show, s.
            rows: (S,) who sends.
            numbers: (S,) of their messages.

        Returns:
            The message (N) as it is read, with its true stamps, and what it says of them (S,), s.
        """
        everyone = len(rows) == len(message.stamp_s)
        mine = message[1:] if everyone else [each[rows] for each in message[1:]]
        self._frames = self._encoding.pack(Broadcast(shown_s, *mine), rows, numbers)
        read, _, _ = self._encoding.unpack(self._frames)
        for heard, each in zip(self._heard[1:], read[1:], strict=True):
            heard[rows] = each
        return self._heard._replace(stamp_s=message.stamp_s), read.stamp_s

    def damage(
        self, spoiled_s: Array, arrivals: Array, fate: Fates, rows: Numbers, numbers: Numbers
    ) -> Believed | None:
        """Turn over bits of the round's spoiled copies; some are believed all the same.

        Args:
            spoiled_s: (n, S, 2) s, when they arrive; infinite: not spoiled, or lost.
            arrivals: (n, S, 2) s, of the others; those that are believed are put in.
            fate: (n, S), changed in place likewise.
            rows: (S,) who sends.
            numbers: (S,) of their messages.

        Returns:
            Those that are believed; None: none.
        """
        at = np.argwhere(np.isfinite(spoiled_s))
        if not len(at):
            return None
        i, s, copy = at.T
        link = i, rows[s]
        damaged = turned_over(
            self._frames[s],
            self._channel.links["bits"][link],
            self._channel.keys[link],
            numbers[s],
            copy,
        )
        said, sender, good = self._encoding.unpack(damaged)
        content = np.stack(said[1:], axis=1)
        sound = np.isfinite(content).all(axis=(1, 2)) & (sender == rows[s])
        taken = good & sound
        self.refused += int((~good).sum())
        self.discarded += int((good & ~sound).sum())
        if not taken.any():
            return None
        self.believed += int(taken.sum())
        i, s, copy = at[taken].T
        arrivals[i, s, copy] = spoiled_s[i, s, copy]
        fate[i, s] = Fate.DELIVERED
        return Believed(at[taken], content[taken], said.stamp_s[taken])


def turned_over(
    frames: Frames, bits: Numbers, keys: NDArray[np.uint64], numbers: Numbers, copies: Numbers
) -> Frames:
    """Frames with some bits turned over, at places that the dice of their links choose.

    Every set of places of that size is as likely as any other (Floyd's sampling; Bentley and
    Floyd, "A sample of brilliance", CACM 30, 1987).

    Args:
        frames: (K, L)
        bits: (K,) how many, at most 8 L.
        keys: (K, 2) of their links.
        numbers: (K,) of their messages.
        copies: (K,) which copy of it, 0 or 1.
    """
    count, size = len(frames), 8 * frames.shape[1]
    turned = np.zeros((count, size), dtype=np.bool_)
    for k in range(int(bits.max())):
        each = np.flatnonzero(bits > k)
        last = size - bits[each] + k
        word = philox(keys[each, 0], keys[each, 1], numbers[each], copies[each], PLACES + k)[0]
        place = (unit(word) * (last + 1)).astype(np.int64)
        turned[each, np.where(turned[each, place], last, place)] = True
    damaged: Frames = frames ^ np.packbits(turned, axis=1)
    return damaged
