"""Packets over one link, without a scenario, a clock or aircraft."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.core.call_list import Call
from testbed.core.errors import InputError
from testbed.core.records import LINK, MESSAGE, Array, allocate, join_names
from testbed.network.channel import (
    initial_departures,
    initial_links,
    initial_transmitters,
    make_channel,
)
from testbed.network.encoding import flip_bits
from testbed.network.fading import fading, make_curves
from testbed.network.link_statistics import initial_statistics, summarise
from testbed.network.links import Outcomes, resolve_links
from testbed.network.outages import make_outages, scripted_outcomes
from testbed.network.packet_outcomes import SIMULTANEOUS_S
from testbed.network.packet_queue import QUEUED_MESSAGE, send_and_count
from testbed.network.trace import make_replays, replayed_delays
from testbed.scenario.network import Link, Network

_NAMES = ("sender", "receiver")  # of the random streams; also of the columns of a trace
# Keys of a link that act without positions of aircraft.
KEYS = (*sorted(Link.model_fields.keys() - {"range_loss", "shadowing"}), "message_bytes")


class SentPackets(NamedTuple):
    """K packets over one link; row k has sequence number k."""

    sent_s: Array  # (K,)
    received_s: Array  # (K,) of the first copy that arrives; NaN: none
    second_s: Array  # (K,) of a second copy; NaN: none
    outcome: Outcomes  # (K,) of PacketOutcome


def send_packets(
    sent_s: Sequence[float] | Array,
    *,
    seed: int = 0,
    **keys: Any,  # noqa: ANN401 - as of a scenario
) -> SentPackets:
    """Send packets over one link, and return when each arrives.

    The random numbers of a packet depend on the seed and its sequence number only.

    Args:
        sent_s: (K,) transmission times, s, which do not decrease.
        seed: of the random numbers.
        keys: of `KEYS`, as in the section `network` of a scenario: `delay_s=0.1`,
            `jitter={"spread_s": 0.02}`, `loss=0.05`, `rate={"bit_per_s": 57600}`. A link without
            keys delivers each packet at once.

    Raises:
        InputError: a key is not of `KEYS`, there are no times, they decrease or are not finite, or
            a file of delays or a trace cannot be used.
        pydantic.ValidationError: the value of a key is out of range.
    """
    if unknown := sorted(keys.keys() - set(KEYS)):
        raise InputError(f"a link alone has no {join_names(unknown)} (write {', '.join(KEYS)})")
    times_s = np.array(sent_s, dtype=np.float64)
    if not times_s.size or not np.isfinite(times_s).all() or (np.diff(times_s) < 0.0).any():
        raise InputError("sent_s: write one or more finite times, s, that do not decrease")
    link, count = SingleLink(Network.model_validate(keys), *_NAMES, seed), len(times_s)
    scripted, trace_s = link.scripts(times_s, np.arange(count))
    arrivals_s, outcome = np.empty((count, 2)), np.empty(count, dtype=np.uint8)
    for k in range(count):
        outcome[k] = link.transmit(times_s[k], scripted[k], trace_s[k])
        arrivals_s[k] = link.arrivals_s
    arrivals_s.sort(axis=1)
    arrivals_s[np.isinf(arrivals_s)] = np.nan
    return SentPackets(times_s, arrivals_s[:, 0], arrivals_s[:, 1], outcome)


class SingleLink:
    """One directed link of a network, a packet at a time, by the kernels of a run.

    The random numbers of a packet depend on the seed, the names and its sequence number only: they
    are those of a run of the same seed between aircraft of these names.

    Args:
        network: section of a scenario, or of the file of a link.
        sender: name of the sending end.
        receiver: name of the receiving end.
        seed: of the random numbers.
        in_order: no packet overtakes another, whatever `jitter` says.

    Attributes:
        arrivals_s: (2,) s, when the last packet and its second copy arrive; infinite: never.
        corrupted_s: (2,) s, the same of copies with wrong bits.
        number: sequence number of the last packet; -1: none was sent.
        fades: whether losses depend on where the ends are.

    Raises:
        InputError: a file of delays or a trace cannot be used.
    """

    def __init__(
        self, network: Network, sender: str, receiver: str, seed: int, *, in_order: bool = False
    ) -> None:
        self._names = sender, receiver
        pairs = resolve_links(self._names, network)
        channel = make_channel(pairs, seed)
        links, departures_s = initial_links(channel), initial_departures(channel)
        if in_order:
            links["parameters"]["in_order"] = True
        self._parameters, self._service = channel.links[0, 0], links["parameters"]["service"]
        self._packet, self._departures_s = links["packet"][0, 0], departures_s[0, 0]
        self.arrivals_s, self.corrupted_s = self._packet["arrival_s"], self._packet["corrupted_s"]
        self._rate = pairs.distinct[pairs.numbers[0, 0]].rate
        self._outages, self._replays = make_outages(pairs), make_replays(pairs, seed)
        self._curves = make_curves(pairs)
        self.fades = self._curves is not None
        self._is_scripted = bool(
            any(each.links.any() for each in self._outages.windows)
            or self._outages.dropped.size
            or self._replays
        )
        self.number = self._latest = -1
        self._statistics, self._sent_s = initial_statistics(1, 2), np.zeros(2)
        self._counts = np.array([0, 4], dtype=np.int64)  # of the queue, which is not used here
        senders = np.zeros(2, dtype=bool)
        self._send = Call(
            send_and_count,
            *(links, departures_s, channel.tables, initial_transmitters(2)),
            *(allocate(QUEUED_MESSAGE, 8), allocate(LINK, 1, 2), self._statistics),
            *(senders, np.zeros(2, dtype=bool), self._sent_s, allocate(MESSAGE, 2), self._counts),
        )
        self._send(0.0)  # compiles it, and sends nothing
        senders[0] = True

    def send(self, now_s: float, size_bytes: int | None = None) -> int:
        """Send the next packet, and return its PacketOutcome.

        Args:
            now_s: s, not before the packet before.
            size_bytes: on the air, without the `overhead_bytes` of a rate; None: as the network
                has it.
        """
        scripted, trace_s = 0, np.nan
        if self._is_scripted:
            both = self.scripts(np.array([now_s]), np.array([self.number + 1]))
            scripted, trace_s = int(both[0][0]), float(both[1][0])
        if size_bytes is not None and self._rate is not None and self._rate.bit_per_s:
            bits = 8 * (size_bytes + self._rate.overhead_bytes)
            self._service[0, 0] = bits / self._rate.bit_per_s
        return self.transmit(now_s, scripted, trace_s)

    def scripts(self, sent_s: Array, numbers: NDArray[np.int64]) -> tuple[Outcomes, Array]:
        """Return the PacketOutcome by outages, 0: none, and the delay by a trace of packets (K,).

        Args:
            sent_s: (K,) s.
            numbers: (K,) sequence numbers.
        """
        rows = np.zeros(len(sent_s), dtype=np.int64)
        trace_s = np.full(len(sent_s), np.nan)
        if self._replays is not None:
            trace_s = replayed_delays(self._replays, sent_s, rows)[0]
        return scripted_outcomes(self._outages, sent_s, rows, numbers)[0], trace_s

    def transmit(self, now_s: float, scripted: int, trace_s: float) -> int:
        """Send the next packet with what `scripts` has of it, and return its PacketOutcome."""
        packet = self._packet
        self._sent_s[0], packet["scripted"], packet["trace_delay_s"] = now_s, scripted, trace_s
        self._counts[0] = 0
        self._send(now_s)
        self.number += 1
        return int(packet["outcome"])

    def set_positions(self, position_ned: Array, euler: Array) -> None:
        """Set where the ends are for the next packets: the sender, then the receiver.

        Args:
            position_ned: (2, 3) m.
            euler: (2, 3) roll, pitch, yaw, rad.
        """
        if self._curves is not None:
            self._packet["fading"] = fading(position_ned, euler, self._curves)[0, 0]

    def receive(self, number: int) -> None:
        """Count a packet that has arrived after a newer one."""
        self._statistics["overtaken"][0, 0] += number < self._latest
        self._latest = max(self._latest, number)

    def damaged(self, data: bytes, copy: int) -> bytes:
        """Return the last packet as a copy with wrong bits has it.

        Args:
            data: its bytes.
            copy: 0 or 1.
        """
        if not data:
            return data
        bits = min(int(self._parameters["bits"]), 8 * len(data))
        flipped = flip_bits(
            np.frombuffer(data, np.uint8)[None],
            np.array([len(data)]),
            np.array([bits]),
            self._parameters["key"][None],
            np.array([self.number]),
            np.array([copy]),
        )
        return flipped.tobytes()

    def free_share(self, now_s: float) -> float:
        """Return the free share of the transmitter's queue, 0 to 1; 1 if there is none."""
        if not self._departures_s.size:
            return 1.0
        return 1.0 - float((self._departures_s > now_s + SIMULTANEOUS_S).mean())

    def summary(self) -> Mapping[str, Any]:
        """Return the statistics of the link, ready for JSON; see `link_statistics.summarise`."""
        sender, receiver = self._names
        links: Mapping[str, Mapping[str, Any]] = summarise(self._statistics, self._names)["links"]
        found: Mapping[str, Any] = links[sender][receiver]
        return found
