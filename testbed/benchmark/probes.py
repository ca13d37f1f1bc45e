"""What an entry needs beside its score: messages, and margins in steady flight."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from testbed.benchmark.draws import task_scenario
from testbed.benchmark.entry import EntryLaw
from testbed.benchmark.limited_flight import LIMITS, FlightLimits, run_limited
from testbed.benchmark.task import WINDOW, load_benchmark
from testbed.core.errors import InputError
from testbed.linear.flown_margins import directions
from testbed.linear.predicted_margins import predict_margins, worse_prediction
from testbed.linear.steady_flight import MarginsError, suitable_banks
from testbed.runs.run import run
from testbed.scenario import Scenario, load_scenario, set_duration
from testbed.scenario.set_keys import SetKeys
from testbed.scenario.yaml_io import to_inline

LONGEST_S = 100.0  # of the flights by which messages are judged, of the first task
BANKS_DEG = (0.0, 45.0)


def probe_entry(
    law: EntryLaw,
    settings: Mapping[str, Any],
    *,
    folder: Path | None = None,
    limits: FlightLimits = LIMITS,
) -> dict[str, Any]:
    """Return `messages` and `margins` of an entry, as `result.Result` has them."""
    flown = {"controller.law": law.reference, **settings}

    def messages(place: Path) -> Any:  # noqa: ANN401 - plain data
        law.check()
        return _messages(flown, folder, place)

    def margins(bank_deg: float, place: Path) -> Any:  # noqa: ANN401 - plain data
        law.check()
        return _margins(flown, folder, bank_deg)

    needed = run_limited(messages, limits).value
    found = []
    for bank_deg in BANKS_DEG:
        result = run_limited(partial(margins, bank_deg), limits)
        empty = {"bank_deg": bank_deg, "damping": None, "factor": None, "phase_deg": None}
        problem = result.value if isinstance(result.value, str) else f"{result.failure}"
        if law.file is not None:  # results are the same in every folder
            problem = problem.replace(f"{law.file.parent}/", "")
        row = {**empty, "latency_s": None, "problem": problem[:200]}
        found.append(result.value if isinstance(result.value, dict) else row)
    return {"messages": needed if isinstance(needed, dict) else None, "margins": found}


def _messages(settings: Mapping[str, Any], folder: Path | None, place: Path) -> dict[str, Any]:
    """Fly with and without the messages of followers; equal to the bit: they are not needed."""
    benchmark = load_benchmark(folder)
    task = next(iter(benchmark.tasks.values()))
    duration_s = min(LONGEST_S, task.head.duration_s)

    def fly(changes: Mapping[str, Any]) -> tuple[list[float | None], Scenario]:
        keys = {**settings, **changes}
        scenario, _ = task_scenario(benchmark.name, task, 1, 1, settings=keys, folder=place)
        metrics = run(set_duration(scenario, duration_s), write=False, progress=False).metrics
        return list(metrics["windows"][WINDOW]["rms_m"].values()), scenario

    whole, scenario = fly({})
    names = [each.name for each in scenario.fleet]
    cut = {name: {"*": {"loss": {"probability": 1.0}}} for name in names}
    without, _ = fly({"network.links": cut})
    needed = whole != without
    senders = len(names) if needed else 1
    return {"neighbours": needed, "per_s": scenario.rates.broadcast_hz * float(senders)}


def _margins(settings: Mapping[str, Any], folder: Path | None, bank_deg: float) -> Any:  # noqa: ANN401
    """Predict the least margins of all followers in steady flight; a text: why there are none."""
    task = next(iter(load_benchmark(folder).tasks.values()))
    texts = [f"{key}={to_inline(value)}" for key, value in settings.items()]
    scenario = load_scenario(task.path, texts).with_set_keys(SetKeys())
    try:
        [bank_deg] = suitable_banks(scenario, [bank_deg], asked=False)
        turns = [predict_margins(scenario, bank, 0.0) for bank in directions(bank_deg)]
        found = worse_prediction(turns)
    except (MarginsError, InputError) as error:
        return f"not predicted: {error}"
    row: dict[str, Any] = {"bank_deg": bank_deg, "problem": found.problem[:200]}
    damping = [each.least_damped.damping for each in found.followers if each.least_damped]
    commands = [each for follower in found.followers for each in follower.commands.values()]
    row["damping"] = min(damping, default=None)
    for name, values in (
        ("factor", [each.gain for each in commands]),
        ("phase_deg", [each.phase_deg for each in commands]),
        ("latency_s", [each.latency_s for each in commands]),
    ):
        least = min(values, default=math.inf)
        row[name] = least if math.isfinite(least) else None
    return row
