"""The telemetry messages of a vehicle, with default rates and ArduPilot's stream groups."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum

from testbed.mavlink import telemetry_motion as motion
from testbed.mavlink import telemetry_status as status
from testbed.mavlink.outgoing import Fields, OutgoingMessage
from testbed.mavlink.telemetry_snapshot import TelemetrySnapshot
from testbed.mavlink.vehicle_context import VehicleContext

FieldBuilder = Callable[[VehicleContext, TelemetrySnapshot], Fields | None]

HEARTBEAT, ATTITUDE = "HEARTBEAT", "ATTITUDE"
LOCKSTEP_STATE = ("LOCAL_POSITION_NED", ATTITUDE)  # sent with every sample in lockstep


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


def _heartbeat(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    return status.heartbeat(context)


TELEMETRY_MESSAGES: Mapping[str, TelemetryMessage] = {
    HEARTBEAT: TelemetryMessage(_heartbeat, 1.0),
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
    fields = (
        None
        if context.snapshot is None
        else TELEMETRY_MESSAGES[name].build(context, context.snapshot)
    )
    return [] if fields is None else [OutgoingMessage(name, fields)]
