"""One ArduPlane (SITL) that flies one aircraft in lockstep.

ArduPlane sends servo pulses and waits for the state one time step later. Its time is that of the
states; wall-clock time serves only for timeouts.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from testbed.autopilot.json_physics import PacketError, ServoPacket, read_servos, state_line
from testbed.autopilot.pwm import RcChannels, ServoOutputs
from testbed.autopilot.sitl_mavlink import FBWA, SitlMavlinkClient
from testbed.autopilot.sitl_parameters import defaults_text
from testbed.autopilot.sitl_process import SitlProcess, command_line, find_binary
from testbed.autopilot.startup import StartupSequence
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.records import Origin

HOST = "127.0.0.1"
_PHYSICS_PORT, _MAVLINK_PORT, _PORT_STEP = 9002, 5760, 10  # of instance 0, and per instance
_POLL_S = 0.1  # between two checks of the process
_MAX_BYTES = 2048
_IDLE = (1500, 1500, 1000, 1500)  # µs, before its parameters are known


def ports(instance: int) -> tuple[int, int]:
    """Return the ports of an instance: physics (UDP) and first MAVLink (TCP).

    Two more MAVLink ports are 2 and 3 above the first.
    """
    return _PHYSICS_PORT + _PORT_STEP * instance, _MAVLINK_PORT + _PORT_STEP * instance


@dataclass(frozen=True, slots=True)
class SitlConfig:
    """Configuration of an aircraft that ArduPlane flies."""

    name: str
    instance: int
    start: bool  # start the process; false: wait for one that is started elsewhere
    binary: str | None  # of the scenario
    tune: Path  # parameter file
    timeout_s: float
    heading_deg: float  # at the start
    elevon_mixing: float  # of its airframe; NaN where it has none


class SitlVehicle:
    """The ArduPlane of one aircraft.

    Call `start` and `start_up` once; then `set_command` when the command changes, and `send_state`
    and `receive_pwm` at each tick.
    """

    def __init__(
        self, config: SitlConfig, origin: Origin, *, physics_hz: int, autopilot_hz: int
    ) -> None:
        """Configure it without starting it.

        Args:
            config: of the aircraft.
            origin: of the scenario.
            physics_hz: ticks per second.
            autopilot_hz: rate of the autopilot.
        """
        self.name, self._config, self._origin = config.name, config, origin
        self._rates = physics_hz, autopilot_hz
        self._physics_port, self._mavlink_port = ports(config.instance)
        self._udp: socket.socket | None = None
        self._peer: tuple[str, int] | None = None
        self._count: int | None = None  # frame_count of the latest packet
        self._states_sent = 0
        self._line = b""
        self._pulses: tuple[int, ...] = _IDLE
        self._rc_channels: RcChannels | None = None
        self._servo_outputs: ServoOutputs | None = None
        self._overrides = False
        self._reported = (True, FBWA, False)  # armed, mode, disconnected
        self._check_stop: Callable[[], None] = lambda: None
        self.client = SitlMavlinkClient()
        self.process: SitlProcess | None = None

    def find(self, arduplane: Path | None) -> Path | None:
        """Find the binary to start; None: it is started elsewhere.

        Args:
            arduplane: of the command line.

        Raises:
            InputError: there is none.
        """
        return find_binary(self._config.binary, arduplane) if self._config.start else None

    def start(self, arduplane: Path | None, check_stop: Callable[[], None]) -> None:
        """Open the physics port, and start the process unless it is started elsewhere.

        Args:
            arduplane: of the command line.
            check_stop: called at least every `_POLL_S` in every wait; may raise.

        Raises:
            InputError: there is no binary, or a port is in use.
        """
        self._check_stop = check_stop
        config, binary = self._config, self.find(arduplane)
        if binary and _is_listening(self._mavlink_port):
            raise InputError(self._port_error("TCP", self._mavlink_port))
        udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            udp.bind((HOST, self._physics_port))
        except OSError:
            udp.close()
            raise InputError(self._port_error("UDP", self._physics_port)) from None
        udp.setblocking(False)
        self._udp = udp
        if binary:
            physics_hz, autopilot_hz = self._rates
            text = defaults_text(config.tune, physics_hz=physics_hz, autopilot_hz=autopilot_hz)
            self.process = SitlProcess(
                binary, config.instance, self._origin, config.heading_deg, text
            )

    def start_up(
        self, columns: Sequence[float], voltage: float, command: tuple[float, float, float]
    ) -> str | None:
        """Boot it in a constant state until it is in fly-by-wire A and receives RC.

        Args:
            columns: of `state_columns`, at the start.
            voltage: see `state_line`.
            command: roll, pitch in rad and throttle during startup.

        Returns:
            The text of an event, if there is one.

        Raises:
            ExternalProgramLost: it does not appear, ends, or does not become ready.
            InputError: it cannot be flown with its parameters.
        """
        start = time.monotonic()
        while not self.client.connect(self._mavlink_port):
            self._check_wait(
                time.monotonic() - start, f"does not listen on {self._mavlink_port}/tcp"
            )
            time.sleep(_POLL_S / 2)
        self.receive_pwm()
        startup = StartupSequence(self.client, self._rates[0], self._config.elevon_mixing, command)
        for wait_s in startup.steps():
            self._check_stop()
            self.client.receive(wait_s)
            if startup.failure:
                self._raise_lost(startup.failure)
            self._pulses = startup.pulses or _IDLE
            if startup.overrides:
                self.client.override_rc(self._pulses)
            self.send_state(columns, voltage)
            self.receive_pwm()
        self._rc_channels, self._servo_outputs = startup.rc_channels, startup.servo_outputs
        self._overrides = startup.overrides
        if self._overrides:
            return "takes no rc from the physics link: commanded by RC_CHANNELS_OVERRIDE"
        return None

    def set_command(self, roll: float, pitch: float, throttle: float) -> None:
        """Set the stick input that is sent with the next state: rad, rad, 0..1."""
        assert self._rc_channels is not None
        self._pulses = self._rc_channels.pulses(roll, pitch, throttle)
        if self._overrides:
            self.client.override_rc(self._pulses)

    def send_state(self, columns: Sequence[float], voltage: float) -> None:
        """Send the current state, upon which it computes one tick; see `state_line`."""
        packet = self._latest_packet(0.0)  # a repetition, which this state answers
        if packet is not None:
            self._accept(packet)
        self._states_sent += 1
        time_s = self._states_sent / self._rates[0]
        self._line = state_line(time_s, columns, voltage, self._pulses)
        self._send_line()

    def receive_pwm(self) -> tuple[int, ...]:
        """Wait for the servo pulses that answer the last state, µs.

        Raises:
            ExternalProgramLost: it has ended, does not answer, has restarted, or sends other
                packets.
        """
        start = time.monotonic()
        while True:
            packet = self._latest_packet(_POLL_S)
            if packet is not None and packet.frame_count != self._count:
                self._accept(packet)
                return packet.pulses
            if packet is not None:
                self._send_line()  # a repetition: the state was lost
            self.client.receive()
            self._check_wait(time.monotonic() - start, "does not answer")

    def surfaces(self, pulses: Sequence[int]) -> tuple[float, float, float, float]:
        """Convert servo pulses to aileron, elevator, rudder and throttle."""
        assert self._servo_outputs is not None
        return self._servo_outputs.surfaces(pulses)

    def pop_messages(self) -> list[tuple[str, str]]:
        """Return level and text of its messages and state changes since the last call."""
        client = self.client
        client.receive()
        messages = [
            ("warning" if is_warning else "info", text) for is_warning, text in client.pop_texts()
        ]
        armed, mode, disconnected = self._reported
        self._reported = client.armed, client.mode or 0, client.disconnected
        if client.disconnected and not disconnected:
            text = "ArduPlane has closed its MAVLink connection: no more messages from it"
            messages.append(("warning", text))
        if client.armed != armed:
            text = "has armed again" if client.armed else "has disarmed: motor off"
            messages.append(("warning", f"ArduPlane {text}"))
        if client.mode != mode:
            text = "takes commands again" if client.mode == FBWA else "takes no commands"
            messages.append(("warning", f"ArduPlane has changed to mode {client.mode}: {text}"))
        return messages

    def close(self) -> None:
        """Close the sockets; the process is stopped by its starter."""
        self.client.close()
        if self._udp is not None:
            self._udp.close()
            self._udp = None

    def _latest_packet(self, wait_s: float) -> ServoPacket | None:
        """Return the latest received packet; without any, wait at most this time, s."""
        udp = self._udp
        if udp is None:
            return None
        data: bytes | None = None
        while True:
            try:
                data, self._peer = udp.recvfrom(_MAX_BYTES)
            except BlockingIOError:
                if data is None and wait_s > 0.0 and select.select([udp], [], [], wait_s)[0]:
                    continue
                break
            except OSError:  # it has ended, so that our last line was not delivered
                break
        if data is None:
            return None
        try:
            return read_servos(data)
        except PacketError as error:
            self._raise_lost(f"or another program that sends to {self._physics_port}/udp: {error}")

    def _accept(self, packet: ServoPacket) -> None:
        if self._count is not None and packet.frame_count < self._count:
            self._raise_lost(
                f"has restarted: packet {packet.frame_count} came after packet {self._count}"
            )
        self._count = packet.frame_count

    def _send_line(self) -> None:
        if self._udp is not None and self._peer is not None and self._line:
            try:
                self._udp.sendto(self._line, self._peer)
            except OSError:  # it has ended; `_check_wait` reports it
                pass

    def _check_wait(self, waited_s: float, failure: str) -> None:
        """Check for a stop request, the end of the process and the timeout."""
        self._check_stop()
        if self.process is not None and (ended := self.process.exit_text()):
            self._raise_lost(ended)
        if waited_s > self._config.timeout_s:
            timeout = f"nothing in {self._config.timeout_s:g} s (autopilot.timeout_s)"
            self._raise_lost(f"{failure}: {timeout}")

    def _raise_lost(self, reason: str) -> NoReturn:
        text = f"{self.name}: ArduPlane (instance {self._config.instance}) {reason}"
        if self.process is not None:
            raise ExternalProgramLost(f"{text}; {self.process.output_tail()}")
        if self._count is None:
            line = command_line(
                "arduplane",
                self._config.instance,
                self._origin,
                self._config.heading_deg,
                "FILE.parm",
            )
            text += f"; start it with: {' '.join(line)}"
        raise ExternalProgramLost(text)

    def _port_error(self, protocol: str, port: int) -> str:
        return (
            f"{self.name}: {protocol} port {port} of ArduPlane's instance {self._config.instance} "
            "is in use, perhaps by another run (end that, or write another instance under "
            "autopilot)"
        )


def _is_listening(port: int) -> bool:
    """Check whether a program listens on a TCP port of this machine."""
    client = SitlMavlinkClient()
    found = client.connect(port)
    client.close()
    return found
