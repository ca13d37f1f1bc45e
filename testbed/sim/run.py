"""A run from a page to its numbers: build, fly, watch, and leave everything readable."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.metrics import MetricsObserver
from testbed.metrics.document import complete, write_json
from testbed.record.recorder import McapRecorder
from testbed.record.rundir import create_run_directory
from testbed.scenario import Scenario, load
from testbed.sim.loop import fly
from testbed.sim.world import build
from testbed.state import Event, Observer

EXIT_CODES: Mapping[str, int] = {"flown": 0, "lost": 1, "failed": 4, "interrupted": 130}


@dataclass(frozen=True, slots=True)
class Run:
    """A flown scenario.

    Args:
        scenario: the page as flown.
        metrics: the document of `metrics.json`.
        directory: where its files are; None if nothing was written.
    """

    scenario: Scenario
    metrics: Mapping[str, Any]
    directory: Path | None

    @property
    def outcome(self) -> str:
        """How it ended: "flown", "lost" or "interrupted"."""
        return str(self.metrics["outcome"])

    @property
    def exit_code(self) -> int:
        """What the command line returns for this outcome."""
        return EXIT_CODES[self.outcome]


def run(
    scenario: Scenario | str | Path,
    overrides: Sequence[str] = (),
    *,
    out: Path | None = None,
    write: bool = True,
    observers: Sequence[Observer] = (),
) -> Run:
    """Fly a scenario to its end.

    Ctrl-C and SIGTERM end it after the current tick with everything written; a second one raises.

    Args:
        scenario: a page, or the name or path of one.
        overrides: `key=value` as for `--set`; only with a name or path.
        out: the run directory to make; default `logs/<scenario>/<UTC>-<id>` below the current one.
        write: leave the log, the resolved page and the metrics there.
        observers: more watchers; one that raises ends the run as failed.

    Raises:
        ScenarioError: and other ValueErrors: the page cannot be flown, and what to write instead.
        LogError: the run directory or the log cannot be written.
    """
    page = scenario if isinstance(scenario, Scenario) else load(scenario, overrides)
    world = build(page)
    directory = create_run_directory(page.name, out=out) if write else None
    if directory:
        (directory / "scenario.resolved.yaml").write_text(world.info.scenario_yaml)
    published = page.scenario.published
    meter = MetricsObserver(published=published.model_dump() if published else None)
    log = [McapRecorder(directory / "run.mcap")] if directory and page.log.mcap else []
    watchers: list[Observer] = [meter, *log, *observers]
    began = time.perf_counter()
    outcome = "failed"
    problem: list[Event] = []
    metrics: dict[str, Any] = {}

    def conclude() -> None:
        wall = time.perf_counter() - began
        metrics.update(
            complete(meter.summary(), network=world.radio.summary(), outcome=outcome, wall_s=wall)
        )
        if directory:
            write_json(directory / "metrics.json", metrics)

    # Every watcher that has begun is ended, whatever happens to the flight or to another one.
    with stopping() as stop, ExitStack() as closing:
        for watcher in watchers:
            watcher.begin(world.info)
            closing.callback(watcher.end, metrics, problem)
        closing.callback(conclude)
        try:
            outcome = fly(world, watchers, stop)
        except KeyboardInterrupt:
            outcome = "interrupted"
            raise
        except BaseException as error:
            now = meter.summary()["simulated_s"]
            problem.append(Event(now, "error", "run", f"failed: {error!r}"))
            raise
    return Run(page, metrics, directory)


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM came; the second Ctrl-C is a KeyboardInterrupt again.

    Outside the main thread Python allows no handlers: there it stays false.
    """
    # not a threading.Event: a handler interrupted by itself would wait for its own lock
    signals: list[int] = []

    def asked() -> bool:
        return bool(signals)

    if threading.current_thread() is not threading.main_thread():
        yield asked
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.getsignal(number) for number in numbers}

    def restore() -> None:
        for number, handler in before.items():
            signal.signal(number, handler)

    def ask(number: int, _frame: object) -> None:
        signals.append(number)
        restore()

    for number in numbers:
        signal.signal(number, ask)
    try:
        yield asked
    finally:
        restore()
