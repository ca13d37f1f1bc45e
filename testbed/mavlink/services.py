"""Small MAVLink services: FTP, onboard logs, time synchronisation, ping, data streams, radios."""

from __future__ import annotations

import struct
from collections.abc import Mapping

from testbed.mavlink.codec import Message
from testbed.mavlink.outgoing import Fields, Handler, OutgoingMessage, sender_of
from testbed.mavlink.telemetry_messages import MessageSchedule
from testbed.mavlink.vehicle_context import VehicleContext

# https://mavlink.io/en/services/ftp.html: sequence, session, opcode, size, requested opcode,
# burst, padding, offset
_FTP = struct.Struct("<HBBBBBBI")
_ACK, _NAK, _FAIL = 128, 129, 1


class Services:
    """Answer requests that need no access to the aircraft."""

    def __init__(self, context: VehicleContext, schedule: MessageSchedule) -> None:
        self._context, self._schedule = context, schedule
        self.handlers: Mapping[str, Handler] = {
            "FILE_TRANSFER_PROTOCOL": self._ftp,
            "LOG_REQUEST_LIST": self._logs,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "REQUEST_DATA_STREAM": self._stream,
            "RADIO_STATUS": self._radio,
        }

    def _ftp(self, message: Message) -> list[OutgoingMessage]:
        """Answer every operation with a NAK, as there are no files; ground stations go on."""
        payload = message.fields["payload"]
        assert isinstance(payload, tuple)
        sequence, session, opcode, *_ = _FTP.unpack(bytes(map(int, payload[: _FTP.size])))
        if opcode >= _ACK:
            return []  # an answer is not answered
        head = _FTP.pack((sequence + 1) % 65536, session, _NAK, 1, opcode, 0, 0, 0)
        fields: Fields = {"target_network": 0, "payload": head + bytes([_FAIL])}
        fields |= sender_of(message).target
        return [OutgoingMessage("FILE_TRANSFER_PROTOCOL", fields)]

    def _logs(self, message: Message) -> list[OutgoingMessage]:
        """Answer that there are no logs."""
        names = ("id", "num_logs", "last_log_num", "time_utc", "size")
        return [OutgoingMessage("LOG_ENTRY", dict.fromkeys(names, 0))]

    def _timesync(self, message: Message) -> list[OutgoingMessage]:
        """Answer with the simulation time, ns."""
        if int(message.number("tc1")) != 0:
            return []  # an answer
        snapshot = self._context.snapshot
        now_ns = 0 if snapshot is None else round(snapshot.sample.time_s * 1e9)
        return [OutgoingMessage("TIMESYNC", {"tc1": max(now_ns, 1), "ts1": message.fields["ts1"]})]

    def _ping(self, message: Message) -> list[OutgoingMessage]:
        if int(message.number("target_system")) != 0:
            return []  # an answer
        echo: Fields = {name: message.fields[name] for name in ("time_usec", "seq")}
        return [OutgoingMessage("PING", echo | sender_of(message).target)]

    def _stream(self, message: Message) -> list[OutgoingMessage]:
        """Set the rate of a group of messages, as older ground stations request it."""
        rate_hz = message.number("req_message_rate")
        started = int(message.number("start_stop")) == 1
        stream = int(message.number("req_stream_id"))
        self._schedule.set_stream(stream, rate_hz if started else 0.0)
        return []

    def _radio(self, message: Message) -> list[OutgoingMessage]:
        """Send telemetry slower while the radio's buffer is full, as ArduPilot does."""
        radio = self._context.radio
        radio.report(int(message.number("txbuf")), self._context.wall_s)
        self._schedule.slowdown_us = 1000 * radio.slowdown_ms
        return []
