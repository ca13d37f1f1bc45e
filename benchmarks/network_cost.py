"""Measure the cost of the network of many aircraft, all to all, relative to their flight models.

Both compute the same flight time in one process, alternating: the models of N Rascals step at
200 Hz and nothing else; the network carries 10 messages a second from each to each other on links
with bursts, jitter and queues, delivers them at 25 control steps a second and counts their ages.

usage: make bench  (or: python benchmarks/network_cost.py [--aircraft N] [--seconds S]
[--repeats N] [--json FILE])
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from pathlib import Path

import numpy as np

from testbed.core.records import MESSAGE, NedOrigin, allocate
from testbed.flight.monitors import LINK_WATCH, check_links
from testbed.network.channel import make_channel
from testbed.network.links import resolve_links
from testbed.network.radio import Radio
from testbed.scenario import find_aircraft
from testbed.scenario.network import Network
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.trim import InitialState

PHYSICS_HZ, CONTROL_HZ, MESSAGES_HZ = 200, 25, 10
LINK = {
    "loss": {"kind": "gilbert-elliott", "p": 0.1, "r": 0.4},
    "delay_s": 0.02,
    "jitter": {"distribution": "pareto", "spread_s": 0.015, "correlation": 0.3},
    "duplicate": 0.01,
    "corrupt": 0.005,
    "rate": {"bit_per_s": 1e6, "overhead_bytes": 66, "queue_packets": 50},
}


def flight_s(fleet: JsbsimFleet, seconds: float) -> float:
    """Measure wall-clock time of the models, with writing and reading, s."""
    trimmed = fleet.trimmed
    began = time.perf_counter()
    for _ in range(round(seconds * CONTROL_HZ)):
        fleet.step(trimmed, PHYSICS_HZ // CONTROL_HZ)
    return time.perf_counter() - began


def radio_s(radio: Radio, aircraft: int, start_s: float, seconds: float, together: bool) -> float:
    """Measure wall-clock time of the network, s; all send at once, or each at its own tick."""
    messages, sent_s = allocate(MESSAGE, aircraft), np.empty(aircraft)
    period, control = PHYSICS_HZ // MESSAGES_HZ, PHYSICS_HZ // CONTROL_HZ
    phase = np.zeros(aircraft, int) if together else np.arange(aircraft) % period
    rows, watches = np.arange(aircraft - 1), allocate(LINK_WATCH, aircraft - 1, aircraft)
    began = time.perf_counter()
    for tick in range(round(seconds * PHYSICS_HZ)):
        now = start_s + tick / PHYSICS_HZ
        senders = np.equal(tick % period, phase)
        if senders.any():
            messages["stamp_s"] = sent_s[:] = now
            radio.send(sent_s, messages, None, senders)
        if tick % control == 0:
            radio.deliver(now)
            np.subtract(now, radio.links["measured_s"], out=radio.links["age_s"])
            check_links(radio.statistics, radio.links, watches, np.inf, rows, now)
    return time.perf_counter() - began


def main() -> None:
    """Measure, and print the result."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--aircraft", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    n = options.aircraft
    starts = [
        InitialState(position_ned=(30.0 * row, 0.0, -100.0), course=0.0, airspeed=22.0)
        for row in range(n)
    ]
    fleet = JsbsimFleet([find_aircraft("rascal110")] * n, starts, NedOrigin(), PHYSICS_HZ)
    names = tuple(f"uav{row}" for row in range(n))
    channel = make_channel(resolve_links(names, Network.model_validate(LINK)), 1)
    radios = {together: Radio(channel) for together in (True, False)}
    packets = options.seconds * MESSAGES_HZ * n * (n - 1)
    result: dict[str, float] = {}
    for together, radio in radios.items():
        radio_s(radio, n, 0.0, 1.0, together)  # compiles the kernels
    turns = []
    for turn in range(options.repeats):
        flown = flight_s(fleet, options.seconds)
        start = 1.0 + turn * options.seconds
        turns.append(
            (flown, *(radio_s(radios[way], n, start, options.seconds, way) for way in radios))
        )
    if fleet.lost(fleet.read()).any():
        raise SystemExit("an aircraft was lost and costs nothing: fly a shorter time")
    for name, column in (("together", 1), ("at own moments", 2)):
        ratios = [turn[column] / turn[0] for turn in turns]
        result[name] = statistics.median(ratios)
        print(
            f"{n} aircraft all to all, {MESSAGES_HZ} Hz, {name}: radio / flight models = "
            f"{result[name]:.2f} ({min(ratios):.2f}-{max(ratios):.2f}); "
            f"{1e9 * turns[-1][column] / packets:.0f} ns a packet"
        )
    if options.json:
        options.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
