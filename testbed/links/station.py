"""All aircraft of a run as MAVLink vehicles, on the links that programs outside use."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from testbed.errors import InputError
from testbed.links.addresses import Address, places
from testbed.links.catalogue import ATTITUDE
from testbed.links.cockpit import Cockpit
from testbed.links.endpoint import Endpoint, Peer, wait
from testbed.links.link import Link, believed
from testbed.links.replies import Reply
from testbed.links.scene import Scene
from testbed.links.vehicle import COMPONENT, Vehicle
from testbed.mavlink.door import Codec, Message
from testbed.mavlink.signing import Signing, signing_time
from testbed.mavlink.tlog import TlogWriter
from testbed.state import Event, Frame, Origin, RunInfo

MOST_VEHICLES = 250  # system numbers above are those of ground stations
MOST_CLIENTS = 32
SPARED_S = 0.005  # for what one link says at a time, wall-clock s: a flood must not stop a flight
GLANCE_S = 0.02  # between two looks at what is due while waiting, wall-clock s


class Client(NamedTuple):
    """A program outside that has said something that was believed."""

    system: int
    component: int
    heard_s: float  # simulation time of its latest message


class Station:
    """Tells programs outside of every frame, and lets them command what cockpits allow.

    An observer of a run; also heard between frames, by `poll` and `wait`. Nothing of the
    simulation changes unless somebody commands it.
    """

    def __init__(
        self,
        addresses: Sequence[Address],
        cockpits: Sequence[Cockpit],
        *,
        epoch_us: int,
        signing: Signing | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the links; nobody is told anything before `begin`.

        Args:
            addresses: of the links; each carries all aircraft.
            cockpits: of N aircraft, the leader's first; their system numbers count from 1.
            epoch_us: what vehicles call the start of the run, µs since 1970.
            signing: sign what is said and believe only what is signed; None: neither. Its time
                is that of `epoch_us`.
            clock: wall-clock time, s.

        Raises:
            InputError: a link cannot be had; says what to write instead.
        """
        if len(cockpits) > MOST_VEHICLES:
            raise InputError(
                f"{len(cockpits)} aircraft: MAVLink numbers {MOST_VEHICLES}; fly fewer with it"
            )
        self._cockpits, self._clock, self._epoch_us = cockpits, clock, epoch_us
        self._signed, self._opened_s = signing is not None, clock()
        self._codecs = [Codec(row + 1, COMPONENT, signing) for row in range(len(cockpits))]
        self._vehicles: list[Vehicle] = []
        self._names: Mapping[str, int] = {}
        self._origin = Origin()
        self._scene: Scene | None = None
        self._now_s = 0.0
        self._clients: dict[tuple[int, int], float] = {}
        self._sent = self._heard = 0
        self._warned = False
        self._links: list[Link] = []
        self._log: TlogWriter | None = None
        try:
            for place, reached in places(addresses, [each.name for each in cockpits]):
                codec = Codec(MOST_VEHICLES, COMPONENT, signing)
                self._links.append(Link(Endpoint(place, clock), reached, codec))
        except BaseException:
            self.close()
            raise

    @property
    def clients(self) -> tuple[Client, ...]:
        """Who has spoken."""
        return tuple(Client(*who, heard) for who, heard in self._clients.items())

    def keep(self, tlog: Path) -> None:
        """Have every frame that is said or heard in this file, from `begin` with all parameters.

        Raises:
            MavlinkError: it cannot be written.
        """
        self._log = TlogWriter(tlog)

    def begin(self, info: RunInfo) -> None:
        """Make the vehicles; they speak from the first frame on."""
        self._origin = info.origin
        self._names = {name: row for row, name in enumerate(info.names)}
        self._vehicles = [
            Vehicle(cockpit, row + 1, row, info, self._epoch_us)
            for row, cockpit in enumerate(self._cockpits)
        ]
        if self._log is not None:
            for codec, vehicle in zip(self._codecs, self._vehicles, strict=True):
                for reply in vehicle.parameters():
                    self._log.write(self._stamp_us(), codec.pack(reply.name, **reply.fields))

    def observe(self, frame: Frame) -> None:
        """Say what is due with a frame, and what has happened."""
        self._tick(frame.time_s)
        scene, at_s = Scene(frame, self._origin), self._clock()
        self._scene = scene
        last = []  # a program in lockstep answers these: by then it has heard of everybody
        for row, vehicle in self._awake():
            replies = vehicle.look(scene, at_s)
            if vehicle.lockstep:
                last += [(row, reply) for reply in replies if reply.name == ATTITUDE]
                replies = [reply for reply in replies if reply.name != ATTITUDE]
            self._say(row, replies)
        self._tell(frame.events)
        for row, reply in last:
            self._say(row, [reply])
        self._flush()

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Say the last events, and close the links."""
        self._tell(events)
        self._flush()
        self.close()

    def poll(self, now_s: float) -> None:
        """Hear and answer what has come; simulation time, s."""
        self._hear(now_s)

    def wait(self, seconds: float, now_s: float) -> None:
        """Hear and answer what comes, until something does or the time is over.

        Args:
            seconds: of wall-clock time.
            now_s: simulation time.
        """
        endpoints = [link.endpoint for link in self._links]
        stop = self._clock() + seconds
        while not self._hear(now_s):
            left = stop - self._clock()
            if left <= 0.0:
                return
            wait(endpoints, min(left, GLANCE_S))

    def repeat(self, now_s: float) -> None:
        """Say the latest state again of those whose commands the run waits for."""
        self._tick(now_s)
        for row, vehicle in self._awake():
            if vehicle.lockstep and self._scene is not None:
                self._say(row, vehicle.state())
        self._flush()

    def news(self) -> list[Event]:
        """A warning, once, when somebody speaks who is not believed."""
        if self._warned or not self._refused():
            return []
        self._warned = True
        text = "MAVLink heard without this run's key: not believed"
        return [Event(self._now_s, "warning", "run", text)]

    def summary(self) -> dict[str, Any]:
        """What has gone over the links."""
        return {
            "frames_sent": self._sent,
            "frames_heard": self._heard,
            "refused": dict(sorted(self._refused().items())),
            "skipped_bytes": sum(link.codec.skipped for link in self._links),
            "datagrams_dropped": sum(link.endpoint.dropped for link in self._links),
            "clients": [f"{system}.{component}" for system, component in sorted(self._clients)],
        }

    def close(self) -> None:
        """Close links and file; may be called again."""
        for link in self._links:
            link.endpoint.close()
        if self._log is not None:
            self._log.close()
            self._log = None

    def _hear(self, now_s: float) -> bool:
        """Answer what has come and say what is due; whether anything was heard."""
        if not self._vehicles:
            return False
        self._tick(now_s)
        at_s, heard = self._clock(), False
        for link in self._links:
            heard |= self._attend(link, at_s)
        for row, vehicle in self._awake():
            self._say(row, vehicle.due(at_s))
        self._flush()
        return heard

    def _awake(self) -> Iterator[tuple[int, Vehicle]]:
        """The vehicles by row, but those whose autopilot hangs: they neither speak nor hear."""
        for row, vehicle in enumerate(self._vehicles):
            if self._scene is None or not self._scene.hangs(row):
                yield row, vehicle

    def _attend(self, link: Link, at_s: float) -> bool:
        """Answer what has come over a link, while there is time; whether there was anything.

        The rest waits for the next look, in order. A message may cost as much as a datagram of
        noise, and a datagram has room for a hundred.
        """
        stop, heard = self._clock() + SPARED_S, False
        datagrams = link.endpoint.receive()
        while self._clock() <= stop:
            if link.unanswered:
                self._answer(link, link.unanswered.popleft(), at_s)
                heard = True
            elif (came := next(datagrams, None)) is not None:
                self._take(link, *came)
            else:
                break
        return heard

    def _take(self, link: Link, peer: Peer, data: bytes) -> None:
        """Have the messages of a datagram answered."""
        messages = link.codec.feed(data, whole=True)
        if messages:
            link.endpoint.welcome(peer)
            self._heard += len(messages)
            link.unanswered += messages
            if self._log is not None:
                for frame in believed(data, messages):
                    self._log.write(self._stamp_us(), frame)

    def _answer(self, link: Link, message: Message, at_s: float) -> None:
        self._meet(message)
        for row, vehicle in self._awake():
            if row in link.rows:
                self._say(row, vehicle.hear(message, at_s))

    def _meet(self, message: Message) -> None:
        who = (message.system, message.component)
        if who in self._clients or len(self._clients) < MOST_CLIENTS:
            self._clients[who] = self._now_s

    def _tell(self, events: Sequence[Event]) -> None:
        """Each in the words of the aircraft it is about; of the run, in the leader's.

        What there is to say of an autopilot that hangs is in the log only.
        """
        awake = dict(self._awake())
        for event in events:
            row = self._names.get(event.source, 0)
            if row in awake:
                self._say(row, awake[row].report(event))

    def _say(self, row: int, replies: Sequence[Reply]) -> None:
        for reply in replies:
            frame = self._codecs[row].pack(reply.name, **reply.fields)
            self._sent += 1
            for link in self._links:
                if row in link.rows:
                    link.put(frame)
            if self._log is not None:
                self._log.write(self._stamp_us(), frame)

    def _flush(self) -> None:
        for link in self._links:
            link.flush()

    def _tick(self, now_s: float) -> None:
        """Set the clocks; signatures are stamped by that of the wall, as those of others are."""
        self._now_s = now_s
        if self._signed:
            moment = signing_time(1e-6 * self._epoch_us + self._clock() - self._opened_s)
            for codec in (*self._codecs, *(link.codec for link in self._links)):
                codec.advance(moment)

    def _stamp_us(self) -> int:
        return self._epoch_us + round(self._now_s * 1e6)

    def _refused(self) -> Counter[str]:
        return sum((Counter(link.codec.refused) for link in self._links), Counter())
