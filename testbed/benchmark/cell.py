"""One flight of the benchmark, and its numbers.

The number of a flight is the mean over the followers of their RMS errors in the window, in metres,
each at most `LOST_M`. A flight in which an aircraft without a fault is lost, or leaves its
formation, and one that fails, has `LOST_M`: no flight is better for having ended.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from testbed.benchmark.draws import DrawnFlight, task_scenario
from testbed.benchmark.entry import EntryLaw
from testbed.benchmark.limited_flight import LIMITS, FlightLimits, run_limited
from testbed.benchmark.task import WINDOW, load_benchmark
from testbed.core.errors import InputError
from testbed.metrics.document import exceedances, losses
from testbed.plan.world import build
from testbed.runs.run import run
from testbed.scenario import Scenario, set_duration

LOST_M = 50.0  # number of a flight that is lost or fails, and the largest of any
FLOWN, LOST, FAILED = "flown", "lost", "failed"
_WARM_S = 1.0  # of a flight with the testbed's own law, which loads what all flights use
_MAX_WHY = 200


@dataclass(frozen=True, slots=True)
class CellKey:
    """Which flight: task, level from 1, seed."""

    task: str
    level: int
    seed: int

    def __str__(self) -> str:
        """Return it as the option --cell has it."""
        return f"{self.task}/{self.level}/{self.seed}"


def fly_cell(
    key: CellKey,
    law: EntryLaw,
    settings: Mapping[str, Any],
    *,
    folder: Path | None = None,
    limits: FlightLimits = LIMITS,
    log: Path | None = None,
) -> dict[str, Any]:
    """Fly one cell in a process of its own, and return its numbers.

    Args:
        key: of the cell.
        law: of the entry; its file is checked in that process before it is imported.
        settings: of the entry, keys of the scenario.
        folder: of the benchmark; None: the one that comes with the testbed.
        limits: of the process.
        log: folder in which a folder of the flight gets its log; None: nothing is written.

    Returns:
        The keys of `CellRecord`, and `cpu_s`; see `result`.
    """
    _warm(key.task, folder)
    out = None if log is None else log.absolute() / str(key).replace("/", "-")
    found = run_limited(lambda place: _fly(key, law, settings, folder, place, out), limits)
    head = {"task": key.task, "level": key.level, "seed": key.seed}
    numbers = _checked(found.value)
    if numbers is None:
        failure = found.failure or "crash"
        text = found.text or "returned no numbers of a flight"
        if law.file is not None:  # results are the same in every folder
            text = text.replace(f"{law.file.parent}/", "")
        why = f"{failure}: {text}"
        numbers = {**lost_numbers(), "outcome": FAILED, "failure": failure, "why": why[:_MAX_WHY]}
    return {**head, **numbers, "cpu_s": round(found.cpu_s, 3)}


def find_mistake(
    key: CellKey,
    law: EntryLaw,
    settings: Mapping[str, Any],
    *,
    folder: Path | None = None,
    limits: FlightLimits = LIMITS,
) -> str:
    """Return why a law cannot be flown with settings, as `testbed validate` says it; "": it can.

    It is loaded and checked in a process of its own. One that does not end there fails in flight.
    The arguments are those of `fly_cell`.
    """

    def check(place: Path) -> str:
        try:
            build(_scenario(key, law, settings, folder, place)[0], in_process=True)
        except InputError as error:
            return str(error)
        return ""

    found = run_limited(check, limits)
    return found.value if isinstance(found.value, str) else ""


def lost_numbers() -> dict[str, Any]:
    """Return the numbers of a flight that has none."""
    return {
        "number_m": LOST_M,
        "lost_at_s": None,
        "separation_joining_m": None,
        "separation_window_m": None,
        "saturated_s": None,
        "effort": None,
    }


def _fly(
    key: CellKey,
    law: EntryLaw,
    settings: Mapping[str, Any],
    folder: Path | None,
    place: Path,
    out: Path | None,
) -> dict[str, Any]:
    scenario, drawn = _scenario(key, law, settings, folder, place)
    flown = run(scenario, write=out is not None, out=out, progress=False)
    return cell_numbers(flown.metrics, drawn)


def _scenario(
    key: CellKey, law: EntryLaw, settings: Mapping[str, Any], folder: Path | None, place: Path
) -> tuple[Scenario, DrawnFlight]:
    law.check()
    benchmark = load_benchmark(folder)
    return task_scenario(
        benchmark.name,
        benchmark.task(key.task),
        key.level,
        key.seed,
        settings={"controller.law": law.reference, **settings},
        folder=place,
    )


@cache
def _warm(task: str, folder: Path | None) -> None:
    """Load what flights of a task use, by a short one with the testbed's own law."""
    benchmark = load_benchmark(folder)

    def fly(place: Path) -> None:
        found = benchmark.task(task)
        scenario, _ = task_scenario(benchmark.name, found, 1, 1, settings={}, folder=place)
        short: Scenario = set_duration(scenario, _WARM_S)
        run(short, write=False, progress=False)

    import tempfile

    with tempfile.TemporaryDirectory(prefix="testbed-flight-") as place:
        fly(Path(place))


def cell_numbers(metrics: Mapping[str, Any], drawn: DrawnFlight) -> dict[str, Any]:
    """Return the numbers of a flight, from its metrics.

    Args:
        metrics: the document of metrics.json.
        drawn: what was drawn for the flight.
    """
    window = metrics["windows"].get(WINDOW) or {"rms_m": {}, "min_separation_m": None}
    names = list(drawn.starts_m)
    failed = None if drawn.failed is None else names[drawn.failed[0]]
    scored = [name for name in names if name != failed]
    lost = {k: at for k, at in metrics["lost_at_s"].items() if at is not None and k != failed}
    ended = metrics["outcome"] not in ("completed", "separation_lost", "envelope_exceeded")
    why = ""
    if lost:
        why = f"lost: {', '.join(losses({'lost_at_s': lost}))}"
    elif ended and not (metrics["outcome"] == "lost" and failed):
        why = f"{metrics['outcome']}: {', '.join(exceedances(metrics))}"
    errors = [_bounded(window["rms_m"].get(name)) for name in scored]
    return {
        "outcome": LOST if why else FLOWN,
        "failure": "",
        "why": why[:_MAX_WHY],
        "number_m": LOST_M if why else statistics.fmean(errors),
        "lost_at_s": min(lost.values()) if lost else None,
        "separation_joining_m": metrics.get("min_separation_outside_windows_m"),
        "separation_window_m": window["min_separation_m"],
        "saturated_s": statistics.fmean(metrics["saturations"][k]["seconds"] for k in scored),
        "effort": statistics.fmean(metrics["mean_throttle"][k] or 0.0 for k in scored),
    }


def _bounded(error: float | None) -> float:
    return LOST_M if error is None or not math.isfinite(error) else min(error, LOST_M)


_NUMBERS = ("number_m", *(key for key in lost_numbers() if key != "number_m"))


def _checked(value: object) -> dict[str, Any] | None:
    """Return what a process sent as the numbers of a flight; None: it is not that."""
    keys = {"outcome", "failure", "why", *_NUMBERS}
    if not isinstance(value, dict) or set(value) != keys:
        return None
    texts = (value["outcome"], value["failure"], value["why"])
    if not all(isinstance(each, str) and len(each) <= _MAX_WHY for each in texts):
        return None
    if value["outcome"] not in (FLOWN, LOST) or value["failure"]:
        return None
    for name in _NUMBERS:
        each = value[name]
        if each is None and name != "number_m":
            continue
        if isinstance(each, bool) or not isinstance(each, int | float) or not math.isfinite(each):
            return None
    number = value["number_m"]
    return (
        value
        if 0.0 <= number <= LOST_M and (value["outcome"] == FLOWN or number == LOST_M)
        else None
    )
