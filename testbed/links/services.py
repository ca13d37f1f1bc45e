"""What ground stations also ask, and what a virtual vehicle answers: mostly, that it has none."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from testbed.links.craft import Craft
from testbed.links.replies import Fields, Handler, Reply, asker
from testbed.links.schedule import Schedule
from testbed.mavlink.door import Message

# https://mavlink.io/en/services/ftp.html: sequence, session, operation, size, what was asked,
# burst, padding, offset
_FTP = struct.Struct("<HBBBBBBI")
_NAK, _FAIL = 129, 1


class Services:
    """Files, logs, clocks, and streams by their old names."""

    def __init__(self, craft: Craft, schedule: Schedule) -> None:
        """Ready for any."""
        self._craft, self._schedule = craft, schedule
        self.handlers: Mapping[str, Handler] = {
            "FILE_TRANSFER_PROTOCOL": self._ftp,
            "LOG_REQUEST_LIST": self._logs,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "REQUEST_DATA_STREAM": self._stream,
        }

    def _ftp(self, message: Message, at_s: float) -> list[Reply]:
        """There are no files: ground stations go on without."""
        payload = message.fields["payload"]
        assert isinstance(payload, tuple)
        sequence, session, operation, *_ = _FTP.unpack(bytes(map(int, payload[: _FTP.size])))
        if operation >= _NAK - 1:
            return []  # an answer is not to be answered
        head = _FTP.pack((sequence + 1) % 65536, session, _NAK, 1, operation, 0, 0, 0)
        fields: Fields = {"target_network": 0, "payload": head + bytes([_FAIL])}
        fields |= asker(message).target
        return [Reply("FILE_TRANSFER_PROTOCOL", fields)]

    def _logs(self, message: Message, at_s: float) -> list[Reply]:
        """The vehicle keeps none."""
        nothing = ("id", "num_logs", "last_log_num", "time_utc", "size")
        return [Reply("LOG_ENTRY", dict.fromkeys(nothing, 0))]

    def _timesync(self, message: Message, at_s: float) -> list[Reply]:
        """Tell the time of the simulation, ns."""
        if int(message.number("tc1")) != 0:
            return []  # an answer
        scene = self._craft.scene
        now_ns = 0 if scene is None else round(scene.frame.time_s * 1e9)
        return [Reply("TIMESYNC", {"tc1": max(now_ns, 1), "ts1": message.fields["ts1"]})]

    def _ping(self, message: Message, at_s: float) -> list[Reply]:
        if int(message.number("target_system")) != 0:
            return []  # an answer
        echo: Fields = {name: message.fields[name] for name in ("time_usec", "seq")}
        return [Reply("PING", echo | asker(message).target)]

    def _stream(self, message: Message, at_s: float) -> list[Reply]:
        """A group of messages at one rate, as ArduPilot's older ground stations ask for it."""
        rate_hz = message.number("req_message_rate")
        started = int(message.number("start_stop")) == 1
        stream = int(message.number("req_stream_id"))
        self._schedule.set_stream(stream, rate_hz if started else 0.0)
        return []
