"""Step a scenario from Python, in one process and without sockets."""

from __future__ import annotations

import math
import os
import time
import warnings
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self, TypeAlias

import numpy as np
from pydantic import Field

from testbed.core.compile import reporting
from testbed.core.errors import InputError, NotCopied
from testbed.core.exclusive import Exclusive, exclusive
from testbed.core.records import Event, FbwaCommand, Observer, RunInfo, Sample
from testbed.core.saved_state import SavedState
from testbed.flight.loop import Flight
from testbed.flight.stages import UserStage, check_stages
from testbed.flight.world import World
from testbed.logs.file_record import record_files
from testbed.logs.recorder import McapRecorder
from testbed.logs.run_directory import LOG_NAME, METRICS_NAME
from testbed.metrics.document import finalise, write_json
from testbed.metrics.model import Metrics
from testbed.metrics.observer import MetricsObserver
from testbed.plan.world import build, build_single
from testbed.runs.command_ranges import check_command
from testbed.runs.external_options import external_summary
from testbed.runs.flight_progress import (
    Progress,
    check_progress,
    compiling_report,
    reporting_progress,
)
from testbed.runs.run import check_observers, open_run_directory, stop_bounds
from testbed.scenario import Scenario, SingleAircraft, find_loaded, set_seed
from testbed.scenario.aircraft import ArduPlane
from testbed.scenario.arguments import check_argument, check_path
from testbed.scenario.fields import MAX_DURATION_S, Instant, Section
from testbed.scenario.validate import shown_value

Commands: TypeAlias = "Mapping[str, FbwaCommand[float] | tuple[float, float, float]]"


class Simulation(NotCopied):
    """A scenario that is flown step by step.

    Aircraft with `commanded_by: external` fly the fly-by-wire-A commands of `step`; all others fly
    as with `testbed run`, to the bit. In a `with` statement the log is closed at its end. If it is
    never closed, the log is finished with a ResourceWarning when the object or the program ends,
    and metrics are missing. A forked child must make a simulation of its own; copies and
    pickles are refused, and so is a call while another thread is within one, or from a stage, an
    observer or a law of the flight.

    Args:
        scenario: a scenario, or the name or path of one.
        overrides: `key=value` as for `--set`; only with a name or path.
        seed: of all random streams; None: that of the scenario.
        duration_s: at which the flight ends, s; None: that of the scenario.
        out: run directory to create, with log, resolved scenario and, after `close`, metrics; None:
            nothing is written.
        observers: as of `testbed.run`.
        progress: of compiling, as of `testbed.run`.
        stages: as of `testbed.run`.

    Attributes:
        scenario: as resolved, with the seed that is flown.
        names: of all N aircraft, the leader first.
        time_s: s, of the present tick.
        events: all events up to now.
        outcome: how the flight ended; None: it has not.
        directory: of the files; None: nothing is written.

    Raises:
        InputError: the scenario cannot be flown, or has ArduPlanes, which `testbed.run` starts.
        LogError: the run directory cannot be created.
    """

    def __init__(
        self,
        scenario: Scenario | SingleAircraft | str | os.PathLike[str],
        overrides: Sequence[str] = (),
        *,
        seed: int | None = None,
        duration_s: float | None = None,
        out: str | os.PathLike[str] | None = None,
        observers: Sequence[Observer] = (),
        progress: Progress = None,
        stages: Sequence[UserStage] = (),
    ) -> None:
        self._stages = check_stages(stages)
        self._out = None if out is None else check_path("out", out)
        check_observers(observers)
        check_progress(progress)
        self.scenario: Scenario | SingleAircraft = (
            scenario
            if isinstance(scenario, SingleAircraft)
            else find_loaded(scenario, overrides, duration_s=duration_s)
        )
        for each in self.scenario.aircraft:
            if isinstance(each.autopilot, ArduPlane):
                raise InputError(
                    f"{each.name} has autopilot: ardupilot, a program of its own (fly it with "
                    "testbed.run, or write autopilot: virtual)"
                )
        self._exclusive = Exclusive(f"the flight of {self.scenario.name}")
        self._further, self._progress = tuple(observers), progress
        self._flown = False
        self._open: list[Observer] = []  # observers that have begun
        self._unclosed: list[McapRecorder] = []  # at most one
        weakref.finalize(self, _finish_log, self._unclosed, os.getpid())
        self.reset(seed)

    @exclusive
    def reset(self, seed: int | None = None) -> Sample:
        """Return to the start, and return the state there.

        Args:
            seed: of the new flight; None: the same as before.

        Raises:
            InputError: `out` has the log of a flight, and holds one only; or the seed is wrong. The
                flight then goes on.
        """
        if (self._flown or self._open) and self._out is not None:
            raise InputError(f"{self._out} holds one flight (make another Simulation for the next)")
        scenario = self.scenario
        if seed is not None:
            scenario = set_seed(scenario, seed)
        with reporting_progress(self._progress, scenario.name) as report:
            return self._begin(scenario, compiling_report(report))

    def _begin(
        self, scenario: Scenario | SingleAircraft, compiling: Callable[[int, int], None] | None
    ) -> Sample:
        with reporting(compiling):
            if isinstance(scenario, SingleAircraft):
                world = build_single(scenario)
            else:
                world = build(scenario, in_process=True)
        self._end_observers()
        self.scenario = scenario
        meter = MetricsObserver(published=scenario.published, stop_at=stop_bounds(scenario))
        events = EventCollector()
        self._world, self._meter, self.events = world, meter, events.all
        self.directory = self._open_directory(world)
        observers: list[Observer] = [meter, events]
        if self.directory and self.scenario.log.mcap:
            self._unclosed.append(McapRecorder(self.directory / LOG_NAME))
        observers += self._unclosed
        observers += self._further
        self._flight = Flight(world, observers, self._stages)
        self._flight.prepare(compiling)
        for each in observers:
            each.begin(world.info)
            self._open.append(each)
        self.names = world.names
        self.outcome: str | None = None
        self._array = world.array_commands
        self._period = world.clock.autopilot
        self._begun_s = time.perf_counter()
        self._flight.fly_to(-math.inf)
        self.time_s = self._flight.time_s
        return self.state

    def _open_directory(self, world: World) -> Path | None:
        """Create the run directory of a flight that is built; None: nothing is written."""
        return open_run_directory(self.scenario, world, self._out) if self._out else None

    @exclusive
    def step(self, commands: Commands | None = None, until: float | None = None) -> Sample:
        """Fly to the next tick of the autopilots, or up to a time, and return the state there.

        Args:
            commands: by name, an `FbwaCommand` or (pitch, roll, throttle) in rad, rad and 0..1, for
                aircraft with `commanded_by: external`: angles up to 75° either way, as a stick
                gives. An aircraft without a new one keeps the last; the first is its trim.
            until: s, from 0 to a day; the first tick at or after it, and after the present one.

        Raises:
            InputError: an aircraft takes no commands, a number is out of range, or the flight has
                ended. The flight then goes on as if there had been no call.
        """
        if self.outcome is not None:
            raise InputError(f"the flight has ended: {self.outcome} at {self.time_s:g} s; reset()")
        clock = self._world.clock
        due = (clock.ticks(self.time_s) // self._period + 1) * self._period
        if until is not None:
            if not (type(until) is float and 0.0 <= until <= MAX_DURATION_S):  # else it is right
                until = check_argument("until", until, StepArguments, "until")
            due = max(due, clock.first_tick(until))
        if commands is not None:
            for row, command in self._checked_commands(commands).items():
                if self._array is not None:  # else no row has passed
                    self._array.commands[row] = command
        try:
            self._advance(due)
        except BaseException:
            self.outcome, self.time_s = "failed", self._flight.begun_s
            raise
        return self.state

    def _checked_commands(self, commands: Commands) -> dict[int, FbwaCommand[float]]:
        if not isinstance(commands, Mapping):
            raise InputError(
                f"commands: is {shown_value(commands)} (write {{name: (pitch, roll, throttle)}})"
            )
        return {
            self._commandable(name): check_command(name, each) for name, each in commands.items()
        }

    def _advance(self, due: int) -> None:
        """Fly to a tick of the base rate, or to the end."""
        for log in self._unclosed:
            log.check_process()
        if not self._flight.fly_to(self._world.clock.time_s(due)):
            self.outcome = self._flight.ending
        self.time_s = self._flight.time_s

    @exclusive
    def save(self) -> SavedFlight:
        """Save the flight as it is now, for `restore`.

        Raises:
            InputError: a part of the flight is outside Python: a log, a viewer, flight models of
                JSBSim, or an object of a law or an observer that cannot be copied.
        """
        if self.directory is not None:
            raise InputError(f"{self.directory}: a flight that writes files cannot be saved")
        models = self._world.fleet
        if models is not None and models.engine != "compiled":
            cure = (
                f"; {models.engine_reason}"
                if models.engine_reason
                else " (write scenario.engine=compiled into the overrides)"
            )
            raise InputError(f"engine: jsbsim: flight models outside Python cannot be saved{cure}")
        of_user = {"observers": self._further, "stages": self._stages}  # first, to be named so
        state = SavedState(**of_user, flight=self._flight, meter=self._meter, events=self.events)
        return SavedFlight(self._flight, state, self.time_s, self.outcome)

    @exclusive
    def restore(self, saved: SavedFlight) -> Sample:
        """Return to a saved moment of this flight, any number of times, and return the state there.

        The flight goes on from there as it did, to the bit, or otherwise, as other commands let
        it. `reset` begins another flight, to which this one's moments do not belong.

        Raises:
            InputError: `saved` is of another flight.
        """
        if not isinstance(saved, SavedFlight) or saved.flight is not self._flight:
            raise InputError(
                "saved: is not of this flight (write what save() of this Simulation has returned "
                "since its last reset)"
            )
        saved.state.restore()
        self.time_s, self.outcome = saved.time_s, saved.outcome
        return self.state

    @property
    def state(self) -> Sample:
        """The present state, a `Sample`, whose arrays the next step overwrites.

        Of N aircraft, the leader first, and n followers; SI units and radians:

        - `time_s`, `tick`, `events` since the sample before, `lost` (N,)
        - `truth` and `estimate`, each a `VehicleState`: `position_ned` (N, 3) m, `velocity_ned`
          (N, 3) m/s, `acceleration_ned` (N, 3) m/s², `euler` (N, 3) rad, `rates_body` (N, 3)
          rad/s, `airspeed` and `equivalent_airspeed` (N,) m/s
        - `air`, an `AirData`: `wind_ned` (N, 3) m/s, `alpha` and `beta` (N,) rad and others
        - `command`, an `FbwaCommand`: `pitch` and `roll` (N,) rad, `throttle` (N,) 0..1
        - `surfaces`, an `ActuatorCommand`: `aileron`, `elevator`, `rudder` (N,) −1..1, `throttle`
        - `formation`, a `FormationState`: `slot_ned` and `error_ned` (n, 3) m, speeds (n,) m/s,
          courses (n,) rad, `age_s` (n, N) and others
        - `links`: messages `sent` and `delivered` (n, N)

        `help(testbed.core.records.Sample)` has all fields.
        """
        return self._flight.sample(self.time_s)

    @property
    def commands(self) -> dict[str, FbwaCommand[float]]:
        """The command of each aircraft that takes commands, by name; first its trim."""
        if self._array is None:
            return {}
        rows = np.flatnonzero(self._array.commanded).tolist()
        return {self.names[row]: FbwaCommand(*self._array.commands[row].item()) for row in rows}

    @property
    def metrics(self) -> Metrics:
        """The metrics up to now, as in metrics.json; of a flight that goes on, "interrupted"."""
        self._exclusive.check("metrics")
        outcome, expect = self.outcome or "interrupted", self.scenario.expect
        return flight_metrics(self._world, self._meter, outcome, self._begun_s, expect)

    @exclusive
    def close(self) -> None:
        """End the flight, and write log and metrics where there is a directory; repeatable."""
        self._end_observers()

    def _end_observers(self) -> None:
        if not self._open:
            return
        self._flown = True
        if self.outcome is None:
            self.outcome = "interrupted"
        metrics = self.metrics
        while self._open:
            self._open.pop().end(metrics, ())
        self._unclosed.clear()
        if self.directory:
            write_json(self.directory / METRICS_NAME, metrics)
            record_files(self.directory, LOG_NAME, METRICS_NAME)

    def _commandable(self, name: str) -> int:
        """Return the row of an aircraft that takes commands."""
        if name in self.names:
            row = self.names.index(name)
            if self._array is not None and self._array.commanded[row]:
                return row
        if name not in self.names:
            shown = name if isinstance(name, str) else shown_value(name)
            raise InputError(f"{shown}: no such aircraft (there are {', '.join(self.names)})")
        key = "leader" if name == self.names[0] else f"fleet.{name}"
        raise InputError(
            f"{name} takes no commands: write {key}.commanded_by=external into the overrides"
        )

    def __enter__(self) -> Self:
        """Return the simulation."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def _why_not_copied(self) -> str:
        """See `NotCopied`: the flight models are outside Python."""
        return (
            f"the flight of {self.scenario.name} cannot be copied or pickled (make another one, "
            "with the same seed, and give it the same commands)"
        )

    def __repr__(self) -> str:
        """Describe the flight in one line."""
        duration = self.scenario.scenario.duration_s
        return (
            f"<Simulation: {self.scenario.name}; {self.time_s:g} of {duration:g} s; "
            f"{self.outcome or 'flying'}>"
        )


def _finish_log(unclosed: list[McapRecorder], process: int) -> None:
    """Finish the log of a simulation that was not closed; `testbed recover` adds its metrics."""
    if os.getpid() != process:  # a fork, which has no part in the log
        return
    for recorder in unclosed:
        warnings.warn(
            f"{recorder.path}: its Simulation was not closed: the log has no metrics (write `with "
            "testbed.Simulation(...) as simulation:`, or call close(); testbed recover adds them)",
            ResourceWarning,
            stacklevel=1,
        )
        recorder.close()


@dataclass(frozen=True, eq=False)
class SavedFlight(NotCopied):
    """A moment of a flight of a `Simulation`.

    Attributes:
        flight: to which it belongs.
        state: of its parts.
        time_s: s, of the tick.
        outcome: how the flight had ended; None: it had not.
    """

    CONSTANT: ClassVar[bool] = True  # for another state, of a flight that holds this one
    flight: Flight = field(repr=False)
    state: SavedState = field(repr=False)
    time_s: float
    outcome: str | None

    def _why_not_copied(self) -> str:
        """See `NotCopied`."""
        return (
            f"the flight as saved at {self.time_s:g} s cannot be copied or pickled: it belongs to "
            "its Simulation (restore it there, as often as you like)"
        )


class StepArguments(Section):
    """Arguments of a step."""

    until: Instant = Field(description="Time of the flight, s.")


def flight_metrics(
    world: World, meter: MetricsObserver, outcome: str, begun_s: float, expect: Section
) -> Metrics:
    """Return the metrics of a flight without links.

    Args:
        world: that is flown.
        meter: of the flight.
        outcome: how it has ended, or "interrupted".
        begun_s: when it began, of `time.perf_counter`.
        expect: bounds of the scenario on its numbers.
    """
    return finalise(
        meter.summary(),
        network=world.parts.radio.summary() if world.parts else None,
        external=external_summary(world, None, None),
        outcome=outcome,
        wall_s=time.perf_counter() - begun_s,
        expect=expect.model_dump(),
    )


class EventCollector:
    """Collect the events of a flight."""

    events_only = True

    def __init__(self) -> None:
        self.all: list[Event] = []

    def begin(self, info: RunInfo) -> None:
        """Do nothing."""

    def observe(self, sample: Sample) -> None:
        """Keep the events of a sample."""
        self.all.extend(sample.events)

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Keep the events after the last sample."""
        self.all.extend(events)
