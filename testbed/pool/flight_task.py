"""One flight of a study: the task, its result, and what every worker process runs."""

from __future__ import annotations

import functools
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from testbed.core.errors import FlightError, InputError, raise_memory_shortage
from testbed.metrics.document import BOUND_VIOLATED, EXCEEDED, exceedances, losses
from testbed.metrics.expectations import bound_key, describe_violation, violations

if TYPE_CHECKING:
    from testbed.runs.repeated import RepeatedFlights
    from testbed.scenario import Scenario

COMPLETED, LOST, FAILED, INVALID = "completed", "lost", "failed", "invalid"
OUTCOMES = (COMPLETED, LOST, *EXCEEDED, BOUND_VIOLATED, FAILED, INVALID)
INTERRUPTED = "interrupted"
_ONE_FLIGHT = threading.Lock()  # a Dask worker may have several threads


@dataclass(frozen=True, slots=True)
class FlightTask:
    """A scenario to fly.

    Args:
        number: identifies the task and its result.
        scenario: None if it is invalid.
        error: why it is invalid; empty where there is a scenario.
        measure: what to do with the scenario in place of one flight; it returns the metrics.
    """

    number: int
    scenario: Scenario | None
    error: str = ""
    measure: Callable[[Scenario], Mapping[str, Any]] | None = None


@dataclass(frozen=True, slots=True)
class FlightResult:
    """Outcome and metrics of a task.

    Args:
        number: of the task.
        outcome: one of `OUTCOMES`.
        error: reason for any outcome but "completed"; of a completed flight the violated bounds of
            the scenario's `expect`, else empty.
        metrics: the document of metrics.json; None where there is none.
        wall_s: duration on the wall clock.
        depends_on_seed: whether another seed may change the result but for its seed.
    """

    number: int
    outcome: str
    error: str
    metrics: Mapping[str, Any] | None
    wall_s: float = 0.0
    depends_on_seed: bool = True


class WorkerPool(Protocol):
    """Processes that run tasks."""

    def capacity(self) -> int:
        """Return how many tasks should be submitted at once."""

    def submit(self, task: FlightTask) -> Future[FlightResult]:
        """Run `run_task` on a task in a worker."""

    def lost_worker(self, error: BaseException) -> bool:
        """Return whether an error of a future means that its worker process ended."""

    def shutdown(self) -> None:
        """End the workers and their flights."""


@functools.cache
def _flights() -> RepeatedFlights:
    from testbed.runs.repeated import RepeatedFlights  # in workers only: the parent flies nothing

    return RepeatedFlights()


def describe_ending(metrics: Mapping[str, Any]) -> str:
    """Describe what is wrong with a flight: a loss, a limit exceeded, violated bounds; or ""."""
    outcome = str(metrics["outcome"])
    if describe := {LOST: losses, **dict.fromkeys(EXCEEDED, exceedances)}.get(outcome):
        return f"{outcome}: {', '.join(describe(metrics))}"
    return "; ".join(
        f"{bound_key(each)}: {describe_violation(each)}" for each in violations(metrics)
    )


def run_task(task: FlightTask) -> FlightResult:
    """Fly a task in this process, without files; errors become part of the result.

    Tasks whose scenarios differ by the seed alone are best flown one after another.

    Raises:
        MemoryError: there was too little memory, which is no result of the flight.
    """
    assert task.scenario is not None
    metrics: Mapping[str, Any] | None = None
    depends_on_seed = True
    with _ONE_FLIGHT:
        start = time.perf_counter()
        try:
            if task.measure is not None:
                metrics = task.measure(task.scenario)
                return FlightResult(
                    task.number, COMPLETED, "", metrics, time.perf_counter() - start
                )
            metrics, depends_on_seed = _flights().fly(task.scenario)
            outcome, error = str(metrics["outcome"]), describe_ending(metrics)
        except FlightError as failure:
            outcome, error = FAILED, f"failed: {failure}"
        except InputError as refused:
            outcome, error = INVALID, f"invalid: {refused}"
        except Exception as failure:
            raise_memory_shortage(failure)
            last = traceback.extract_tb(failure.__traceback__)[-1]
            where = f"{Path(last.filename).name}:{last.lineno}"
            outcome, error = FAILED, f"failed: {type(failure).__name__}: {failure} ({where})"
    wall_s = time.perf_counter() - start
    return FlightResult(task.number, outcome, error, metrics, wall_s, depends_on_seed)
