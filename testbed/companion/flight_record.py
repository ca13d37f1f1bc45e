"""The log of a companion: the topics of a run, with what is known aboard one aircraft.

The own row has the own state, as the autopilot estimates it. Those of the others have their last
messages, moved along their velocities to the time of the sample; what no message has is NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from testbed.companion.control_loop import CompanionLoop
from testbed.companion.engagement import CompanionText
from testbed.companion.follower_control import FollowerControl
from testbed.core.compile import bind_entry, prepare, registered, registering
from testbed.core.errors import InputError
from testbed.core.records import (
    AIRCRAFT,
    FOLLOWER,
    LINK,
    Event,
    Record,
    RunInfo,
    allocate,
    mark_unknown,
)
from testbed.core.samples import make_sample
from testbed.formation.slots import write_formation_state
from testbed.logs.file_record import record_files
from testbed.logs.mcap_file import LogError
from testbed.logs.recorder import McapRecorder
from testbed.logs.run_directory import (
    LOG_NAME,
    METRICS_NAME,
    SCENARIO_NAME,
    create_run_directory,
    write_run_file,
)
from testbed.mavlink.outgoing import Severity
from testbed.metrics.document import write_json
from testbed.metrics.observer import MetricsObserver
from testbed.plan.clock import versions_without_jsbsim
from testbed.plan.user_code import with_stored_code
from testbed.scenario import Scenario, ScenarioText

STATISTICS_NAME = "companion.json"
FLUSH_S = 2.0  # of flight that a log loses at most where the companion is killed
_LEVELS = {Severity.ERROR: "error", Severity.WARNING: "warning", Severity.INFO: "info"}
_MOTION = ("position_ned", "velocity_ned", "acceleration_ned", "euler")
# parts of an aircraft without a message
_UNKNOWN = ("truth", "estimate", "air", "wind", "command", "control", "surfaces")


class FlightRecord:
    """Write the log of a companion's flight.

    A log that cannot be written on, as where the disk is full, ends: the flight goes on.

    Attributes:
        directory: of the files.
    """

    def __init__(
        self,
        scenario: Scenario,
        control: FollowerControl,
        out: Path | None,
        warn: Callable[[str], None],
    ) -> None:
        """Create the directory, with the scenario and its code.

        Args:
            scenario: that is flown.
            control: of the aircraft.
            out: the directory; None: a new one below `logs`.
            warn: called with the reason why the log ends.

        Raises:
            LogError: the directory cannot be made.
        """
        self._scenario, self._control, self._warn = scenario, control, warn
        stored, self._code = with_stored_code(scenario)
        self._make_yaml = ScenarioText(stored)
        self.directory = create_run_directory(scenario.name, out=out)
        write_run_file(self.directory, SCENARIO_NAME, self._make_yaml().encode())
        for name, code in self._code.items():
            write_run_file(self.directory, name, code)
        record_files(self.directory, SCENARIO_NAME, *self._code)
        plan = control.plan
        n = len(plan.names)
        self._aircraft, self._followers = allocate(AIRCRAFT, n), allocate(FOLLOWER, n - 1)
        self._links = allocate(LINK, n - 1, n)
        mark_unknown(self._aircraft, self._followers, self._links, _UNKNOWN)
        with registering():
            self._write_formation = bind_entry(
                write_formation_state,
                self._aircraft,
                self._followers,
                plan.offsets,
                plan.altitudes,
            )
            prepare(registered())
        law = control.reports.logged if control.row else None
        records = self._aircraft, self._followers, self._links
        self._sample = make_sample(*records, law, exact=True, faults=False)
        self._recorder = McapRecorder(self.directory / LOG_NAME, flush_s=FLUSH_S)
        self._meter = MetricsObserver()
        self._observers = self._recorder, self._meter
        self._events: list[Event] = []
        self._tick = -1
        self._begun = self._ended = False

    def sample(self, loop: CompanionLoop) -> None:
        """Write a sample, unless the log has ended."""
        if self._ended:
            return
        tick = round(loop.boot_s * self._control.clock.base_rate_hz)
        try:
            if not self._begun:
                self._begin(loop)
            if tick <= self._tick:
                self._end("the autopilot's time went back")
                return
            self._tick = tick
            self._write_rows(loop)
            sample = self._sample._replace(
                tick=tick, time_s=loop.boot_s, events=tuple(self._take_events())
            )
            for observer in self._observers:
                observer.observe(sample)
        except (LogError, OSError) as error:
            self._end(str(error))

    def text(self, boot_s: float, text: CompanionText) -> None:
        """Log a text as an event of the own aircraft."""
        level = _LEVELS.get(text.severity, "info")
        self._events.append(Event(boot_s, level, self._control.name, text.text))

    def alive(self, now_s: float) -> None:
        """Note that the loop runs; the log needs nothing of it."""

    def close(self, statistics: Any) -> None:  # noqa: ANN401 - plain data
        """Finish all files: the log with its metrics, and the statistics.

        Args:
            statistics: of the loop, for JSON.
        """
        metrics: dict[str, Any] = {}
        try:
            if self._begun and self._tick >= 0:
                metrics = dict(self._meter.summary())
                metrics["outcome"], metrics["recorded"] = "completed", True
            if self._begun and not self._ended:
                self._recorder.end(metrics, self._take_events())
            if metrics:
                write_json(self.directory / METRICS_NAME, metrics)
            write_json(self.directory / STATISTICS_NAME, statistics)
            record_files(self.directory, LOG_NAME, METRICS_NAME)
        except (LogError, InputError, OSError) as error:
            self._end(str(error))

    def _end(self, reason: str) -> None:
        """End the log where it is."""
        if not self._ended:
            self._ended = True
            with suppress(LogError, OSError):
                self._recorder.close()
            self._warn(f"log ended: {reason}")

    def _take_events(self) -> list[Event]:
        events, self._events = self._events, []
        return events

    def _begin(self, loop: CompanionLoop) -> None:
        """Write the header: what is known of a flight before its first sample."""
        self._begun = True
        info = self._info(loop)
        for observer in self._observers:
            observer.begin(info)
        self._events.insert(
            0,
            Event(
                loop.boot_s,
                "info",
                self._control.name,
                "recorded by its companion: others are known by their messages",
            ),
        )

    def _info(self, loop: CompanionLoop) -> RunInfo:
        scenario, control, plan = self._scenario, self._control, self._control.plan
        agents = [each.agent for each in plan.followers]
        base_ms = loop.state.base_ms
        return RunInfo(
            scenario_name=scenario.name,
            make_yaml=self._make_yaml,
            code=self._code,
            names=plan.names,
            aircraft=tuple(each.folder.name for each in plan.aircraft),
            wingspan_m=tuple(each.airframe.span for each in plan.aircraft),
            origin=plan.origin,
            base_rate_hz=control.clock.base_rate_hz,
            sample_rate_hz=round(control.rate_hz),
            duration_s=loop.boot_s + scenario.scenario.duration_s,
            seed=scenario.scenario.seed,
            speed_bounds_mps=tuple(each.speed_mps for each in agents),
            kappa_mps=tuple(each.kappa_mps for each in agents),
            roll_limit_rad=tuple(control.built.config.roll_limit.tolist()),
            leader_path_ned=np.zeros((0, 3)),
            windows=dict(scenario.scenario.windows),
            versions=versions_without_jsbsim(),
            start_unix_ns=max(base_ms or 0, 0) * 1_000_000,
            law_numbers=control.built.outputs.logged_names if control.row else (),
        )

    def _write_rows(self, loop: CompanionLoop) -> None:
        """Copy what is known to the records of the sample."""
        control, row = self._control, self._control.row
        own = self._aircraft[row]
        own["truth"] = own["estimate"] = control.own["estimate"]
        if loop.command:
            own["command"] = control.own["control"]
            self._followers[row - 1] = control.followers[row - 1]
        else:
            for name in own["command"].dtype.names:
                own["command"][name] = math.nan
        for other, link in enumerate(control.inbox):
            if other != row:
                _write_other(self._aircraft[other], link, loop.boot_s)
        if row:
            self._links[row - 1] = control.inbox
        self._write_formation()


def _write_other(out: Record, link: Record, now: float) -> None:
    """Write the motion of another aircraft by its newest message."""
    ahead_s = now - link["stamp_s"]
    for part in (out["truth"], out["estimate"]):
        for name in _MOTION:
            part[name] = link[name]
        part["position_ned"] += ahead_s * link["velocity_ned"]
