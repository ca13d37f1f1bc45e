"""A MAVLink client in a test: a UDP socket and the testbed's codec."""

import math
import socket
import time

from waiting import TIMEOUT_S

from testbed.mavlink.codec import Codec

SYSTEM, COMPONENT = 250, 190


class MavlinkClient:
    """Receives from a run that was given its address, and sends to it.

    Received frames are accepted with any signature.
    """

    def __init__(self, port=0, signing=None):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.bind(("127.0.0.1", port))
        self._receiver, self.codec = Codec(SYSTEM, COMPONENT), Codec(SYSTEM, COMPONENT, signing)
        self._peer = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()

    @property
    def address(self):
        """The value of --mavlink."""
        return f"udpout:127.0.0.1:{self._socket.getsockname()[1]}"

    def receive(self, seconds=0.2):
        """Return the messages of the next datagram; none after this time."""
        self._socket.settimeout(seconds)
        try:
            data, self._peer = self._socket.recvfrom(2048)
        except TimeoutError:
            return []
        return self._receiver.feed(data, datagram=True)

    def messages_until_end(self, flight):
        """Yield the received messages until the run ends."""
        stop = time.monotonic() + TIMEOUT_S
        while flight.process.poll() is None:
            assert time.monotonic() < stop, flight.output
            yield from self.receive()

    def wait_for(self, flight, name, holds=lambda message: True):
        """Return the first message of this name for which the condition holds."""
        for message in self.messages_until_end(flight):
            if message.name == name and holds(message):
                return message
        raise AssertionError(f"no {name}: {flight.output}")

    def send(self, name, **fields):
        self.send_bytes(self.codec.pack(name, **fields))

    def send_bytes(self, data):
        self._socket.sendto(data, self._peer)

    def command(self, system, command, *numbers):
        """Send a COMMAND_LONG."""
        values = (*numbers, *[0.0] * (7 - len(numbers)))
        self.send(
            "COMMAND_LONG",
            target_system=system,
            target_component=1,
            command=command,
            confirmation=0,
            **{f"param{k}": value for k, value in enumerate(values, 1)},
        )

    def attitude(self, system, roll, pitch, thrust, *, boot_ms=0):
        """Send a SET_ATTITUDE_TARGET with heading north."""
        half_roll, half_pitch = 0.5 * roll, 0.5 * pitch
        self.send(
            "SET_ATTITUDE_TARGET",
            time_boot_ms=boot_ms,
            target_system=system,
            target_component=1,
            type_mask=7,  # no rates
            q=(
                math.cos(half_roll) * math.cos(half_pitch),
                math.sin(half_roll) * math.cos(half_pitch),
                math.cos(half_roll) * math.sin(half_pitch),
                -math.sin(half_roll) * math.sin(half_pitch),
            ),
            body_roll_rate=0.0,
            body_pitch_rate=0.0,
            body_yaw_rate=0.0,
            thrust=thrust,
        )
