"""Which room of the house a flight spends its time in.

The doors by which the loop enters the rooms are given a clock: from one crossing to the next, time
belongs to the room that is in. What is between rooms is the loop's own. The clocks cost some time
themselves, which is measured beside it.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from testbed.air.air import Air
from testbed.metrics import MetricsObserver
from testbed.network.radio import Radio
from testbed.record.recorder import McapRecorder
from testbed.sensing.estimators import Estimators
from testbed.sim.breakdowns import Breakdowns
from testbed.sim.casualties import Casualties
from testbed.sim.control import Control
from testbed.sim.hearing import Hearing
from testbed.sim.pilots import MissionPilot
from testbed.sim.vehicles import Flown
from testbed.sim.watch import Arrivals, Engagement, Slots, Speaker
from testbed.state import Event, Frame, Observer, RunInfo
from testbed.vehicle.fleet import JsbsimFleet

ROOMS: Mapping[str, str] = {
    "physics": "the flight models' own steps, setting their controls and reading their motion",
    "truth": "making what was read of the flight models the state, and what they say of the air",
    "air": "what blows where each aircraft is, and telling the flight models",
    "sensing": "sensors and estimates",
    "autopilot": "fly-by-wire A",
    "network": "sending, losing, delaying and delivering messages",
    "leader": "guidance of the leader",
    "control": "formation law and middle loop",
    "events": "what is watched for: losses, silences with ages of news, faults, engagement",
    "metrics": "true errors, and the numbers of the run",
    "log": "the MCAP file",
    "loop": "the clock, and what hands things from one room to the next",
}

DOORS: Mapping[str, Sequence[tuple[type, str]]] = {
    "physics": [(Flown, "step")],
    "truth": [(JsbsimFleet, "look"), (JsbsimFleet, "air")],
    "air": [(Air, "felt"), (Air, "gusts_inside"), (JsbsimFleet, "blow")],
    "sensing": [(Estimators, "estimate")],
    "autopilot": [(Flown, "act"), (Flown, "fail")],
    "network": [
        (Speaker, "says"),
        *((Radio, name) for name in ("send", "deliver", "counts")),
    ],
    "leader": [(MissionPilot, "command")],
    "control": [(Control, "learn"), (Control, "step")],
    "events": [
        (JsbsimFleet, "lost"),
        *((kind, "changes") for kind in (Casualties, Breakdowns)),
        *((Hearing, name) for name in ("changes", "silences")),
        *((kind, "changes") for kind in (Arrivals, Engagement)),
    ],
    "metrics": [(Slots, "state"), (MetricsObserver, "observe")],
    "log": [(McapRecorder, "observe")],
}


class Rooms(Observer):
    """Adds up the time in each room, of flights that are built and flown `within` it."""

    borrows = True

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        """Nothing was seen yet; flights one after the other add up."""
        self._clock = clock
        self._spent = dict.fromkeys(ROOMS, 0.0)
        self._in, self._since = "loop", 0.0
        self._flies = False  # while a world is built its parts are called, too

    @contextmanager
    def within(self) -> Iterator[None]:
        """Have the doors watched."""
        before = [
            (kind, name, getattr(kind, name)) for each in DOORS.values() for kind, name in each
        ]
        try:
            for room, doors in DOORS.items():
                for kind, name in doors:
                    setattr(kind, name, self._watched(room, getattr(kind, name)))
            yield
        finally:
            for kind, name, function in before:
                setattr(kind, name, function)

    def begin(self, info: RunInfo) -> None:
        """Begin to count."""
        self._since, self._flies = self._clock(), True

    def observe(self, frame: Frame) -> None:
        """Nothing."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Count no more."""
        self._cross("loop")
        self._flies = False

    @property
    def shares(self) -> dict[str, float]:
        """Of the time, by room."""
        whole = sum(self._spent.values())
        return {room: spent / whole for room, spent in self._spent.items()}

    def _cross(self, room: str) -> str:
        """Into a room; the one that is left."""
        now, before = self._clock(), self._in
        if self._flies:
            self._spent[before] += now - self._since
        self._in, self._since = room, now
        return before

    def _watched(self, room: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*given: Any, **named: Any) -> Any:  # noqa: ANN401 - as the function
            before = self._cross(room)
            try:
                return function(*given, **named)
            finally:
                self._cross(before)

        return watched
