"""One ArduPlane (SITL) that flies one aircraft in lockstep.

ArduPlane sends servo pulses and waits for the state one time step later. Its time is that of the
states; wall-clock time serves only for timeouts.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from testbed.ardupilot.json_physics import (
    PacketError,
    RcChannels,
    ServoOutputs,
    ServoPacket,
    inputs_text,
    motion_text,
    read_servos,
)
from testbed.ardupilot.sitl_mavlink import FBWA, SitlMavlinkClient
from testbed.ardupilot.sitl_parameters import defaults_text
from testbed.ardupilot.sitl_process import SitlProcess, command_line, find_binary
from testbed.ardupilot.startup import StartupSequence
from testbed.core.errors import ExternalProgramLost, InputError
from testbed.core.records import FbwaCommand, NedOrigin

HOST = "127.0.0.1"
_PHYSICS_PORT, _MAVLINK_PORT, _RC_PORT = 9002, 5760, 5501  # of instance 0
_PORT_STEP = 10  # per instance
INSTANCES = range(251)
_POLL_S = 0.1  # between two checks of the process
_REPEAT_S = 0.5  # without a state it repeats its pulses, after 1 or 10 s depending on the version
_MAX_BYTES = 2048
_IDLE = (1500, 1500, 1000, 1500)  # µs, before its parameters are known


def ports(instance: int) -> tuple[int, int]:
    """Return the ports of an instance: physics (UDP) and first MAVLink (TCP).

    Two more MAVLink ports are 2 and 3 above the first.
    """
    return _PHYSICS_PORT + _PORT_STEP * instance, _MAVLINK_PORT + _PORT_STEP * instance


def open_ports(instance: int) -> tuple[int, tuple[int, int, int]]:
    """Return the ports that ArduPlane opens on every address: RC input (UDP), MAVLink (TCP)."""
    mavlink = ports(instance)[1]
    return _RC_PORT + _PORT_STEP * instance, (mavlink, mavlink + 2, mavlink + 3)


@dataclass(frozen=True, slots=True)
class SitlConfig:
    """Configuration of an aircraft that ArduPlane flies."""

    name: str
    instances: Sequence[int]  # that it may have; the first one with free ports is used
    start: bool  # start the process; false: wait for one that is started elsewhere
    tune: Path  # parameter file
    timeout_s: float
    heading_deg: float  # at the start
    elevon_mixing: float  # of its airframe; NaN where it has none


class SitlVehicle:
    """The ArduPlane of one aircraft.

    Call `start` and `start_up` once; then `set_command` when the command changes, `set_inputs` at
    the autopilot rate, and `send_state` and `receive_pwm` at each tick.
    """

    def __init__(
        self, config: SitlConfig, origin: NedOrigin, *, physics_hz: int, autopilot_hz: int
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
        self.instance = config.instances[0]
        self._udp: socket.socket | None = None
        self._peer: tuple[str, int] | None = None
        self._count: int | None = None  # frame_count of the latest packet
        self._states_sent, self._sent_s = 0, 0.0
        self._line, self._inputs = b"", ""
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
        return find_binary(arduplane) if self._config.start else None

    def start(self, arduplane: Path | None, check_stop: Callable[[], None]) -> None:
        """Open the physics port, and start the process unless it is started elsewhere.

        Args:
            arduplane: of the command line.
            check_stop: called at least every `_POLL_S` in every wait; may raise.

        Raises:
            InputError: there is no binary, or no instance has free ports.
        """
        self._check_stop = check_stop
        config, binary = self._config, self.find(arduplane)
        self._udp = self._claim_ports(starts=binary is not None)
        _set_receive_timeout(self._udp, _POLL_S)
        if binary:
            physics_hz, autopilot_hz = self._rates
            text = defaults_text(config.tune, physics_hz=physics_hz, autopilot_hz=autopilot_hz)
            self.process = SitlProcess(
                binary, self.instance, self._origin, config.heading_deg, text
            )

    def start_up(
        self,
        motion: Sequence[float],
        inputs: tuple[Sequence[float], float, float],
        command: FbwaCommand[float],
    ) -> str | None:
        """Boot it in a constant state until it is in fly-by-wire A and receives RC.

        Args:
            motion: a row of `pack_motion`, at the start.
            inputs: of `set_inputs`, at the start.
            command: during startup.

        Returns:
            The text of an event, if there is one.

        Raises:
            ExternalProgramLost: it does not appear, ends, or does not become ready.
            InputError: it cannot be flown with its parameters.
        """
        start, port = time.monotonic(), ports(self.instance)[1]
        while not self.client.connect(port):
            self._check_wait(time.monotonic() - start, f"does not listen on {port}/tcp")
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
            self.set_inputs(*inputs)
            self.send_state(motion)
            self.receive_pwm()
        self._rc_channels, self._servo_outputs = startup.rc_channels, startup.servo_outputs
        self._overrides = startup.overrides
        if self._overrides:
            return "takes no rc from the physics link: commanded by RC_CHANNELS_OVERRIDE"
        return None

    def set_command(self, command: FbwaCommand[float]) -> None:
        """Set the stick input that is sent with the next state."""
        assert self._rc_channels is not None
        self._pulses = self._rc_channels.pulses(command)
        if self._overrides:
            self.client.override_rc(self._pulses)

    def set_inputs(self, wind_ned: Sequence[float], pitot: float, voltage: float) -> None:
        """Set what is sent with the next states besides motion; see `inputs_text`."""
        self._inputs = inputs_text(wind_ned, pitot, voltage, self._pulses)

    def send_state(self, motion: Sequence[float]) -> None:
        """Send the current motion, upon which it computes one tick; see `motion_text`."""
        now = time.monotonic()
        if now - self._sent_s > _REPEAT_S:
            self._drop_repetitions()
        self._sent_s = now
        self._states_sent += 1
        time_s = self._states_sent / self._rates[0]
        self._line = (motion_text(time_s, motion) + self._inputs).encode()
        self._send_line()

    def receive_pwm(self) -> tuple[int, ...]:
        """Wait for the servo pulses that answer the last state, µs.

        Raises:
            ExternalProgramLost: it has ended, does not answer, has restarted, or sends other
                packets.
        """
        packet = self._receive()
        if packet is None or packet.frame_count == self._count:
            packet = self._wait_for_pwm(packet)
        if self._count is not None and packet.frame_count < self._count:
            self._raise_lost(
                f"has restarted: packet {packet.frame_count} came after packet {self._count}"
            )
        self._count = packet.frame_count
        return packet.pulses

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

    def _receive(self) -> ServoPacket | None:
        """Return the next packet, or None after `_POLL_S` without one."""
        if self._udp is None:
            return None
        try:
            data, self._peer = self._udp.recvfrom(_MAX_BYTES)
        except OSError:  # none yet, or it has ended, so that our last line was not delivered
            return None
        try:
            return read_servos(data)
        except PacketError as error:
            port = ports(self.instance)[0]
            self._raise_lost(f"or another program that sends to {port}/udp: {error}")

    def _wait_for_pwm(self, packet: ServoPacket | None) -> ServoPacket:
        """Wait for the next servo pulses, after a repetition or none."""
        start = time.monotonic()
        while packet is None or packet.frame_count == self._count:
            if packet is not None:
                self._send_line()  # a repetition: the state was lost
            self.client.receive()
            self._check_wait(time.monotonic() - start, "does not answer")
            packet = self._receive()
        return packet

    def _drop_repetitions(self) -> None:
        """Drop the packets that it repeated while the run was paused: the next state answers."""
        if self._udp is not None:
            self._udp.setblocking(False)
            while self._receive():
                pass
            self._udp.setblocking(True)

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
        text = f"{self.name}: ArduPlane (instance {self.instance}) {reason}"
        if self.process is not None:
            raise ExternalProgramLost(f"{text}; {self.process.output_tail()}")
        if self._count is None:
            line = command_line(
                "arduplane", self.instance, self._origin, self._config.heading_deg, "FILE.parm"
            )
            text += f"; start it with: {' '.join(line)}"
        raise ExternalProgramLost(text)

    def _claim_ports(self, *, starts: bool) -> socket.socket:
        """Bind the physics port of the first instance with free ports.

        Args:
            starts: ArduPlane is started next, so that its own ports must be free too.

        Raises:
            InputError: no instance has free ports.
        """
        reasons = []
        for instance in self._config.instances:
            udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            port = ports(instance)[0]
            # of two runs that try the same instance one can bind its port
            used = None if _binds(udp, HOST, port) else f"UDP port {port}"
            if starts and not used:
                used = _used_port(instance)
            if not used:
                self.instance = instance
                return udp
            udp.close()
            reasons.append(f"{used} of ArduPlane's instance {instance}")
        others = f", and so are ports of the {len(reasons) - 1} others" if len(reasons) > 1 else ""
        raise InputError(
            f"{self.name}: {reasons[0]} is in use{others}, by another run or by an arduplane that "
            "runs without one (end it, or write another instance under autopilot)"
        )


def _set_receive_timeout(udp: socket.socket, timeout_s: float) -> None:
    """Set the timeout in the kernel: a system call less per packet than `settimeout`."""
    seconds, rest = divmod(timeout_s, 1.0)
    timeval = struct.pack("ll", int(seconds), round(1e6 * rest))
    udp.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval)


def _binds(endpoint: socket.socket, host: str, port: int) -> bool:
    """Bind a socket; False if the port is in use."""
    try:
        endpoint.bind((host, port))
    except OSError:
        return False
    return True


def _used_port(instance: int) -> str | None:
    """Name a port of an instance that another program has opened; None: all are free."""
    rc, tcp = open_ports(instance)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        if not _binds(udp, "", rc):
            return f"UDP port {rc}"
    for port in tcp:
        # A connection could be the one that another ArduPlane waits for. With this option, as in
        # ArduPlane, closed connections that have not timed out are no conflict, listeners are.
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if not _binds(listener, "", port):
                return f"TCP port {port}"
    return None
