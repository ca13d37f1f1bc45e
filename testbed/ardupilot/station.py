"""A ground station of one ArduPlane: its MAVLink over TCP, for what the physics link cannot say."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterable, Mapping

from testbed.mavlink.door import Codec, Message, number

FBWA = 5  # ArduPlane's number of fly-by-wire A
_SYSTEM, _COMPONENT = 255, 190  # a ground station, whose overrides ArduPlane takes by default
_FORCE = 21196.0  # of MAV_CMD_COMPONENT_ARM_DISARM: whatever the checks say
_LOUD = 4  # MAV_SEVERITY_WARNING; a smaller number is more severe
_MOST_BYTES = 1 << 16
_PATIENCE_S = 0.2  # for connecting to a port of this machine
_OVERRIDES = 8  # channels of a short RC_CHANNELS_OVERRIDE


class Station:
    """What one ArduPlane said and is told.

    Attributes:
        mode: its number of its mode; None: not heard yet.
        armed: whether it said so.
        parameters: those it was asked for.
        version: of itself, as "4.6.1 (1a2b3c4d)"; None: not heard yet.
        receiver: the pulses it last said to receive, µs, channel 1 first.
        said: (severity, text) of its messages, until they are taken.
        lost: it hung up.
    """

    def __init__(self) -> None:
        """Not connected."""
        self._socket: socket.socket | None = None
        self._codec = Codec(_SYSTEM, _COMPONENT)
        self._target = {"target_system": 1, "target_component": 1}
        self.mode: int | None = None
        self.armed = False
        self.version: str | None = None
        self.parameters: dict[str, float] = {}
        self.receiver: tuple[int, ...] = ()
        self.said: list[tuple[int, str]] = []
        self.lost = False

    @property
    def connected(self) -> bool:
        """Whether it was ever reached."""
        return self._socket is not None

    def connect(self, port: int) -> bool:
        """Try once to reach it on this machine."""
        try:
            self._socket = socket.create_connection(("127.0.0.1", port), timeout=_PATIENCE_S)
        except OSError:
            return False
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True

    def close(self) -> None:
        """Hang up."""
        if self._socket is not None:
            self._socket.close()

    def listen(self, wait_s: float = 0.0) -> None:
        """Take in everything that has come; with nothing there, wait this long for something."""
        if self._socket is not None and wait_s > 0.0 and not self.lost:
            select.select([self._socket], [], [], wait_s)
        while self._socket is not None and not self.lost:
            try:
                data = self._socket.recv(_MOST_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self.lost = True
                break
            for message in self._codec.feed(data):
                self._take(message)

    def ask_parameters(self, names: Iterable[str]) -> None:
        """Ask for the values of these."""
        for name in names:
            self._send("PARAM_REQUEST_READ", param_id=name, param_index=-1)

    def arm(self) -> None:
        """Have the motor turn."""
        self._command("MAV_CMD_COMPONENT_ARM_DISARM", 1.0, _FORCE)

    def change_mode(self, mode: int) -> None:
        """Have it fly in this mode."""
        self._command(
            "MAV_CMD_DO_SET_MODE", float(number("MAV_MODE_FLAG_CUSTOM_MODE_ENABLED")), mode
        )

    def ask_version(self) -> None:
        """Ask which it is."""
        self._command("MAV_CMD_REQUEST_MESSAGE", float(number("MAVLINK_MSG_ID_AUTOPILOT_VERSION")))

    def ask_receiver(self) -> None:
        """Ask for the pulses it receives."""
        self._command("MAV_CMD_REQUEST_MESSAGE", float(number("MAVLINK_MSG_ID_RC_CHANNELS")))

    def override(self, pulses: tuple[int, ...]) -> None:
        """Have it take these pulses, µs, for those of its receiver."""
        channels = {f"chan{n}_raw": pulse for n, pulse in enumerate(pulses[:_OVERRIDES], start=1)}
        silent = {f"chan{n}_raw": 65535 for n in range(len(pulses) + 1, _OVERRIDES + 1)}
        self._send("RC_CHANNELS_OVERRIDE", **channels, **silent)

    def take_texts(self) -> list[tuple[bool, str]]:
        """What it said since: whether it is a warning, and the text."""
        said, self.said = self.said, []
        return [(severity <= _LOUD, text) for severity, text in said]

    def _command(self, name: str, *values: float) -> None:
        given = dict(zip((f"param{n}" for n in range(1, 8)), (*values, *(0.0,) * 7), strict=False))
        self._send("COMMAND_LONG", command=number(name), confirmation=0, **given)

    def _send(self, name: str, **fields: float | str) -> None:
        if self._socket is None or self.lost:
            return
        try:
            self._socket.sendall(self._codec.pack(name, **self._target, **fields))
        except OSError:  # what we say is said again; one that takes nothing in has hung up
            self.lost = True

    def _take(self, message: Message) -> None:
        fields: Mapping[str, object] = message.fields
        if message.name == "HEARTBEAT":
            if message.number("autopilot") != number("MAV_AUTOPILOT_ARDUPILOTMEGA"):
                return
            self._target = {
                "target_system": message.system,
                "target_component": message.component,
            }
            armed = number("MAV_MODE_FLAG_SAFETY_ARMED")
            self.armed = bool(int(message.number("base_mode")) & armed)
            self.mode = int(message.number("custom_mode"))
        elif message.name == "PARAM_VALUE":
            self.parameters[str(fields["param_id"])] = message.number("param_value")
        elif message.name == "AUTOPILOT_VERSION":
            self.version = _version(message)
        elif message.name == "RC_CHANNELS":
            count = int(message.number("chancount"))
            self.receiver = tuple(
                int(message.number(f"chan{n}_raw")) for n in range(1, min(count, 18) + 1)
            )
        elif message.name == "STATUSTEXT":
            self.said.append((int(message.number("severity")), str(fields["text"])))


def _version(message: Message) -> str:
    """Major, minor and patch, a byte each, and the source's hash as ArduPlane writes it."""
    major, minor, patch, _ = int(message.number("flight_sw_version")).to_bytes(4, "big")
    digits = message.fields["flight_custom_version"]
    source = bytes(int(each) for each in digits) if isinstance(digits, tuple) else b""
    words = source.split(b"\0", 1)[0].decode("ascii", "replace")
    return f"{major}.{minor}.{patch}" + (f" ({words})" if words else "")
