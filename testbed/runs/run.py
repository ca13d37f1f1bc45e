"""Fly a scenario: build, fly, observe, and write log, resolved scenario and metrics."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, cast

from testbed.commands.tick_gate import RealTimePacer, TickGate
from testbed.core.compile import reporting
from testbed.core.errors import InputError
from testbed.core.files import reserve_standard_descriptors
from testbed.core.records import Event, Observer
from testbed.flight.loop import Flight
from testbed.flight.stages import UserStage, check_stages, describe_stages
from testbed.flight.world import World
from testbed.logs.file_record import record_files
from testbed.logs.flight_data import FlightData, load_run
from testbed.logs.recorder import McapRecorder
from testbed.logs.run_directory import (
    LOG_NAME,
    LOGS,
    METRICS_NAME,
    SCENARIO_NAME,
    TLOG_NAME,
    create_run_directory,
    write_run_file,
)
from testbed.metrics.document import BOUND_VIOLATED, finalise, write_json
from testbed.metrics.expectations import violations
from testbed.metrics.model import Metrics
from testbed.metrics.observer import MetricsObserver
from testbed.plan.resources import check_disk
from testbed.plan.world import build
from testbed.runs.companion_run import (
    check_companions,
    commands_of,
    open_companions,
    with_message_links,
)
from testbed.runs.external_options import (
    NO_EXTERNAL,
    ExternalOptions,
    announcements,
    check_links,
    external_summary,
    make_server,
)
from testbed.runs.flight_progress import (
    FlightProgress,
    Progress,
    Report,
    compiling_report,
    reporting_progress,
)
from testbed.runs.fmu_flight import fly_fmu, is_fmu
from testbed.runs.stop_request import RunStopped, stop_on_signals
from testbed.scenario import Scenario, SingleAircraft, find_loaded
from testbed.scenario.arguments import check_calls, check_count, check_path
from testbed.scenario.validate import shown_value
from testbed.vehicle.workers import ParallelFleet

UNEXPECTED = 3  # exit code of a number outside the bounds of `expect`
EXIT_CODES: Mapping[str, int] = {
    "completed": 0,
    "lost": 1,
    "envelope_exceeded": 1,
    "formation_lost": 1,
    "separation_lost": 1,
    BOUND_VIOLATED: UNEXPECTED,
    "failed": 4,
    "interrupted": 130,
}


@dataclass(frozen=True, repr=False)
class Run:
    """A flown scenario.

    Args:
        scenario: as resolved and flown.
        metrics: the content of `metrics.json`.
        directory: of its files; None if nothing was written.
    """

    scenario: Scenario
    metrics: Metrics
    directory: Path | None

    def __repr__(self) -> str:
        """Show outcome, RMS errors by follower and window, and the directory."""
        from testbed.metrics.printed_tables import table_text

        return table_text(self.metrics, str(self.directory or ""))

    def _repr_html_(self) -> str:
        """Show the same in a notebook."""
        from testbed.metrics.printed_tables import table_html

        return table_html(self.metrics, str(self.directory or ""))

    @cached_property
    def data(self) -> FlightData:
        """The samples of the log, as of `testbed.load_run`; read when it is first used.

        Raises:
            InputError: the run wrote no log.
            LogError: the log has been moved or damaged since.
        """
        if self.directory is None:
            raise InputError(
                "data: this run wrote no log (leave out write=False; metrics has its numbers)"
            )
        if not self.scenario.log.mcap:
            raise InputError("data: this run wrote no log (write log: {mcap: true})")
        return load_run(self.directory)

    @property
    def outcome(self) -> str:
        """The outcome: a key of `EXIT_CODES` except "failed"."""
        return str(self.metrics["outcome"])

    @property
    def exit_code(self) -> int:
        """The exit code of the command line: of the outcome, or that of an unexpected number."""
        return EXIT_CODES[self.outcome] or (UNEXPECTED if violations(self.metrics) else 0)


def run(
    scenario: Scenario | str | os.PathLike[str],
    overrides: Sequence[str] = (),
    *,
    duration_s: float | None = None,
    seed: int | None = None,
    out: str | os.PathLike[str] | None = None,
    write: bool = True,
    progress: Progress = None,
    observers: Sequence[Observer] = (),
    external: ExternalOptions = NO_EXTERNAL,
    processes: int | None = 1,
    stages: Sequence[UserStage] = (),
) -> Run:
    """Fly a scenario to its end.

    A law that is an FMU flies in a forked process, unless there are observers or stages: a crash of
    it then is a FlightError, and the log up to it is complete.

    Ctrl-C and SIGTERM end it after the current tick, or during a wait for ArduPlane, and all files
    are written. Another one within a second has no effect; a later one ends it within the tick and
    raises KeyboardInterrupt after all files are written.

    Args:
        scenario: a scenario, or the name or path of one.
        overrides: `key=value` as for `--set`; only with a name or path.
        duration_s: simulated time at the end, s; None: that of the scenario. See `set_duration`.
        seed: of all random streams; None: that of the scenario.
        out: run directory to create; default `logs/<scenario>/<UTC>-<id>` in the current one.
        write: write the log, the resolved scenario and the metrics there.
        progress: of compiling and flying. True: a bar in a terminal, one line in a notebook, lines
            10 s apart elsewhere, on standard error; False: none; None: in a notebook only. Or a
            function that is called with "compiling", the kernels that are ready and their number,
            then with "flying", the simulated time and the duration, s, up to ten times a second;
            an error in it ends the run.
        observers: further observers; one that raises ends the run as failed.
        external: links to external programs, and the pace.
        processes: that step flight models, including this one; None: as many as are fastest for
            this number of aircraft on this machine. Results do not depend on it.
        stages: of your own, inserted into the flight's; `testbed validate --stages` lists these.

    Raises:
        InputError: an argument is wrong, or the scenario cannot be flown; the message has what to
            write instead.
        LogError: the run directory or the log cannot be written.
        FlightError: the law raises an exception, or is an FMU that crashes.
        ExternalProgramLost: an external program that the scenario needs has ended or does not
            respond.
    """
    reserve_standard_descriptors()  # or the log gets one of them, on which JSBSim prints
    folder = None if out is None else check_path("out", out)
    if not isinstance(external, ExternalOptions):
        raise InputError(f"external: is {shown_value(external)} (write ExternalOptions(...))")
    if processes is not None:
        check_count("processes", processes)
    check_observers(observers)
    stages = check_stages(stages)
    loaded = find_loaded(scenario, overrides, duration_s=duration_s, seed=seed)
    if external.companions:
        loaded = with_message_links(loaded)
    if write and loaded.log.mcap:
        check_disk(loaded, folder or LOGS)
    with reporting_progress(progress, loaded.name) as report:
        if observers or stages or not is_fmu(loaded):
            return _fly(loaded, folder, write, report, observers, external, processes, stages)

        def fly(
            out: Path | None,
            report: Report | None,
            external: ExternalOptions,
            begun: Callable[[Path | None], None],
        ) -> tuple[Metrics, Path | None]:
            found = _fly(loaded, out, write, report, (), external, processes, (), begun)
            return found.metrics, found.directory

        metrics, directory = fly_fmu(loaded, fly, folder, report, external)
        return Run(loaded, metrics, directory)


def _fly(
    loaded: Scenario,
    folder: Path | None,
    write: bool,
    report: Report | None,
    observers: Sequence[Observer],
    external: ExternalOptions,
    processes: int | None,
    stages: Sequence[UserStage],
    begun: Callable[[Path | None], None] = lambda directory: None,
) -> Run:
    """Fly a scenario; the arguments are checked, see `run`.

    `begun` is called with the directory when that has been made.
    """
    compiling = compiling_report(report)
    if report is not None:
        observers = [FlightProgress(report), *observers]
    lockstep = not external.pace
    with reporting(compiling):
        world = build(
            loaded,
            commanded=external.has_server,
            arduplane=external.arduplane,
            processes=processes,
            companions=commands_of(lockstep=lockstep) if external.companions else None,
        )
    world = check_links(external, loaded, world)
    if external.companions:
        check_companions(loaded, world)
    for process in world.external_processes:
        process.check()
    pacer = RealTimePacer(external.pace) if external.pace else None
    outcome = "failed"
    errors: list[Event] = []
    metrics: dict[str, Any] = {}

    # whatever was opened or started is closed or ended, also after an error
    with stop_on_signals() as stop, ExitStack() as closing:
        if isinstance(world.fleet, ParallelFleet):
            closing.callback(world.fleet.close)
        companions = open_companions(external, world, closing)
        if companions is not None:
            external = companions.options
        server = make_server(external, world, None if companions is None else companions.epoch_us)
        if server:
            closing.callback(server.close)
        if companions is not None and server is not None:
            server.attach(companions.hub)
            stages = (companions.hub.stage(world), *stages)
            closing.callback(stop.without_interruption, companions.processes.close)
            companions.processes.start(world.info.scenario_yaml, world.info.code)
        for line in announcements(external, loaded):
            external.announce(line)
        directory = open_run_directory(loaded, world, folder) if write else None
        begun(directory)
        if server and directory and external.tlog:
            server.log_to(directory / TLOG_NAME)
        meter = MetricsObserver(published=loaded.published, stop_at=stop_bounds(loaded))
        log = [McapRecorder(directory / LOG_NAME)] if directory and loaded.log.mcap else []
        all_observers: list[Observer] = [meter, *log, *observers, *([server] if server else [])]
        if companions is not None:
            all_observers.append(companions.hub)
        flight = Flight(world, all_observers, stages)
        with suppress(RunStopped):  # the flight then ends before its first tick
            flight.prepare(compiling, stop.check)
        start = time.perf_counter()

        def finish_metrics() -> None:
            wall = time.perf_counter() - start
            metrics.update(
                finalise(
                    meter.summary(errors),
                    network=world.formation.radio.summary(),
                    external=external_summary(world, server, pacer),
                    outcome=outcome,
                    wall_s=wall,
                    expect=loaded.expect.model_dump(),
                )
            )

        def write_metrics(_: object, error: BaseException | None, __: object) -> None:
            # called last, so that a finished log exists where metrics do; the first error is raised
            if directory and metrics:
                try:
                    write_json(directory / METRICS_NAME, metrics)
                except InputError:
                    if error is None:
                        raise
                finally:
                    record_files(directory, LOG_NAME, METRICS_NAME, TLOG_NAME)

        closing.push(write_metrics)
        for observer in all_observers:
            observer.begin(world.info)
            end = partial(observer.end, metrics, errors)
            closing.callback(partial(stop.interruptible, end) if observer in observers else end)
        closing.callback(finish_metrics)
        try:
            try:
                for process in world.external_processes:
                    closing.callback(stop.without_interruption, process.close)
                    process.start(stop.check, *([] if external.quiet else [external.announce]))
                if companions is not None:
                    companions.processes.wait(stop.check)
                gate = TickGate(world.external_control, server, pacer, stop, external.announce)
                outcome = flight.fly(gate)
            except RunStopped:
                outcome = "interrupted"
            stop.begin_ending()
        except KeyboardInterrupt:
            stop.begin_ending()
            outcome = "interrupted"
            raise
        except BaseException as error:
            stop.begin_ending()
            errors.append(Event(flight.begun_s, "error", "run", f"failed: {error!r}"))
            if directory and (directory / LOG_NAME).exists():
                error.add_note(f"log: {directory}")
            raise
    return Run(loaded, cast("Metrics", metrics), directory)


def stop_bounds(scenario: Scenario | SingleAircraft) -> dict[str, Any]:
    """Return the bounds of a scenario that end a flight when they are violated."""
    return scenario.expect.model_dump() if scenario.limits.on_violation == "stop" else {}


def list_stages(world: World) -> list[tuple[str, str, str, str]]:
    """List the stages of a flight with log and metrics; see `stages.describe_stages`."""
    observers = MetricsObserver(), McapRecorder(Path(LOG_NAME))
    return list(describe_stages(Flight(world, observers).stages))


def check_observers(observers: Sequence[Observer]) -> None:
    """Check that observers have their methods.

    Raises:
        InputError: one does not.
    """
    if not isinstance(observers, list | tuple):
        raise InputError(f"observers: {shown_value(observers)} is no list (write [observer])")
    for index, each in enumerate(observers):
        check_calls(f"observers[{index}]", each, ("begin", "observe", "end"))


def open_run_directory(scenario: Scenario | SingleAircraft, world: World, out: Path | None) -> Path:
    """Create a run directory, with the resolved scenario and the code of its laws.

    Args:
        scenario: that is flown.
        world: built from it.
        out: the directory; None: a new one below `logs`.
    """
    directory = create_run_directory(scenario.name, out=out)
    write_run_file(directory, SCENARIO_NAME, world.info.scenario_yaml.encode())
    for name, code in world.info.code.items():
        write_run_file(directory, name, code)
    record_files(directory, SCENARIO_NAME, *world.info.code)
    return directory
