"""The channel by itself: messages that nobody reads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.network.channel import Channel
from testbed.network.fates import BEFALL
from testbed.network.links import Fates
from testbed.network.traffic import idle
from testbed.state import Array


class Transmission(NamedTuple):
    """K messages of each of N aircraft to each of n followers; row k is sequence number k."""

    sent_s: Array  # (K, N)
    received_s: Array  # (K, n, N) of the first that came through; nan: none
    second_s: Array  # (K, n, N) of a second copy; nan: none
    fate: Fates  # (K, n, N) of links.Fate
    copies: Fates  # (K, n, N) that came through


def transmit(
    channel: Channel,
    *,
    packets: int,
    period_s: float | Array,
    phase_s: float | Array = 0.0,
    faded: Array | None = None,
) -> Transmission:
    """Send this many messages on every link.

    Args:
        channel: between N aircraft and n followers.
        packets: K.
        period_s: from message to message of each aircraft (N,) or all.
        phase_s: the first message of each aircraft (N,) or all.
        faded: (n, N) probability of being lost to distance and airframes.
    """
    n, aircraft = channel.links.shape
    rows, traffic = np.arange(aircraft), idle(channel)
    period, phase = np.broadcast_to(period_s, aircraft), np.broadcast_to(phase_s, aircraft)
    script, untold = np.zeros((n, aircraft), np.uint8), np.full((n, aircraft), np.nan)
    fading = np.zeros((n, aircraft)) if faded is None else faded
    sent = phase + np.arange(packets)[:, None] * period
    both = np.empty((packets, n, aircraft, 2))
    fate = np.empty((packets, n, aircraft), np.uint8)
    for k in range(packets):
        number = np.full(aircraft, k)
        at = rows, number, sent[k], script, untold, fading
        BEFALL(channel, traffic, *at, both[k], fate[k])
    both.sort(axis=-1)
    both[np.isinf(both)] = np.nan
    copies = np.isfinite(both).sum(axis=-1).astype(np.uint8)
    return Transmission(sent, both[..., 0], both[..., 1], fate, copies)
