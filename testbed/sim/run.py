"""A run from a page to its numbers: build, fly, watch, and leave everything readable."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.errors import InputError
from testbed.metrics import MetricsObserver
from testbed.metrics.document import complete, write_json
from testbed.record.recorder import METRICS_NAME, McapRecorder
from testbed.record.rundir import LOG_NAME, LOGS, SCENARIO_NAME, create_run_directory, leave
from testbed.scenario import Scenario, load
from testbed.sim.gate import Gate
from testbed.sim.loop import fly
from testbed.sim.outside import NOBODY, Outside, announcement, checked, make_station, report
from testbed.sim.pace import Pace
from testbed.sim.partners import Stopped
from testbed.sim.sizes import check_disk
from testbed.sim.stop import stopping
from testbed.sim.world import build
from testbed.state import Event, Observer
from testbed.vehicle.crew import CrewedFleet

EXIT_CODES: Mapping[str, int] = {"flown": 0, "lost": 1, "upset": 1, "failed": 4, "interrupted": 130}


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
        """How it ended: "flown", "lost", "upset" or "interrupted"."""
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
    outside: Outside = NOBODY,
    processes: int | None = 1,
) -> Run:
    """Fly a scenario to its end.

    Ctrl-C and SIGTERM end it after the current tick, or in the midst of a wait for ArduPlane, with
    everything written; a second one raises KeyboardInterrupt.

    Args:
        scenario: a page, or the name or path of one.
        overrides: `key=value` as for `--set`; only with a name or path.
        out: the run directory to make; default `logs/<scenario>/<UTC>-<id>` below the current one.
        write: leave the log, the resolved page and the metrics there.
        observers: more watchers; one that raises ends the run as failed.
        outside: who may see and command the aircraft, and the pace.
        processes: that step flight models, this one included; None: as many as are best for so
            many aircraft on this machine. No number depends on it.

    Raises:
        ScenarioError: and other ValueErrors: the page cannot be flown, and what to write instead.
        LogError: the run directory or the log cannot be written.
        PartnerLost: a program outside that the page needs is gone or silent.
    """
    page = scenario if isinstance(scenario, Scenario) else load(scenario, overrides)
    if write and page.log.mcap:
        check_disk(page, out or LOGS)
    world = build(
        page, commanded=outside.looks_on, arduplane=outside.arduplane, processes=processes
    )
    world = checked(outside, page, world)
    for partner in world.partners:
        partner.check()
    pace = Pace(outside.pace) if outside.pace else None
    outcome = "failed"
    problem: list[Event] = []
    metrics: dict[str, Any] = {}

    # Everything that has been opened or begun is ended, whatever happens to the flight.
    with stopping() as stop, ExitStack() as closing:
        if isinstance(world.fleet, CrewedFleet):
            closing.callback(world.fleet.close)
        station = make_station(outside, world)
        if station:
            closing.callback(station.close)
        for line in announcement(outside, page):
            outside.tell(line)
        directory = create_run_directory(page.name, out=out) if write else None
        if directory:
            leave(directory, SCENARIO_NAME, world.info.scenario_yaml.encode())
            for name, code in world.info.code.items():
                leave(directory, name, code)
        if station and directory and outside.tlog:
            station.keep(directory / "run.tlog")
        published = page.scenario.published
        meter = MetricsObserver(published=published.model_dump() if published else None)
        log = [McapRecorder(directory / LOG_NAME)] if directory and page.log.mcap else []
        watchers: list[Observer] = [meter, *log, *observers, *([station] if station else [])]
        began = time.perf_counter()

        def conclude() -> None:
            wall = time.perf_counter() - began
            metrics.update(
                complete(
                    meter.summary(problem),
                    network=world.radio.summary(),
                    outside=report(world, station, pace),
                    outcome=outcome,
                    wall_s=wall,
                )
            )

        def document(_: object, error: BaseException | None, __: object) -> None:
            # last, so that a log is finished where metrics are; of troubles the first is told
            if directory and metrics:
                try:
                    write_json(directory / METRICS_NAME, metrics)
                except InputError:
                    if error is None:
                        raise

        closing.push(document)
        for watcher in watchers:
            watcher.begin(world.info)
            closing.callback(watcher.end, metrics, problem)
        closing.callback(conclude)
        try:
            for partner in world.partners:
                closing.callback(stop.undisturbed, partner.close)
                partner.begin(stop.heed)
            outcome = fly(world, watchers, Gate(world.deck, station, pace, stop, outside.tell))
        except Stopped:
            outcome = "interrupted"
        except KeyboardInterrupt:
            outcome = "interrupted"
            raise
        except BaseException as error:
            now = meter.summary()["simulated_s"]
            problem.append(Event(now, "error", "run", f"failed: {error!r}"))
            if directory and (directory / LOG_NAME).exists():
                error.add_note(f"log: {directory}")
            raise
    return Run(page, metrics, directory)
