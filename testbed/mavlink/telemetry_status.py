"""Telemetry of identity, health and mode of a vehicle.

Messages and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence

import numpy as np

from testbed.core.geodetic import geodetic_from_ned, longitude_e7, origin_geodetic
from testbed.mavlink.codec import constant
from testbed.mavlink.outgoing import Fields
from testbed.mavlink.telemetry_snapshot import I32, U16, TelemetrySnapshot, to_integer
from testbed.mavlink.vehicle_context import VehicleContext
from testbed.mavlink.vehicle_control import FlightMode

_PLANE = "MAV_TYPE_FIXED_WING"
_ARDUPILOT = "MAV_AUTOPILOT_ARDUPILOTMEGA"
_MANUAL_INPUT, _STABILIZE, _GUIDED, _ARMED, _CUSTOM = 64, 16, 8, 128, 1  # MAV_MODE_FLAG
_ACTIVE, _CRITICAL, _EMERGENCY = 4, 5, 6  # MAV_STATE
_ON_GROUND, _IN_AIR = 1, 2  # MAV_LANDED_STATE
_NO_MISSION, _RUNNING, _PAUSED = 1, 3, 4  # MISSION_STATE
_IN_MISSION, _SUSPENDED = 1, 2  # of MISSION_CURRENT.mission_mode
_EKF_FLAGS = 1 | 2 | 4 | 8 | 16 | 32 | 256 | 512  # attitude, velocities, positions
_UNKNOWN = 65535
_CELLS = 10
_LITHIUM = 1  # MAV_BATTERY_TYPE_LIPO
_ALL = 1  # MAV_BATTERY_FUNCTION_ALL
_SENSORS = (
    "SENSOR_3D_GYRO",
    "SENSOR_3D_ACCEL",
    "SENSOR_3D_MAG",
    "SENSOR_ABSOLUTE_PRESSURE",
    "SENSOR_DIFFERENTIAL_PRESSURE",
    "SENSOR_GPS",
    "AHRS",
)
_CONTROLS = (
    "PREARM_CHECK",
    "SENSOR_MOTOR_OUTPUTS",
    "SENSOR_ANGULAR_RATE_CONTROL",
    "SENSOR_ATTITUDE_STABILIZATION",
    "SENSOR_YAW_POSITION",
    "SENSOR_Z_ALTITUDE_CONTROL",
    "SENSOR_XY_POSITION_CONTROL",
)
_GPS, _RC_RECEIVER, _BATTERY = ("SENSOR_GPS",), ("SENSOR_RC_RECEIVER",), ("SENSOR_BATTERY",)
_FENCE = ("GEOFENCE",)  # there is none, but ground stations take a cleared bit for a breach
_CAPABILITIES = (
    "MISSION_INT",
    "MISSION_FLOAT",
    "PARAM_FLOAT",
    "COMMAND_INT",
    "SET_ATTITUDE_TARGET",
    "MAVLINK2",
)
_OFFICIAL, _DEVELOPMENT = 255, 0  # FIRMWARE_VERSION_TYPE


def heartbeat(context: VehicleContext, snapshot: TelemetrySnapshot | None = None) -> Fields:
    """HEARTBEAT, with the base_mode bits that ArduPlane sets for the mode."""
    control = context.control
    mode = control.mode
    base = _CUSTOM | _STABILIZE | (_MANUAL_INPUT if mode is FlightMode.FBWA else _GUIDED)
    state = _EMERGENCY if context.lost else _CRITICAL if control.failsafe else _ACTIVE
    return {
        "type": constant(_PLANE),
        "autopilot": constant(_ARDUPILOT),
        "base_mode": base | (_ARMED if control.armed else 0),
        "custom_mode": int(mode),
        "system_status": state,
        "mavlink_version": 3,
    }


def sys_status(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """SYS_STATUS: sensors that are present, and their health as far as a sample shows it."""
    control, battery = context.control, snapshot.battery(context.row)
    present = _sensors(_SENSORS + _CONTROLS)
    failed = _sensors(_CONTROLS) if context.lost else 0
    if control.external:
        present |= _sensors(_RC_RECEIVER)
        failed |= _sensors(_RC_RECEIVER) if control.failsafe else 0
    if not snapshot.has_fix(context.row):
        failed |= _sensors(_GPS)
    volts, charge = _UNKNOWN, -1
    if battery is not None:
        present |= _sensors(_BATTERY)
        failed |= _sensors(_BATTERY) if battery[0] <= 0.0 else 0
        volts, charge = to_integer(1e3 * battery[1], U16), to_integer(100.0 * battery[0], (0, 100))
    return {
        "onboard_control_sensors_present": present,
        "onboard_control_sensors_enabled": present,
        "onboard_control_sensors_health": (present & ~failed) | _sensors(_FENCE),
        "voltage_battery": volts,
        "current_battery": -1,
        "battery_remaining": charge,
        **dict.fromkeys(("load", "drop_rate_comm", "errors_comm"), 0),
        **{f"errors_count{number}": 0 for number in range(1, 5)},
    }


def battery_status(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """BATTERY_STATUS of one battery; unknown values as MAVLink marks them."""
    battery = snapshot.battery(context.row)
    volts = _UNKNOWN if battery is None else to_integer(1e3 * battery[1], (0, _UNKNOWN - 1))
    return {
        "id": 0,
        "battery_function": _ALL,
        "type": _LITHIUM if battery else 0,
        "temperature": 32767,
        "voltages": [volts] + [_UNKNOWN] * (_CELLS - 1),
        "current_battery": -1,
        "current_consumed": -1,
        "energy_consumed": -1,
        "battery_remaining": -1 if battery is None else to_integer(100.0 * battery[0], (0, 100)),
    }


def extended_sys_state(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """EXTENDED_SYS_STATE: in the air unless it is lost."""
    return {"vtol_state": 0, "landed_state": _ON_GROUND if context.lost else _IN_AIR}


def home_position(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """HOME_POSITION: the scenario's origin."""
    return {
        **_origin(context),
        **{f"{of}{axis}": 0.0 for of in ("", "approach_") for axis in "xyz"},
        "q": (1.0, 0.0, 0.0, 0.0),
        "time_usec": _boot_us(snapshot),
    }


def gps_global_origin(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """GPS_GLOBAL_ORIGIN: the origin of LOCAL_POSITION_NED."""
    local = np.array(context.control.local_origin_ned)
    place = geodetic_from_ned(local, context.origin).tolist() if local.any() else None
    return {**_origin(context, place), "time_usec": _boot_us(snapshot)}


def mission_current(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """MISSION_CURRENT; the total does not include home."""
    control = context.control
    flying = control.mode is FlightMode.AUTO
    count = len(control.mission) - 1
    fields: Fields = {"seq": to_integer(control.current_item, U16)}
    if count < 1:
        return fields | {"total": _UNKNOWN, "mission_state": _NO_MISSION}
    return fields | {
        "total": to_integer(count, U16),
        "mission_state": _RUNNING if flying else _PAUSED,
        "mission_mode": _IN_MISSION if flying else _SUSPENDED,
    }


def system_time(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """SYSTEM_TIME: simulation time, as Unix time from the start of the run."""
    return {
        "time_unix_usec": context.epoch_us + _boot_us(snapshot),
        "time_boot_ms": snapshot.boot_ms,
    }


def ekf_status_report(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """EKF_STATUS_REPORT: a valid estimate; its errors are in the run's metrics."""
    variances = ("velocity", "pos_horiz", "pos_vert", "compass", "terrain_alt")
    return {"flags": _EKF_FLAGS, **{f"{name}_variance": 0.0 for name in variances}}


def vibration(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """VIBRATION: zero, as the flight model has none."""
    return {
        "time_usec": _boot_us(snapshot),
        **{f"vibration_{axis}": 0.0 for axis in "xyz"},
        **{f"clipping_{sensor}": 0 for sensor in range(3)},
    }


def autopilot_version(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """AUTOPILOT_VERSION, with the testbed's version as that of the firmware."""
    capabilities = 0
    for name in _CAPABILITIES:
        capabilities |= constant(f"MAV_PROTOCOL_CAPABILITY_{name}")
    uid = context.uid
    return {
        "capabilities": capabilities,
        "flight_sw_version": firmware(context.version),
        **dict.fromkeys(("middleware_sw_version", "os_sw_version", "board_version"), 0),
        **{f"{of}_custom_version": b"" for of in ("flight", "middleware", "os")},
        **dict.fromkeys(("vendor_id", "product_id"), 0),
        "uid": int.from_bytes(uid[:8], "little"),
        "uid2": uid,
    }


def firmware(version: str) -> int:
    """Pack a version as in MAVLink: major, minor, patch and release type, a byte each.

    Anything after the third number makes it a development version.
    """
    found = re.match(r"([0-9]+)(?:\.([0-9]+))?(?:\.([0-9]+))?(.*)", version)
    if found is None:
        return 0
    numbers = [min(int(part or 0), 255) for part in found.groups()[:3]]
    kind = _DEVELOPMENT if found[4] else _OFFICIAL
    return int.from_bytes(bytes([*numbers, kind]), "big")


@functools.cache
def _sensors(names: tuple[str, ...]) -> int:
    bits = 0
    for name in names:
        bits |= constant(f"MAV_SYS_STATUS_{name}")
    return bits


def _origin(context: VehicleContext, place: Sequence[float] | None = None) -> Fields:
    """Return the fields of a place; None: of the scenario's origin."""
    latitude, longitude, elevation = origin_geodetic(context.origin) if place is None else place
    return {
        "latitude": to_integer(latitude * 1e7, I32),
        "longitude": to_integer(longitude_e7(longitude), I32),
        "altitude": to_integer(elevation * 1e3, I32),
    }


def _boot_us(snapshot: TelemetrySnapshot) -> int:
    return round(snapshot.sample.time_s * 1e6)
