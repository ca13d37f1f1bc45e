"""Which room of the house a flight spends its time in.

A timer interrupts the flight every millisecond and looks at what is being done: the innermost
function that belongs to a room counts. So nothing of the flight is wrapped or changed, and what the
looking costs is measured beside it. Compiled functions count for who called them.
"""

from __future__ import annotations

import functools
import signal
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import testbed
from testbed.state import Event, Frame, Observer, RunInfo

EVERY_S = 0.00097  # no whole part of any period of the flight
HOME = Path(testbed.__file__).parent

ROOMS: Mapping[str, str] = {
    "physics": "the flight models' own steps, and setting their controls",
    "truth": "reading the flight models",
    "air": "what blows where each aircraft is, and telling the flight models",
    "sensing": "sensors and estimates",
    "autopilot": "fly-by-wire A",
    "network": "sending, losing, delaying and delivering messages",
    "leader": "guidance of the leader",
    "control": "formation law and middle loop",
    "events": "what is watched for: losses, silences, faults, engagement",
    "metrics": "true errors, and the numbers of the run",
    "log": "the MCAP file",
    "loop": "the clock, and what hands things from one room to the next",
}

# Of what is in a folder, or in a file of it, before its folder.
_PLACES: Mapping[str, str] = {
    "air": "air",
    "formation": "control",
    "guidance": "leader",
    "metrics": "metrics",
    "network": "network",
    "record": "log",
    "sensing": "sensing",
    "sim": "loop",
    "sim/airs.py": "air",
    "sim/breakdowns.py": "events",
    "sim/casualties.py": "events",
    "sim/control.py": "control",
    "sim/deck.py": "leader",
    "sim/failures.py": "events",
    "sim/limits.py": "events",
    "sim/middle_loops.py": "control",
    "sim/navigator.py": "leader",
    "sim/own_law.py": "control",
    "sim/pilots.py": "leader",
    "sim/radios.py": "network",
    "sim/watch.py": "events",
    "vehicle": "physics",
    "vehicle/fbwa.py": "autopilot",
}
# What one file does for several rooms, by names of its functions.
_DEEDS: Mapping[str, Mapping[str, str]] = {
    "sim/watch.py": {"broadcast": "network", "formation_state": "metrics"},
    **dict.fromkeys(
        ("sim/vehicles.py", "vehicle/jsbsim_door.py", "vehicle/jsbsim_model.py"),
        {
            "step": "physics",
            "read": "truth",
            "air": "truth",
            "lost": "events",
            "blow": "air",
            "act": "autopilot",
            "fail": "autopilot",
        },
    ),
}


class Rooms(Observer):
    """Counts in which rooms a flight is found. In the main thread only."""

    borrows = True

    def __init__(self) -> None:
        """Nothing was seen yet; flights one after the other add up."""
        self._found: Counter[str] = Counter()

    def begin(self, info: RunInfo) -> None:
        """Begin to look."""
        self._before = signal.signal(signal.SIGALRM, self._look)
        signal.setitimer(signal.ITIMER_REAL, EVERY_S, EVERY_S)

    def observe(self, frame: Frame) -> None:
        """Nothing."""

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Look no more."""
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, self._before)

    @property
    def shares(self) -> dict[str, float]:
        """Of the time, by room."""
        return {room: self._found[room] / self._found.total() for room in ROOMS}

    def _look(self, number: int, frame: FrameType | None) -> None:
        room = None
        while frame is not None and room is None:
            room, frame = room_of(frame.f_code), frame.f_back
        self._found[room or "loop"] += 1


@functools.cache
def room_of(code: CodeType) -> str | None:
    """The room that a function belongs to; None: whoever called it knows."""
    file = Path(code.co_filename)
    if not file.is_relative_to(HOME):
        return None
    place = file.relative_to(HOME).as_posix()
    deeds = _DEEDS.get(place)
    if deeds is None:
        return _PLACES.get(place) or _PLACES.get(place.partition("/")[0])
    known = (deeds[name] for name in code.co_qualname.split(".") if name in deeds)
    return next(known, _PLACES.get(place))
