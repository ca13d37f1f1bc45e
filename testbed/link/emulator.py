"""The loop that carries packets between two ends as the channel of a run would.

One `select` waits for both ends and for the next arrival. A packet's transmission time is the
system's time stamp of its receipt, so that a loop that wakes up late delays no packet twice.
"""

from __future__ import annotations

import ctypes
import heapq
import math
import select
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from testbed.link.end_positions import EndPositions
from testbed.link.ends import End
from testbed.link.frame_cutter import (
    StreamCutter,
    Unit,
    cut_datagram,
    find_frames,
    load_messages,
)
from testbed.link.link_settings import LinkSettings
from testbed.link.message_counts import Durations, MessageCounts
from testbed.link.packet_capture import EndCapture
from testbed.mavlink.codec import Codec
from testbed.network.links import PacketOutcome
from testbed.network.single_link import SingleLink

SECOND_NS = 1_000_000_000
WAIT_S = 0.2  # longest wait, after which a request to stop is noticed
READ_AT_ONCE, READ_NS = 64, 1_000_000  # pieces of an end, and time, before arrivals are looked at
SILENCE_NS = 50_000_000  # of a line, after which the begin of a frame waits no longer
MAX_ON_WAY, MAX_BYTES_ON_WAY = 200_000, 1 << 26  # packets and bytes; more are dropped
# Every half second a SiK radio sends RADIO_STATUS to its own serial line, from this system and
# component, if MAVLink has passed since the last.
REPORT_NS, RADIO_SYSTEM, RADIO_COMPONENT = SECOND_NS // 2, 51, 68
NOT_KNOWN = 255  # in RADIO_STATUS
_SET_TIMER_SLACK = 29  # of prctl: how late the system may wake a process, ns
_ENDS = 0, 1


class Progress(NamedTuple):
    """Packets of one direction up to now."""

    offered: int
    lost: int
    on_way: int


class _Packet(NamedTuple):
    """A copy of a packet on its way; sorted by arrival."""

    due_ns: int
    serial: int
    sender: int  # end
    number: int
    data: bytes


class _Direction:
    """What one end sends."""

    def __init__(self, settings: LinkSettings, sender: int) -> None:
        names = settings.names
        self.link = SingleLink(
            settings.network,
            names[sender],
            names[1 - sender],
            settings.seed,
            in_order=settings.frames,
        )
        self.counts, self.latest_s = MessageCounts(), 0.0
        self.offered = self.lost = self.on_way = self.corrupted = self.overflow = 0


class LinkEmulator:
    """Carry packets between two open ends.

    Args:
        settings: of the link.
        ends: of which it takes the packets.
        streams: whether each end is a line of bytes.
        captures: what records at each end.

    Raises:
        InputError: a file that the network names cannot be used.
    """

    def __init__(
        self,
        settings: LinkSettings,
        ends: tuple[End, End],
        streams: tuple[bool, bool],
        captures: Sequence[EndCapture] = (),
    ) -> None:
        """Prepare the kernels; nothing is received before `run`."""
        self._settings, self._ends, self._captures = settings, ends, tuple(captures)
        self._directions = tuple(_Direction(settings, end) for end in _ENDS)
        self._cutters = [StreamCutter() if each else None for each in streams]
        self._positions = EndPositions(settings.positions)
        self._fades = any(each.link.fades for each in self._directions)
        self._set_positions()
        self._radio = Codec(RADIO_SYSTEM, RADIO_COMPONENT) if settings.radio else None
        self._has_mavlink = [False, False]  # since the last report, sent by each end
        self._reports = 0
        self._queue: list[_Packet] = []
        self._bytes_on_way = self._serial = 0
        self._late = Durations()
        self._fed_ns = [0, 0]  # when a line was last read
        self._begin_ns = self._end_ns = 0  # of the first `run`
        self._used_s = 0.0
        load_messages()  # not when the first packet waits

    def run(
        self,
        stop: Callable[[], bool],
        *,
        duration_s: float = math.inf,
        progress: Callable[[Sequence[Progress]], None] | None = None,
    ) -> None:
        """Carry packets until a stop is requested or the time is over.

        Times of the network count from the first call.

        Args:
            stop: called at least every 0.2 s; true ends it.
            duration_s: wall-clock time, s.
            progress: called every second with both directions, that of the first end first.

        Raises:
            ExternalProgramLost: a serial device is gone.
        """
        _wake_up_on_time()
        begun_s = time.process_time()
        now_ns = time.monotonic_ns()
        self._begin_ns = self._begin_ns or now_ns
        limit_ns = now_ns + duration_s * SECOND_NS
        report_ns, shown_ns = now_ns + REPORT_NS, now_ns + SECOND_NS
        try:
            while not stop() and now_ns < limit_ns:
                self._wait(now_ns, limit_ns)
                now_ns = time.monotonic_ns()
                if now_ns >= report_ns:
                    report_ns += REPORT_NS * (1 + (now_ns - report_ns) // REPORT_NS)
                    self._report(now_ns)
                if progress is not None and now_ns >= shown_ns:
                    shown_ns += SECOND_NS * (1 + (now_ns - shown_ns) // SECOND_NS)
                    progress(self.progress())
        finally:
            self._end_ns = time.monotonic_ns()
            self._used_s += time.process_time() - begun_s

    def progress(self) -> list[Progress]:
        """Return what both directions have carried."""
        return [Progress(each.offered, each.lost, each.on_way) for each in self._directions]

    def _wait(self, now_ns: int, limit_ns: float) -> None:
        """Wait for packets or for the next arrival, and handle them."""
        wait_ns = min(WAIT_S * SECOND_NS, limit_ns - now_ns)
        if self._queue:
            wait_ns = min(wait_ns, self._queue[0].due_ns - now_ns)
        if any(each is not None and each.is_waiting for each in self._cutters):
            wait_ns = min(wait_ns, SILENCE_NS)
        full = [end for end in self._ends if end.has_output]
        ready, writable, _ = select.select(self._ends, full, [], max(wait_ns / SECOND_NS, 0.0))
        self._deliver()  # what has arrived waits for nothing that has just been sent
        for end in writable:
            end.flush()
        for number in _ENDS:
            if self._ends[number] in ready:
                self._read(number)
                self._deliver()
            elif self._cutters[number] is not None:
                self._flush_line(number)
        self._deliver()

    def _read(self, end: int) -> None:
        """Take what an end has sent, for a while."""
        began_ns = time.monotonic_ns()
        offset_ns = began_ns - time.time_ns()
        cutter = self._cutters[end]
        for data, time_ns in self._ends[end].receive(READ_AT_ONCE):
            if self._captures:
                self._captures[end].record(time_ns, data, sent_here=True)
            now_ns = time.monotonic_ns()
            # a clock that was set meanwhile moves no packet by more than a second
            sent_ns = min(max(time_ns + offset_ns, now_ns - SECOND_NS), now_ns)
            if cutter is not None:
                self._fed_ns[end] = now_ns
                units = cutter.feed(data)
            elif self._settings.frames:
                units = cut_datagram(data)
            else:
                units = [Unit(data, tuple(find_frames(data)[0]))]
            for unit in units:
                self._offer(end, unit, sent_ns)
            if now_ns - began_ns > READ_NS:
                return

    def _flush_line(self, end: int) -> None:
        """Take the begin of a frame whose rest does not come."""
        cutter, now_ns = self._cutters[end], time.monotonic_ns()
        if cutter is not None and cutter.is_waiting and now_ns - self._fed_ns[end] >= SILENCE_NS:
            for unit in cutter.flush():
                self._offer(end, unit, now_ns)

    def _offer(self, end: int, unit: Unit, sent_ns: int) -> None:
        """Send a packet over the link."""
        direction, size = self._directions[end], len(unit.data)
        link = direction.link
        if unit.frames:
            self._has_mavlink[end] = True
            if self._fades and self._positions.read(end, unit):
                self._set_positions()
        sent_s = max((sent_ns - self._begin_ns) / SECOND_NS, direction.latest_s)
        direction.latest_s = sent_s
        outcome = link.send(sent_s, size)
        direction.offered += 1
        direction.lost += outcome != PacketOutcome.DELIVERED
        first_s = math.inf
        for arrival_s in link.arrivals_s.tolist():
            if arrival_s < math.inf:
                first_s = min(first_s, arrival_s)
                self._put_on_way(end, arrival_s, unit.data)
        if self._settings.frames:  # a wrong datagram is dropped by the checksum of UDP
            for copy, arrival_s in enumerate(link.corrupted_s.tolist()):
                if arrival_s < math.inf:
                    direction.corrupted += 1
                    self._put_on_way(end, arrival_s, link.damaged(unit.data, copy))
        direction.counts.add(unit.frames, size, outcome, first_s - sent_s)

    def _put_on_way(self, end: int, arrival_s: float, data: bytes) -> None:
        direction = self._directions[end]
        size = self._bytes_on_way + len(data)
        if len(self._queue) >= MAX_ON_WAY or size > MAX_BYTES_ON_WAY:
            direction.overflow += 1
            return
        self._bytes_on_way = size
        direction.on_way += 1
        self._serial += 1
        due_ns = self._begin_ns + int(arrival_s * SECOND_NS)
        packet = _Packet(due_ns, self._serial, end, direction.link.number, data)
        heapq.heappush(self._queue, packet)

    def _deliver(self) -> None:
        """Deliver the packets that have arrived."""
        queue = self._queue
        while queue and queue[0].due_ns <= time.monotonic_ns():
            packet = heapq.heappop(queue)
            receiver = 1 - packet.sender
            self._ends[receiver].send(packet.data)
            self._late.add((time.monotonic_ns() - packet.due_ns) / SECOND_NS)
            direction = self._directions[packet.sender]
            direction.on_way -= 1
            direction.link.receive(packet.number)
            self._bytes_on_way -= len(packet.data)
            if self._captures:
                self._captures[receiver].record(time.time_ns(), packet.data, sent_here=False)

    def _set_positions(self) -> None:
        for end, direction in enumerate(self._directions):
            if (places := self._positions.seen_from(end)) is not None:
                direction.link.set_positions(*places)

    def _report(self, now_ns: int) -> None:
        """Send RADIO_STATUS to the ends whose MAVLink has passed."""
        if self._radio is None:
            return
        now_s = (now_ns - self._begin_ns) / SECOND_NS
        for end in _ENDS:
            if not self._has_mavlink[end]:
                continue
            self._has_mavlink[end] = False
            frame = self._radio.pack(
                "RADIO_STATUS",
                rssi=NOT_KNOWN,
                remrssi=NOT_KNOWN,
                txbuf=int(100 * self._directions[end].link.free_share(now_s)),
                noise=NOT_KNOWN,
                remnoise=NOT_KNOWN,
                rxerrors=self._directions[1 - end].corrupted & 0xFFFF,
                fixed=0,
            )
            self._reports += 1
            self._ends[end].send(frame)
            if self._captures:
                self._captures[end].record(time.time_ns(), frame, sent_here=False)

    def summary(self) -> dict[str, Any]:
        """Return what passed, by direction, system and message, ready for JSON."""
        settings, seconds = self._settings, (self._end_ns - self._begin_ns) / SECOND_NS
        links: dict[str, dict[str, Any]] = {}
        for end, direction in enumerate(self._directions):
            found = dict(direction.link.summary())
            del found["age_s"]  # of content, which is not read
            links[settings.names[end]] = {
                settings.names[1 - end]: {
                    **found,
                    "rate_hz": direction.offered / seconds if seconds > 0.0 else None,
                    "on_way_at_end": direction.on_way,
                    "messages": direction.counts.summary(seconds),
                }
            }
        return {
            "ends": list(settings.names),
            "seed": settings.seed,
            "unit": "frames" if settings.frames else "datagrams",
            "radio": "sik" if settings.radio else None,
            "duration_s": seconds,
            "links": links,
            "positions": {
                "received": dict(zip(settings.names, self._positions.updates, strict=True)),
                "distance_m": self._positions.distance_m(),
            },
            "emulator": {
                "late_s": self._late.summary(),
                "processor_share": self._used_s / seconds if seconds > 0.0 else None,
                "radio_reports": self._reports,
                "unread": sum(end.unread for end in self._ends),
                "not_sent": sum(end.dropped for end in self._ends),
                "overflow": sum(each.overflow for each in self._directions),
            },
        }


def _wake_up_on_time() -> None:
    """Ask Linux to wake this thread at the time itself, not up to 50 µs later."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SET_TIMER_SLACK, 1, 0, 0, 0)
