"""The radio of a page by itself: everyone sends, nobody flies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from testbed.network.ledger import Numbers
from testbed.network.links import Fates
from testbed.scenario import Scenario
from testbed.sim.radios import make_radio
from testbed.sim.world import clock_of
from testbed.state import Array, Broadcast, VehicleState

TELL = 1000  # rounds from one word on how far it is to the next


class Heard(NamedTuple):
    """K messages of each of N aircraft to each of n followers; row k is sequence number k."""

    sent_s: Array  # (K, N)
    received_s: Array  # (K, n, N) of the first copy that came through; nan: none
    fate: Fates  # (K, n, N) of links.Fate
    copies: Fates  # (K, n, N) that came through


class Sounding(NamedTuple):
    """What became of the messages."""

    summary: Mapping[str, Any]  # numbers of all links
    heard: Heard | None  # message by message, if asked for


def sound(
    page: Scenario,
    packets: int,
    *,
    keep: bool,
    tell: Callable[[int, int], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Sounding:
    """Send this many messages on every link of a page, as in a flight that stays as it began.

    Everyone sends when it would in the flight, with the same dice. Distances and airframes in the
    way are those of the start in level flight.

    Args:
        page: whose network.
        packets: K.
        keep: whether to return them one by one.
        tell: called now and then with how many messages were sent, and of how many.
        stop: asked before each round.

    Raises:
        KeyboardInterrupt: it was to stop.
        InputError: a file of delays or a trace cannot be used.
    """
    radio, _ = make_radio(page)
    truth = _formation(page)
    aircraft = len(truth.airspeed)
    everyone = np.arange(aircraft)
    content = Broadcast(np.zeros(aircraft), *(np.zeros((aircraft, 3)),) * 5)
    heard = _blank(packets, aircraft) if keep else None
    number = np.zeros(aircraft, np.int64)
    clock = clock_of(page)
    # of all that a clock tells nothing but the broadcasts matters
    only = replace(
        clock,
        autopilot=clock.broadcast,
        control=clock.broadcast,
        log=clock.broadcast,
        control_phases=(),
    )
    longest = max([clock.broadcast / clock.base_rate_hz, *(beat.period_s for beat in clock.beats)])
    latest = max([longest, *(beat.phase_s for beat in clock.beats)])
    for round_, (tick, due, *_) in enumerate(only.schedule(latest + (packets + 1) * longest)):
        if stop():
            raise KeyboardInterrupt
        if due.broadcast is None:
            continue
        who = due.broadcast & (number < packets)
        if not who.any():
            if (number == packets).all():
                break
            continue
        now = clock.time_s(tick)
        sent_s = np.full(aircraft, now) if due.sent_s is None else due.sent_s
        content.stamp_s.fill(now)
        arrivals, fate = radio.send(sent_s, content, truth, who)
        radio.deliver(now)
        if heard is not None:
            rows = everyone[who]
            _put(heard, number[rows], rows, sent_s[rows], arrivals, fate)
        number += who
        if tell and round_ % TELL == 0:
            tell(int(number.sum()), packets * aircraft)
    radio.deliver(np.inf)
    return Sounding(radio.summary(), heard)


def _formation(page: Scenario) -> VehicleState:
    """Everyone at its start, level, on a leader's course of north."""
    starts = np.array([(0.0, 0.0, 0.0), *(each.start_m for each in page.fleet)], dtype=np.float64)
    still, speed = np.zeros_like(starts), np.zeros(len(starts))
    return VehicleState(starts, still, still, still, still, speed, speed)


def _blank(packets: int, aircraft: int) -> Heard:
    links = (packets, aircraft - 1, aircraft)
    return Heard(
        np.empty((packets, aircraft)),
        np.empty(links),
        np.empty(links, np.uint8),
        np.empty(links, np.uint8),
    )


def _put(
    heard: Heard,
    numbers: Numbers,
    rows: Numbers,
    sent_s: Array,
    arrivals: Array,
    fate: Fates,
) -> None:
    """Write down a round of S messages: numbers and rows (S,)."""
    came = np.isfinite(arrivals)
    first = arrivals.min(axis=2)
    heard.sent_s[numbers, rows] = sent_s
    heard.received_s[numbers, :, rows] = np.where(came.any(axis=2), first, np.nan).T
    heard.fate[numbers, :, rows] = fate.T
    heard.copies[numbers, :, rows] = came.sum(axis=2).T
