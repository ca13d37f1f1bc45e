"""Time many flights in one process, in turns with bare JSBSim.

Rows fly Simulation 3 with law, network and metrics, each with its own seed of 20 % packet loss.
Bare JSBSim is `run()` of four of the same aircraft at 200 Hz, with its default integrators and
constant controls, on one thread. Also times resets, and steps of the vector environment.

usage: python benchmarks/batch.py [--rows N ...] [--physics-hz HZ] [--into docs/many-flights.md]
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np
from full_over_bare import bare
from inputs import Inputs
from tables import add_output_arguments, draw, publish, row

import testbed
import testbed.rl  # noqa: F401 - registers the environment
from testbed.scenario import load_scenario, set_duration
from testbed.views.panels import BLUE, DASHED, GREY, ORANGE, Line, Panel, PanelGrid

TURNS, FLIGHT_S, BARE_S = 3, 60.0, 20.0
ROWS = (1, 2, 4, 8, 16, 32, 64, 128)
ENVIRONMENTS, ENV_STEPS = (1, 4, 16, 64), 300
FIGURE = Path(__file__).parent.parent / "docs" / "images" / "many-flights.png"
MARK = "python benchmarks/batch.py"
INPUTS = {MARK: Inputs()}  # times depend on packages and machine, not on gains


class Rate(NamedTuple):
    """What a number of rows flies, aircraft-seconds per second of the wall clock; medians."""

    rows: int
    alone: float  # on one thread
    threads: float  # on all processors
    bare: float  # JSBSim, on one thread, in the same minutes
    build_ms: float  # per row
    reset_ms: float  # per row, with the same seed
    reseed_ms: float  # per row, with another one

    def cells(self) -> Iterator[str]:
        """Yield the cells of its line of the table."""
        yield f"{self.rows}"
        yield f"{self.alone:,.0f}"
        yield f"{self.alone / self.bare:.1f}"
        yield f"{self.threads:,.0f}"
        yield f"{self.bare:,.0f}"
        yield from (f"{each:.2f}" for each in (self.build_ms, self.reset_ms, self.reseed_ms))


def measure(rows: int, physics_hz: int) -> Rate:
    """Measure some turns of a number of rows."""
    changes = [f"rates.physics_hz={physics_hz}", "network.loss=0.2"]
    scenario = set_duration(load_scenario("simulation-3", changes), FLIGHT_S)
    jsbsim = load_scenario("simulation-3", ["rates.physics_hz=200"])
    aircraft, begun = len(scenario.aircraft), time.perf_counter()
    seeds = range(1, rows + 1)
    batches = [testbed.Batch(scenario, seeds=seeds, threads=each) for each in (1, None)]
    build_ms = 1e3 * (time.perf_counter() - begun) / (2 * rows)
    turns = []
    for turn in range(TURNS):
        others = range(1000 * (turn + 1), 1000 * (turn + 1) + rows)
        reseed_ms = 1e3 * _seconds(lambda: batches[0].reset(seeds=others)) / rows  # noqa: B023
        batches[0].reset()  # keeps the start of each row
        batches[0].step(1.0)
        reset_ms = 1e3 * _seconds(batches[0].reset) / rows
        batches[1].reset()
        rates = [rows * aircraft * FLIGHT_S / _seconds(each.run) for each in batches]
        spent = aircraft * BARE_S / bare(jsbsim, BARE_S).wall_s
        turns.append((*rates, spent, build_ms, reset_ms, reseed_ms))
    return Rate(rows, *(statistics.median(each) for each in zip(*turns, strict=True)))


def environments(count: int) -> float:
    """Return steps per second of the vector environment, with resets."""
    envs = gymnasium.make_vec("testbed/HoldSlot-v0", num_envs=count)
    envs.reset(seed=1)
    actions = np.random.default_rng(1).uniform(-0.2, 0.2, (ENV_STEPS, count, 3))
    for action in actions:  # each start is reset once
        envs.step(action)
    return count * ENV_STEPS / _seconds(lambda: [envs.step(each) for each in actions])


def single_environment() -> float:
    """Return steps per second of the environment for one flight, without resets."""
    env = gymnasium.make("testbed/HoldSlot-v0", duration_s=2000.0, limit_m=100_000.0)
    env.reset(seed=1)
    env.step(np.zeros(3))
    action = np.zeros(3, np.float32)
    return ENV_STEPS / _seconds(lambda: [env.step(action) for _ in range(ENV_STEPS)])


def _seconds(call: object) -> float:
    begun = time.perf_counter()
    call()  # type: ignore[operator]
    return time.perf_counter() - begun


def picture(rates: Sequence[Rate], processors: int) -> PanelGrid:
    """Return the figure: throughput against rows."""
    rows = np.array([each.rows for each in rates], dtype=float)

    def line(values: Sequence[float], colour: str, name: str, dashes: object = "-") -> Line:
        return Line(rows, np.array(values), colour, name, 2.0, False, dashes, "o")  # type: ignore[arg-type]

    return PanelGrid(
        "Flights in one process",
        "Simulation 3 with packet loss and metrics, aircraft-seconds per second",
        [
            [
                Panel(
                    "Throughput",
                    "rows",
                    "aircraft-seconds per second",
                    [
                        line([each.threads for each in rates], ORANGE, f"{processors} threads"),
                        line([each.alone for each in rates], BLUE, "1 thread"),
                        Line(
                            rows,
                            np.array([each.bare for each in rates]),
                            GREY,
                            "bare JSBSim, 200 Hz, 1 thread",
                            2.0,
                            dashes=DASHED,
                        ),
                    ],
                    x_log=True,
                    y_limits=(0.0, 1.15 * max(each.threads for each in rates)),
                    x_ticks=[(float(each), str(int(each))) for each in rows],
                )
            ]
        ],
        [1.0],
        (10.0, 6.0),
    )


def text(rates: Sequence[Rate], physics_hz: int, processors: int) -> str:
    """Return the tables."""
    head = (
        "rows, 1 thread, / bare JSBSim, all threads, bare JSBSim, build ms, reset ms, new seed ms"
    ).split(", ")
    lines = [row(*head), row(*["--:"] * len(head)), *(row(*each.cells()) for each in rates)]
    lines += [
        "",
        f"Aircraft-seconds per second of the wall clock, flight models at {physics_hz} Hz, "
        f"{processors} processors; bare JSBSim at 200 Hz on one. Times per row.",
        "",
        row("environments", "steps per second"),
        row("--:", "--:"),
        row("one flight, `gymnasium.make`", f"{single_environment():,.0f}"),
        *(row(f"{each}, `make_vec`", f"{environments(each):,.0f}") for each in ENVIRONMENTS),
    ]
    return "\n".join(lines)


def main() -> None:
    """Measure, print, and write the requested files."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--rows", type=int, nargs="+", default=ROWS)
    parser.add_argument("--physics-hz", type=int, default=100)
    add_output_arguments(parser)
    args = parser.parse_args()
    processors = len(os.sched_getaffinity(0))
    rates = [measure(each, args.physics_hz) for each in args.rows]
    lines = text(rates, args.physics_hz, processors)
    draw(picture(rates, processors), FIGURE)
    publish(args, {MARK: lines}, INPUTS)


if __name__ == "__main__":
    main()
