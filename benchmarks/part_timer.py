"""Measure how a flight's time is divided among the parts of the simulation.

The methods of each part are replaced by timed ones. Time belongs to the innermost part that runs;
outside of all parts it is the loop's own. Timing has a cost, which is measured too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from testbed.atmosphere.air import Air
from testbed.core.records import Event, Observer, RunInfo, Sample
from testbed.logs.recorder import McapRecorder
from testbed.metrics import MetricsObserver
from testbed.network.radio import Radio
from testbed.sensors.estimators import Estimators
from testbed.sim.control import Control
from testbed.sim.faults import FaultManager
from testbed.sim.leader_control import MissionController
from testbed.sim.limits import EnvelopeMonitor
from testbed.sim.monitors import GustMonitor, JoinMonitor, LinkMonitor, LossMonitor
from testbed.sim.vehicles import JsbsimVehicles
from testbed.vehicle.fleet import JsbsimFleet

PARTS: Mapping[str, str] = {
    "physics": "steps of the flight models, with their inputs and motion",
    "properties": "conversion of inputs and motion, reading air data",
    "air": "wind at each aircraft",
    "sensing": "sensors and estimates",
    "autopilot": "fly-by-wire A, actuator faults",
    "network": "broadcast, loss, delay and delivery of messages",
    "leader": "guidance of the leader",
    "control": "formation law and middle loop",
    "events": "monitors: losses, limits, timeouts and message ages, faults, joining",
    "metrics": "the metrics of the run",
    "log": "the MCAP file",
    "loop": "schedule, and everything between the parts",
}

TIMED_METHODS: Mapping[str, Sequence[tuple[type, str]]] = {
    "physics": [(JsbsimFleet, "_run_models")],
    "properties": [
        (JsbsimFleet, name) for name in ("run", "read_air", "write_wind", "write_surfaces")
    ],
    "air": [(Air, "sample_wind"), (Air, "active_gusts")],
    "sensing": [(Estimators, "warm_up"), (Estimators, "estimate")],
    "autopilot": [(JsbsimVehicles, "autopilot_step"), (JsbsimVehicles, "apply_faults")],
    "network": [(Radio, name) for name in ("send", "deliver")],
    "leader": [(MissionController, "step")],
    "control": [(Control, "update_membership"), (Control, "step")],
    "events": [
        (LinkMonitor, "neighbour_changes"),
        (LinkMonitor, "leader_changes"),
        *(
            (monitor, "changes")
            for monitor in (
                *(LossMonitor, FaultManager),
                *(EnvelopeMonitor, GustMonitor, JoinMonitor),
            )
        ),
    ],
    "metrics": [(MetricsObserver, "observe")],
    "log": [(McapRecorder, "observe")],
}


class PartTimer(Observer):
    """Add up the time in each part, over flights that are built and flown in `timing()`."""

    zero_copy = True

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """Start at zero; successive flights add up."""
        self._clock = clock
        self._spent = dict.fromkeys(PARTS, 0.0)
        self._part, self._since = "loop", 0.0
        self._flying = False  # building a simulation also calls timed methods

    @contextmanager
    def timing(self) -> Iterator[None]:
        """Time the methods inside this context."""
        before = [
            (kind, name, getattr(kind, name))
            for each in TIMED_METHODS.values()
            for kind, name in each
        ]
        try:
            for part, methods in TIMED_METHODS.items():
                for kind, name in methods:
                    setattr(kind, name, self._timed(part, getattr(kind, name)))
            yield
        finally:
            for kind, name, function in before:
                setattr(kind, name, function)

    def begin(self, info: RunInfo) -> None:
        """Start timing."""
        self._since, self._flying = self._clock(), True

    def observe(self, sample: Sample) -> None:
        """Do nothing."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Stop timing."""
        self._enter("loop")
        self._flying = False

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the time, by part."""
        whole = sum(self._spent.values())
        return {part: spent / whole for part, spent in self._spent.items()}

    def _enter(self, part: str) -> str:
        """Enter a part; return the one before."""
        now, before = self._clock(), self._part
        if self._flying:
            self._spent[before] += now - self._since
        self._part, self._since = part, now
        return before

    def _timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - as the function
            before = self._enter(part)
            try:
                return function(*args, **kwargs)
            finally:
                self._enter(before)

        return timed
