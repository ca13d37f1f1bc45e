"""Messages as frames of bytes, as sent and as received with bit errors."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import MESSAGE, Array, BoolArray, Broadcast, Records, allocate
from testbed.network.channel import Channel
from testbed.network.links import BITS, Numbers, PacketOutcome
from testbed.network.philox import philox, unit

Frames = NDArray[np.uint8]


class Encoding(Protocol):
    """Pack messages into frames of L bytes and unpack them.

    Attributes:
        payload_bytes: behind the L bytes of the motion, a frame with numbers of a law's own.
    """

    payload_bytes: int

    def pack(self, message: Broadcast, rows: Numbers, numbers: Numbers) -> Frames:
        """Return the frames (S, L) of S messages.

        Args:
            message: (S), stamped by the senders' clocks.
            rows: (S,) of the senders.
            numbers: (S,) sequence numbers.
        """

    def pack_payload(self, values: Array, rows: Numbers, numbers: Numbers) -> Frames:
        """Return the second frames (S, payload_bytes) of S messages with K numbers.

        Args:
            values: (S, K)
            rows: (S,) of the senders.
            numbers: (S,) sequence numbers of the messages.
        """

    def unpack_payload(self, frames: Frames) -> Array:
        """Return the numbers (S, K) of second frames."""

    def unpack(self, frames: Frames) -> tuple[Broadcast, Numbers, BoolArray]:
        """Return K messages, the rows of their senders (K,), and whether they are valid (K,).

        A receiver discards a frame that is not valid without reading its content.
        """


class UndetectedErrors(NamedTuple):
    """B copies of messages that pass all checks with wrong bits."""

    at: Numbers  # (B, 3) follower, index among the senders, copy
    message: Broadcast  # (B) as read, stamped by the senders' clocks


class Encoder:
    """Encode broadcasts of N aircraft, and decide what receivers make of damaged frames.

    Attributes:
        refused: damaged copies with a wrong checksum, or of another message type.
        discarded: copies that pass, with another sender or numbers that are not finite.
        undetected: copies that pass and are used.
    """

    UNSAVED = ("_frames",)

    def __init__(self, encoding: Encoding, channel: Channel, payload: Array) -> None:
        """Encode as frames.

        Args:
            encoding: of the frames.
            channel: the links.
            payload: (N, K) numbers of a law's own in the next messages; rounded as in the frames.
        """
        self._encoding, self._channel, self._payload = encoding, channel, payload
        self._read = allocate(MESSAGE, len(channel.names))
        self._frames: Frames = np.zeros((0, 0), np.uint8)  # of the last broadcast
        self.refused = self.discarded = self.undetected = 0

    def encode(self, messages: Records, stamp_s: Array, rows: Numbers, numbers: Numbers) -> Records:
        """Pack the messages of a broadcast, and read the undamaged frames as a receiver does.

        Args:
            messages: (N,) of MESSAGE, stamped with the true times of their content.
            stamp_s: (N,) s, by the senders' clocks; the content of the frames is written.
            rows: (S,) of the senders.
            numbers: (S,) sequence numbers.

        Returns:
            (N,) of MESSAGE as read, with true stamps.
        """
        content = (messages[name][rows] for name in Broadcast._fields[1:])
        self._frames = self._encoding.pack(Broadcast(stamp_s[rows], *content), rows, numbers)
        read, _, _ = self._encoding.unpack(self._frames)
        for name, values in zip(Broadcast._fields, read, strict=True):
            self._read[name][rows] = values
        stamp_s[rows] = read.stamp_s
        self._read["stamp_s"] = messages["stamp_s"]
        if self._payload.shape[1]:
            second = self._encoding.pack_payload(self._payload[rows], rows, numbers)
            self._payload[rows] = self._encoding.unpack_payload(second)
            self._frames = np.concatenate([self._frames, second], axis=1)
        return self._read

    def corrupt(self, packets: Records, rows: Numbers, numbers: Numbers) -> UndetectedErrors | None:
        """Flip bits of corrupted copies; some still pass all checks.

        Args:
            packets: (n, N) of PACKET; copies that pass are written as delivered.
            rows: (S,) of the senders.
            numbers: (S,) sequence numbers.

        Returns:
            The copies that pass; None: none.
        """
        corrupted_s = packets["corrupted_s"][:, rows]
        at = np.argwhere(np.isfinite(corrupted_s))
        if not len(at):
            return None
        i, s, copy = at.T
        links = self._channel.links[i, rows[s]]
        whole = self._frames.shape[1]
        first = whole - (self._encoding.payload_bytes if self._payload.shape[1] else 0)
        # the leader has no law, and sends no second frame
        lengths = np.where(rows[s] == 0, first, whole)
        sent, chosen = self._frames[s], (links["bits"], links["key"], numbers[s], copy)
        frames = flip_bits(sent, lengths, *chosen)
        read, sender, valid = self._encoding.unpack(np.ascontiguousarray(frames[:, :first]))
        # a packet is dropped with a damaged second frame; that its checksum may fit is left out
        valid &= (frames[:, first:] == sent[:, first:]).all(axis=1)
        finite = np.isfinite(np.stack(read[1:], axis=1)).all(axis=(1, 2))
        plausible = finite & (sender == rows[s])
        used = valid & plausible
        self.refused += int((~valid).sum())
        self.discarded += int((valid & ~plausible).sum())
        if not used.any():
            return None
        self.undetected += int(used.sum())
        i, s, copy = at[used].T
        packets["arrival_s"][i, rows[s], copy] = corrupted_s[i, s, copy]
        packets["outcome"][i, rows[s]] = PacketOutcome.DELIVERED
        return UndetectedErrors(at[used], Broadcast(*(each[used] for each in read)))


def flip_bits(
    frames: Frames,
    lengths: Numbers,
    bits: Numbers,
    keys: NDArray[np.uint64],
    numbers: Numbers,
    copies: Numbers,
) -> Frames:
    """Return frames with some bits flipped, at random places.

    All sets of places of a size are equally likely (Floyd's sampling; J. Bentley and R. Floyd, "A
    sample of brilliance", CACM 30, 1987).

    Args:
        frames: (K, L)
        lengths: (K,) bytes of each frame, at most L.
        bits: (K,) number of bits to flip, at most 8 lengths.
        keys: (K, 2) of the links.
        numbers: (K,) sequence numbers of the messages.
        copies: (K,) which copy of the message, 0 or 1.
    """
    count, sizes = len(frames), 8 * lengths
    flipped = np.zeros((count, 8 * frames.shape[1]), dtype=np.bool_)
    for k in range(int(bits.max())):
        each = np.flatnonzero(bits > k)
        last = sizes[each] - bits[each] + k
        word = philox(keys[each, 0], keys[each, 1], numbers[each], copies[each], BITS + k)[0]
        position = (unit(word) * (last + 1)).astype(np.int64)
        flipped[each, np.where(flipped[each, position], last, position)] = True
    damaged: Frames = frames ^ np.packbits(flipped, axis=1)
    return damaged
