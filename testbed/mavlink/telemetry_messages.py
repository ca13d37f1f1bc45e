"""The telemetry messages of a vehicle, with default rates and ArduPilot's stream groups."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from testbed.mavlink import telemetry_motion as motion
from testbed.mavlink import telemetry_status as status
from testbed.mavlink.codec import constant
from testbed.mavlink.outgoing import Fields, OutgoingMessage
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.vehicle_context import VehicleContext

FieldBuilder = Callable[[VehicleContext, TelemetrySnapshot], Fields | None]

HEARTBEAT, ATTITUDE = "HEARTBEAT", "ATTITUDE"
LOCKSTEP_STATE = ("LOCAL_POSITION_NED", ATTITUDE)  # sent with every sample in lockstep
# Sent with every sample to companion computers that the run starts.
COMPANION_STATE = ("GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "VFR_HUD", "SCALED_IMU", ATTITUDE)


class Stream(IntEnum):
    """Groups of messages for REQUEST_DATA_STREAM: MAV_DATA_STREAM."""

    ALL = 0
    EXTENDED_STATUS = 2
    RC_CHANNELS = 3
    POSITION = 6
    EXTRA1 = 10
    EXTRA2 = 11
    EXTRA3 = 12


@dataclass(frozen=True, slots=True)
class TelemetryMessage:
    """One telemetry message.

    Attributes:
        build: computes its fields; None: this aircraft does not have the message.
        rate_hz: default rate; 0: only on request.
        stream: its group; None: none.
    """

    build: FieldBuilder
    rate_hz: float = 0.0
    stream: Stream | None = None


TELEMETRY_MESSAGES: Mapping[str, TelemetryMessage] = {
    HEARTBEAT: TelemetryMessage(status.heartbeat, 1.0),
    "SYS_STATUS": TelemetryMessage(status.sys_status, 2.0, Stream.EXTENDED_STATUS),
    "MISSION_CURRENT": TelemetryMessage(status.mission_current, 1.0, Stream.EXTENDED_STATUS),
    "GPS_RAW_INT": TelemetryMessage(motion.gps_raw_int, 5.0, Stream.EXTENDED_STATUS),
    "NAV_CONTROLLER_OUTPUT": TelemetryMessage(
        motion.nav_controller_output, 2.0, Stream.EXTENDED_STATUS
    ),
    "GLOBAL_POSITION_INT": TelemetryMessage(motion.global_position_int, 10.0, Stream.POSITION),
    "LOCAL_POSITION_NED": TelemetryMessage(motion.local_position_ned, 10.0, Stream.POSITION),
    "SERVO_OUTPUT_RAW": TelemetryMessage(motion.servo_output_raw, 4.0, Stream.RC_CHANNELS),
    "RC_CHANNELS": TelemetryMessage(motion.rc_channels, 4.0, Stream.RC_CHANNELS),
    "ATTITUDE_QUATERNION": TelemetryMessage(motion.attitude_quaternion, 10.0, Stream.EXTRA1),
    "VFR_HUD": TelemetryMessage(motion.vfr_hud, 4.0, Stream.EXTRA2),
    "SYSTEM_TIME": TelemetryMessage(status.system_time, 1.0, Stream.EXTRA3),
    "WIND": TelemetryMessage(motion.wind, 1.0, Stream.EXTRA3),
    "BATTERY_STATUS": TelemetryMessage(status.battery_status, 1.0, Stream.EXTRA3),
    "EKF_STATUS_REPORT": TelemetryMessage(status.ekf_status_report, 1.0, Stream.EXTRA3),
    "VIBRATION": TelemetryMessage(status.vibration, 1.0, Stream.EXTRA3),
    "EXTENDED_SYS_STATE": TelemetryMessage(status.extended_sys_state, 1.0),
    "HOME_POSITION": TelemetryMessage(status.home_position, 0.1),
    "NAMED_VALUE_FLOAT": TelemetryMessage(motion.formation_error, 2.0),
    "SCALED_IMU": TelemetryMessage(motion.scaled_imu),
    "AOA_SSA": TelemetryMessage(motion.aoa_ssa),
    "GPS_GLOBAL_ORIGIN": TelemetryMessage(status.gps_global_origin),
    "AUTOPILOT_VERSION": TelemetryMessage(status.autopilot_version),
    # the last of a sample, so that a program that answers it has received the rest
    ATTITUDE: TelemetryMessage(motion.attitude, 10.0, Stream.EXTRA1),
}


def build_message(name: str, context: VehicleContext) -> list[OutgoingMessage]:
    """Build a telemetry message; before the first sample only the heartbeat is available."""
    if name == HEARTBEAT:
        return [OutgoingMessage(name, status.heartbeat(context))]
    if context.snapshot is None:
        return []
    fields = TELEMETRY_MESSAGES[name].build(context, context.snapshot)
    return [] if fields is None else [OutgoingMessage(name, fields)]


DISABLED = -1  # in place of an interval, as in MESSAGE_INTERVAL
_MAX_INTERVAL_US = (1 << 31) - 1


@functools.cache
def message_names() -> Mapping[int, str]:
    """Return the names of the telemetry messages by their MAVLink numbers."""
    return {constant(f"MAVLINK_MSG_ID_{name}"): name for name in TELEMETRY_MESSAGES}


class MessageSchedule:
    """Send intervals and next send times of the telemetry messages of one vehicle.

    Messages are sent with samples, so that no rate exceeds the sample rate.

    Attributes:
        slowdown_us: added to every interval but that of the heartbeat.
    """

    def __init__(self, sample_rate_hz: float, always: Sequence[str] = ()) -> None:
        """Start with the default rates and all messages due.

        Args:
            sample_rate_hz: rate of the samples.
            always: messages that are sent with every sample.
        """
        self.slowdown_us = 0
        self._min_interval_us = round(1e6 / sample_rate_hz)
        self._always = frozenset(always)
        self._intervals = {name: self._default(name) for name in TELEMETRY_MESSAGES}
        self._next = {name: 0 for name, every in self._intervals.items() if every != DISABLED}

    def due(self, time_s: float) -> list[str]:
        """Return the messages to send with the sample of this time, and schedule the next."""
        now = round(time_s * 1e6)
        names = []
        for name in TELEMETRY_MESSAGES:  # in its order
            when = self._next.get(name)
            if name in self._always:
                names.append(name)
            elif when is not None and when <= now:
                names.append(name)
                every = self._intervals[name] + (self.slowdown_us if name != HEARTBEAT else 0)
                # keeps the mean rate where samples are not at multiples of the interval
                self._next[name] = when + every if when + every > now else now + every
        return names

    def interval_us(self, name: str) -> int:
        """Return the interval of a message, µs; `DISABLED`: it is not sent."""
        return self._min_interval_us if name in self._always else self._intervals[name]

    def set_interval(self, name: str, interval_us: float) -> None:
        """Set the interval of a message from the next sample on, µs.

        Negative disables the message, 0 restores the default. The heartbeat and the messages that
        lockstep needs do not change.
        """
        if name == HEARTBEAT or name in self._always:
            return
        if interval_us < 0:
            self._intervals[name] = DISABLED
            self._next.pop(name, None)
            return
        every = round(interval_us) if interval_us > 0 else self._default(name)
        if every == DISABLED:
            self.set_interval(name, DISABLED)
            return
        self._intervals[name] = min(max(every, self._min_interval_us), _MAX_INTERVAL_US)
        self._next[name] = 0

    def set_stream(self, stream: int, rate_hz: float) -> None:
        """Set the rate of a group of messages; 0 disables it, unknown groups are ignored."""
        for name, message in TELEMETRY_MESSAGES.items():
            if message.stream is not None and stream in (Stream.ALL, message.stream):
                self.set_interval(name, 1e6 / rate_hz if rate_hz > 0.0 else DISABLED)

    def _default(self, name: str) -> int:
        rate = TELEMETRY_MESSAGES[name].rate_hz
        return max(round(1e6 / rate), self._min_interval_us) if rate > 0.0 else DISABLED
