"""Telemetry of the state: who it is, how it is, and what it is doing.

Messages and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import functools
import re

from testbed.links.cockpit import Mode
from testbed.links.craft import Craft
from testbed.links.replies import Fields
from testbed.links.scene import I32, U16, Scene, whole
from testbed.mavlink.door import number

_PLANE = "MAV_TYPE_FIXED_WING"
_ARDUPILOT = "MAV_AUTOPILOT_ARDUPILOTMEGA"
_HAND, _STEADY, _GUIDED, _ARMED, _CUSTOM = 64, 16, 8, 128, 1  # MAV_MODE_FLAG
_ACTIVE, _CRITICAL, _EMERGENCY = 4, 5, 6  # MAV_STATE
_ON_GROUND, _IN_AIR = 1, 2  # MAV_LANDED_STATE
_NO_MISSION, _RUNNING, _PAUSED = 1, 3, 4  # MISSION_STATE
_IN_MISSION, _SUSPENDED = 1, 2  # of MISSION_CURRENT.mission_mode
_ESTIMATED = 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512  # EKF: attitude, velocities, positions
_UNKNOWN = 65535
_CELLS = 10
_LITHIUM = 1  # MAV_BATTERY_TYPE_LIPO
_FLIES = 1  # MAV_BATTERY_FUNCTION_ALL
_SENSORS = (
    "SENSOR_3D_GYRO",
    "SENSOR_3D_ACCEL",
    "SENSOR_3D_MAG",
    "SENSOR_ABSOLUTE_PRESSURE",
    "SENSOR_DIFFERENTIAL_PRESSURE",
    "SENSOR_GPS",
    "AHRS",
)
_ABLE = (
    "PREARM_CHECK",
    "SENSOR_MOTOR_OUTPUTS",
    "SENSOR_ANGULAR_RATE_CONTROL",
    "SENSOR_ATTITUDE_STABILIZATION",
    "SENSOR_YAW_POSITION",
    "SENSOR_Z_ALTITUDE_CONTROL",
    "SENSOR_XY_POSITION_CONTROL",
)
_RECEIVER = ("SENSOR_GPS",)
_STICKS, _BATTERY = ("SENSOR_RC_RECEIVER",), ("SENSOR_BATTERY",)
_FENCE = ("GEOFENCE",)  # there is none, but a bit that is not set reads as one that is breached
_CAPABILITIES = (
    "MISSION_INT",
    "MISSION_FLOAT",
    "PARAM_FLOAT",
    "COMMAND_INT",
    "SET_ATTITUDE_TARGET",
    "MAVLINK2",
)
_OFFICIAL, _DEVELOPMENT = 255, 0  # FIRMWARE_VERSION_TYPE


def heartbeat(craft: Craft) -> Fields:
    """HEARTBEAT: base_mode has the bits ArduPlane sets for the mode."""
    cockpit = craft.cockpit
    mode = cockpit.mode
    base = _CUSTOM | _STEADY | (_HAND if mode is Mode.FBWA else _GUIDED)
    state = _EMERGENCY if craft.lost else _CRITICAL if cockpit.failsafe else _ACTIVE
    return {
        "type": number(_PLANE),
        "autopilot": number(_ARDUPILOT),
        "base_mode": base | (_ARMED if cockpit.armed else 0),
        "custom_mode": int(mode),
        "system_status": state,
        "mavlink_version": 3,
    }


def sys_status(craft: Craft, scene: Scene) -> Fields:
    """SYS_STATUS: what is there, and what of it works as far as a frame tells."""
    cockpit, battery = craft.cockpit, scene.battery(craft.row)
    had = _sensors(_SENSORS + _ABLE)
    broken = _sensors(_ABLE) if craft.lost else 0
    if cockpit.external:
        had |= _sensors(_STICKS)
        broken |= _sensors(_STICKS) if cockpit.failsafe else 0
    if not scene.has_fix(craft.row):
        broken |= _sensors(_RECEIVER)
    volts, charge = _UNKNOWN, -1
    if battery is not None:
        had |= _sensors(_BATTERY)
        broken |= _sensors(_BATTERY) if battery[0] <= 0.0 else 0
        volts, charge = whole(1e3 * battery[1], U16), whole(100.0 * battery[0], (0, 100))
    return {
        "onboard_control_sensors_present": had,
        "onboard_control_sensors_enabled": had,
        "onboard_control_sensors_health": (had & ~broken) | _sensors(_FENCE),
        "load": 0,
        "voltage_battery": volts,
        "current_battery": -1,
        "battery_remaining": charge,
        "drop_rate_comm": 0,
        "errors_comm": 0,
        "errors_count1": 0,
        "errors_count2": 0,
        "errors_count3": 0,
        "errors_count4": 0,
    }


def battery_status(craft: Craft, scene: Scene) -> Fields:
    """BATTERY_STATUS: one battery; what is not known is said so."""
    battery = scene.battery(craft.row)
    volts = _UNKNOWN if battery is None else whole(1e3 * battery[1], (0, _UNKNOWN - 1))
    return {
        "id": 0,
        "battery_function": _FLIES,
        "type": _LITHIUM if battery else 0,
        "temperature": 32767,
        "voltages": [volts] + [_UNKNOWN] * (_CELLS - 1),
        "current_battery": -1,
        "current_consumed": -1,
        "energy_consumed": -1,
        "battery_remaining": -1 if battery is None else whole(100.0 * battery[0], (0, 100)),
    }


def extended_sys_state(craft: Craft, scene: Scene) -> Fields:
    """EXTENDED_SYS_STATE: in the air until it is lost."""
    return {"vtol_state": 0, "landed_state": _ON_GROUND if craft.lost else _IN_AIR}


def home_position(craft: Craft, scene: Scene) -> Fields:
    """HOME_POSITION: the scenario's origin."""
    return {
        **_origin(craft),
        "x": 0.0,
        "y": 0.0,
        "z": 0.0,
        "q": (1.0, 0.0, 0.0, 0.0),
        "approach_x": 0.0,
        "approach_y": 0.0,
        "approach_z": 0.0,
        "time_usec": _boot_us(scene),
    }


def gps_global_origin(craft: Craft, scene: Scene) -> Fields:
    """GPS_GLOBAL_ORIGIN: where LOCAL_POSITION_NED counts from."""
    return {**_origin(craft), "time_usec": _boot_us(scene)}


def mission_current(craft: Craft, scene: Scene) -> Fields:
    """MISSION_CURRENT: items are counted without home."""
    cockpit = craft.cockpit
    flying = cockpit.mode is Mode.AUTO
    count = len(cockpit.mission) - 1
    fields: Fields = {"seq": whole(cockpit.item, U16)}
    if count < 1:
        return fields | {"total": _UNKNOWN, "mission_state": _NO_MISSION}
    return fields | {
        "total": whole(count, U16),
        "mission_state": _RUNNING if flying else _PAUSED,
        "mission_mode": _IN_MISSION if flying else _SUSPENDED,
    }


def system_time(craft: Craft, scene: Scene) -> Fields:
    """SYSTEM_TIME: that of the simulation, counted from when it was started."""
    return {"time_unix_usec": craft.epoch_us + _boot_us(scene), "time_boot_ms": scene.boot_ms}


def ekf_status_report(craft: Craft, scene: Scene) -> Fields:
    """EKF_STATUS_REPORT: an estimate is always there; how good it is is in the run's metrics."""
    variances = ("velocity", "pos_horiz", "pos_vert", "compass", "terrain_alt")
    return {"flags": _ESTIMATED, **{f"{name}_variance": 0.0 for name in variances}}


def vibration(craft: Craft, scene: Scene) -> Fields:
    """VIBRATION: a flight model has none."""
    return {
        "time_usec": _boot_us(scene),
        **{f"vibration_{axis}": 0.0 for axis in "xyz"},
        **{f"clipping_{sensor}": 0 for sensor in range(3)},
    }


def autopilot_version(craft: Craft, scene: Scene) -> Fields:
    """AUTOPILOT_VERSION: the testbed's version stands for the firmware's."""
    capabilities = 0
    for name in _CAPABILITIES:
        capabilities |= number(f"MAV_PROTOCOL_CAPABILITY_{name}")
    uid = craft.uid
    return {
        "capabilities": capabilities,
        "flight_sw_version": firmware(craft.version),
        "middleware_sw_version": 0,
        "os_sw_version": 0,
        "board_version": 0,
        "flight_custom_version": b"",
        "middleware_custom_version": b"",
        "os_custom_version": b"",
        "vendor_id": 0,
        "product_id": 0,
        "uid": int.from_bytes(uid[:8], "little"),
        "uid2": uid,
    }


def firmware(version: str) -> int:
    """A version as MAVLink packs it: major, minor, patch and whether it is a release, a byte each.

    Anything after the third number makes it a development version.
    """
    found = re.match(r"(\d+)(?:\.(\d+))?(?:\.(\d+))?(.*)", version)
    if found is None:
        return 0
    numbers = [min(int(part or 0), 255) for part in found.groups()[:3]]
    kind = _DEVELOPMENT if found[4] else _OFFICIAL
    return int.from_bytes(bytes([*numbers, kind]), "big")


@functools.cache
def _sensors(names: tuple[str, ...]) -> int:
    bits = 0
    for name in names:
        bits |= number(f"MAV_SYS_STATUS_{name}")
    return bits


def _origin(craft: Craft) -> Fields:
    origin = craft.origin
    return {
        "latitude": whole(origin.latitude_deg * 1e7, I32),
        "longitude": whole(origin.longitude_deg * 1e7, I32),
        "altitude": whole(origin.elevation_m * 1e3, I32),
    }


def _boot_us(scene: Scene) -> int:
    return round(scene.frame.time_s * 1e6)
