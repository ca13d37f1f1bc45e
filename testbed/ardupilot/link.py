"""One ArduPlane flying one of our aircraft: in lockstep, from its boot to the end of the run.

It sends pulses and waits until we have answered with the motion a time step later. Time is what our
answers say; the clock on the wall only tells how long it has been silent.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from testbed.ardupilot.bring_up import Bringing
from testbed.ardupilot.channels import Outputs, Sticks
from testbed.ardupilot.defaults import defaults_text
from testbed.ardupilot.packets import PacketError, ServoPacket, motion_line, read_servos
from testbed.ardupilot.process import Process, command_line, find_binary
from testbed.ardupilot.station import FBWA, Station
from testbed.errors import InputError, PartnerLost
from testbed.state import Origin

HOST = "127.0.0.1"
_PHYSICS_PORT, _MAVLINK_PORT, _PORTS = 9002, 5760, 10  # of instance 0, and from one to the next
_LOOK_S = 0.1  # between looks at whether it still lives
_MOST_BYTES = 2048
_IDLE = (1500, 1500, 1000, 1500)  # µs, before its parameters are known


def ports(instance: int) -> tuple[int, int]:
    """Of an instance's physics, UDP, and of its first MAVLink, TCP; two more are 2 and 3 above."""
    return _PHYSICS_PORT + _PORTS * instance, _MAVLINK_PORT + _PORTS * instance


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the page says of an aircraft that ArduPlane flies."""

    name: str
    instance: int
    start: bool  # the process; or wait for one
    binary: str | None  # as on the page
    tune: Path
    patience_s: float
    heading_deg: float  # at the start
    elevon_mixing: float  # of its airframe; not a number where it has none


class Plane:
    """An ArduPlane. After `start` and `bring_up`: `tell`, then `answer` and `collect` each tick."""

    def __init__(
        self, wanted: Wanted, origin: Origin, *, physics_hz: int, autopilot_hz: int
    ) -> None:
        """Not started."""
        self.name, self._wanted, self._origin = wanted.name, wanted, origin
        self._rates = physics_hz, autopilot_hz
        self._physics_port, self._mavlink_port = ports(wanted.instance)
        self._udp: socket.socket | None = None
        self._peer: tuple[str, int] | None = None
        self._count: int | None = None
        self._answered = 0
        self._line = b""
        self._pulses: tuple[int, ...] = _IDLE
        self._sticks: Sticks | None = None
        self._outputs: Outputs | None = None
        self._overrides = False
        self._reported = (True, FBWA, False)  # armed, mode, hung up
        self._heed: Callable[[], None] = lambda: None
        self.station = Station()
        self.process: Process | None = None

    def find(self, arduplane: Path | None) -> Path | None:
        """The program to start; None: somebody else starts one.

        Raises:
            InputError: there is none.
        """
        return find_binary(self._wanted.binary, arduplane) if self._wanted.start else None

    def start(self, arduplane: Path | None, heed: Callable[[], None]) -> None:
        """Take the port of the physics, and start the process if it is ours to start.

        Args:
            arduplane: the program, where the page says nothing.
            heed: called at least every `_LOOK_S` or so while it is waited for; may raise.

        Raises:
            InputError: there is no program, or a port is taken.
        """
        self._heed = heed
        wanted, binary = self._wanted, self.find(arduplane)
        if binary and _listens(self._mavlink_port):
            raise InputError(self._taken("TCP", self._mavlink_port))
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            udp.bind((HOST, self._physics_port))
        except OSError:
            udp.close()
            raise InputError(self._taken("UDP", self._physics_port)) from None
        udp.setblocking(False)
        self._udp = udp
        if binary:
            physics_hz, autopilot_hz = self._rates
            text = defaults_text(wanted.tune, physics_hz=physics_hz, autopilot_hz=autopilot_hz)
            self.process = Process(binary, wanted.instance, self._origin, wanted.heading_deg, text)

    def bring_up(
        self, columns: Sequence[float], voltage: float, command: tuple[float, float, float]
    ) -> str | None:
        """Boot it with the motion standing still, until it flies by wire and hears its receiver.

        Args:
            columns: of `motion_columns`, at the start.
            voltage: as in `motion_line`.
            command: roll, pitch in rad and throttle, held meanwhile.

        Returns:
            What is to be told about it, if anything.

        Raises:
            PartnerLost: it is not there, ends, or does not get ready.
            InputError: it cannot be flown with its parameters.
        """
        began = time.monotonic()
        while not self.station.connect(self._mavlink_port):
            self._endure(time.monotonic() - began, f"does not listen on {self._mavlink_port}/tcp")
            time.sleep(_LOOK_S / 2)
        self.collect()
        bringing = Bringing(self.station, self._rates[0], self._wanted.elevon_mixing, command)
        for wait_s in bringing.steps():
            self._heed()
            self.station.listen(wait_s)
            if bringing.failed:
                self._lose(bringing.failed)
            self._pulses = bringing.pulses or _IDLE
            if bringing.overrides:
                self.station.override(self._pulses)
            self.answer(columns, voltage)
            self.collect()
        self._sticks, self._outputs = bringing.sticks, bringing.outputs
        self._overrides = bringing.overrides
        if self._overrides:
            return "takes no rc in its physics link: sticks go by RC_CHANNELS_OVERRIDE"
        return None

    def tell(self, roll: float, pitch: float, throttle: float) -> None:
        """Move the sticks: rad, rad, 0..1; with the next answer."""
        assert self._sticks is not None
        self._pulses = self._sticks.pulses(roll, pitch, throttle)
        if self._overrides:
            self.station.override(self._pulses)

    def answer(self, columns: Sequence[float], voltage: float) -> None:
        """Send the motion now, upon which it thinks on for one tick; see `motion_line`."""
        packet = self._newest(0.0)  # what it repeats while we were busy is answered by this
        if packet is not None:
            self._accept(packet)
        self._answered += 1
        time_s = self._answered / self._rates[0]
        self._line = motion_line(time_s, columns, voltage, self._pulses)
        self._send()

    def collect(self) -> tuple[int, ...]:
        """Wait for the pulses that come of the last answer, µs.

        Raises:
            PartnerLost: it has ended, is silent, has begun anew, or is no ArduPlane.
        """
        began = time.monotonic()
        while True:
            packet = self._newest(_LOOK_S)
            if packet is not None and packet.frame_count != self._count:
                self._accept(packet)
                return packet.pulses
            if packet is not None:
                self._send()  # it repeats itself: our answer was lost
            self.station.listen()
            self._endure(time.monotonic() - began, "is silent")

    def surfaces(self, pulses: Sequence[int]) -> tuple[float, float, float, float]:
        """What these pulses move: aileron, elevator, rudder, throttle."""
        assert self._outputs is not None
        return self._outputs.surfaces(pulses)

    def news(self) -> list[tuple[str, str]]:
        """Level and text of what it said and did by itself since the last call."""
        station = self.station
        station.listen()
        told = [("warning" if loud else "info", text) for loud, text in station.take_texts()]
        armed, mode, lost = self._reported
        self._reported = station.armed, station.mode or 0, station.lost
        if station.lost and not lost:
            told.append(("warning", "ArduPlane has hung up its MAVLink: nobody hears what it says"))
        if station.armed != armed:
            text = "has armed again" if station.armed else "has disarmed: its motor stands still"
            told.append(("warning", f"ArduPlane {text}"))
        if station.mode != mode:
            text = "flies by wire again" if station.mode == FBWA else "heeds no sticks of ours"
            told.append(("warning", f"ArduPlane has changed to mode {station.mode}: it {text}"))
        return told

    def hang_up(self) -> None:
        """Close the sockets; the process is ended by who started it."""
        self.station.close()
        if self._udp is not None:
            self._udp.close()
            self._udp = None

    def _newest(self, wait_s: float) -> ServoPacket | None:
        """The last of the packets that have come; with none there, of those that soon do."""
        udp = self._udp
        if udp is None:
            return None
        data: bytes | None = None
        while True:
            try:
                data, self._peer = udp.recvfrom(_MOST_BYTES)
            except BlockingIOError:
                if data is None and wait_s > 0.0 and select.select([udp], [], [], wait_s)[0]:
                    continue
                break
            except OSError:  # it has just gone, and left our last answer undelivered
                break
        if data is None:
            return None
        try:
            return read_servos(data)
        except PacketError as error:
            self._lose(f"or whoever sends to {self._physics_port}/udp sends: {error}")

    def _accept(self, packet: ServoPacket) -> None:
        if self._count is not None and packet.frame_count < self._count:
            self._lose(
                f"has begun anew: packet {packet.frame_count} came after packet {self._count}"
            )
        self._count = packet.frame_count

    def _send(self) -> None:
        if self._udp is not None and self._peer is not None and self._line:
            try:
                self._udp.sendto(self._line, self._peer)
            except OSError:  # whoever is not there will be missed soon
                pass

    def _endure(self, waited_s: float, how: str) -> None:
        """Go on waiting, unless the run is to end, it has ended or our patience has."""
        self._heed()
        if self.process is not None and (ended := self.process.ended()):
            self._lose(ended)
        if waited_s > self._wanted.patience_s:
            self._lose(f"{how}: nothing in {self._wanted.patience_s:g} s (autopilot.patience_s)")

    def _lose(self, how: str) -> NoReturn:
        text = f"{self.name}: ArduPlane (instance {self._wanted.instance}) {how}"
        if self.process is not None:
            raise PartnerLost(f"{text}; {self.process.last_words()}")
        if self._count is None:
            line = command_line(
                "arduplane",
                self._wanted.instance,
                self._origin,
                self._wanted.heading_deg,
                "FILE.parm",
            )
            text += f"; start it with: {' '.join(line)}"
        raise PartnerLost(text)

    def _taken(self, kind: str, port: int) -> str:
        return (
            f"{self.name}: {kind} port {port} of ArduPlane's instance {self._wanted.instance} is "
            "taken, by another run perhaps (end that, or write another instance under autopilot)"
        )


def _listens(port: int) -> bool:
    """Whether somebody does there."""
    probe = Station()
    found = probe.connect(port)
    probe.close()
    return found
