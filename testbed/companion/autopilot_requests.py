"""What a companion asks its autopilot for: streams, parameters, and the mode of leaving."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from testbed.companion.autopilot_state import EARLIER_NAMES, AutopilotState
from testbed.mavlink.codec import Codec, constant

AGAIN_S = 5.0  # after which a message that has not come as often as asked for is asked for again
PARAMETER_S, PARAMETER_TRIES = 0.2, 5  # between requests, and for one that is not answered
HEARTBEAT_S = 1.0
_ENOUGH = 0.7  # of the messages that were asked for
_CUSTOM_MODE = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
# Hz, of what is known about mode, health and time
STATUS_RATES = {
    "SYSTEM_TIME": 1.0,
    "EKF_STATUS_REPORT": 2.0,
    "GPS_RAW_INT": 2.0,
    "RC_CHANNELS": 5.0,
    "HEARTBEAT": 4.0,  # with the mode; some autopilots send it once a second all the same
}


def heartbeat(codec: Codec) -> bytes:
    """Return the frame by which others know that a companion is there."""
    return codec.pack(
        "HEARTBEAT",
        type=constant("MAV_TYPE_ONBOARD_CONTROLLER"),
        autopilot=constant("MAV_AUTOPILOT_INVALID"),
        base_mode=0,
        custom_mode=0,
        system_status=constant("MAV_STATE_ACTIVE"),
        mavlink_version=3,
    )


class AutopilotRequests:
    """Frames to send to an autopilot.

    Args:
        codec: of the companion.
        system: id of the autopilot.
        streams: messages of the own state, of which the last ends a sample.
        rate_hz: of these messages.
        parameters: names to read, of the present ArduPlane.
    """

    def __init__(
        self,
        codec: Codec,
        system: int,
        streams: Sequence[str],
        rate_hz: float,
        parameters: Sequence[str],
    ) -> None:
        """See the class."""
        self._codec, self._target = codec, {"target_system": system, "target_component": 1}
        self._rates = {**STATUS_RATES, **dict.fromkeys(streams, rate_hz)}
        self._looked: dict[str, tuple[float, int]] = {}  # when, and how many had come
        self._tries = dict.fromkeys(parameters, 0)
        self._parameter_s = self._heartbeat_s = -1e9

    def due(self, state: AutopilotState, now_s: float) -> Iterator[bytes]:
        """Yield the frames to send at a time, s of the monotonic clock."""
        if now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = now_s
            yield heartbeat(self._codec)
        for name, rate_hz in self._rates.items():
            asked_s, count = self._looked.get(name, (-math.inf, 0))
            if now_s - asked_s < AGAIN_S:
                continue
            now_count = state.counts.get(name, 0)
            self._looked[name] = now_s, now_count
            if now_count - count < _ENOUGH * rate_hz * (now_s - asked_s):
                yield self._ask_stream(name, rate_hz)
        if now_s - self._parameter_s >= PARAMETER_S and (name := self._missing(state)):
            self._parameter_s = now_s
            self._tries[name] += 1
            # older versions know it by another name
            earlier = [each for each, (new, _) in EARLIER_NAMES.items() if new == name]
            for each in (name, *earlier):
                yield self._codec.pack(
                    "PARAM_REQUEST_READ", param_id=each, param_index=-1, **self._target
                )

    def has_read(self, state: AutopilotState) -> bool:
        """Whether all parameters were read, or do not exist."""
        return not self._missing(state)

    def restart(self) -> None:
        """Ask for everything again, as of an autopilot that was started again."""
        self._looked.clear()
        self._tries = dict.fromkeys(self._tries, 0)

    def change_mode(self, mode: int) -> bytes:
        """Return the frame that asks for a flight mode."""
        return self._command("MAV_CMD_DO_SET_MODE", float(_CUSTOM_MODE), float(mode))

    def _missing(self, state: AutopilotState) -> str:
        """Return a parameter that was not read; empty: there is none."""
        left = [name for name, tries in self._tries.items() if tries < PARAMETER_TRIES]
        left = [name for name in left if name not in state.parameters]
        return min(left, key=self._tries.__getitem__, default="")

    def _ask_stream(self, name: str, rate_hz: float) -> bytes:
        number = float(constant(f"MAVLINK_MSG_ID_{name}"))
        return self._command("MAV_CMD_SET_MESSAGE_INTERVAL", number, 1e6 / rate_hz)

    def _command(self, name: str, first: float, second: float) -> bytes:
        rest = dict.fromkeys((f"param{k}" for k in range(3, 8)), 0.0)
        return self._codec.pack(
            "COMMAND_LONG",
            command=constant(name),
            confirmation=0,
            param1=first,
            param2=second,
            **rest,
            **self._target,
        )
