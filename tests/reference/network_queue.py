"""Messages on their way, and the statistics of links, one by one in Python."""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array, Broadcast, Records
from testbed.network.link_statistics import LONGEST_BURST, bin_ends, initial_statistics
from testbed.network.links import Numbers, Outcomes, PacketOutcome

DELIVERED, MUTED = PacketOutcome.DELIVERED, PacketOutcome.MUTED
SAME_TIME_S = 1e-9


def stamps(clocks: Array, content_s: Array, rows: Numbers) -> Array:
    """Return the stamps (n, S), s, of S senders as n receivers take them.

    Args:
        clocks: (N, 3) offset s, drift and resolution s.
        content_s: (N,) s, true times of the content.
        rows: (S,) of the senders.
    """
    offset, drift, resolution = np.asarray(clocks)[rows].T
    true_s = content_s[rows]
    shown = true_s + offset + drift * true_s
    coarse = resolution > 0.0
    shown[coarse] = np.floor(shown[coarse] / resolution[coarse] + 1e-6) * resolution[coarse]
    receivers = np.asarray(clocks)[1:]
    return shown - (receivers[:, :1] + receivers[:, 1:2] * true_s)


def bin_of(seconds: Array) -> Numbers:
    """Return the bins (…) of durations (…), s, by their ends."""
    return np.searchsorted(bin_ends(), np.asarray(seconds))


class Queue:
    """Messages between N aircraft and n followers.

    Attributes:
        statistics: (n, N) of LINK_STATISTICS.
        sent, delivered: (n, N) numbers of messages.
        newest: (number, received_s, content_s, stamp_s, vectors (5, 3)) by (follower, aircraft).
    """

    def __init__(self, n: int, aircraft: int) -> None:
        """Start before the first message."""
        self.statistics = initial_statistics(n, aircraft)
        self.sent, self.delivered = np.zeros((2, n, aircraft), dtype=int)
        self.newest: dict[tuple[int, int], tuple] = {}
        self._waiting: list[tuple] = []

    def send(
        self,
        rows: Numbers,
        numbers: Numbers,
        sent_s: Array,
        stamp_s: Array,
        message: Broadcast,
        arrival_s: Array,
        outcomes: Outcomes,
    ) -> None:
        """Queue the copies of a broadcast that arrive, and count what happened to it.

        Args:
            rows: (S,) of the senders.
            numbers: (S,) sequence numbers.
            sent_s: (S,) s.
            stamp_s: (n, S) s, as the receivers take them.
            message: of all N.
            arrival_s: (n, S, 2) s.
            outcomes: (n, S)
        """
        vectors = np.stack(message[1:], axis=1)
        for i, s, copy in np.argwhere(np.isfinite(arrival_s)):
            m = rows[s]
            content = message.stamp_s[m], stamp_s[i, s], vectors[m].copy()
            self._waiting.append((arrival_s[i, s, copy], (i, m), numbers[s], *content))
        for i, s in np.ndindex(*outcomes.shape):
            if rows[s] != i + 1 and outcomes[i, s] != PacketOutcome.UNSUBSCRIBED:
                first, both = arrival_s[i, s].min(), np.isfinite(arrival_s[i, s]).all()
                _count(self.statistics[i, rows[s]], outcomes[i, s], first - sent_s[s], both)
                self.sent[i, rows[s]] += outcomes[i, s] != MUTED
                self.delivered[i, rows[s]] += outcomes[i, s] == DELIVERED

    def deliver(self, now: float) -> None:
        """Deliver what has arrived by `now`, s, in order of arrival."""
        due = [each for each in self._waiting if each[0] <= now + SAME_TIME_S]
        self._waiting = [each for each in self._waiting if each[0] > now + SAME_TIME_S]
        for arrival_s, link, number, *content in sorted(due, key=lambda each: each[0]):
            newest = self.newest[link][0] if link in self.newest else -1
            if number > newest:
                self.newest[link] = number, arrival_s, *content
            elif number < newest:
                self.statistics["overtaken"][link] += 1


def _count(statistics: Records, outcome: int, delay_s: float, both: bool) -> None:
    statistics["outcomes"][outcome] += 1
    if outcome == DELIVERED:
        statistics["duplicated"] += both
        statistics["delay_sum"] += delay_s
        statistics["delay_min"] = min(statistics["delay_min"], delay_s)
        statistics["delay_max"] = max(statistics["delay_max"], delay_s)
        statistics["delays"][bin_of(delay_s)] += 1
        if statistics["burst"]:
            statistics["bursts"][min(statistics["burst"], LONGEST_BURST) - 1] += 1
            statistics["burst"] = 0
    elif outcome != MUTED:
        statistics["burst"] += 1
        statistics["longest_burst"] = max(statistics["longest_burst"], statistics["burst"])


def count_ages(statistics: Records, rows: Numbers, age_s: Array) -> None:
    """Count the ages (n, N), s, of what the followers in these rows used; nan: not used."""
    for k, m in np.argwhere(~np.isnan(age_s[rows])):
        link, age = statistics[rows[k], m], age_s[rows[k], m]
        link["uses"] += 1
        link["age_sum"] += age
        link["age_min"], link["age_max"] = min(link["age_min"], age), max(link["age_max"], age)
        link["ages"][bin_of(age)] += 1
