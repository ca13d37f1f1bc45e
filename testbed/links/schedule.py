"""When each message is due, in simulation time."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from testbed.links.catalogue import CATALOGUE, HEARTBEAT, STATE, Stream
from testbed.mavlink.door import number

OFF = -1  # instead of an interval, as in MESSAGE_INTERVAL
_LONGEST_US = (1 << 31) - 1


@functools.cache
def numbers() -> Mapping[int, str]:
    """The messages of the catalogue by MAVLink's numbers."""
    return {number(f"MAVLINK_MSG_ID_{name}"): name for name in CATALOGUE}


class Schedule:
    """How often one vehicle says what.

    A message goes out with a frame, so that none is more frequent than frames are.
    """

    def __init__(self, frame_rate_hz: float, *, lockstep: bool) -> None:
        """Begin with the usual rates, all due at once; in lockstep every frame has the state."""
        self._shortest_us = round(1e6 / frame_rate_hz)
        self._always = frozenset(STATE if lockstep else ())
        self._intervals = {name: self._usual(name) for name in CATALOGUE}
        self._next = {name: 0 for name, every in self._intervals.items() if every != OFF}

    def due(self, time_s: float) -> list[str]:
        """What is to be said with the frame of this time."""
        now = round(time_s * 1e6)
        found = []
        for name in CATALOGUE:  # in its order
            when = self._next.get(name)
            if name in self._always:
                found.append(name)
            elif when is not None and when <= now:
                found.append(name)
                every = self._intervals[name]
                # the mean rate is kept where frames do not fall on multiples of the interval
                self._next[name] = when + every if when + every > now else now + every
        return found

    def interval_us(self, name: str) -> int:
        """From one to the next, µs; `OFF`: never."""
        return self._shortest_us if name in self._always else self._intervals[name]

    def set_interval(self, name: str, interval_us: float) -> None:
        """Say it this often from the next frame on; negative: never, 0: as usual, µs.

        The heartbeat stays as it is, without which a vehicle is not there, and so does what
        lockstep needs.
        """
        if name == HEARTBEAT or name in self._always:
            return
        if interval_us < 0:
            self._intervals[name] = OFF
            self._next.pop(name, None)
            return
        every = round(interval_us) if interval_us > 0 else self._usual(name)
        if every == OFF:
            self.set_interval(name, OFF)
            return
        self._intervals[name] = min(max(every, self._shortest_us), _LONGEST_US)
        self._next[name] = 0

    def set_stream(self, stream: int, rate_hz: float) -> None:
        """Say all of a group this often; 0: never. A group that is not there changes nothing."""
        for name, entry in CATALOGUE.items():
            if entry.stream is not None and stream in (Stream.ALL, entry.stream):
                self.set_interval(name, 1e6 / rate_hz if rate_hz > 0.0 else OFF)

    def _usual(self, name: str) -> int:
        rate = CATALOGUE[name].rate_hz
        return max(round(1e6 / rate), self._shortest_us) if rate > 0.0 else OFF
