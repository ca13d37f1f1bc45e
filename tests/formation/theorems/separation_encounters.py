"""Ideal fixed-wing aircraft that meet, each behind the product's separation filter.

An aircraft turns by its bank at g tan φ / s, with a lag of the bank or none, and at most 50°; its
speed follows with the pole 0.64 1/s within 16 to 30 m/s, its climb angle with 0.5 s within 10°.
Each desires the velocity of its slot plus a closing of at most 3 m/s towards it, and steers to what
the filter leaves of that. Control and messages are at 25 Hz.
"""

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.records import FOLLOWER, LINK, MOTION
from testbed.formation.hbh23 import LAW, NEIGHBOUR, reach_velocity, write_inputs
from testbed.formation.paper_law import make_paper_law
from testbed.formation.separation_filter import SEPARATION, limit_closing

G, POLE, LOW, HIGH = 9.81, 0.64, 16.0, 30.0
BANK, CLIMB, CLIMB_LAG = np.radians(50.0), np.radians(10.0), 0.5
DT = 0.04
SLOT_CHANGES, CROSSINGS, HEAD_ON = 0, 1, 2
LEAST_START = 10.0  # m, between two aircraft; without it slow overtakers begin too close
# of an aircraft: north, east, down, course, speed, climb angle, bank
N, E, D, COURSE, SPEED, GAMMA, PHI = range(7)


@kernel
def move(x, speed, bank, climb, lag):
    """Move an aircraft by a step with its commands."""
    if lag <= 0.0:
        x[PHI] = bank
    rate = G * np.tan(x[PHI]) / x[SPEED]
    course = x[COURSE] + 0.5 * rate * DT
    forward = x[SPEED] * np.cos(x[GAMMA]) * DT
    x[N] += forward * np.cos(course)
    x[E] += forward * np.sin(course)
    x[D] -= x[SPEED] * np.sin(x[GAMMA]) * DT
    x[COURSE] += rate * DT
    x[SPEED] += DT * POLE * (speed - x[SPEED])
    x[GAMMA] += DT / CLIMB_LAG * (climb - x[GAMMA])
    if lag > 0.0:
        x[PHI] += DT / lag * (bank - x[PHI])


@kernel
def velocity_of(x):
    level = x[SPEED] * np.cos(x[GAMMA])
    return level * np.cos(x[COURSE]), level * np.sin(x[COURSE]), -x[SPEED] * np.sin(x[GAMMA])


@kernel
def write_message(link, x, stamp):
    """Write what an aircraft sends into a link."""
    north, east, down = velocity_of(x)
    rate = G * np.tan(x[PHI]) / x[SPEED]
    link.stamp_s = link.received_s = stamp
    for axis in range(3):
        link.position_ned[axis] = x[axis]
        link.euler_rates[axis] = 0.0
    link.velocity_ned[0], link.velocity_ned[1], link.velocity_ned[2] = north, east, down
    link.acceleration_ned[0], link.acceleration_ned[1] = -rate * east, rate * north
    link.acceleration_ned[2] = 0.0
    link.euler_rates[2] = rate


@kernel
def steer(x, p0, p1, p2):
    """Return commanded speed, bank and climb angle of a desired velocity."""
    s = np.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
    error = (np.arctan2(p1, p0) - x[COURSE] + np.pi) % (2.0 * np.pi) - np.pi
    bank = np.arctan(1.5 * error * x[SPEED] / G)
    climb = np.arcsin(min(max(-p2 / s, -1.0), 1.0))
    return min(max(s, LOW), HIGH), min(max(bank, -BANK), BANK), min(max(climb, -CLIMB), CLIMB)


def start_slot_changes(rng, n, x, slots, velocities):
    """Draw n aircraft within 50 m of each other, and slots 10 m apart that they change to.

    Of two aircraft, each slot is behind the other aircraft.
    """
    course, speed = rng.uniform(-np.pi, np.pi), rng.uniform(19.0, 25.0)
    c, s = np.cos(course), np.sin(course)
    ahead, aside, below = np.zeros(n), np.zeros(n), np.zeros(n)
    for i in range(n):
        apart = False
        while not apart:
            ahead[i], aside[i] = rng.uniform(-25.0, 25.0), rng.uniform(-25.0, 25.0)
            below[i] = rng.uniform(-3.0, 3.0)
            apart = True
            for j in range(i):
                apart &= np.hypot(ahead[i] - ahead[j], aside[i] - aside[j]) >= 10.0
    order = rng.permutation(n)
    for i in range(n):
        x[i, N], x[i, E] = ahead[i] * c - aside[i] * s, ahead[i] * s + aside[i] * c
        x[i, D], x[i, COURSE] = below[i], course + rng.uniform(-0.1, 0.1)
        x[i, SPEED] = speed + rng.uniform(-1.0, 1.0)
        f, r = -10.0 * (order[i] % 2), 10.0 * (order[i] - 0.5 * (n - 1))
        slots[i, 0], slots[i, 1] = f * c - r * s, f * s + r * c
        velocities[i, 0], velocities[i, 1] = speed * c, speed * s
    if n == 2:
        for i in range(2):
            to = x[1 - i, :3] - x[i, :3]
            far = np.sqrt(np.sum(to**2))
            slots[i] = x[i, :3] + to * (1.0 + 12.0 / far)
        aside_m = rng.uniform(-0.8, 0.8) * 6.0 / far
        slots[0, 0] -= aside_m * to[1]
        slots[0, 1] += aside_m * to[0]


def start_crossing(rng, x, slots, velocities, vertical):
    """Draw two aircraft whose straight paths pass within the separation after 4 to 12 s."""
    after = rng.uniform(4.0, 12.0)
    for i in range(2):
        x[i, COURSE], x[i, SPEED] = rng.uniform(-np.pi, np.pi), rng.uniform(18.0, 28.0)
        x[i, GAMMA] = rng.uniform(-1.0, 1.0) * vertical
        aside = rng.uniform(-3.0, 3.0)
        velocities[i, 0], velocities[i, 1], velocities[i, 2] = velocity_of(x[i])
        x[i, N] = -after * velocities[i, 0] - aside * np.sin(x[i, COURSE])
        x[i, E] = -after * velocities[i, 1] + aside * np.cos(x[i, COURSE])
        x[i, D] = -after * velocities[i, 2] + rng.uniform(-1.8, 1.8)
        for axis in range(3):
            slots[i, axis] = x[i, axis]


def start_head_on(x, slots, velocities):
    """Place two aircraft abreast, 40 m apart, each with its slot 40 m beyond the other."""
    for i in range(2):
        side = 2.0 * i - 1.0
        x[i, E], x[i, SPEED], slots[i, 1], velocities[i, 0] = 20.0 * side, 22.0, -60.0 * side, 22.0


@kernel
def distance(a, b):
    return np.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@entry
def meet(
    x, slots, velocities, leader, law, separation, filtered, lag, delay, lost, wind, distances, work
):
    """Fly one encounter; return the smallest distance and the largest distance from a slot, m.

    Args:
        x: (n, 7) of the aircraft at the start; written.
        slots: (n, 3) m; written.
        velocities: (n, 3) m/s, of the slots.
        leader: (7,) of the leader; written.
        law: (n,) of LAW, for its bounds and gains.
        separation: (n,) of SEPARATION.
        filtered: how many of them have the filter.
        lag: of the bank, s; 0: none; below 0: each flies exactly at its desired velocity.
        delay: of messages, steps.
        lost: (steps, n, n + 1) messages from the leader and the aircraft.
        wind: speed of the air to the east, m/s.
        distances: (steps,) of the first two aircraft; written.
        work: records MOTION (1,), LINK (n, n + 1), NEIGHBOUR (n + 1,), FOLLOWER (1,); states of
            all steps (steps, n, 7) and of the leader (steps, 7); commands (n, 3). What numba
            allocates itself takes it seconds to compile.
    """
    own, links, neighbours, outs, past, past_leader, commands = work
    me, out = own[0], outs[0]
    steps, n = lost.shape[0], lost.shape[1]
    closest = 1e9
    for k in range(steps):
        now = k * DT
        for c in range(7):
            past_leader[k, c] = leader[c]
        for i in range(n):
            for c in range(7):
                past[k, i, c] = x[i, c]
        for i in range(n):
            for m in range(n + 1):
                if m == i + 1 or lost[k, i, m]:
                    continue
                sender = past_leader[k - delay] if m == 0 else past[k - delay, m - 1]
                write_message(links[i, m], sender, now - delay * DT)
        for i in range(n):
            v0, v1, v2 = velocity_of(x[i])
            s0, s1, s2 = velocities[i, 0], velocities[i, 1], velocities[i, 2]
            g0, g1, g2 = slots[i, 0] - x[i, 0], slots[i, 1] - x[i, 1], slots[i, 2] - x[i, 2]
            closing = 3.0 / np.sqrt(50.0 + g0 * g0 + g1 * g1 + g2 * g2)
            wanted = s0 + closing * g0, s1 + closing * g1, s2 + closing * g2
            rate = closing * (s0 - v0), closing * (s1 - v1), closing * (s2 - v2)
            me.velocity_ned[0], me.velocity_ned[1], me.velocity_ned[2] = v0, v1, v2
            for axis in range(3):
                me.position_ned[axis] = x[i, axis]
            me.airspeed = x[i, SPEED]
            write_inputs(reach_velocity(law[i], me.velocity_ned, me.airspeed, wanted, rate), out)
            p0, p1, p2 = wanted
            if i < filtered:
                limit_closing(separation[i], law[i], now, me, links[i], neighbours, out)
                speed, to = out.speed_desired, out.direction
                p0, p1, p2 = speed * to[0], speed * to[1], speed * to[2]
            if lag >= 0.0:
                p0, p1, p2 = steer(x[i], p0, p1, p2)
            commands[i, 0], commands[i, 1], commands[i, 2] = p0, p1, p2
        for i in range(n):
            if lag < 0.0:
                for axis in range(3):
                    x[i, axis] += DT * commands[i, axis]
            else:
                move(x[i], commands[i, 0], commands[i, 1], commands[i, 2], lag)
            x[i, E] += wind * DT
            for axis in range(3):
                slots[i, axis] += velocities[i, axis] * DT
            slots[i, 1] += wind * DT
        for axis in range(3):
            leader[axis] += velocities[0, axis] * DT
        leader[E] += wind * DT
        distances[k] = distance(x[0], x[1])
        for i in range(n):
            for j in range(i):
                closest = min(closest, distance(x[i], x[j]))
    away = 0.0
    for i in range(n):
        away = max(away, distance(slots[i], x[i]))
    return closest, away


def start(rng, kind, n, vertical):
    """Draw aircraft, slots and their velocities, and a leader 300 m ahead of all slots.

    Args:
        rng: generator of the draws.
        kind: SLOT_CHANGES and HEAD_ON, which are behind a leader, or CROSSINGS without one.
        n: aircraft.
        vertical: rad, largest climb angle of a crossing.
    """
    x, slots, velocities = np.zeros((n, 7)), np.zeros((n, 3)), np.zeros((n, 3))
    if kind == SLOT_CHANGES:
        start_slot_changes(rng, n, x, slots, velocities)
    elif kind == HEAD_ON:
        start_head_on(x, slots, velocities)
    else:
        start_crossing(rng, x, slots, velocities, vertical)
        while np.linalg.norm(x[0, :3] - x[1, :3]) < LEAST_START:
            start_crossing(rng, x, slots, velocities, vertical)
    leader = np.zeros(7)
    leader[SPEED] = np.linalg.norm(velocities[0])
    direction = velocities[0] / leader[SPEED]
    leader[:3] = slots[0] + 300.0 * direction
    leader[COURSE] = np.arctan2(direction[1], direction[0])
    return x, slots, velocities, leader


def draw_lost(rng, kind, n, steps, delay, loss):
    """Draw which messages do not arrive: (steps, n, n + 1), from the leader and the aircraft."""
    lost = np.ones((steps, n, n + 1), dtype=bool)
    others = ~np.eye(n, n + 1, 1, dtype=bool)
    lost[delay:, others] = (rng.random((steps - delay, n, n)) < loss).reshape(-1, n * n)
    if kind == CROSSINGS:
        lost[:, :, 0] = True
    return lost


def encounters(count, kind=SLOT_CHANGES, n=2, *, separation_m=6.0, margin_m=1.0, rate=0.3,
               filtered=None, lag=0.0, delay_s=0.0, loss=0.0, wind=0.0, vertical=0.0, seconds=None,
               seed=1, distances=None):  # fmt: skip
    """Fly encounters of a seed; return the smallest distances and those from the slots at the end.

    Args:
        distances: (steps,) m, between the first two aircraft of the last encounter; written.
    """
    law = make_paper_law(np.zeros((n, 3)), np.zeros((n, n + 1))).law
    separation = np.zeros(n, SEPARATION)
    separation["on"], separation["distance"] = True, separation_m + margin_m
    separation["rate"] = rate
    neighbours = np.zeros(n + 1, NEIGHBOUR)
    neighbours["timeout_s"] = 5.0
    seconds = seconds or 90.0
    steps, delay = int(seconds / DT), round(delay_s / DT)
    links = np.zeros((n, n + 1), LINK)
    records = np.zeros(1, MOTION), links, neighbours, np.zeros(1, FOLLOWER)
    work = *records, np.zeros((steps, n, 7)), np.zeros((steps, 7)), np.zeros((n, 3))
    filtered = n if filtered is None else filtered
    plain = np.zeros(n, LAW)
    plain[:] = law
    distances = np.zeros(steps) if distances is None else distances
    found = np.zeros((count, 2))
    for i in range(count):
        rng = np.random.default_rng([seed, i])
        drawn = start(rng, kind, n, vertical)
        lost = draw_lost(rng, kind, n, steps, delay, loss)
        links["stamp_s"] = links["received_s"] = np.nan  # no message yet
        conditions = filtered, lag, delay, lost, wind, distances, work
        found[i] = meet(*drawn, plain, separation, *conditions)
    return found[:, 0], found[:, 1]
