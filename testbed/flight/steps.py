"""Compiled steps of the loop over all aircraft: copies, messages, losses, slots."""

from __future__ import annotations

from math import isnan

from testbed.core.compile import entry, kernel
from testbed.core.copies import copy_command, copy_motion
from testbed.core.frames import attitude_rates
from testbed.core.records import Array, BoolArray, Records


@entry
def copy_truth(aircraft: Records) -> None:
    """Copy `truth` of all aircraft (N,) to `estimate`, where autopilots know it exactly."""
    for i in range(len(aircraft)):
        copy_motion(aircraft[i].truth, aircraft[i].estimate)


@entry
def copy_control(aircraft: Records) -> None:
    """Copy `control` of all aircraft (N,) to `command`: no external program commands them."""
    for i in range(len(aircraft)):
        copy_command(aircraft[i].control, aircraft[i].command)
        aircraft[i].guided = False


@entry
def write_messages(
    aircraft: Records, messages: Records, planned_s: Array, sent_s: Array, now: float
) -> None:
    """Write what all aircraft (N,) would broadcast: their estimates, with Euler angle rates.

    Positions are extrapolated to the time of transmission along the velocity, as senders do in
    [HBH23] sec. 8.3.

    Args:
        aircraft: (N,) of AIRCRAFT.
        messages: (N,) of MESSAGE; written.
        planned_s: (N,) s, transmission times; NaN: now.
        sent_s: (N,) s, transmission times; written.
        now: of the estimates, s.
    """
    for i in range(len(aircraft)):
        sent_s[i] = now if isnan(planned_s[i]) else planned_s[i]
        e, message = aircraft[i].estimate, messages[i]
        p, q, r = e.rates_body
        roll_rate, pitch_rate, yaw_rate = attitude_rates(e.euler[0], e.euler[1], p, q, r)
        message.euler_rates[0] = roll_rate
        message.euler_rates[1] = pitch_rate
        message.euler_rates[2] = yaw_rate
        message.stamp_s, ahead_s = sent_s[i], sent_s[i] - now
        for axis in range(3):
            message.position_ned[axis] = e.position_ned[axis]
            if ahead_s != 0.0:  # infinite velocities of lost aircraft are not multiplied by zero
                message.position_ned[axis] += ahead_s * e.velocity_ned[axis]
            message.velocity_ned[axis] = e.velocity_ned[axis]
            message.acceleration_ned[axis] = e.acceleration_ned[axis]
            message.euler[axis] = e.euler[axis]


@entry
def find_losses(
    aircraft: Records,
    lowest_m: Array,
    scripted: bool,
    limit_m: float,
    minimum_m: Array,
    watching: BoolArray,
) -> bool:
    """Write which aircraft (N,) are on the ground or have stopped.

    Args:
        aircraft: (N,) of AIRCRAFT; `down` is written.
        lowest_m: (N,) m above the terrain, below which an aircraft counts as on the ground.
        scripted: the leader follows a script, whatever happens.
        limit_m: the distance, for all pairs.
        minimum_m: (N,) the same by aircraft, of which the larger one counts for a pair; NaN: none
            for pairs with this aircraft.
        watching: (1,) two aircraft are in an encounter.

    Returns:
        Whether `down` changed, or two aircraft are within their distance or in an encounter.
    """
    changed = _write_down(aircraft, lowest_m, scripted)
    return bool(changed | watching[0] | _any_within(aircraft, limit_m, minimum_m))


@kernel
def _any_within(aircraft: Records, limit_m: float, minimum_m: Array) -> bool:
    """Return whether two aircraft that are not lost are within their distance."""
    for i in range(1, len(aircraft)):
        if aircraft[i].lost:
            continue
        q = aircraft[i].truth.position_ned
        for j in range(i):
            limit, one, other = limit_m, minimum_m[i], minimum_m[j]
            if one >= other:  # false with NaN
                limit = max(limit, one)
            elif other > one:
                limit = max(limit, other)
            p = aircraft[j].truth.position_ned
            x, y, z = q[0] - p[0], q[1] - p[1], q[2] - p[2]
            if x * x + y * y + z * z < limit * limit and not aircraft[j].lost:
                return True
    return False


@kernel
def _write_down(aircraft: Records, lowest_m: Array, scripted: bool) -> bool:
    """Write `down`; see `find_losses`. Return whether it changed."""
    changed = False
    for i in range(len(aircraft)):
        a = aircraft[i]
        down = a.stopped or not -a.truth.position_ned[2] >= lowest_m[i]
        if i == 0 and scripted:
            down = False
        if down != a.down:
            a.down = down
            changed = True
    return changed


@entry
def has_events(waiting: BoolArray) -> bool:
    """Return whether events wait for the observers, (1,)."""
    return bool(waiting[0])
