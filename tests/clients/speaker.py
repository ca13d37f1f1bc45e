"""A program outside, played by a test: one socket of loopback and our own MAVLink."""

import math
import socket
import time

from patience import PATIENCE_S

from testbed.mavlink.door import Codec

SYSTEM, COMPONENT = 250, 190


class Speaker:
    """Hears a run that was given its address, and speaks to it.

    What it hears is believed whatever its signature.
    """

    def __init__(self, port=0, signing=None):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        self._socket.bind(("127.0.0.1", port))
        self._ear, self.mouth = Codec(SYSTEM, COMPONENT), Codec(SYSTEM, COMPONENT, signing)
        self._peer = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()

    @property
    def address(self):
        """For --mavlink."""
        return f"udpout:127.0.0.1:{self._socket.getsockname()[1]}"

    def hear(self, seconds=0.2):
        """The messages of the next datagram; none in that time."""
        self._socket.settimeout(seconds)
        try:
            data, self._peer = self._socket.recvfrom(2048)
        except TimeoutError:
            return []
        return self._ear.feed(data, whole=True)

    def hear_while(self, flight):
        """All that is heard until the flight is over."""
        stop = time.monotonic() + PATIENCE_S
        while flight.process.poll() is None:
            assert time.monotonic() < stop, flight.said
            yield from self.hear()

    def wait_for(self, flight, name, holds=lambda message: True):
        """The first message of this name for which this holds."""
        for message in self.hear_while(flight):
            if message.name == name and holds(message):
                return message
        raise AssertionError(f"no {name}: {flight.said}")

    def say(self, name, **fields):
        self.send(self.mouth.pack(name, **fields))

    def send(self, data):
        self._socket.sendto(data, self._peer)

    def command(self, system, command, *numbers):
        """A COMMAND_LONG."""
        values = (*numbers, *[0.0] * (7 - len(numbers)))
        self.say(
            "COMMAND_LONG",
            target_system=system,
            target_component=1,
            command=command,
            confirmation=0,
            **{f"param{k}": value for k, value in enumerate(values, 1)},
        )

    def attitude(self, system, roll, pitch, thrust, *, boot_ms=0):
        """A SET_ATTITUDE_TARGET with heading north."""
        half_roll, half_pitch = 0.5 * roll, 0.5 * pitch
        self.say(
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
