"""Write the tables of docs/margins.md that compare the linearised formation with flights.

usage: make predictions  (ARGS="--only ring")
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Sequence
from typing import cast

import numpy as np
from inputs import Case, Inputs
from scipy.signal import dlsim
from tables import add_output_arguments, part_of, publish, row

import testbed
from testbed.core.oscillations import Oscillation, find_oscillations
from testbed.core.records import Array
from testbed.linear.delay_margin import delay_margins
from testbed.linear.flown_margins import FASTEST_HZ, RECORD_S
from testbed.linear.held_flight import COMMANDS, KICK_S, HeldFlight
from testbed.linear.linear_formation import join
from testbed.linear.linear_system import LinearSystem
from testbed.linear.loop_margins import MAX_GAIN, MAX_LATENCY_S
from testbed.linear.pooled_margins import margins_of, predicted_margins_of
from testbed.linear.predicted_margins import fly_linearisable, linearise
from testbed.linear.steady_flight import settle, steady_scenario
from testbed.plan.world import build, versions
from testbed.pool.flight_pool import open_flight_pool
from testbed.scenario import Scenario, find_aircraft, load_scenario
from testbed.scenario.yaml_io import read

MARK = "make predictions"
KICK = math.radians(1.0)
SMALL_KICK = math.radians(0.02)
PROFILES = ("tuned", "rms")  # whose predictions are compared with flights
SIMULATIONS = (1, 2, 3)
BANKS_DEG = (0.0, 30.0, 45.0)
AIRCRAFT = {
    "rascal110": ("Rascal 110", ()),
    "skywalker_x8": (
        "Skywalker X8",
        ("fleet.*.aircraft=skywalker_x8", "formation.speed_pole_per_s=0.4"),
    ),
}
RING_S = (531.0, 533.7)  # of uav1 in Simulation 3, profile rms: a descending turn
RING_DT = 0.04
PAIR = (
    "formation.leader_gains={uav1: 1, uav2: 1, uav3: 1}",
    "formation.neighbour_gains={uav1: {uav2: 1}, uav2: {uav1: 1}, uav3: {uav2: 1}}",
)


def profiles(aircraft: str) -> list[str]:
    """Return the profiles of an airframe's middle_loop.yaml."""
    return list(cast(dict[str, object], read(find_aircraft(aircraft) / "middle_loop.yaml").value))


def cases() -> Iterator[tuple[tuple[str, str, float], Scenario]]:
    """Yield the row of the table, and each scenario in it."""
    for aircraft, (_, overrides) in AIRCRAFT.items():
        for profile in profiles(aircraft):
            for bank_deg in BANKS_DEG:
                for number in SIMULATIONS:
                    changes = (*overrides, f"controller.profile={profile}")
                    yield (
                        (aircraft, profile, bank_deg),
                        load_scenario(f"simulation-{number}", changes),
                    )


def text_of_modes() -> str:
    """Compare responses to kicks of 1°: frequency, damping, and the whole response."""
    lines = [
        row("profile", "bank", "follower", "Hz, predicted", "flown", "ratio, predicted", "flown")
        + " whole response |",
        "|---|--:|---|--:|--:|--:|--:|--:|",
    ]
    errors: list[tuple[float, float, float]] = []
    for scenario, bank_deg in _cases():
        flight, problem = fly_linearisable(scenario, bank_deg)
        profile = f"`{scenario.controller.profile}`"
        if problem:
            lines.append(row(profile, f"{bank_deg:g}°", problem, *("–",) * 5))
            continue
        formation = join(linearise(flight))
        start = flight.save()
        banks = np.degrees(flight.world.aircraft["truth"]["euler"][1:, 0])
        for i, name in enumerate(flight.world.names[1:]):
            periods = round(RECORD_S / flight.dt)
            flown = _flown(flight, start, i, periods, KICK)
            found = _predicted(formation, name, periods)
            mode, other = _pair(find_oscillations(found, flight.dt), flown, flight.dt)
            whole = float(np.linalg.norm(found - flown) / np.linalg.norm(flown))
            errors.append(
                (
                    mode.frequency_hz / other.frequency_hz - 1.0,
                    mode.damping / other.damping - 1.0,
                    whole,
                )
            )
            lines.append(
                row(
                    *(profile, f"{banks[i]:.1f}°", name),
                    *(f"{mode.frequency_hz:.3f}", f"{other.frequency_hz:.3f}"),
                    *(f"{mode.damping:.4f}", f"{other.damping:.4f}", f"{100.0 * whole:.1f} %"),
                )
            )
    largest = 100.0 * np.abs(np.array(errors)).max(axis=0)
    lines += [
        "",
        f"Largest errors: frequency {largest[0]:.1f} %, damping ratio {largest[1]:.1f} %, whole "
        f"response {largest[2]:.1f} %.",
    ]
    return "\n".join(lines)


def text_of_margins() -> str:
    """Compare factors and latencies of one command of one follower with bisections in flight."""
    lines = [
        row("simulation", "profile", "bank", "follower", "factor: pitch", "roll", "throttle")
        + " latency, ms: pitch | roll | throttle |",
        "|--:|---|--:|---|" + "--:|" * 6,
    ]
    cases = list(_cases_of_margins())
    flat = [(scenario, bank_deg) for _, scenario, bank_deg in cases]
    with open_flight_pool(jobs=2) as pool:
        predicted = predicted_margins_of(flat, pool)
        flown = margins_of(flat, pool)
    errors: dict[str, list[tuple[float, float]]] = {}
    for (number, scenario, bank_deg), expected, measured in zip(
        cases, predicted, flown, strict=True
    ):
        title = f"{number}", f"`{scenario.controller.profile}`", f"{bank_deg:g}°"
        if problem := expected.problem or measured.problem:
            lines.append(row(*title, problem, *("–",) * 6))
            continue
        of_bank = errors.setdefault(title[-1], [])
        for one, other in zip(expected.followers, measured.followers, strict=True):
            pairs = [(one.commands[name], other.commands[name]) for name in COMMANDS]
            of_bank += [
                (_error(a.gain, b.gain), _error(a.latency_s, b.latency_s)) for a, b in pairs
            ]
            gains = [f"{_limited(a.gain)} \\| {_limited(b.gain)}" for a, b in pairs]
            latencies = [f"{_late(a.latency_s)} \\| {_late(b.latency_s)}" for a, b in pairs]
            lines.append(row(*title, one.name, *gains, *latencies))
    lines.append("")
    for bank, found in errors.items():
        largest = 100.0 * np.nanmax(np.abs(np.array(found)), axis=0)
        lines.append(
            f"Largest errors at {bank}: factor {largest[0]:.1f} %, latency {largest[1]:.1f} %.  "
        )
    return "\n".join(lines)


def _cases_of_margins() -> Iterator[tuple[int, Scenario, float]]:
    for number in SIMULATIONS:
        for bank_deg in (0.0, 30.0):
            yield number, load_scenario(f"simulation-{number}"), bank_deg
    yield 3, load_scenario("simulation-3"), 45.0
    for bank_deg in BANKS_DEG:
        yield 3, load_scenario("simulation-3", ["controller.profile=rms"]), bank_deg


def _error(predicted: float, flown: float) -> float:
    """Return the relative error of a prediction; NaN where it is beyond what is tried."""
    return predicted / flown - 1.0 if math.isfinite(predicted + flown) else math.nan


def _late(latency_s: float) -> str:
    most = f"> {1000.0 * MAX_LATENCY_S:g}"
    return f"{1000.0 * latency_s:.0f}" if math.isfinite(latency_s) else most


def text_of_delays() -> str:
    """Compare the message delay that followers bear which receive from each other."""
    lines = [
        row("scenario", "followers in a circle", "delay, predicted, s", "flown, s"),
        "|---|---|--:|--:|",
    ]
    for title, name, overrides in (
        ("Simulation 1", "simulation-1", ()),
        ("Simulation 3, uav1 and uav2 in both directions", "simulation-3", PAIR),
    ):
        [margin] = delay_margins(linearise(_late_flight(name, overrides, 0.0)))
        dt = _late_flight(name, overrides, 0.0).dt
        first = round(0.7 * margin.delay_s / dt)
        while _decays_late(name, overrides, (first + 1) * dt):
            first += 1
        lines.append(
            row(title, ", ".join(margin.followers), f"{margin.delay_s:.2f}", f"{first * dt:.2f}")
        )
    return "\n".join(lines)


def text_of_ring() -> str:
    """Compare the ring of uav1 in Simulation 3 with a steady turn of its radius and descent."""
    scenario = load_scenario("simulation-3", ["controller.profile=rms", "log.mcap=false"])
    bank, velocity = [], []
    with testbed.Simulation(scenario) as simulation:
        for time_s in np.arange(RING_S[0], RING_S[1], RING_DT).tolist():
            truth = simulation.step(until=time_s).truth
            bank.append(float(truth.euler[1, 0]))
            velocity.append(truth.velocity_ned[0].copy())
    signal, moved = np.array(bank), np.array(velocity)
    course = np.unwrap(np.arctan2(moved[:, 1], moved[:, 0]))
    rate = (course[-1] - course[0]) / (RING_DT * (len(course) - 1))
    speed, climb = float(np.linalg.norm(moved, axis=1).mean()), -float(moved[:, 2].mean())
    ringing = find_oscillations(signal[:, np.newaxis] - signal.mean(), RING_DT)

    data = steady_scenario(scenario, 30.0, "compiled", climb).model_dump(mode="json", by_alias=True)
    path = data["leader"]["path"]
    path["speed_mps"] = speed
    path["curve"]["radius_m"] = speed / abs(rate)
    path["curve"]["direction"] = "clockwise" if rate > 0.0 else "anticlockwise"
    flight = HeldFlight(build(Scenario.model_validate(data)))
    if problem := settle(flight):
        return problem
    steady = math.degrees(flight.world.aircraft["truth"]["euler"][1, 0])
    modes = join(linearise(flight)).coupled_with("uav1").modes()
    flown = ringing[0]
    fast = [mode for mode in modes if mode.frequency_hz > 0.5]
    near = min(fast, key=lambda mode: abs(mode.frequency_hz - flown.frequency_hz))
    return "\n".join(
        [
            row("uav1", "mean bank", "radius, m", "climb, m/s", "Hz", "damping ratio"),
            "|---|--:|--:|--:|--:|--:|",
            row(
                *("flown", f"{math.degrees(signal.mean()):.1f}°", f"{speed / abs(rate):.1f}"),
                *(f"{climb:.1f}", f"{flown.frequency_hz:.3f}", f"{flown.damping:.3f}"),
            ),
            row(
                *("predicted", f"{steady:.1f}°", f"{speed / abs(rate):.1f}", f"{climb:.1f}"),
                *(f"{near.frequency_hz:.3f}", f"{near.damping:.3f}"),
            ),
        ]
    )


def _cases() -> Iterator[tuple[Scenario, float]]:
    for profile in PROFILES:
        for bank_deg in BANKS_DEG:
            yield load_scenario("simulation-3", [f"controller.profile={profile}"]), bank_deg


def _flown(flight: HeldFlight, start: object, i: int, periods: int, kick: float) -> Array:
    """Return roll and pitch (K, 2) of a follower after a kick of its roll and pitch commands."""
    n = len(flight.world.followers)
    flight.inputs.end()
    still = flight.respond(start, periods)  # type: ignore[arg-type]
    kicks = np.zeros((n, 3))
    kicks[i, :2] = kick
    moved: Array = flight.respond(start, periods, kicks) - still  # type: ignore[arg-type]
    return moved[:, i, :2]


def _predicted(formation: LinearSystem, name: str, periods: int) -> Array:
    kicked = formation.select([f"{name}.pitch", f"{name}.roll"], f"{name}.attitude")
    during = np.arange(periods) * formation.dt < KICK_S - 1e-9
    _, found, _ = dlsim(kicked.to_scipy(), np.outer(during, (KICK, KICK)))
    return np.asarray(found, dtype=float)


def _pair(predicted: list[Oscillation], flown: Array, dt: float) -> tuple[Oscillation, Oscillation]:
    """Return the least damped mode of a predicted response, and the next one of the flown one."""

    def pole(mode: Oscillation) -> complex:
        return 2.0 * math.pi * mode.frequency_hz * complex(-mode.damping, 1.0)

    mode = next(each for each in predicted if each.frequency_hz < FASTEST_HZ)
    others = find_oscillations(flown, dt)
    return mode, min(others, key=lambda other: abs(pole(other) - pole(mode)))


def _late_flight(name: str, overrides: tuple[str, ...], delay_s: float) -> HeldFlight:
    late = (f"network.delay_s={delay_s}", "controller.extrapolate_from=timestamp")
    scenario = load_scenario(name, (*overrides, *late))
    flight = HeldFlight(build(steady_scenario(scenario, 0.0, "compiled")))
    # soon: an unstable formation leaves its steady flight
    flight.fly_to(24.0)
    return flight


def _decays_late(name: str, overrides: tuple[str, ...], delay_s: float) -> bool:
    """Return whether a small kick decays with messages so late."""
    flight = _late_flight(name, overrides, delay_s)
    start, kicks = flight.save(), np.zeros((len(flight.world.followers), 3))
    still = flight.respond(start, 1250)
    kicks[0] = SMALL_KICK, SMALL_KICK, SMALL_KICK
    errors = np.abs(flight.respond(start, 1250, kicks) - still)[..., 2:].max(axis=(1, 2))
    return bool(errors[1000:].max() < errors[500:750].max())


def text_of_profiles() -> str:
    """List the margins of every profile, the least of Simulations 1 to 3, beside the RMS error."""
    by_row: dict[tuple[str, str, float], list[Scenario]] = {}
    for where, scenario in cases():
        by_row.setdefault(where, []).append(scenario)
    lines = [
        row(
            *("aircraft", "profile", "mean RMS, m", "bank", "least damped, Hz", "damping ratio"),
            *("factor: pitch", "roll", "throttle", "least latency, ms"),
        ),
        "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    with open_flight_pool(jobs=2) as pool:
        flat = [(each, where[2]) for where, scenarios in by_row.items() for each in scenarios]
        found = iter(predicted_margins_of(flat, pool))
    for (aircraft, profile, bank_deg), scenarios in by_row.items():
        predictions = [next(found) for _ in scenarios]
        title = (AIRCRAFT[aircraft][0], f"`{profile}`")
        rms = f"{_mean_rms(scenarios):.2f}" if not bank_deg else ""
        followers = [one for each in predictions for one in each.followers]
        modes = [one.least_damped for one in followers if one.least_damped is not None]
        least = min(modes, key=lambda mode: mode.damping)
        commands = {name: min(one.commands[name].gain for one in followers) for name in COMMANDS}
        latency = min(each.latency_s for one in followers for each in one.commands.values())
        lines.append(
            row(
                *(*title, rms, f"{bank_deg:g}°", f"{least.frequency_hz:.2f}"),
                *(f"{least.damping:.2f}", *(_limited(of) for of in commands.values())),
                f"{1000.0 * latency:.0f}" if math.isfinite(latency) else "> 1000",
            )
        )
    about = ", ".join(f"{each} {of}" for each, of in versions().items())
    return "\n".join([*lines, "", f"Measured with {about}."])


def _limited(factor: float) -> str:
    return f"{factor:.2f}" if math.isfinite(factor) else f"> {MAX_GAIN:g}"


def _mean_rms(scenarios: Sequence[Scenario]) -> float:
    """Return the mean RMS error of the windows of scenarios, m."""
    windows = [
        window["mean_rms_m"]
        for scenario in scenarios
        for window in testbed.run(scenario, write=False).metrics["windows"].values()
    ]
    return float(np.mean(np.array(windows, dtype=float)))


TABLES = {
    "profiles": text_of_profiles,
    "modes": text_of_modes,
    "margins": text_of_margins,
    "delays": text_of_delays,
    "ring": text_of_ring,
}
_PROFILES = tuple(Case("simulation-3", (f"controller.profile={each}",)) for each in PROFILES)
INPUTS = {
    f"{MARK}, profiles": Inputs(
        tuple(
            Case(f"simulation-{number}", (*overrides, f"controller.profile={profile}"))
            for aircraft, (_, overrides) in AIRCRAFT.items()
            for profile in profiles(aircraft)
            for number in SIMULATIONS
        )
    ),
    f"{MARK}, modes": Inputs(_PROFILES),
    f"{MARK}, margins": Inputs(
        (*(Case(f"simulation-{number}") for number in SIMULATIONS), *_PROFILES)
    ),
    f"{MARK}, delays": Inputs((Case("simulation-1"), Case("simulation-3", PAIR))),
    f"{MARK}, ring": Inputs((Case("simulation-3", ("controller.profile=rms",)),)),
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add_output_arguments(parser, INPUTS)
    options = parser.parse_args()
    same = True
    for mark in INPUTS:
        if part_of(mark) in options.only:
            same &= publish(options, {mark: TABLES[part_of(mark)]()}, INPUTS)
    sys.exit(0 if same else 1)
