"""Hold a run before each tick: for external programs, for real time, or to stop it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from testbed.core.errors import ExternalProgramLost, InputError
from testbed.flight.external_control import ExternalControl
from testbed.flight.schedule import TickActions
from testbed.scenario.fields import is_number
from testbed.scenario.validate import shown_value

if TYPE_CHECKING:
    from testbed.mavlink.server import MavlinkServer

_POLL_S = 0.1  # between two checks for a stop
_REPEAT_S = 0.5
_ANNOUNCE_S = 2.0  # of waiting, after which the user is informed


class TickGate:
    """Hold the loop before each tick until it may be flown.

    Args:
        control: of the aircraft whose commands lockstep waits for; None: no external commands.
        server: that receives them; None: no links.
        pacer: of the run; None: as fast as possible.
        stop: whether a stop was requested.
        announce: receives messages to the user during long waits.

    Attributes:
        each_tick: whether it is to be called before each tick; else there is only the stop.
    """

    def __init__(
        self,
        control: ExternalControl | None,
        server: MavlinkServer | None,
        pacer: RealTimePacer | None,
        stop: Callable[[], bool],
        announce: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._control, self._server, self._pacer, self._stop = control, server, pacer, stop
        self._announce = announce
        self.each_tick = not (control is None and server is None and pacer is None)
        self._sample_s: float | None = None

    def __call__(self, now: float, due: TickActions) -> bool:
        """Wait until the tick at `now`, s, may be flown; true: stop before it.

        Raises:
            ExternalProgramLost: no lockstep command came in time.
        """
        if not self.each_tick:
            return self._stop()
        if self._control is not None and self._sample_s is not None:
            self._control.expect_commands(self._sample_s)
        self._sample_s = now if due.log else None
        if self._pacer is not None:
            self._pacer.wait(now, lambda left: self._idle(left, now))
        if self._server is not None:
            self._server.poll(now)
        if self._control is not None:
            # at once, so that an answer takes effect at the same tick however early it came
            self._wait_for_commands(self._control, now)
            if self._server is not None:
                self._control.add_events(self._server.pop_events())
        return self._stop()

    def _idle(self, left: float, now: float) -> bool:
        """Wait for at most `left` s; return whether to go on waiting."""
        left = min(left, _POLL_S)
        if self._server is None:
            time.sleep(left)
        else:
            self._server.wait(left, now)
        return not self._stop()

    def _wait_for_commands(self, control: ExternalControl, now: float) -> None:
        start = repeated = time.monotonic()
        announced = False
        while (names := control.waiting) and self._server is not None and not self._stop():
            self._server.wait(_POLL_S, now)
            wall = time.monotonic()
            if wall - start > control.timeout_s:
                raise ExternalProgramLost(
                    f"{', '.join(names)}: no command came in {control.timeout_s:g} s of waiting at "
                    f"{now:g} s; in lockstep every ATTITUDE is answered with one command"
                )
            if not announced and wall - start > _ANNOUNCE_S:
                announced = True
                self._announce(f"{', '.join(names)}: the run waits at {now:g} s for a command")
            if wall - repeated > _REPEAT_S:
                repeated = wall
                self._server.repeat(now)


_MIN_RATE, _MAX_RATE = 1e-3, 1e6  # simulated s per s: a slower run looks as if it hung
_BIN_S = 1e-4  # of the histogram of delays
_WARM_UP_S = 0.2  # simulated; the first ticks of a first flight compile
_MAX_DELAY_S = 0.25  # after a longer one the schedule restarts, without catching up


def check_pace(name: str, pace: object) -> float:
    """Return the simulated seconds per second of a run in real time.

    Args:
        name: of the argument or option, as the error begins.
        pace: its value.

    Raises:
        InputError: it is no number from 0.001 to a million.
    """
    if isinstance(pace, float | int) and is_number(pace) and _MIN_RATE <= pace <= _MAX_RATE:
        return float(pace)
    shown = f"{pace:g}" if isinstance(pace, float) else shown_value(pace)
    raise InputError(
        f"{name} {shown}: write a number from {_MIN_RATE:g} to {_MAX_RATE:g}, as 1 for real time, "
        "or 0"
    )


class RealTimePacer:
    """Wait for the wall-clock time of each tick, and measure how late ticks are.

    The schedule starts after the first ticks. Small delays are caught up; after a long one the
    schedule restarts, because clients could not follow a run that catches up at full speed.
    """

    def __init__(self, rate: float, clock: Callable[[], float] = time.monotonic) -> None:
        """Keep this many simulated seconds per second.

        Raises:
            InputError: the rate is out of range.
        """
        self.rate, self._clock = check_pace("--pace", rate), clock
        self._first: tuple[float, float] | None = None  # simulated and wall-clock s
        self._schedule = (0.0, 0.0)
        self._last = (0.0, 0.0)
        self._bins = np.zeros(round(_MAX_DELAY_S / _BIN_S) + 1, dtype=np.int64)
        self._sum = self._max = 0.0

    def wait(self, now_s: float, idle: Callable[[float], bool]) -> None:
        """Wait until the tick at `now_s` is due.

        Args:
            now_s: simulated s.
            idle: called with the time left, s; may return earlier. False: the wait ends and that
                tick does not count.
        """
        wall = self._clock()
        if self._first is None:
            if now_s >= _WARM_UP_S:
                self._first = self._schedule = self._last = (now_s, wall)
            return
        due = self._schedule[1] + (now_s - self._schedule[0]) / self.rate
        while (left := due - wall) > 0.0:
            if not idle(left):
                return
            wall = self._clock()
        delay = wall - due
        if delay > _MAX_DELAY_S:
            self._schedule = (now_s, wall)
        self._bins[min(int(delay / _BIN_S), len(self._bins) - 1)] += 1
        self._sum += delay
        self._max = max(self._max, delay)
        self._last = (now_s, wall)

    def summary(self) -> Mapping[str, object]:
        """Return requested and achieved pace and the delays of ticks, ready for JSON."""
        first = self._first or (0.0, 0.0)
        wall = self._last[1] - first[1]
        count = int(self._bins.sum())
        rank = int(np.searchsorted(np.cumsum(self._bins), 0.99 * count)) + 1
        return {
            "requested": self.rate,
            "achieved": (self._last[0] - first[0]) / wall if wall > 0.0 else None,
            "late_s": {
                "mean": self._sum / count if count else 0.0,
                "p99": min(rank * _BIN_S, self._max),
                "max": self._max,
            },
        }
