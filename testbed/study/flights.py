"""Many flights, each in a process of its own, in the order asked for however many fly at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from testbed.scenario import Scenario
from testbed.study.crew import Task, crew


@dataclass(frozen=True, slots=True)
class Flight:
    """A flight's metrics, or what went wrong with it instead."""

    seed: int
    metrics: Mapping[str, Any] | None
    problem: str = ""
    wall_s: float = 0.0


def with_seed(page: Scenario, seed: int) -> Scenario:
    """The page with another seed."""
    header = page.scenario.model_copy(update={"seed": seed})
    return page.model_copy(update={"scenario": header})


def fly_all(
    wanted: Sequence[tuple[Scenario, int]],
    *,
    jobs: int,
    progress: Callable[[int, int], None] = lambda flown, of: None,
) -> list[Flight]:
    """Fly every page with its seed, without files, and return what came of each, in order.

    A flight that raises is a Flight with a problem.

    Args:
        wanted: pages and seeds.
        jobs: processes at once; the results do not depend on it.
        progress: told how many have been flown, of how many.

    Raises:
        KeyboardInterrupt: Ctrl-C or SIGTERM came; every process of ours has ended.
    """
    if not wanted:
        return []
    progress(0, len(wanted))
    tasks = (Task(number, with_seed(*each)) for number, each in enumerate(wanted))
    flights: dict[int, Flight] = {}
    with crew(jobs=min(jobs, len(wanted))) as ours:
        for flown in ours.fly(tasks):
            seed, problem = wanted[flown.number][1], flown.error if flown.metrics is None else ""
            flights[flown.number] = Flight(seed, flown.metrics, problem, flown.wall_s)
            progress(len(flights), len(wanted))
    return [flights[number] for number in range(len(wanted))]
