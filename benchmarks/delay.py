"""Write the tables of message delay, loss and large disturbances of docs/margins.md.

usage: make delay  (ARGS="--jobs N")
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import NamedTuple

import numpy as np
from inputs import Case as Flight
from inputs import Inputs
from tables import add_output_arguments, part_of, publish, row

import testbed
from testbed.core.records import Array
from testbed.linear.delay_flight import (
    Origin,
    fly_errors,
    predict_errors,
    solve_errors,
    with_network,
    without_network,
)
from testbed.linear.delay_offset import SteadyMotion
from testbed.linear.held_flight import COMMANDS, HeldFlight
from testbed.linear.limit_cycle import LimitCycle, find_limit_cycle
from testbed.linear.linear_formation import join
from testbed.linear.predicted_margins import linearise
from testbed.linear.steady_flight import steady_scenario
from testbed.plan.world import build
from testbed.scenario import Scenario, load_scenario

SIMULATIONS = ("simulation-1", "simulation-2", "simulation-3")
PROFILES = ("tuned", "rms")
ORIGINS: tuple[Origin, ...] = ("receipt", "timestamp")
DELAYS_S = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
SHOWN_S = 0.2
LOSSES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
BANK_DEG = 30.0
LEADER_MPS, CIRCLE_M = 22.0, 120.0  # of the missions of Simulations 1 to 3
SMALL_M = 0.25  # offsets below it have no relative error: what has not settled is as large

# limit cycles: scenario, profile, bank, follower, latencies of the roll command, s
CYCLES = (
    ("tuned", 45.0, 0, (0.5, 0.56, 0.6, 0.65, 0.7)),
    ("tuned", 45.0, 1, (0.44, 0.5, 0.55, 0.6)),
    ("authors", 45.0, 0, (0.7, 0.8)),
    ("rms", 40.0, 0, (0.22, 0.26, 0.3, 0.35)),
)
ROLL = COMMANDS.index("roll")
STEADY_S = 120.0
LARGE_KICK_DEG = 20.0
LATE_S = (0.12, 0.14, 0.16, 0.18, 0.2, 0.22)  # latencies of all commands
KICKS_DEG = (1.0, 5.0, 10.0, 20.0, 40.0)
DECAYED_DEG = 0.5


class Comparison(NamedTuple):
    """Offsets (n, 3) of followers, predicted and flown."""

    predicted: Array
    flown: Array

    def errors(self) -> tuple[float, float]:
        """Return the largest error, relative of larger offsets, and in metres."""
        apart = np.linalg.norm(self.predicted - self.flown, axis=1)
        length = np.linalg.norm(self.flown, axis=1)
        relative = apart[length > SMALL_M] / length[length > SMALL_M]
        return float(relative.max(initial=0.0)), float(apart.max())


class Case(NamedTuple):
    """A formation in steady flight with late messages."""

    simulation: str
    profile: str
    bank_deg: float
    origin: Origin
    delay_s: float
    loss: float = 0.0

    def scenario(self) -> Scenario:
        """Return the scenario."""
        overrides = [f"controller.profile={self.profile}", f"network.loss={self.loss}"]
        return with_network(load_scenario(self.simulation, overrides), self.delay_s, self.origin)


@cache
def without_delay(simulation: str, profile: str, bank_deg: float) -> Comparison:
    """Return the errors with a perfect network."""
    scenario = without_network(load_scenario(simulation, [f"controller.profile={profile}"]))
    return Comparison(
        predict_errors(scenario, bank_deg).error_m, fly_errors(scenario, bank_deg).error_m
    )


def compare(case: Case) -> Comparison:
    """Predict and fly the offsets of a case."""
    scenario = case.scenario()
    base = without_delay(case.simulation, case.profile, case.bank_deg)
    predicted, flown = (
        predict_errors(scenario, case.bank_deg),
        fly_errors(scenario, case.bank_deg),
    )
    if flown.problem or predicted.problem:
        raise SystemExit(f"{case}: {flown.problem or predicted.problem}")
    return Comparison(predicted.error_m - base.predicted, flown.error_m - base.flown)


def pair(predicted: float, flown: float, digits: int = 2) -> str:
    """Return two numbers as predicted | flown, without the sign of a zero."""
    return " \\| ".join(f"{round(each, digits) + 0.0:.{digits}f}" for each in (predicted, flown))


def offset_table(jobs: int) -> Iterator[str]:
    """Yield the table of offsets in steady flight."""
    cases = [
        Case(simulation, profile, bank_deg, origin, delay_s)
        for simulation in SIMULATIONS
        for profile in PROFILES
        for bank_deg in (0.0, BANK_DEG)
        for origin in ORIGINS
        for delay_s in DELAYS_S
    ]
    with ProcessPoolExecutor(jobs) as pool:
        found = dict(zip(cases, pool.map(compare, cases, chunksize=8), strict=True))
    header = (
        *("simulation", "bank", "extrapolated from", "uav1 forward", "right"),
        *("uav3 forward", "right", "largest error"),
    )
    yield row(*header)
    yield "|---|--:|---|--:|--:|--:|--:|--:|"
    for simulation in SIMULATIONS:
        for bank_deg in (0.0, BANK_DEG):
            for origin in ORIGINS:
                shown = found[Case(simulation, "tuned", bank_deg, origin, SHOWN_S)]
                texts = [
                    pair(shown.predicted[i, axis], shown.flown[i, axis])
                    for i in (0, 2)
                    for axis in (0, 1)
                ]
                of = [
                    each.errors()
                    for case, each in found.items()
                    if (case.simulation, case.bank_deg, case.origin)
                    == (simulation, bank_deg, origin)
                ]
                relative, metres = (max(each) for each in zip(*of, strict=True))
                worst = f"{100.0 * relative:.1f} %, " if relative else ""
                error = f"{worst}{metres:.2f} m"
                yield row(simulation[-1], f"{bank_deg:g}°", origin, *texts, error)


class Mission(NamedTuple):
    """A simulation as it is, with late messages."""

    simulation: str
    origin: Origin
    delay_s: float


def fly_mission(mission: Mission) -> dict[str, Array]:
    """Return the RMS errors (n,) of a mission by window."""
    overrides = (
        f"network.delay_s={mission.delay_s}",
        f"controller.extrapolate_from={mission.origin}",
    )
    flown = testbed.run(mission.simulation, overrides, write=False)
    windows = flown.metrics["windows"]
    return {name: np.array(list(each["rms_m"].values())) for name, each in windows.items()}


def mission_table(jobs: int) -> Iterator[str]:
    """Yield the table of the missions."""
    delays = (0.0, *DELAYS_S)
    missions = [Mission(s, o, d) for s in SIMULATIONS for o in ORIGINS for d in delays]
    with ProcessPoolExecutor(jobs) as pool:
        flown = dict(zip(missions, pool.map(fly_mission, missions, chunksize=3), strict=True))
    motions = {
        "rectangles": SteadyMotion(LEADER_MPS),
        "circles": SteadyMotion(LEADER_MPS, LEADER_MPS / CIRCLE_M),
    }
    yield row("simulation", "window", "extrapolated from", *(f"{each:g} s" for each in delays))
    yield "|---|---|---|" + "--:|" * len(delays)
    for simulation in SIMULATIONS:
        world = build(load_scenario(simulation))
        for window, motion in motions.items():
            for origin in ORIGINS:
                first = flown[Mission(simulation, origin, 0.0)][window]
                texts = [f"{first.mean():.2f}"]
                for delay_s in DELAYS_S:
                    scenario = with_network(load_scenario(simulation), delay_s, origin)
                    offset = np.linalg.norm(solve_errors(scenario, world, motion), axis=1)
                    predicted = np.hypot(first, offset).mean()
                    measured = flown[Mission(simulation, origin, delay_s)][window].mean()
                    texts.append(pair(predicted, measured, 1))
                yield row(simulation[-1], window, origin, *texts)


def loss_table(jobs: int) -> Iterator[str]:
    """Yield the table of lost messages."""
    cases = [
        Case("simulation-2", "tuned", bank_deg, "receipt", 0.1, loss)
        for loss in LOSSES
        for bank_deg in (0.0, BANK_DEG)
    ]
    with ProcessPoolExecutor(jobs) as pool:
        found = dict(zip(cases, pool.map(compare, cases, chunksize=6), strict=True))
    yield row(
        *("loss", "straight: uav1 forward", "uav3 forward", "30°: uav1 forward", "right"),
        *("uav3 forward", "right", "largest error at 30°"),
    )
    yield "|--:|" + "--:|" * 7
    for loss in LOSSES:
        straight, turn = (
            found[Case("simulation-2", "tuned", bank_deg, "receipt", 0.1, loss)]
            for bank_deg in (0.0, BANK_DEG)
        )
        texts = [pair(straight.predicted[i, 0], straight.flown[i, 0]) for i in (0, 2)]
        texts += [
            pair(turn.predicted[i, axis], turn.flown[i, axis]) for i in (0, 2) for axis in (0, 1)
        ]
        yield row(f"{loss:g}", *texts, f"{100.0 * turn.errors()[0]:.1f} %")


class Turn:
    """Simulation 3 in a steady turn, whose followers are kicked."""

    def __init__(self, profile: str, bank_deg: float) -> None:
        """Fly until it is steady."""
        scenario = load_scenario("simulation-3", [f"controller.profile={profile}"])
        self.flight = HeldFlight(build(steady_scenario(scenario, bank_deg, "compiled")))
        self.flight.fly_to(STEADY_S)
        self.start = self.flight.save()
        world = self.flight.world
        limits = world.formation.built_control.config.roll_limit
        self.room_deg = np.degrees(limits - world.aircraft["control"]["roll"][1:])
        self.formation = join(linearise(self.flight))
        self.start.restore()

    def swing(self, follower: int, kick_deg: float, late: Iterable[tuple[int, float]]) -> Array:
        """Return the bank (K,), degrees, in the last of 100 s after a kick of the roll command."""
        inputs = self.flight.inputs
        inputs.end()
        for command, latency_s in late:
            inputs.latency_s[follower, command] = latency_s
        kick = np.zeros(inputs.gain.shape)
        kick[follower, ROLL] = math.radians(kick_deg)
        rows = self.flight.respond(self.start, round(100.0 / self.flight.dt), kick)
        inputs.end()
        bank: Array = np.degrees(rows[:, follower, 0])
        return bank[-round(24.0 / self.flight.dt) :]


def measure_cycle(bank_deg: Array, dt: float) -> LimitCycle | None:
    """Return frequency and first harmonic of a bank (K,); None: it has decayed."""
    bank = bank_deg - bank_deg.mean()
    if 0.5 * float(np.ptp(bank)) < DECAYED_DEG:
        return None
    up = np.flatnonzero((bank[:-1] < 0.0) & (bank[1:] >= 0.0))
    at = up + bank[up] / (bank[up] - bank[up + 1])
    frequency = (len(at) - 1) / ((at[-1] - at[0]) * dt)
    whole = bank[: round((len(at) - 1) / (frequency * dt))]
    turning = np.exp(-2j * np.pi * frequency * dt * np.arange(len(whole)))
    return LimitCycle(float(frequency), 2.0 * float(abs((whole * turning).mean())))


def cycle_tables() -> Iterator[str]:
    """Yield the tables of limit cycles."""
    yield row(
        *("profile", "follower", "room to the limit", "latency of the roll command"),
        *("frequency, Hz", "bank, amplitude"),
    )
    yield "|---|---|--:|--:|--:|--:|"
    turns: dict[tuple[str, float], Turn] = {}
    for profile, bank_deg, follower, latencies in CYCLES:
        turn = turns.setdefault((profile, bank_deg), Turn(profile, bank_deg))
        room = float(turn.room_deg[follower])
        name = turn.flight.world.names[1 + follower]
        for latency_s in latencies:
            predicted = find_limit_cycle(turn.formation, name, latency_s, room)
            swing = turn.swing(follower, LARGE_KICK_DEG, [(ROLL, latency_s)])
            flown = measure_cycle(swing, turn.flight.dt)
            texts = ["decays" if each is None else "" for each in (predicted, flown)]
            if predicted is None or flown is None:
                cells = (" \\| ".join(each or "cycle" for each in texts), "")
            else:
                cells = (
                    pair(predicted.frequency_hz, flown.frequency_hz, 3),
                    f"{pair(predicted.roll_deg, flown.roll_deg, 1)}°",
                )
            yield row(f"`{profile}`", name, f"{room:.1f}°", f"{1000.0 * latency_s:.0f} ms", *cells)
    yield ""
    yield row("latency of all commands", *(f"kick of {each:g}°" for each in KICKS_DEG))
    yield "|--:|" + "--:|" * len(KICKS_DEG)
    turn = turns["tuned", 45.0]
    for latency_s in LATE_S:
        late = [(command, latency_s) for command in range(3)]
        cells_of = []
        for kick_deg in KICKS_DEG:
            swing = turn.swing(0, -kick_deg, late)
            cycle = measure_cycle(swing, turn.flight.dt) if np.isfinite(swing).all() else None
            if not np.isfinite(swing).all():
                cells_of.append("lost")
            elif cycle is None:
                cells_of.append("decays")
            else:
                cells_of.append(f"{cycle.frequency_hz:.2f} Hz, {cycle.roll_deg:.1f}°")
        yield row(f"{1000.0 * latency_s:.0f} ms", *cells_of)


TABLES: Mapping[str, Callable[[int], Iterator[str]]] = {
    "make delay: offsets": offset_table,
    "make delay: missions": mission_table,
    "make delay: loss": loss_table,
    "make delay: limit cycles": lambda jobs: cycle_tables(),
}

INPUTS = {
    "make delay: offsets": Inputs(
        tuple(
            Flight(simulation, (f"controller.profile={profile}",))
            for simulation in SIMULATIONS
            for profile in PROFILES
        )
    ),
    "make delay: missions": Inputs(tuple(Flight(simulation) for simulation in SIMULATIONS)),
    "make delay: loss": Inputs((Flight("simulation-2"),)),
    "make delay: limit cycles": Inputs(
        tuple(Flight("simulation-3", (f"controller.profile={of}",)) for of, *_ in CYCLES)
    ),
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=2)
    add_output_arguments(parser, INPUTS)
    options = parser.parse_args()
    same = True
    for mark, make in TABLES.items():
        if part_of(mark) in options.only:
            same &= publish(options, {mark: "\n".join(make(options.jobs))}, INPUTS)
    sys.exit(0 if same else 1)
