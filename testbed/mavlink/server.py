"""MAVLink server: all aircraft of a run as vehicles for external programs."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from testbed.core.errors import InputError
from testbed.core.records import Event, NedOrigin, RunInfo, Sample
from testbed.mavlink.codec import Codec, Message
from testbed.mavlink.outgoing import OutgoingMessage
from testbed.mavlink.signing import MessageSigner, Signing, signing_time
from testbed.mavlink.telemetry_messages import ATTITUDE
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.tlog import TlogWriter
from testbed.mavlink.udp_endpoint import Address, Endpoint, HasFileno, Peer, link_addresses, wait
from testbed.mavlink.vehicle import COMPONENT, MavlinkVehicle
from testbed.mavlink.vehicle_control import VehicleControl

MAX_PACKET_BYTES = 1200  # of frames in one datagram


class MavlinkLink:
    """Combine frames into datagrams, and store received messages until they are handled.

    Attributes:
        endpoint: the socket.
        rows: of the aircraft that use this link.
        codec: parses received datagrams.
        unhandled: received messages, in order.
    """

    def __init__(self, endpoint: Endpoint, rows: Sequence[int], codec: Codec) -> None:
        self.endpoint, self.rows, self.codec = endpoint, frozenset(rows), codec
        self.unhandled: deque[Message] = deque()
        self._packet = bytearray()

    def queue(self, frame: bytes) -> None:
        """Add a frame to the datagram; send the datagram before if it is full."""
        if len(self._packet) + len(frame) > MAX_PACKET_BYTES:
            self.flush()
        self._packet += frame

    def flush(self) -> None:
        """Send the queued frames."""
        if self._packet:
            self.endpoint.send(bytes(self._packet))
            self._packet.clear()


MAX_VEHICLES = 250  # higher system ids are those of ground stations
MAX_CLIENTS = 32
RECEIVE_BUDGET_S = 0.005  # wall-clock s per poll, so that a flood cannot stop a flight
POLL_S = 0.02  # wall-clock s between two polls while waiting


class Attached(Protocol):
    """What is served beside the links of a run."""

    def fileno(self) -> int:
        """Return the file descriptor, for select."""

    def poll(self, now_s: float) -> bool:
        """Handle what was received, and send what is due; true: there was something.

        Args:
            now_s: simulation time, s.
        """

    def due_s(self) -> float:
        """Return the wall-clock time until something is due, s; infinite: nothing is."""

    def pop_events(self) -> list[Event]:
        """Return the events since the last call."""


class Client(NamedTuple):
    """An external program that has sent an accepted message."""

    system: int
    component: int
    latest_s: float  # simulation time of its latest message


class MavlinkServer:
    """Send telemetry of every sample, and pass commands on to the aircraft.

    An observer of a run, which also receives between samples, in `poll` and `wait`. Without
    commands it does not change the simulation.
    """

    def __init__(
        self,
        addresses: Sequence[Address],
        controls: Sequence[VehicleControl],
        *,
        epoch_us: int,
        signing: Signing | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the links; nothing is sent before `begin`.

        Args:
            addresses: of the links, each for all aircraft.
            controls: of N aircraft, leader first; their system ids count from 1.
            epoch_us: Unix time of the start of the run, µs.
            signing: sign messages, and accept only signed ones; None: neither. Its time is that
                of `epoch_us`.
            clock: wall-clock time, s.

        Raises:
            InputError: a link cannot be opened, or there are too many aircraft.
        """
        if len(controls) > MAX_VEHICLES:
            raise InputError(
                f"{len(controls)} aircraft: MAVLink numbers {MAX_VEHICLES}; fly fewer with it"
            )
        self._controls, self._clock, self._epoch_us = controls, clock, epoch_us
        self._signer, self._opened_s = MessageSigner(signing) if signing else None, clock()
        self._codecs = [Codec(row + 1, COMPONENT, self._signer) for row in range(len(controls))]
        self._vehicles: list[MavlinkVehicle] = []
        self._names: Mapping[str, int] = {}
        self._origin = NedOrigin()
        self._snapshot: TelemetrySnapshot | None = None
        self._now_s = 0.0
        self._clients: dict[tuple[int, int], float] = {}
        self._frames_sent = self._frames_received = 0
        self._warned = False
        self._links: list[MavlinkLink] = []
        self._attached: list[Attached] = []
        self._log: TlogWriter | None = None
        try:
            for address, rows in link_addresses(addresses, [each.name for each in controls]):
                codec = Codec(MAX_VEHICLES, COMPONENT, self._signer)
                self._links.append(MavlinkLink(Endpoint(address, clock), rows, codec))
        except BaseException:
            self.close()
            raise

    @property
    def clients(self) -> tuple[Client, ...]:
        """The programs that have sent an accepted message."""
        return tuple(Client(*ids, latest_s) for ids, latest_s in self._clients.items())

    def attach(self, part: Attached) -> None:
        """Serve something else, too, wherever the links are served."""
        self._attached.append(part)

    def log_to(self, tlog: Path) -> None:
        """Log every sent and received frame from `begin` on, all parameters first.

        Raises:
            MavlinkError: the file cannot be written.
        """
        self._log = TlogWriter(tlog)

    def begin(self, info: RunInfo) -> None:
        """Create the vehicles, which send from the first sample on."""
        self._origin = info.origin
        self._names = {name: row for row, name in enumerate(info.names)}
        self._vehicles = [
            MavlinkVehicle(control, row + 1, row, info, self._epoch_us)
            for row, control in enumerate(self._controls)
        ]
        if self._log is not None:
            for codec, vehicle in zip(self._codecs, self._vehicles, strict=True):
                for message in vehicle.parameter_messages():
                    self._log.write(
                        self._timestamp_us(), codec.pack(message.name, **message.fields)
                    )

    def observe(self, sample: Sample) -> None:
        """Send the messages that are due with a sample, and its events."""
        self._set_time(sample.time_s)
        snapshot, wall_s = TelemetrySnapshot(sample, self._origin), self._clock()
        self._snapshot = snapshot
        last = []  # lockstep programs answer these, and have then received all other messages
        for row, vehicle in self._responsive_vehicles():
            messages = vehicle.update(snapshot, wall_s)
            if vehicle.lockstep:
                last += [(row, message) for message in messages if message.name == ATTITUDE]
                messages = [message for message in messages if message.name != ATTITUDE]
            self._send(row, messages)
        self._send_events(sample.events)
        for row, message in last:
            self._send(row, [message])
        self._flush()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Send the last events, and close the links."""
        self._send_events(events)
        self._flush()
        self.close()

    def poll(self, now_s: float) -> bool:
        """Handle received messages, and send what is due; true: there were messages.

        Args:
            now_s: simulation time, s.
        """
        if not self._vehicles:
            return False
        self._set_time(now_s)
        wall_s, received = self._clock(), False
        stop = wall_s + RECEIVE_BUDGET_S
        for k, link in enumerate(self._links):
            # links after a quiet one get its unused share
            share = (stop - self._clock()) / (len(self._links) - k)
            received |= self._serve_link(link, wall_s, share)
        for row, vehicle in self._responsive_vehicles():
            self._send(row, vehicle.poll(wall_s))
        self._flush()
        for part in self._attached:
            received |= part.poll(now_s)
        return received

    def wait(self, seconds: float, now_s: float) -> None:
        """Handle messages until one has been received or the time is over.

        Args:
            seconds: of wall-clock time.
            now_s: simulation time, s.
        """
        endpoints: list[HasFileno] = [*(link.endpoint for link in self._links), *self._attached]
        stop = self._clock() + seconds
        while not self.poll(now_s):
            remaining = stop - self._clock()
            if remaining <= 0.0:
                return
            wait(endpoints, min(remaining, POLL_S, *(part.due_s() for part in self._attached)))

    def repeat(self, now_s: float) -> None:
        """Send the latest state of vehicles again that a run waits for in lockstep.

        Args:
            now_s: simulation time, s.
        """
        self._set_time(now_s)
        for row, vehicle in self._responsive_vehicles():
            if self._snapshot is not None:
                self._send(row, vehicle.repeated_state())
        self._flush()

    def pop_events(self) -> list[Event]:
        """Return those since the last call: a warning, once, after a message failed verification.

        And those of what is attached.
        """
        events = [event for part in self._attached for event in part.pop_events()]
        if self._warned or not self._rejected():
            return events
        self._warned = True
        text = (
            "MAVLink messages were ignored: not signed with this run's key, received before, or "
            "signed before the run began"
        )
        return [*events, Event(self._now_s, "warning", "run", text)]

    def summary(self) -> dict[str, Any]:
        """Count the traffic over all links, for the metrics."""
        return {
            "frames_sent": self._frames_sent,
            "frames_received": self._frames_received,
            "rejected": dict(sorted(self._rejected().items())),
            "skipped_bytes": sum(link.codec.skipped for link in self._links),
            "datagrams_dropped": sum(link.endpoint.dropped for link in self._links),
            "clients": [f"{system}.{component}" for system, component in sorted(self._clients)],
        }

    def close(self) -> None:
        """Close links and log; may be called again."""
        for link in self._links:
            link.endpoint.close()
        if self._log is not None:
            self._log.close()
            self._log = None

    def _responsive_vehicles(self) -> Iterator[tuple[int, MavlinkVehicle]]:
        """Yield row and vehicle of all aircraft whose autopilot is not frozen."""
        for row, vehicle in enumerate(self._vehicles):
            if self._snapshot is None or not self._snapshot.autopilot_frozen(row):
                yield row, vehicle

    def _serve_link(self, link: MavlinkLink, wall_s: float, budget_s: float) -> bool:
        """Handle the messages of a link for this time; true: there were some.

        The others are handled, in order, at the next polls. The budget is checked after each
        message and datagram, because a datagram may contain a hundred messages or only noise.
        """
        stop, received = self._clock() + budget_s, False
        datagrams = link.endpoint.receive()
        while True:
            if link.unhandled:
                self._handle(link, link.unhandled.popleft(), wall_s)
                received = True
            elif (datagram := next(datagrams, None)) is not None:
                self._parse_datagram(link, *datagram)
            else:
                return received
            if self._clock() > stop:  # also of a link without a budget one is handled
                return received

    def _parse_datagram(self, link: MavlinkLink, peer: Peer, data: bytes) -> None:
        """Store the messages of a datagram, and log their frames."""
        outdated = link.codec.rejected["outdated"]
        messages = link.codec.feed(data, datagram=True)
        if link.codec.rejected["outdated"] > outdated:
            link.endpoint.reply(peer, self._time_frame(min(link.rows)))
        if messages:
            link.endpoint.add_peer(peer)
            self._frames_received += len(messages)
            link.unhandled += messages
            if self._log is not None:
                for message in messages:
                    self._log.write(self._timestamp_us(), message.frame)

    def _time_frame(self, row: int) -> bytes:
        """Pack SYSTEM_TIME; its signature advances a slow client's clock.

        Without it a client that waits for telemetry before it sends a newer time would get none.
        """
        time_us, now_ms = self._timestamp_us(), round(1e3 * self._now_s)
        self._frames_sent += 1
        return self._codecs[row].pack("SYSTEM_TIME", time_unix_usec=time_us, time_boot_ms=now_ms)

    def _handle(self, link: MavlinkLink, message: Message, wall_s: float) -> None:
        ids = (message.system, message.component)
        if ids in self._clients or len(self._clients) < MAX_CLIENTS:
            self._clients[ids] = self._now_s
        for row, vehicle in self._responsive_vehicles():
            if row in link.rows:
                self._send(row, vehicle.handle(message, wall_s))

    def _send_events(self, events: Sequence[Event]) -> None:
        """Send each event from its aircraft; those of the run from the leader.

        Events of an aircraft whose autopilot is frozen are not sent.
        """
        responsive = dict(self._responsive_vehicles())
        for event in events:
            row = self._names.get(event.source, 0)
            if row in responsive:
                self._send(row, responsive[row].event_text(event))

    def _send(self, row: int, messages: Sequence[OutgoingMessage]) -> None:
        for message in messages:
            frame = self._codecs[row].pack(message.name, **message.fields)
            self._frames_sent += 1
            for link in self._links:
                if row in link.rows:
                    link.queue(frame)
            if self._log is not None:
                self._log.write(self._timestamp_us(), frame)

    def _flush(self) -> None:
        for link in self._links:
            link.flush()

    def _set_time(self, now_s: float) -> None:
        """Set simulation time and signature clock; signatures use wall-clock time."""
        self._now_s = now_s
        if self._signer is not None:
            elapsed_s = self._clock() - self._opened_s
            self._signer.advance(signing_time(1e-6 * self._epoch_us + elapsed_s))

    def _timestamp_us(self) -> int:
        return self._epoch_us + round(self._now_s * 1e6)

    def _rejected(self) -> Counter[str]:
        return sum((Counter(link.codec.rejected) for link in self._links), Counter())
