"""MAVLink over TCP to one ArduPlane, for what its physics link does not transfer."""

from __future__ import annotations

import select
import socket
from collections.abc import Iterable, Mapping

from testbed.mavlink.codec import Codec, Message, constant

FBWA = 5  # ArduPlane's number of fly-by-wire A
_SYSTEM, _COMPONENT = 255, 190  # a ground station, whose overrides ArduPlane accepts by default
_FORCE = 21196.0  # of MAV_CMD_COMPONENT_ARM_DISARM: skip the checks
_WARNING = 4  # MAV_SEVERITY_WARNING; smaller numbers are more severe
_MAX_BYTES = 1 << 16
_TIMEOUT_S = 0.2  # of connecting to a port of this machine
_OVERRIDES = 8  # channels of a short RC_CHANNELS_OVERRIDE


class SitlMavlinkClient:
    """Send requests to one ArduPlane, and store its state and answers.

    Attributes:
        mode: number of its mode; None: not received yet.
        armed: whether it is armed.
        parameters: values received so far.
        version: as "4.6.1 (1a2b3c4d)"; None: not received yet.
        rc_channels: pulses of its receiver by its latest RC_CHANNELS, µs, channel 1 first.
        texts: (severity, text) of its STATUSTEXTs since the last `pop_texts`.
        disconnected: it has closed the connection.
    """

    def __init__(self) -> None:
        self._socket: socket.socket | None = None
        self._codec = Codec(_SYSTEM, _COMPONENT)
        self._target = {"target_system": 1, "target_component": 1}
        self.mode: int | None = None
        self.armed = False
        self.version: str | None = None
        self.parameters: dict[str, float] = {}
        self.rc_channels: tuple[int, ...] = ()
        self.texts: list[tuple[int, str]] = []
        self.disconnected = False

    def connect(self, port: int) -> bool:
        """Try once to connect to a port of this machine."""
        try:
            self._socket = socket.create_connection(("127.0.0.1", port), timeout=_TIMEOUT_S)
        except OSError:
            return False
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()

    def receive(self, wait_s: float = 0.0) -> None:
        """Handle all received messages; without any, wait at most this wall-clock time, s."""
        if self._socket is not None and wait_s > 0.0 and not self.disconnected:
            select.select([self._socket], [], [], wait_s)
        while self._socket is not None and not self.disconnected:
            try:
                data = self._socket.recv(_MAX_BYTES)
            except BlockingIOError:
                break
            except OSError:
                data = b""
            if not data:
                self.disconnected = True
                break
            for message in self._codec.feed(data):
                self._handle(message)

    def request_parameters(self, names: Iterable[str]) -> None:
        """Request the values of parameters."""
        for name in names:
            self._send("PARAM_REQUEST_READ", param_id=name, param_index=-1)

    def arm(self) -> None:
        """Request forced arming."""
        self._send_command("MAV_CMD_COMPONENT_ARM_DISARM", 1.0, _FORCE)

    def change_mode(self, mode: int) -> None:
        """Request a mode."""
        custom = float(constant("MAV_MODE_FLAG_CUSTOM_MODE_ENABLED"))
        self._send_command("MAV_CMD_DO_SET_MODE", custom, mode)

    def request_message(self, name: str) -> None:
        """Request a message, e.g. RC_CHANNELS."""
        number = float(constant(f"MAVLINK_MSG_ID_{name}"))
        self._send_command("MAV_CMD_REQUEST_MESSAGE", number)

    def override_rc(self, pulses: tuple[int, ...]) -> None:
        """Override the pulses of its receiver, µs."""
        channels = {f"chan{n}_raw": pulse for n, pulse in enumerate(pulses[:_OVERRIDES], start=1)}
        ignored = {f"chan{n}_raw": 65535 for n in range(len(pulses) + 1, _OVERRIDES + 1)}
        self._send("RC_CHANNELS_OVERRIDE", **channels, **ignored)

    def pop_texts(self) -> list[tuple[bool, str]]:
        """Return the texts since the last call: whether each is a warning, and the text."""
        texts, self.texts = self.texts, []
        return [(severity <= _WARNING, text) for severity, text in texts]

    def _send_command(self, name: str, *values: float) -> None:
        params = dict(zip((f"param{n}" for n in range(1, 8)), (*values, *(0.0,) * 7), strict=False))
        self._send("COMMAND_LONG", command=constant(name), confirmation=0, **params)

    def _send(self, name: str, **fields: float | str) -> None:
        if self._socket is None or self.disconnected:
            return
        try:
            self._socket.sendall(self._codec.pack(name, **self._target, **fields))
        except OSError:  # also a full buffer: it reads nothing any more
            self.disconnected = True

    def _handle(self, message: Message) -> None:
        fields: Mapping[str, object] = message.fields
        if message.name == "HEARTBEAT":
            if message.number("autopilot") != constant("MAV_AUTOPILOT_ARDUPILOTMEGA"):
                return
            self._target = {"target_system": message.system, "target_component": message.component}
            armed = constant("MAV_MODE_FLAG_SAFETY_ARMED")
            self.armed = bool(int(message.number("base_mode")) & armed)
            self.mode = int(message.number("custom_mode"))
        elif message.name == "PARAM_VALUE":
            self.parameters[str(fields["param_id"])] = message.number("param_value")
        elif message.name == "AUTOPILOT_VERSION":
            self.version = _version(message)
        elif message.name == "RC_CHANNELS":
            count = int(message.number("chancount"))
            self.rc_channels = tuple(
                int(message.number(f"chan{n}_raw")) for n in range(1, min(count, 18) + 1)
            )
        elif message.name == "STATUSTEXT":
            text = " ".join(str(fields["text"]).split())  # some have tabs
            self.texts.append((int(message.number("severity")), text))


def _version(message: Message) -> str:
    """Format major, minor and patch, a byte each, and the source hash in ASCII."""
    major, minor, patch, _ = int(message.number("flight_sw_version")).to_bytes(4, "big")
    digits = message.fields["flight_custom_version"]
    source = bytes(int(each) for each in digits) if isinstance(digits, tuple) else b""
    text = source.split(b"\0", 1)[0].decode("ascii", "replace")
    return f"{major}.{minor}.{patch}" + (f" ({text})" if text else "")
