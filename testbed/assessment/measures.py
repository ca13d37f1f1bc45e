"""What a worker does for one row: flights at nominal conditions, a search, faults, margins."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from testbed.assessment.assessed import STOPPING, Assessed, window_setting, without_chance
from testbed.assessment.conditions import CONDITIONS, sensor_settings
from testbed.assessment.extremes import FlightExtremes, limits_reached
from testbed.assessment.search import find_largest
from testbed.core.errors import FlightError, InputError
from testbed.linear.flown_margins import directions
from testbed.linear.linear_system import Mode
from testbed.linear.predicted_margins import (
    NotLinearisable,
    PredictedMargins,
    Prediction,
    predict_margins,
    worse_prediction,
)
from testbed.linear.steady_flight import MarginsError, suitable_banks
from testbed.metrics.model import Metrics
from testbed.plan.measured_fleet import resolve
from testbed.pool.flight_task import COMPLETED, describe_ending
from testbed.runs.repeated import RepeatedFlights
from testbed.runs.run import run
from testbed.scenario import Scenario, ScenarioError, set_seed

MAX_NAMED = 3  # seeds that do not keep the criteria, with the reason
MAX_VICTIMS = 4  # aircraft that fail, one at a time: the leader, and the first followers
IN_SLOT_M = 5.0  # as a follower that has joined
AFTER = "after_fault"  # window
Row = dict[str, Any]


class RowFlights:
    """Flights of one row; the last one is kept for other seeds."""

    def __init__(self, assessed: Assessed) -> None:
        self._assessed, self._repeated = assessed, RepeatedFlights()
        self._last: tuple[tuple[str, ...], Scenario] | None = None
        self.depends_on_seed = False

    def fly(self, settings: Sequence[str], seed: int) -> tuple[Metrics | None, str]:
        """Return the metrics of a flight, and why it does not keep the criteria; "": it does."""
        key = tuple(settings)
        if self._last is None or self._last[0] != key:
            self._last = key, self._assessed.scenario(settings)
        try:
            metrics, depends = self._repeated.fly(set_seed(self._last[1], seed))
        except FlightError as error:
            return None, f"failed: {error}"
        self.depends_on_seed = self.depends_on_seed or depends
        why = describe_ending(metrics)
        return metrics, why or ("" if metrics["outcome"] == COMPLETED else metrics["outcome"] or "")


def measure_nominal(assessed: Assessed, scenario: Scenario) -> Row:
    """Fly a scenario as it is with all seeds, or once where no seed changes it."""
    begun = time.process_time()
    flights, criteria = RowFlights(assessed), assessed.criteria()
    separation, rms = (math.inf, 0), dict[str, float]()
    broken = list[tuple[int, str]]()
    flown = 0
    for seed in assessed.seeds:
        metrics, why = flights.fly(criteria, seed)
        flown += 1
        if why:
            broken.append((seed, why))
        if metrics is not None:
            if metrics["min_separation_m"] is not None:
                separation = min(separation, (metrics["min_separation_m"], seed))
            for window, numbers in metrics["windows"].items():
                values = [each for each in numbers["rms_m"].values() if each is not None]
                rms[window] = max([rms.get(window, 0.0), *values])
        if not flights.depends_on_seed:
            break
    first = assessed.seeds[0]
    extremes = FlightExtremes()
    nominal = assessed.scenario((), first)
    metrics = run(nominal, write=False, progress=False, observers=[extremes]).metrics
    fleet = resolve(nominal)
    return {
        "flights": flown,
        "kept": flown - len(broken),
        "separation_m": separation[0] if math.isfinite(separation[0]) else None,
        "separation_seed": separation[1],
        "largest_rms_m": rms,
        "broken": [
            {"seed": seed, "why": why, "command": assessed.run_command(criteria, seed)}
            for seed, why in broken[:MAX_NAMED]
        ],
        "bank_deg": metrics["leader_bank_deg"],
        "climb_mps": extremes.climb_mps,
        "sink_mps": extremes.sink_mps,
        "flown_s": metrics["simulated_s"] - metrics.get("begin_s", 0.0),
        "charge": {
            name: [_finite(each) for each in extremes.charge[:, k].tolist()]
            for k, name in enumerate(fleet.names)
        },
        "limits": limits_reached(extremes, metrics, fleet.aircraft),
        "command": assessed.run_command(criteria, first),
        "cpu_s": time.process_time() - begun,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def measure_condition(name: str, assessed: Assessed, scenario: Scenario) -> Row:
    """Find the largest value of a condition at which the flights of all seeds keep the criteria."""
    begun = time.process_time()
    condition, flights, criteria = CONDITIONS[name], RowFlights(assessed), assessed.criteria()
    flown, first = assessed.scenario(), assessed.seeds[0]
    reasons: dict[tuple[int, float], str] = {}

    def keeps(seed: int, value: float) -> bool:
        settings = (*criteria, *STOPPING, *condition.flight(flown, value, seed))
        _, why = flights.fly(settings, seed)
        reasons[seed, value] = why
        return not why

    def seeds() -> Iterator[int]:
        yield first
        if condition.is_drawn or flights.depends_on_seed:
            yield from assessed.seeds[1:]

    found = find_largest(condition.levels(flown), seeds(), keeps)
    weakest = None
    if found.weakest is not None and found.above is not None:
        broken = [value for (seed, value), why in reasons.items() if seed == found.weakest and why]
        value = min(broken)
        settings = [*criteria, *condition.flight(flown, value, found.weakest)]
        weakest = {
            "seed": found.weakest,
            "value": value,
            "why": reasons[found.weakest, value],
            "command": assessed.run_command(settings, found.weakest),
        }
    return {
        "value": found.value,
        "own": condition.own(flown),
        "largest_tried": found.above is None,
        "breaks": found.breaks,
        "others": None if found.others is None else list(found.others),
        "seeds": found.seeds,
        "flights": found.flights,
        "weakest": weakest,
        "flown_with": condition.flown_with(flown),
        "command": assessed.command(name),
        "cpu_s": time.process_time() - begun,
    }


FAULTS: Mapping[str, str] = {
    "engine-out": "engine out",
    "gps-lost": "GPS lost",
    "airspeed-blocked": "pitot tube blocked",
    "surface-stuck": "aileron or left elevon stuck",
}
OUTAGES: Mapping[str, str] = {
    "leader-silent": "leader silent",
    "radio-cut": "no messages at all",
}
_SURFACES = "aileron", "left-elevon"


def measure_faults(kind: str, assessed: Assessed, scenario: Scenario) -> Row:
    """Fly one fault of one aircraft after the other, or an outage, from half of the flight on."""
    begun = time.process_time()
    flown = assessed.scenario()
    start_s = flown.scenario.begin.at_s if flown.scenario.begin else 0.0
    end_s = flown.scenario.duration_s
    at_s = round((start_s + end_s) / 2.0, 2)
    common = [window_setting(AFTER, at_s, end_s), "limits.on_loss=continue"]
    note, cases = "", list[tuple[str, list[list[str]]]]()
    if kind == "leader-silent":
        window = f"[[{at_s:g}, {end_s:g}]]"
        cases = [("", [[f"network.transmitter_off_s.{flown.leader.name}={window}"]])]
    elif kind == "radio-cut":
        cases = [("", [[f"network.blackout_s=[[{at_s:g}, {end_s:g}]]"]])]
    else:
        if kind == "gps-lost" and (sensors := sensor_settings(flown)):
            common += sensors
            note = f"with sensors: {sensors[0].partition('=')[2]}, as the scenario has exact ones"
        for k, each in enumerate(flown.aircraft[:MAX_VICTIMS]):
            at = "leader" if k == 0 else f"fleet.{k - 1}"
            faults = [f"kind: {kind}, at_s: {at_s:g}"]
            if kind == "surface-stuck":
                faults = [f"{faults[0]}, surface: {surface}" for surface in _SURFACES]
            cases.append((each.name, [[f"{at}.faults=[{{{fault}}}]"] for fault in faults]))
    flights = [_fly_case(assessed, common, name, tried, at_s) for name, tried in cases]
    return {
        "at_s": at_s,
        "flights": flights,
        "flown_with": note,
        "command": assessed.command(kind),
        "cpu_s": time.process_time() - begun,
    }


def _fly_case(
    assessed: Assessed, common: list[str], name: str, tried: list[list[str]], at_s: float
) -> Row:
    """Fly the first of some settings that the aircraft can have."""
    seed, refused = assessed.seeds[0], ""
    for settings in tried:
        try:
            metrics, why = RowFlights(assessed).fly([*common, *settings], seed)
        except InputError as error:
            refused = error.problems[0].text if isinstance(error, ScenarioError) else str(error)
            continue
        command = assessed.run_command([*common, *settings], seed)
        if metrics is None:
            return {"failed": name, "problem": why, "command": command}
        return {
            "failed": name,
            "problem": "",
            "outcome": metrics["outcome"],
            "what": "" if metrics["outcome"] == COMPLETED else why,
            "separation_m": metrics["min_separation_m"],
            "between": metrics["min_separation_between"],
            "does": {each: _does(metrics, each, at_s) for each in metrics["lost_at_s"]},
            "command": command,
        }
    return {"failed": name, "problem": refused, "command": ""}


_EXCEEDED = ("overspeed", "stalled")


def _does(metrics: Metrics, name: str, at_s: float) -> str:
    """Describe what an aircraft does after a fault, with its largest distance from its slot."""
    first = {
        each["text"].partition(":")[0]: each["time_s"]
        for each in reversed(metrics["events"])
        if each["source"] == name and each["time_s"] >= at_s
    }
    found = [f"{text} at {first[text]:.0f} s" for text in _EXCEEDED if text in first]
    lost = metrics["lost_at_s"][name]
    if lost is not None:
        return ", ".join([*found, f"lost at {lost:.0f} s"])  # what a page marks
    errors = metrics["windows"][AFTER]["max_error_m"]
    largest, recovery = errors.get(name), metrics["recovery"].get(name)
    if recovery is None:
        return ", ".join([*found, "flies on"])
    back = recovery["in_slot_since_s"]
    if largest is None:
        found.append("has no slot")
    elif largest <= IN_SLOT_M:
        found.append(f"in slot, {largest:.1f} m")
    elif back is not None:
        found.append(f"back at {back:.0f} s, {largest:.0f} m")
    else:
        found.append(f"leaves slot, {largest:.0f} m")
    return ", ".join(found)


def measure_margins(
    bank_deg: float, climb_mps: float, assessed: Assessed, scenario: Scenario
) -> Row:
    """Predict margins in one steady flight, in both directions of turn."""
    begun, note, settings = time.process_time(), "", list[str]()
    flown = assessed.scenario()
    try:
        [bank_deg] = suitable_banks(flown, [bank_deg], asked=False)
        try:
            found = _predict(flown, bank_deg, climb_mps)
        except NotLinearisable:
            quiet = without_chance(flown)
            if quiet == flown:
                raise
            found = _predict(quiet, bank_deg, climb_mps)
            note = "with a network that only delays"
            settings = [f"network={{delay_s: {quiet.network.delay_s or 0.0:g}}}"]
    except MarginsError as error:
        return {"bank_deg": bank_deg, "climb_mps": climb_mps, "not_predicted": str(error)}
    return {
        "bank_deg": bank_deg,
        "climb_mps": climb_mps,
        "not_predicted": "",
        "problem": found.problem,
        "followers": [_follower(each) for each in found.followers],
        "flown_with": note,
        "command": assessed.margins_command(bank_deg, climb_mps, settings),
        "cpu_s": time.process_time() - begun,
    }


def _predict(scenario: Scenario, bank_deg: float, climb_mps: float) -> Prediction:
    turns = [predict_margins(scenario, bank, climb_mps) for bank in directions(bank_deg)]
    return worse_prediction(turns)


def _follower(found: PredictedMargins) -> Row:
    mode: Mode | None = found.least_damped
    commands = found.commands
    factor = min(commands, key=lambda name: commands[name].gain)
    phase = min(commands, key=lambda name: commands[name].phase_deg)
    return {
        "name": found.name,
        "bank_deg": found.bank_deg,
        "damping": None if mode is None else mode.damping,
        "frequency_hz": None if mode is None else mode.frequency_hz,
        "factor": _finite(commands[factor].gain),
        "factor_of": factor,
        "phase_deg": _finite(commands[phase].phase_deg),
        "phase_of": phase,
        "latency_s": _finite(min(each.latency_s for each in commands.values())),
    }
