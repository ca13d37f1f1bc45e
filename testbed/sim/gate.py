"""Between two ticks: programs outside are heard, the pace is kept, a stop is heeded."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Protocol

from testbed.errors import PartnerLost
from testbed.sim.clock import Due
from testbed.sim.deck import Deck
from testbed.sim.pace import Pace
from testbed.state import Event

_SLICE_S = 0.1  # how long a stop may go unheard
_REPEAT_S = 0.5
_LONG_S = 2.0  # of waiting, after which people are told


class Hears(Protocol):
    """A station that programs outside speak to."""

    def poll(self, now_s: float) -> None:
        """Hear and answer what has come."""

    def wait(self, seconds: float, now_s: float) -> None:
        """Hear and answer what comes until then, or sooner."""

    def news(self) -> Sequence[Event]:
        """What has happened since the last call."""

    def repeat(self, now_s: float) -> None:
        """Send the last states again: a program may have missed them."""


class Gate:
    """Lets the loop on to each tick.

    Args:
        deck: whose commands lockstep waits for; None: nobody's.
        station: that hears them; None: nobody speaks.
        pace: to keep; None: as fast as it flies.
        stop: whether the run is to end.
        tell: is given what people should know of a long wait.
    """

    def __init__(
        self,
        deck: Deck | None,
        station: Hears | None,
        pace: Pace | None,
        stop: Callable[[], bool],
        tell: Callable[[str], None] = lambda text: None,
    ) -> None:
        """Nothing has been flown yet."""
        self._deck, self._station, self._pace, self._stop = deck, station, pace, stop
        self._tell = tell
        self._alone = deck is None and station is None and pace is None
        self._framed_s: float | None = None

    def __call__(self, now: float, due: Due) -> bool:
        """Return when the tick at `now`, s, may be flown; true: the run ends before it.

        Raises:
            PartnerLost: lockstep has waited in vain.
        """
        if self._alone:
            return self._stop()
        if self._deck is not None and self._framed_s is not None:
            self._deck.ask(self._framed_s)
        self._framed_s = now if due.log else None
        if self._pace is not None:
            self._pace.wait(now, lambda left: self._idle(left, now))
        if self._station is not None:
            self._station.poll(now)
        if self._deck is not None:
            # at once, so that an answer counts from the same tick on however soon it came
            self._wait(self._deck, now)
            if self._station is not None:
                self._deck.report(self._station.news())
        return self._stop()

    def _idle(self, left: float, now: float) -> bool:
        """Wait for as long, or a while of it; whether to go on waiting."""
        left = min(left, _SLICE_S)
        if self._station is None:
            time.sleep(left)
        else:
            self._station.wait(left, now)
        return not self._stop()

    def _wait(self, deck: Deck, now: float) -> None:
        begun = repeated = time.monotonic()
        told = False
        while (names := deck.waiting) and self._station is not None and not self._stop():
            self._station.wait(_SLICE_S, now)
            wall = time.monotonic()
            if wall - begun > deck.patience_s:
                raise PartnerLost(
                    f"{', '.join(names)}: no command came in {deck.patience_s:g} s of waiting at "
                    f"{now:g} s; in lockstep every ATTITUDE is answered with one command"
                )
            if not told and wall - begun > _LONG_S:
                told = True
                self._tell(f"{', '.join(names)}: the run waits at {now:g} s for a command")
            if wall - repeated > _REPEAT_S:
                repeated = wall
                self._station.repeat(now)
