"""What a vehicle tells of itself: each message, how often, and in which of ArduPilot's streams."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum

from testbed.links import motion, status
from testbed.links.craft import Craft
from testbed.links.replies import Fields, Reply
from testbed.links.scene import Scene

Build = Callable[[Craft, Scene], Fields | None]

HEARTBEAT, ATTITUDE = "HEARTBEAT", "ATTITUDE"
STATE = ("LOCAL_POSITION_NED", ATTITUDE)  # what lockstep tells of every frame


class Stream(IntEnum):
    """Groups of messages that REQUEST_DATA_STREAM names: MAV_DATA_STREAM."""

    ALL = 0
    EXTENDED_STATUS = 2
    RC_CHANNELS = 3
    POSITION = 6
    EXTRA1 = 10
    EXTRA2 = 11
    EXTRA3 = 12


@dataclass(frozen=True, slots=True)
class Entry:
    """One message.

    Attributes:
        build: its fields; None: this aircraft has nothing to say there.
        rate_hz: unless told otherwise; 0: only on request.
        stream: the group it is in; None: in no group.
    """

    build: Build
    rate_hz: float = 0.0
    stream: Stream | None = None


def _heartbeat(craft: Craft, scene: Scene) -> Fields:
    return status.heartbeat(craft)


CATALOGUE: Mapping[str, Entry] = {
    HEARTBEAT: Entry(_heartbeat, 1.0),
    "SYS_STATUS": Entry(status.sys_status, 2.0, Stream.EXTENDED_STATUS),
    "MISSION_CURRENT": Entry(status.mission_current, 1.0, Stream.EXTENDED_STATUS),
    "GPS_RAW_INT": Entry(motion.gps_raw_int, 5.0, Stream.EXTENDED_STATUS),
    "NAV_CONTROLLER_OUTPUT": Entry(motion.nav_controller_output, 2.0, Stream.EXTENDED_STATUS),
    "GLOBAL_POSITION_INT": Entry(motion.global_position_int, 10.0, Stream.POSITION),
    "LOCAL_POSITION_NED": Entry(motion.local_position_ned, 10.0, Stream.POSITION),
    "SERVO_OUTPUT_RAW": Entry(motion.servo_output_raw, 4.0, Stream.RC_CHANNELS),
    "RC_CHANNELS": Entry(motion.rc_channels, 4.0, Stream.RC_CHANNELS),
    "ATTITUDE_QUATERNION": Entry(motion.attitude_quaternion, 10.0, Stream.EXTRA1),
    "VFR_HUD": Entry(motion.vfr_hud, 4.0, Stream.EXTRA2),
    "SYSTEM_TIME": Entry(status.system_time, 1.0, Stream.EXTRA3),
    "WIND": Entry(motion.wind, 1.0, Stream.EXTRA3),
    "BATTERY_STATUS": Entry(status.battery_status, 1.0, Stream.EXTRA3),
    "EKF_STATUS_REPORT": Entry(status.ekf_status_report, 1.0, Stream.EXTRA3),
    "VIBRATION": Entry(status.vibration, 1.0, Stream.EXTRA3),
    "EXTENDED_SYS_STATE": Entry(status.extended_sys_state, 1.0),
    "HOME_POSITION": Entry(status.home_position, 0.1),
    "NAMED_VALUE_FLOAT": Entry(motion.formation_error, 2.0),
    "AOA_SSA": Entry(motion.aoa_ssa),
    "GPS_GLOBAL_ORIGIN": Entry(status.gps_global_origin),
    "AUTOPILOT_VERSION": Entry(status.autopilot_version),
    # the last of a frame: who answers it has heard the rest
    ATTITUDE: Entry(motion.attitude, 10.0, Stream.EXTRA1),
}


def built(name: str, craft: Craft) -> list[Reply]:
    """A message of the catalogue as it is now; none before the first frame."""
    if name == HEARTBEAT:
        return [Reply(name, status.heartbeat(craft))]
    fields = None if craft.scene is None else CATALOGUE[name].build(craft, craft.scene)
    return [] if fields is None else [Reply(name, fields)]
