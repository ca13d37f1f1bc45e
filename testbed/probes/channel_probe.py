"""Send messages over the network of a scenario, without simulating aircraft."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from testbed.core.records import Array, Broadcast, NedOrigin, Records, VehicleState
from testbed.flight.schedule import Clock
from testbed.network.links import Numbers, Outcomes
from testbed.plan.clock import build_clock
from testbed.plan.fleet import solve_weights
from testbed.plan.radio import build_radio
from testbed.scenario import Scenario

PROGRESS_INTERVAL = 1000  # transmissions between two progress reports


class MessageRecord(NamedTuple):
    """K messages of each of N aircraft to n followers, by sequence number."""

    sent_s: Array  # (K, N)
    received_s: Array  # (K, n, N) of the first copy received; NaN: none
    outcome: Outcomes  # (K, n, N) of PacketOutcome
    copies: Outcomes  # (K, n, N) received copies


class ChannelProbe(NamedTuple):
    """Result of a probe of the network."""

    summary: Mapping[str, Any]  # statistics of all links
    messages: MessageRecord | None  # each message, if requested


def probe_channel(
    scenario: Scenario,
    packets: int,
    *,
    record: bool,
    progress: Callable[[int, int], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> ChannelProbe:
    """Send messages on every link, with the aircraft at their start in level flight.

    Transmission times and random numbers are those of a flight. Distances and obstruction by
    airframes stay as at the start.

    Args:
        scenario: whose network is probed.
        packets: K, number of messages of each aircraft.
        record: whether to return each message.
        progress: called now and then with the number of sent messages and of all.
        stop: called before each transmission; true ends the probe.

    Raises:
        KeyboardInterrupt: `stop` returned true.
        InputError: a file of delays or a trace cannot be used.
    """
    names, network, seed = scenario.aircraft_names, scenario.network, scenario.scenario.seed
    weights = solve_weights(scenario.formation, names[1:])
    origin = NedOrigin(**scenario.scenario.origin.model_dump())
    radio, _ = build_radio(names, network, weights, origin, seed)
    truth = _start_state(scenario)
    aircraft = len(truth.airspeed)
    rows = np.arange(aircraft)
    content = Broadcast(np.zeros(aircraft), *(np.zeros((aircraft, 3)),) * 5)
    messages = _allocate(packets, aircraft) if record else None
    sent = np.zeros(aircraft, np.int64)
    clock = _broadcast_clock(build_clock(scenario))
    periods_s = (each.period_s for each in clock.transmit_schedules)
    longest_s = max([clock.broadcast / clock.base_rate_hz, *periods_s])
    latest_s = max([longest_s, *(each.phase_s for each in clock.transmit_schedules)])
    schedule = clock.schedule(latest_s + (packets + 1) * longest_s)
    for round_, (tick, due, *_) in enumerate(schedule):
        if stop():
            raise KeyboardInterrupt
        if due.broadcast is None:
            continue
        sending = due.broadcast & (sent < packets)
        if not sending.any():
            if (sent == packets).all():
                break
            continue
        now = clock.time_s(tick)
        sent_s = np.full(aircraft, now) if due.sent_s is None else due.sent_s
        content.stamp_s.fill(now)
        transmitted = radio.send(sent_s, content, truth, sending)
        radio.deliver(now)
        if messages is not None:
            senders = rows[sending]
            _write(messages, sent[senders], senders, sent_s[senders], transmitted[:, senders])
        sent += sending
        if progress and round_ % PROGRESS_INTERVAL == 0:
            progress(int(sent.sum()), packets * aircraft)
    radio.deliver(np.inf)
    return ChannelProbe(radio.summary(), messages)


def _broadcast_clock(clock: Clock) -> Clock:
    """Return a clock on which only broadcasts happen."""
    return replace(
        clock,
        autopilot=clock.broadcast,
        control=clock.broadcast,
        log=clock.broadcast,
        control_phases=(),
    )


def _start_state(scenario: Scenario) -> VehicleState:
    """Return all aircraft at their start, level, with the leader heading north."""
    offsets = [(0.0, 0.0, 0.0), *(each.start_m for each in scenario.fleet)]
    position = np.array(offsets, dtype=np.float64)
    zeros, speed = np.zeros_like(position), np.zeros(len(position))
    return VehicleState(position, zeros, zeros, zeros, zeros, speed, speed)


def _allocate(packets: int, aircraft: int) -> MessageRecord:
    links = (packets, aircraft - 1, aircraft)
    return MessageRecord(
        np.empty((packets, aircraft)),
        np.empty(links),
        np.empty(links, np.uint8),
        np.empty(links, np.uint8),
    )


def _write(
    messages: MessageRecord,
    numbers: Numbers,
    senders: Numbers,
    sent_s: Array,
    packets: Records,
) -> None:
    """Record S messages that are sent at once: sequence numbers and senders (S,)."""
    received = np.isfinite(packets["arrival_s"])
    first = packets["arrival_s"].min(axis=2)
    messages.sent_s[numbers, senders] = sent_s
    messages.received_s[numbers, :, senders] = np.where(received.any(axis=2), first, np.nan).T
    messages.outcome[numbers, :, senders] = packets["outcome"].T
    messages.copies[numbers, :, senders] = received.sum(axis=2).T
