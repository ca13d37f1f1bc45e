"""What a user's law may read: the own estimates, and the messages that have arrived."""

from __future__ import annotations

from math import nan
from typing import NamedTuple

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.records import Array, Inbox, Indices, OwnState, Records, allocate
from testbed.flight.faults import FAULT, FaultManager, declares
from testbed.formation.message_extrapolation import dead_reckon, message_time, timed_out
from testbed.sensors.ekf import FILTER, WIND
from testbed.sensors.estimators import StateEstimators


class Declared(NamedTuple):
    """Faults that aircraft declare in their messages."""

    faults: Records  # (K, 1) of FAULT
    after_s: float  # from the beginning of a fault until it is declared


class WindEstimates(NamedTuple):
    """Where the estimates of the wind are."""

    aircraft: Records  # (N,) of AIRCRAFT, with the wind at each
    filters: Records  # (M,) of FILTER
    numbers: Indices  # (N,) of the filter of each aircraft; -1: it has none


def declared_faults(faults: FaultManager | None) -> Declared:
    """Return the faults of a flight; None: it has none."""
    if faults is None:
        return Declared(allocate(FAULT, 0, 1), 0.0)
    return Declared(faults.records, faults.declared_after_s)


def wind_estimates(estimators: StateEstimators | None, aircraft: Records) -> WindEstimates:
    """Return the estimates of aircraft (N,) of AIRCRAFT; None: all know the wind at them."""
    numbers = np.full(len(aircraft), -1)
    filters, rows = (None, None) if estimators is None else estimators.filters
    if filters is None or rows is None:
        return WindEstimates(aircraft, allocate(FILTER, 0), numbers)
    numbers[rows] = np.arange(len(rows))
    return WindEstimates(aircraft, filters, numbers)


@kernel
def _write_wind(wind: WindEstimates, row: int, out: Array) -> None:
    """Write the wind that an aircraft estimates, (3,) m/s."""
    number, present = wind.numbers[row], wind.aircraft[row].wind.wind_ned
    if number < 0:
        for axis in range(3):
            out[axis] = present[axis]
        return
    states = wind.filters[number].states
    out[0], out[1], out[2] = states[WIND], states[WIND + 1], 0.0


@kernel
def _declares(declared: Declared, row: int, measured_s: float) -> bool:
    """Return whether a message of an aircraft declares a fault of it."""
    for k in range(len(declared.faults)):
        fault = declared.faults[k, 0]
        if fault.row == row and declares(fault, declared.after_s, measured_s):
            return True
    return False


@entry
def give_inputs(
    rows: Indices,
    aircraft: Records,
    links: Records,
    neighbours: Records,
    controllers: Records,
    wind: WindEstimates,
    declared: Declared,
    payloads: Array,
    extrapolates: bool,
    own: OwnState,
    inbox: Inbox,
    now: float,
) -> None:
    """Copy what a user's law may read to the inputs of its next step.

    Args:
        rows: (m,) of the followers.
        aircraft: (N,) of AIRCRAFT, with the estimates.
        links: (n, N) of LINK.
        neighbours: (n, N) of NEIGHBOUR; of those that are excluded the law has no message.
        controllers: (n,) of CONTROLLER: how messages are extrapolated.
        wind: where the estimates of the wind are.
        declared: faults that messages declare.
        payloads: (n, N, K) numbers of the law in the newest messages.
        extrapolates: messages are extrapolated to the present, which is then their time; those
            that have timed out stay as they were received.
        own: (m); written.
        inbox: (m, N); written.
        now: s.
    """
    for k in range(len(rows)):
        estimate = aircraft[rows[k] + 1].estimate
        own.airspeed[k] = estimate.airspeed
        own.equivalent_airspeed[k] = estimate.equivalent_airspeed
        _write_wind(wind, rows[k] + 1, own.wind_ned[k])
        for axis in range(3):
            own.position_ned[k, axis] = estimate.position_ned[axis]
            own.velocity_ned[k, axis] = estimate.velocity_ned[axis]
            own.acceleration_ned[k, axis] = estimate.acceleration_ned[axis]
            own.euler[k, axis] = estimate.euler[axis]
            own.rates_body[k, axis] = estimate.rates_body[axis]
        for j in range(links.shape[1]):
            link, other, law = links[rows[k], j], neighbours[rows[k], j], controllers[rows[k]].law
            excluded = other.excluded
            inbox.stamp_s[k, j] = nan if excluded else link.stamp_s
            inbox.received_s[k, j] = nan if excluded else link.received_s
            for axis in range(3):
                inbox.position_ned[k, j, axis] = nan if excluded else link.position_ned[axis]
                inbox.velocity_ned[k, j, axis] = nan if excluded else link.velocity_ned[axis]
                acceleration = nan if excluded else link.acceleration_ned[axis]
                inbox.acceleration_ned[k, j, axis] = acceleration
                inbox.euler[k, j, axis] = nan if excluded else link.euler[axis]
                inbox.euler_rates[k, j, axis] = nan if excluded else link.euler_rates[axis]
            v, a = link.velocity_ned, link.acceleration_ned
            rate = (v[0] * a[1] - v[1] * a[0]) / (v[0] ** 2 + v[1] ** 2)
            inbox.turn_rate[k, j] = nan if excluded else rate
            inbox.failed[k, j] = _declares(declared, j, link.measured_s)
            for number in range(payloads.shape[2]):
                inbox.payload[k, j, number] = nan if excluded else payloads[rows[k], j, number]
            if extrapolates and not (excluded or timed_out(link, now, other.timeout_s)):
                dt = now - message_time(law, link)
                position, velocity = dead_reckon(link, dt, law.with_acceleration, 1.0)
                inbox.stamp_s[k, j] = inbox.received_s[k, j] = now
                for axis in range(3):
                    inbox.position_ned[k, j, axis] = position[axis]
                    inbox.velocity_ned[k, j, axis] = velocity[axis]
