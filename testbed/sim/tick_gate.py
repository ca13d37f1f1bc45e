"""Between two ticks: serve MAVLink, keep the pace, wait for lockstep commands."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Protocol

from testbed.core.errors import ExternalProgramLost
from testbed.core.records import Event
from testbed.sim.external_control import ExternalControl
from testbed.sim.pacing import RealTimePacer
from testbed.sim.schedule import TickActions

_POLL_S = 0.1  # between two checks for a stop
_REPEAT_S = 0.5
_ANNOUNCE_S = 2.0  # of waiting, after which the user is informed


class Server(Protocol):
    """The server that external programs connect to, as `mavlink.server.MavlinkServer`."""

    def poll(self, now_s: float) -> None:
        """Receive and answer the messages that are there."""

    def wait(self, seconds: float, now_s: float) -> None:
        """Receive and answer messages for as long, or until one has come."""

    def pop_events(self) -> Sequence[Event]:
        """Return the events since the last call."""

    def repeat(self, now_s: float) -> None:
        """Send the latest state again, as it may have been lost."""


class TickGate:
    """Hold the loop before each tick until it may be flown.

    Args:
        control: of the aircraft whose commands lockstep waits for; None: no external commands.
        server: that receives them; None: no links.
        pacer: of the run; None: as fast as possible.
        stop: whether a stop was requested.
        announce: receives messages to the user during long waits.
    """

    def __init__(
        self,
        control: ExternalControl | None,
        server: Server | None,
        pacer: RealTimePacer | None,
        stop: Callable[[], bool],
        announce: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Start before the first tick."""
        self._control, self._server, self._pacer, self._stop = control, server, pacer, stop
        self._announce = announce
        self._open = control is None and server is None and pacer is None
        self._sample_s: float | None = None

    def __call__(self, now: float, due: TickActions) -> bool:
        """Wait until the tick at `now`, s, may be flown; true: stop before it.

        Raises:
            ExternalProgramLost: no lockstep command came in time.
        """
        if self._open:
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
