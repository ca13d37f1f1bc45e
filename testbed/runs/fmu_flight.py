"""Flights whose law is an FMU: in a forked process, so that a crash of it is an outcome."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

from testbed.core.errors import FlightError, InputError
from testbed.core.forked import CrashError, Send, run_in_fork
from testbed.logs.file_record import RECORD_NAME
from testbed.logs.mcap_file import tail_path
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME, SCENARIO_NAME
from testbed.metrics.model import Metrics
from testbed.plan.fmu_law import (
    PURPOSES,
    CallReport,
    describe_crash,
    opened_fmu,
    reporting_calls,
)
from testbed.runs.external_options import ExternalOptions
from testbed.runs.flight_progress import Report
from testbed.scenario import FMU, Scenario

# Flies into a directory (None: a new one): progress, external programs, and a function that is
# called with the directory at the begin. Returns metrics and directory.
Fly: TypeAlias = Callable[
    [Path | None, Report | None, ExternalOptions, Callable[[Path | None], None]],
    tuple[Metrics, Path | None],
]


def is_fmu(scenario: Scenario) -> bool:
    """Return whether the law of a scenario is an FMU."""
    return scenario.controller.law.endswith(FMU)


def fly_fmu(
    scenario: Scenario,
    fly: Fly,
    folder: Path | None,
    report: Report | None,
    external: ExternalOptions,
) -> tuple[Metrics, Path | None]:
    """Fly a scenario whose law is an FMU in a forked process.

    If the FMU crashes it, and no program outside takes part, the flight is flown once more up to
    that step, where it ends as failed: so its log is complete. Flights repeat to the bit.

    Args:
        scenario: to fly.
        fly: what flies it.
        folder: the run directory to make; None: see `testbed.run`.
        report: of its progress.
        external: programs outside.

    Raises:
        FlightError: the FMU has crashed; the text has function, follower and time.
        InputError: it has crashed before the flight.
        Exception: what `fly` raises.
    """
    flight, calls = _ForkedFlight(scenario, fly, report, external), CallReport()
    with opened_fmu(Path(scenario.controller.law)):
        try:
            return flight.run(folder, calls)
        except CrashError as crash:
            raise flight.error_of(crash, calls) from None


_PLAIN: dict[str, Any] = {"mavlink": (), "pace": 0.0, "arduplane": None}


class _ForkedFlight:
    """A flight in a forked process.

    Attributes:
        begun: the law was built, and the flight has begun.
        directory: that was made for it.
    """

    def __init__(
        self, scenario: Scenario, fly: Fly, report: Report | None, external: ExternalOptions
    ) -> None:
        self._scenario, self._fly = scenario, fly
        self._report, self._external = report, external
        self.begun = False
        self.directory: Path | None = None

    def run(self, folder: Path | None, calls: CallReport) -> tuple[Metrics, Path | None]:
        """Fly, in the process; see `fly_fmu`."""

        def work(send: Send) -> tuple[Metrics, Path | None]:
            def progress(phase: str, done: float, total: float) -> None:
                send(("progress", phase, done, total))

            report = None if self._report is None else progress
            external = replace(self._external, announce=lambda line: send(("line", line)))
            with reporting_calls(calls):
                return self._fly(folder, report, external, lambda made: send(("begun", made)))

        found: tuple[Metrics, Path | None] = run_in_fork(work, self._receive)
        return found

    def error_of(self, crash: CrashError, calls: CallReport) -> Exception:
        """Return the error of a crash, after the flight up to there if its log can be complete.

        Args:
            crash: of the process.
            calls: of the FMU in it.

        Raises:
            FlightError: in the flight up to there.
        """
        scenario, directory = self._scenario, self.directory
        text = describe_crash(crash, calls, scenario.aircraft_names, begun=self.begun)
        if not self.begun:
            return InputError(f"{scenario.controller.law}: {text}")
        error = FlightError(f"{scenario.controller.law}: {text}")
        if directory is None:
            return error
        alone = self._external == replace(self._external, **_PLAIN)
        in_step = calls.call >= 0 and not crash.killed
        if alone and in_step and _has_own_files(directory, scenario):
            _delete_files(directory, scenario)
            reason = f"{crash.end} in the call to {PURPOSES[calls.call]}"
            self.run(directory, CallReport(calls.time_s, reason))  # raises a FlightError
        error.add_note(f"log: {directory}, which was cut (testbed recover finishes it)")
        return error

    def _receive(self, message: Any) -> None:  # noqa: ANN401 - a tuple of plain data
        kind, *values = message
        if kind == "begun":
            self.begun, (self.directory,) = True, values
        elif kind == "line":
            self._external.announce(*values)
        elif self._report is not None:
            self._report(*values)


def _own_files(directory: Path, scenario: Scenario) -> list[Path]:
    """Return the files of a run, which may be there."""
    names = LOG_NAME, METRICS_NAME, SCENARIO_NAME, RECORD_NAME, Path(scenario.controller.law).name
    return [*(directory / each for each in names), tail_path(directory / LOG_NAME)]


def _has_own_files(directory: Path, scenario: Scenario) -> bool:
    """Return whether a run directory has no files but those of the run."""
    return {*directory.iterdir()} <= {*_own_files(directory, scenario)}


def _delete_files(directory: Path, scenario: Scenario) -> None:
    for each in _own_files(directory, scenario):
        each.unlink(missing_ok=True)
