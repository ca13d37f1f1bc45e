"""The place at which the companions of a run exchange their messages.

Each companion sends its FOLLOW_TARGET here. The radio of the run decides, by its network and seed,
which copy reaches which follower and when; that copy's bytes are then sent on as they came.

In lockstep a companion gets, for each sample, what its aircraft has received up to the time of the
sample, in one datagram with a mark at its end; it steps and answers after that. In real time each
copy is sent on when it arrives.
"""

from __future__ import annotations

import heapq
import math
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from testbed.core.records import Event, RunInfo, Sample
from testbed.flight.stages import UserStage
from testbed.flight.world import World
from testbed.mavlink.codec import Codec, Message
from testbed.mavlink.lockstep_messages import pack_mark, pack_receipt
from testbed.mavlink.udp_endpoint import LOOPBACK, Address, Endpoint, Peer, wait

COMPONENT = 191  # of a companion
SIMULTANEOUS_S = 1e-9  # times closer than this are equal
LATE_S = 1.0  # simulated; after it a frame that a companion has not sent is waited for no more
_HUB_SYSTEM, _HUB_COMPONENT = 255, 191
_MESSAGE, _GREETING = "FOLLOW_TARGET", "HEARTBEAT"
_MS = 1000


class CompanionHub:
    """Pass on the messages of companions, as an observer of a run that is served by its server.

    Attributes:
        listening: rows of the aircraft whose companions have sent something.
        watch: called with the time, s, wherever the hub is served; returns events of companions.
        counts: datagrams and frames.
    """

    def __init__(
        self,
        epoch_us: int,
        *,
        pace: float | None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the socket; nothing is sent before the first sample.

        Args:
            epoch_us: Unix time of the start of the run, whole ms, in µs.
            pace: simulated seconds per second; None: lockstep.
            clock: wall-clock time, s.

        Raises:
            InputError: no port is free.
        """
        self._endpoint = Endpoint(Address("udpin", LOOPBACK, 0), clock)
        self._epoch_us, self._pace, self._clock = epoch_us, pace, clock
        self.watch: Callable[[float], list[Event]] = lambda now_s: []
        self._events: list[Event] = []
        self._codec = Codec(_HUB_SYSTEM, _HUB_COMPONENT)
        self._peers: dict[int, Peer] = {}
        self._world: World | None = None
        # by row of the sender and time, ms
        self._frames: dict[tuple[int, int], bytes] = {}
        self._copies: Counter[tuple[int, int]] = Counter()  # on their way
        # arrival, s; order; follower; sender and time of the frame
        self._under_way: list[tuple[float, int, int, tuple[int, int]]] = []
        self._order = 0
        self._expected: set[int] = set()  # rows that broadcast at the newest control step
        self._step_ms, self._step_wall_s = -1, 0.0
        self._sample_ms = -1  # of the sample that companions answer; -1: none waits
        self._followers: set[int] = set()  # that get its mark
        self.counts: Counter[str] = Counter()

    @property
    def listening(self) -> set[int]:
        """Rows of the aircraft whose companions have sent something."""
        return set(self._peers)

    @property
    def address(self) -> str:
        """Its address on the command line of a companion."""
        return f"hub:{LOOPBACK}:{self._endpoint.port}"

    def stage(self, world: World) -> UserStage:
        """Return the stage of a flight that notes what its radio decides."""
        self._world = world
        return UserStage("pass on messages of companions", "send messages", self._note)

    def _note(self, now: float, records: object) -> None:
        """Note when the copies of the messages of this time, s, arrive."""
        assert self._world is not None, "a stage of its flight"
        radio = self._world.formation.radio
        self._step_ms, self._step_wall_s = round(now * _MS), self._clock()
        senders = radio.senders & ~radio.muted
        self._expected = {row for row, sends in enumerate(senders.tolist()) if sends}
        for arrival_s, follower, sender in radio.sent():
            key = sender, self._step_ms
            self._order += 1
            heapq.heappush(self._under_way, (arrival_s, self._order, follower + 1, key))
            self._copies[key] += 1

    def begin(self, info: RunInfo) -> None:
        """See `Observer`."""

    def observe(self, sample: Sample) -> None:
        """Begin to wait for the messages of a sample, which its companions now receive."""
        self._sample_ms = round(sample.time_s * _MS)
        frozen = None if sample.faults is None else sample.faults.frozen
        self._followers = {
            row for row in range(1, len(sample.lost)) if frozen is None or not frozen[row]
        }
        oldest_ms = self._sample_ms - _MS * LATE_S
        for key in [each for each in self._frames if each[1] < oldest_ms]:
            if not self._copies[key]:
                del self._frames[key]

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """See `Observer`."""

    def pop_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def fileno(self) -> int:
        """Return the file descriptor, for select."""
        return self._endpoint.fileno()

    def poll(self, now_s: float) -> bool:
        """Take messages of companions, and send on what is due; true: there was something."""
        self._events += self.watch(now_s)
        received = False
        for peer, data in self._endpoint.receive():
            received = True
            for message in self._codec.feed(data, datagram=True):
                self._take(message, peer)
        if self._pace is None:
            self._answer_sample()
        else:
            self._send_arrived(self._simulated_s())
        return received

    def due_s(self) -> float:
        """Return the wall-clock time until the next copy arrives, s."""
        if self._pace is None or not self._under_way:
            return math.inf
        left = (self._under_way[0][0] - self._simulated_s()) / self._pace
        return left if left > 0.0 else math.inf  # what waits for its frame is due with that

    def _simulated_s(self) -> float:
        """Return the simulated time by the wall clock, s."""
        elapsed_s = self._clock() - self._step_wall_s
        return self._step_ms / _MS + elapsed_s * (self._pace or 0.0)

    def _take(self, message: Message, peer: Peer) -> None:
        row = message.system - 1
        if message.component != COMPONENT:
            return
        self._peers[row] = peer
        if message.name == _MESSAGE:
            time_ms = int(message.number("timestamp")) - self._epoch_us // _MS
            self._frames[row, time_ms] = message.frame
            self.counts["received"] += 1

    def _answer_sample(self) -> None:
        """In lockstep send what has arrived up to the sample, once all of its messages are here."""
        time_ms = self._sample_ms
        if time_ms < 0:
            return
        if time_ms == self._step_ms:
            if any((row, time_ms) not in self._frames for row in self._expected):
                return
        self._sample_ms = -1
        parts: dict[int, list[bytes]] = {row: [] for row in self._followers}
        latest_s = time_ms / _MS + SIMULTANEOUS_S
        while self._under_way and self._under_way[0][0] <= latest_s:
            arrival_s, _, follower, key = heapq.heappop(self._under_way)
            frame = self._take_copy(key)
            if frame is not None and follower in parts:
                parts[follower] += pack_receipt(self._codec, arrival_s), frame
        mark = pack_mark(self._codec, time_ms, self._epoch_us + time_ms * _MS)
        for row, frames in parts.items():
            self._send(row, b"".join((*frames, mark)))

    def _send_arrived(self, now_s: float) -> None:
        """In real time send copies that have arrived and whose frames are here."""
        waiting = []
        while self._under_way and self._under_way[0][0] <= now_s:
            copy = heapq.heappop(self._under_way)
            arrival_s, _, follower, key = copy
            if key in self._frames:
                frame = self._take_copy(key)
                assert frame is not None, "it is here"
                self._send(follower, frame)
            elif arrival_s > now_s - LATE_S:
                waiting.append(copy)
            else:
                self._take_copy(key)
                self.counts["missing"] += 1
        for copy in waiting:
            heapq.heappush(self._under_way, copy)

    def _take_copy(self, key: tuple[int, int]) -> bytes | None:
        """Return the frame of a copy, and forget it after the last one."""
        self._copies[key] -= 1
        if self._copies[key] > 0:
            return self._frames.get(key)
        del self._copies[key]
        return self._frames.pop(key, None)

    def _send(self, row: int, data: bytes) -> None:
        if (peer := self._peers.get(row)) is not None:
            self._endpoint.reply(peer, data)
            self.counts["sent"] += 1

    def wait_for_greetings(self, seconds: float) -> None:
        """Take what companions send before the flight, waiting at most this time, s."""
        wait([self._endpoint], seconds)
        self.poll(0.0)

    def close(self) -> None:
        """Close the socket."""
        self._endpoint.close()
