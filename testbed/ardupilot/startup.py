"""Startup of an ArduPlane: the requests from its boot until it flies in fly-by-wire A."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

from testbed.ardupilot.json_physics import (
    LIMITS,
    RC_MAPS,
    SERVO_FUNCTIONS,
    RcChannels,
    ServoOutputs,
    make_rc_channels,
    make_servo_outputs,
    range_names,
)
from testbed.ardupilot.sitl_mavlink import FBWA, SitlMavlinkClient
from testbed.core.records import FbwaCommand

_STAGE_TIMEOUT_S = 40.0  # of its own time, for each stage
_RC_TIMEOUT_S = 3.0  # until its receiver shows our pulses; after it, RC is overridden
_VERSION_TIMEOUT_S = 3.0  # after it, it is flown without a known version
_REPEAT_S = 0.5  # between two equal requests
_START_PERIOD_S = 2.0  # the flight starts at a multiple of this, as boots differ by some ticks
_BATCH = 10  # parameters per request; ArduPlane queues 20
_REPLY_TICKS, _REPLY_S = 5, 0.01  # ticks after a request, and wall-clock wait for a reply in each


class StartupSequence:
    """Bring an ArduPlane from its boot to fly-by-wire A, armed and receiving RC.

    Attributes:
        rc_channels: its RC channels, once known.
        servo_outputs: its servo outputs, once known.
        pulses: of the RC channels, µs, once known.
        overrides: whether RC is overridden over MAVLink, because it ignores RC of the physics
            link.
        failure: why startup failed; None: it has not.
    """

    def __init__(
        self,
        client: SitlMavlinkClient,
        physics_hz: int,
        elevon_mixing: float,
        command: FbwaCommand[float],
    ) -> None:
        """Start at the boot.

        Args:
            client: connected to the ArduPlane.
            physics_hz: ticks per second of its time.
            elevon_mixing: of the airframe; NaN where it has none.
            command: during startup.
        """
        self._client, self._hz, self._mixing = client, physics_hz, elevon_mixing
        self._command = command
        self._ticks = 0
        self.rc_channels: RcChannels | None = None
        self.servo_outputs: ServoOutputs | None = None
        self.pulses: tuple[int, ...] | None = None
        self.overrides = False
        self.failure: str | None = None

    def steps(self) -> Iterator[float]:
        """Make the requests between ticks; yields the time to wait for replies, wall-clock s."""
        for wait_s in self._stages():
            self._ticks += 1
            yield wait_s

    def _stages(self) -> Iterator[float]:
        client = self._client
        request_version = partial(client.request_message, "AUTOPILOT_VERSION")
        request_rc = partial(client.request_message, "RC_CHANNELS")
        yield from self._require("sends no heartbeat", lambda: client.mode is not None)
        yield from self._wait(
            lambda: client.version is not None, request_version, _VERSION_TIMEOUT_S
        )
        yield from self._fetch((*RC_MAPS, *LIMITS, *SERVO_FUNCTIONS))
        yield from self._fetch(range_names(client.parameters))
        self.rc_channels = make_rc_channels(client.parameters)
        self.servo_outputs = make_servo_outputs(client.parameters, self._mixing)
        self.pulses = self.rc_channels.pulses(self._command)
        yield from self._require("does not arm", lambda: client.armed, client.arm)
        yield from self._require(
            "does not change to fly-by-wire A",
            lambda: client.mode == FBWA,
            lambda: client.change_mode(FBWA),
        )
        yield from self._wait(self._receives_rc, request_rc, _RC_TIMEOUT_S)
        if not self._receives_rc():
            self.overrides = True
            yield from self._require(
                "receives neither rc nor overrides", self._receives_rc, request_rc
            )
        while self._ticks % round(_START_PERIOD_S * self._hz):
            yield 0.0

    def _fetch(self, names: Sequence[str]) -> Iterator[float]:
        for k in range(0, len(names), _BATCH):
            yield from self._fetch_batch(names[k : k + _BATCH])

    def _fetch_batch(self, names: Sequence[str]) -> Iterator[float]:
        client = self._client

        def missing() -> list[str]:
            return [name for name in names if name not in client.parameters]

        yield from self._wait(
            lambda: not missing(), lambda: client.request_parameters(missing()), _STAGE_TIMEOUT_S
        )
        if left := missing():
            yield from self._fail(
                f"does not send its {', '.join(left)} (ArduPlane has these names since 4.5)"
            )

    def _require(
        self, failure: str, done: Callable[[], bool], request: Callable[[], None] | None = None
    ) -> Iterator[float]:
        yield from self._wait(done, request, _STAGE_TIMEOUT_S)
        if not done():
            yield from self._fail(f"{failure} in {_STAGE_TIMEOUT_S:g} s of its time")

    def _wait(
        self, done: Callable[[], bool], request: Callable[[], None] | None, timeout_s: float
    ) -> Iterator[float]:
        """Repeat a request until a condition holds, for at most this time of ArduPlane, s."""
        period = round(_REPEAT_S * self._hz)
        for tick in range(round(timeout_s * self._hz)):
            if done():
                return
            since = tick % period
            if request is not None and since == 0:
                request()
            yield _REPLY_S if request is not None and since < _REPLY_TICKS else 0.0

    def _fail(self, reason: str) -> Iterator[float]:
        texts = [text for _, text in self._client.texts[-5:]]
        self.failure = f"{reason}; its messages: {' | '.join(texts)}" if texts else reason
        yield 0.0

    def _receives_rc(self) -> bool:
        """Check whether its receiver shows our pulses, within 1 µs of truncation."""
        received, sent = self._client.rc_channels, self.pulses or ()
        return len(received) >= len(sent) > 0 and all(
            abs(pulse - expected) <= 1 for pulse, expected in zip(received, sent, strict=False)
        )
