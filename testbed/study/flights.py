"""Many flights, each in a process of its own, in the order asked for however many fly at once."""

from __future__ import annotations

import multiprocessing
import signal
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.errors import InputError
from testbed.scenario import Scenario
from testbed.sim.run import run, stopping

POLL_S = 0.1  # between two looks at whether a signal came


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

    A flight that raises is a Flight with a problem. Processes are spawned: a fork would copy the
    threads of whoever asks.

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
    others = set(multiprocessing.active_children())
    context = multiprocessing.get_context("spawn")
    with (
        stopping() as stop,
        ProcessPoolExecutor(
            min(jobs, len(wanted)), mp_context=context, initializer=_leave_signals
        ) as pool,
    ):
        flights = [pool.submit(_fly, page, seed) for page, seed in wanted]
        left = set(flights)
        while left:
            _, left = wait(left, timeout=POLL_S, return_when=FIRST_COMPLETED)
            if stop():
                pool.shutdown(wait=False, cancel_futures=True)
                _end(others)
                raise KeyboardInterrupt
            progress(len(wanted) - len(left), len(wanted))
        return [_result(each, seed) for each, (_, seed) in zip(flights, wanted, strict=True)]


def _leave_signals() -> None:
    """Ctrl-C reaches every process of a terminal; ours answer to the one that started them."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _end(others: set[Any]) -> None:
    """End our processes: the first SIGTERM ends a flight, the next one the process."""
    while ours := set(multiprocessing.active_children()) - others:
        for process in ours:
            process.terminate()
        time.sleep(POLL_S)


def _fly(page: Scenario, seed: int) -> Flight:
    began = time.perf_counter()
    try:
        metrics, problem = run(with_seed(page, seed), write=False).metrics, ""
    except InputError as error:
        metrics, problem = None, f"cannot be flown: {error}"
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{Path(last.filename).name}:{last.lineno}"
        metrics, problem = None, f"failed: {type(error).__name__}: {error} ({where})"
    return Flight(seed, metrics, problem, time.perf_counter() - began)


def _result(future: Future[Flight], seed: int) -> Flight:
    error = future.exception()
    if error is None:
        return future.result()
    return Flight(seed, None, f"failed: its process ended: {error}")
