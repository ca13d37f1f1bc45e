"""From an ArduPlane that boots to one that flies by wire: what is asked of it, in which order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from testbed.ardupilot.channels import (
    FUNCTIONS,
    LIMITS,
    MAPS,
    Outputs,
    Sticks,
    make_outputs,
    make_sticks,
    ranges_needed,
)
from testbed.ardupilot.station import FBWA, Station

_STAGE_S = 40.0  # of its own time, for each thing that is asked
_RECEIVER_S = 3.0  # for its receiver to show what we send; else it takes no rc there
_VERSION_S = 3.0  # for saying which it is; one that does not is flown all the same
_AGAIN_S = 0.5  # between askings
_SETTLED_S = 2.0  # the flight begins at a multiple of this: boots differ by some ticks
_AT_ONCE = 10  # parameters; ArduPlane keeps a queue of 20 requests
_HEED, _REPLY_S = 5, 0.01  # ticks after asking in which time stands still for a reply, and how long


class Bringing:
    """What is known of an ArduPlane while it is brought up.

    Attributes:
        sticks: how it is told, once that is known.
        outputs: what it moves.
        pulses: of the receiver, µs, once they are known.
        overrides: its receiver is overridden over MAVLink, because the physics link has no say.
        failed: why it does not get ready; None: it may.
    """

    def __init__(
        self,
        station: Station,
        physics_hz: int,
        elevon_mixing: float,
        command: tuple[float, float, float],
    ) -> None:
        """Nothing is known."""
        self._station, self._hz, self._mixing = station, physics_hz, elevon_mixing
        self._command = command
        self._ticks = 0
        self.sticks: Sticks | None = None
        self.outputs: Outputs | None = None
        self.pulses: tuple[int, ...] | None = None
        self.overrides = False
        self.failed: str | None = None

    def steps(self) -> Iterator[float]:
        """Between the ticks of its boot; yields how long to listen before the next, s."""
        for wait_s in self._stages():
            self._ticks += 1
            yield wait_s

    def _stages(self) -> Iterator[float]:
        station = self._station
        yield from self._until("sends no heartbeat", lambda: station.mode is not None)
        yield from self._wait(lambda: station.version is not None, station.ask_version, _VERSION_S)
        yield from self._fetch((*MAPS, *LIMITS, *FUNCTIONS))
        yield from self._fetch(ranges_needed(station.parameters))
        self.sticks = make_sticks(station.parameters)
        self.outputs = make_outputs(station.parameters, self._mixing)
        self.pulses = self.sticks.pulses(*self._command)
        yield from self._until("does not arm", lambda: station.armed, station.arm)
        yield from self._until(
            "does not change to fly-by-wire A",
            lambda: station.mode == FBWA,
            lambda: station.change_mode(FBWA),
        )
        yield from self._wait(self._hears_us, station.ask_receiver, _RECEIVER_S)
        if not self._hears_us():
            self.overrides = True
            yield from self._until(
                "hears neither rc nor overrides", self._hears_us, station.ask_receiver
            )
        while self._ticks % round(_SETTLED_S * self._hz):
            yield 0.0

    def _fetch(self, names: Sequence[str]) -> Iterator[float]:
        """Have these parameters."""
        for k in range(0, len(names), _AT_ONCE):
            yield from self._fetch_some(names[k : k + _AT_ONCE])

    def _fetch_some(self, names: Sequence[str]) -> Iterator[float]:
        station = self._station

        def missing() -> list[str]:
            return [name for name in names if name not in station.parameters]

        yield from self._wait(
            lambda: not missing(), lambda: station.ask_parameters(missing()), _STAGE_S
        )
        if left := missing():
            yield from self._fail(
                f"does not tell its {', '.join(left)} (ArduPlane has these names since 4.5)"
            )

    def _until(
        self, else_it: str, done: Callable[[], bool], ask: Callable[[], None] | None = None
    ) -> Iterator[float]:
        yield from self._wait(done, ask, _STAGE_S)
        if not done():
            yield from self._fail(f"{else_it} in {_STAGE_S:g} s of its time")

    def _wait(
        self, done: Callable[[], bool], ask: Callable[[], None] | None, most_s: float
    ) -> Iterator[float]:
        again = round(_AGAIN_S * self._hz)
        for tick in range(round(most_s * self._hz)):
            if done():
                return
            since = tick % again
            if ask is not None and since == 0:
                ask()
            yield _REPLY_S if ask is not None and since < _HEED else 0.0

    def _fail(self, why: str) -> Iterator[float]:
        said = [text for _, text in self._station.said[-5:]]
        self.failed = f"{why}; it said: {' | '.join(said)}" if said else why
        yield 0.0

    def _hears_us(self) -> bool:
        """Whether its receiver shows our pulses; what it cuts off may be 1 µs."""
        heard, sent = self._station.receiver, self.pulses or ()
        return len(heard) >= len(sent) > 0 and all(
            abs(got - told) <= 1 for got, told in zip(heard, sent, strict=False)
        )
