"""Measure how a flight's time is divided among the parts of the simulation.

Stages of one part that follow each other are run and timed together; methods that stages of other
parts call, or that no stage calls, are replaced by timed ones. Time belongs to the innermost part
that runs; outside of all parts it is the loop's own. Timing has a cost, which is measured too.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from testbed.atmosphere.air import Atmosphere
from testbed.core.call_list import CallList
from testbed.core.records import Event, Observer, RunInfo, Sample
from testbed.flight import loop
from testbed.flight.stages import Stage
from testbed.flight.tick_loop import TickLoop
from testbed.metrics import MetricsObserver
from testbed.sensors.estimators import StateEstimators
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
    "log": "copies of samples, the MCAP file",
    "loop": "schedule, and everything between the parts",
}

# Every stage has a part: a stage without one is an error.
STAGES: Mapping[str, Sequence[str]] = {
    "physics": ["move to the next tick"],
    "properties": [
        "read the air of flight models",
        "give the wind to flight models",
        "give surfaces to models",
    ],
    "air": ["sample the wind"],
    "sensing": ["advance sensors and estimates", "estimate with the present errors"],
    "autopilot": ["fly by wire", "apply actuator faults"],
    "network": ["write messages", "send messages", "deliver messages"],
    "leader": ["guide the leader"],
    "control": ["respond to declared failures", "step law and middle loop"],
    "events": [
        "begin and end faults",
        "count message ages, find timeouts",
        "find timeouts of the leader",
        "find losses and encounters",
        "find gusts that reach aircraft",
        "find outages",
        "find joins",
        "find limits exceeded",
    ],
    "loop": [
        "copy the truth to the estimates",
        "send states to the companions",
        "guide aircraft commanded from outside",
        "steer ideal vehicles",
        "give commands to autopilots",
        "take commands from outside",
        "take commands",
        "give commands of the program to autopilots",
        "clear what the law reports of commanded followers",
        "collect messages of ArduPlanes",
        "write slots and errors",
        "find followers commanded from outside",
        "give events to observers",
        "give events and a sample to observers",
        "wait for the caller",
    ],
    "log": ["append a sample", "take a full block of samples"],
}
_PART_OF = {name: part for part, names in STAGES.items() for name in names}

TIMED_METHODS: Mapping[str, Sequence[tuple[type, str]]] = {
    "physics": [(JsbsimFleet, "_run_models")],
    "properties": [(JsbsimFleet, "run"), (JsbsimFleet, "read_air")],
    "air": [(Atmosphere, "active_gusts")],
    "sensing": [(StateEstimators, "warm_up")],
    "metrics": [(MetricsObserver, "take_block")],
}


def _run_all(stages: Sequence[Stage]) -> Callable[[float], None]:
    """Return a step that runs stages in order."""
    calls = CallList([each.call for each in stages])

    def run(now: float) -> None:
        number = calls.run(0, now)
        while number < len(stages):
            if (then := stages[number].then) is not None:
                then(now)
            number = calls.run(number + 1, now)

    return run


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
        """Time stages and methods inside this context."""
        timed: list[tuple[Any, str, Any]] = [(loop, "TickLoop", self._timed_loop)]
        timed += [
            (kind, name, self._timed(part, getattr(kind, name)))
            for part, methods in TIMED_METHODS.items()
            for kind, name in methods
        ]
        before = [(owner, name, getattr(owner, name)) for owner, name, _ in timed]
        try:
            for owner, name, function in timed:
                setattr(owner, name, function)
            yield
        finally:
            for owner, name, function in before:
                setattr(owner, name, function)

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

    def _timed_loop(self, stages: Sequence[Stage], *rest: Any) -> TickLoop:  # noqa: ANN401
        """Return a loop that runs and times those stages together that are due together."""
        groups = itertools.groupby(
            stages, key=lambda each: (_PART_OF[each.name], each.part, each.rate, each.group)
        )
        timed = []
        for (part, *_), group in groups:
            together = tuple(group)
            if together[0].name == loop.PAUSE:
                timed += together
                continue
            then = self._timed(part, _run_all(together))
            timed.append(replace(together[0], call=None, then=then))
        return TickLoop(timed, *rest)

    def _timed(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any, **kwargs: Any) -> Any:  # noqa: ANN401 - as the function
            before = self._enter(part)
            try:
                return function(*args, **kwargs)
            finally:
                self._enter(before)

        return timed
