"""Telemetry of motion and control from the autopilots' estimates, in MAVLink's units.

Messages and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import math

from testbed.core.frames import GRAVITY, specific_force
from testbed.core.geodetic import longitude_e7
from testbed.mavlink.outgoing import Fields
from testbed.mavlink.rc_channels import MAX_US, MIN_US, TRIM_US
from testbed.mavlink.telemetry_snapshot import (
    I16,
    I32,
    U16,
    TelemetrySnapshot,
    to_finite,
    to_integer,
)
from testbed.mavlink.vehicle_context import VehicleContext
from testbed.mavlink.vehicle_control import FlightMode

_E7 = 1e7  # of a degree
_MILLI_G = 1e-3 * GRAVITY  # m/s²
_UNKNOWN = 65535
_NO_FIX, _FIX_3D = 1, 3  # GPS_FIX_TYPE_3D_FIX
_DILUTION = 100  # of precision, hundredths: under a clear sky
_SATELLITES = 12
_RSSI_UNKNOWN = 255
_CENTRE_US, _HALF_RANGE_US, _RANGE_US = TRIM_US, 0.5 * (MAX_US - MIN_US), MAX_US - MIN_US
_CHANNELS, _USED_CHANNELS = 18, 4
_CALM = 1e-6  # m/s, below which wind has no direction


def attitude(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """ATTITUDE: rad and rad/s."""
    roll, pitch, yaw = snapshot.euler[context.row]
    p, q, r = snapshot.rates_body[context.row]
    return {
        "time_boot_ms": snapshot.boot_ms,
        "roll": roll,
        "pitch": pitch,
        "yaw": math.remainder(yaw, math.tau),
        "rollspeed": p,
        "pitchspeed": q,
        "yawspeed": r,
    }


def attitude_quaternion(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """ATTITUDE_QUATERNION: w, x, y, z."""
    x, y, z, w = snapshot.quaternion_xyzw[context.row]
    p, q, r = snapshot.rates_body[context.row]
    return {
        "time_boot_ms": snapshot.boot_ms,
        "q1": w,
        "q2": x,
        "q3": y,
        "q4": z,
        "rollspeed": p,
        "pitchspeed": q,
        "yawspeed": r,
    }


def local_position_ned(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """LOCAL_POSITION_NED, relative to the origin of the autopilot."""
    x, y, z = (
        position - origin
        for position, origin in zip(
            snapshot.position_ned[context.row], context.control.local_origin_ned, strict=True
        )
    )
    vx, vy, vz = snapshot.velocity_ned[context.row]
    return {"time_boot_ms": snapshot.boot_ms, "x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz}


def global_position_int(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """GLOBAL_POSITION_INT; the relative altitude is above the origin, which is home."""
    latitude, longitude, height = snapshot.geodetic[context.row]
    vx, vy, vz = (to_integer(100.0 * each, I16) for each in snapshot.velocity_ned[context.row])
    return {
        "time_boot_ms": snapshot.boot_ms,
        "lat": to_integer(latitude * _E7, I32),
        "lon": to_integer(longitude_e7(longitude), I32),
        "alt": to_integer(height * 1e3, I32),
        "relative_alt": to_integer(-snapshot.position_ned[context.row][2] * 1e3, I32),
        "vx": vx,
        "vy": vy,
        "vz": vz,
        "hdg": _hundredths(snapshot.euler[context.row][2]),
    }


def gps_raw_int(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """GPS_RAW_INT, from the estimate, as samples contain no raw fixes."""
    latitude, longitude, height = snapshot.geodetic[context.row]
    north, east, _ = snapshot.velocity_ned[context.row]
    fix = snapshot.has_fix(context.row)
    return {
        "time_usec": round(snapshot.sample.time_s * 1e6),
        "fix_type": _FIX_3D if fix else _NO_FIX,
        "lat": to_integer(latitude * _E7, I32),
        "lon": to_integer(longitude_e7(longitude), I32),
        "alt": to_integer(height * 1e3, I32),
        "eph": _DILUTION,
        "epv": _DILUTION,
        "vel": to_integer(100.0 * math.hypot(north, east), U16),
        "cog": _hundredths(math.atan2(east, north)),
        "satellites_visible": _SATELLITES if fix else 0,
    }


def scaled_imu(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """SCALED_IMU: specific force, mG, and rates, mrad/s, of the estimate; no magnetometer."""
    row, time_boot_ms = context.row, snapshot.boot_ms
    force = specific_force(snapshot.euler[row], snapshot.acceleration_ned[row])
    xacc, yacc, zacc = (to_integer(each / _MILLI_G, I16) for each in force)
    xgyro, ygyro, zgyro = (to_integer(1e3 * each, I16) for each in snapshot.rates_body[row])
    return {
        "time_boot_ms": time_boot_ms,
        "xacc": xacc,
        "yacc": yacc,
        "zacc": zacc,
        "xgyro": xgyro,
        "ygyro": ygyro,
        "zgyro": zgyro,
        "xmag": 0,
        "ymag": 0,
        "zmag": 0,
    }


def vfr_hud(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """VFR_HUD, with equivalent airspeed, as a pitot tube measures it."""
    north, east, down = snapshot.velocity_ned[context.row]
    return {
        "airspeed": snapshot.equivalent_airspeed[context.row],
        "groundspeed": math.hypot(north, east),
        "heading": round(math.degrees(snapshot.euler[context.row][2])) % 360,
        "throttle": to_integer(100.0 * snapshot.surfaces[context.row][2], U16),
        "alt": snapshot.geodetic[context.row][2],
        "climb": -down,
    }


def wind(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """WIND: direction the wind comes from, −180° to 180°; 0 in still air."""
    north, east, down = snapshot.wind_ned[context.row]
    speed = math.hypot(north, east)
    return {
        "direction": math.degrees(math.atan2(-east, -north)) if speed >= _CALM else 0.0,
        "speed": speed,
        "speed_z": down,
    }


def servo_output_raw(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """SERVO_OUTPUT_RAW: 1 aileron, 2 elevator, 3 throttle, 4 rudder, 1000 to 2000 µs.

    Long pulses roll right, pitch down and yaw left.
    """
    aileron, elevator, throttle, rudder = snapshot.surfaces[context.row]
    turns = {1: aileron, 2: -elevator, 4: -rudder}
    fields: Fields = {f"servo{number}_raw": 0 for number in range(1, 9)}
    fields |= {
        f"servo{number}_raw": to_integer(_CENTRE_US + _HALF_RANGE_US * turn, U16)
        for number, turn in turns.items()
    }
    fields["servo3_raw"] = to_integer(MIN_US + _RANGE_US * throttle, U16)
    return {"time_usec": round(snapshot.sample.time_s * 1e6) & 0xFFFFFFFF, "port": 0, **fields}


def rc_channels(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """RC_CHANNELS: the stick pulses that correspond to the command, whatever its source."""
    pulses = context.rc_scaling().pulses(snapshot.commands[context.row])
    fields: Fields = {f"chan{n}_raw": _UNKNOWN for n in range(_USED_CHANNELS + 1, _CHANNELS + 1)}
    fields |= {f"chan{n}_raw": to_integer(each, U16) for n, each in enumerate(pulses, 1)}
    return {
        "time_boot_ms": snapshot.boot_ms,
        "chancount": _USED_CHANNELS,
        "chan4_raw": round(_CENTRE_US),
        **fields,
        "rssi": _RSSI_UNKNOWN,
    }


def aoa_ssa(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """AOA_SSA: true angle of attack and sideslip, deg, as the autopilots estimate none."""
    air = snapshot.sample.air
    return {
        "time_usec": round(snapshot.sample.time_s * 1e6),
        "AOA": math.degrees(to_finite(air.alpha[context.row])),
        "SSA": math.degrees(to_finite(air.beta[context.row])),
    }


def nav_controller_output(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """NAV_CONTROLLER_OUTPUT: demanded attitude, and distance and course to the target.

    The demand is what fly-by-wire A makes of the command, without its limits. The target is that of
    guidance or, of a follower in FBWA, its slot by its own estimate; without a target all of these
    are zero. Errors are desired minus actual; the cross-track error is positive to the left, as in
    ArduPlane.
    """
    command = snapshot.commands[context.row]
    roll, pitch, _ = snapshot.euler[context.row]
    nose_down_share = abs(math.cos(roll)) if command.pitch < 0.0 else 1.0
    nav_pitch = math.degrees(command.pitch) * nose_down_share
    return {
        "nav_roll": math.degrees(command.roll) * math.cos(pitch),
        "nav_pitch": nav_pitch - _pitch_down_deg(context, snapshot),
        **_target_fields(context, snapshot),
    }


def _target_fields(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields:
    """Build the fields from the offset to the target, m, its course, rad, and the errors."""
    target, row = context.control.target, context.row
    north = east = course = altitude_error = airspeed_error = crosstrack = 0.0
    if target is not None:
        own_north, own_east, own_down = snapshot.position_ned[row]
        north, east = target.north - own_north, target.east - own_east
        course, crosstrack = target.course, target.crosstrack
        altitude_error = target.altitude + own_down
        airspeed_error = target.airspeed - to_finite(snapshot.sample.estimate.airspeed[row])
    elif row > 0 and context.control.mode is FlightMode.FBWA:
        formation, i = snapshot.sample.formation, row - 1
        x, y, altitude_error = (to_finite(each) for each in formation.estimated_error_ned[i])
        north, east, course = -x, -y, to_finite(formation.course_desired[i])
        airspeed_error = to_finite(formation.speed_desired[i]) - to_finite(formation.speed[i])
        crosstrack = x * math.sin(course) - y * math.cos(course)
    return {
        "nav_bearing": to_integer(math.degrees(math.remainder(course, math.tau)), I16),
        "target_bearing": to_integer(math.degrees(math.atan2(east, north)), I16),
        "wp_dist": to_integer(math.hypot(north, east), U16),
        "alt_error": altitude_error,
        "aspd_error": airspeed_error,
        "xtrack_error": crosstrack,
    }


def _pitch_down_deg(context: VehicleContext, snapshot: TelemetrySnapshot) -> float:
    """Pitch, deg, that STAB_PITCH_DOWN subtracts from the command before ArduPlane reports it.

    Of an attitude target in GUIDED it subtracts nothing.
    """
    if context.control.guided:
        return 0.0
    parameters = context.parameters()
    down, cruise = parameters.get("STAB_PITCH_DOWN", 0.0), parameters.get("TRIM_THROTTLE", 0.0)
    throttle = snapshot.surfaces[context.row][2]
    return down * max(1.0 - 100.0 * throttle / cruise, 0.0) if cruise > 0.0 else 0.0


def formation_error(context: VehicleContext, snapshot: TelemetrySnapshot) -> Fields | None:
    """NAMED_VALUE_FLOAT err_m: distance of a follower from its slot, m; None for the leader."""
    if context.row == 0:
        return None
    error = (to_finite(each) for each in snapshot.sample.formation.error_ned[context.row - 1])
    return {"time_boot_ms": snapshot.boot_ms, "name": "err_m", "value": math.hypot(*error)}


def _hundredths(angle: float) -> int:
    """Convert a direction, rad, to hundredths of a degree, 0 to 35999."""
    return round(100.0 * math.degrees(angle)) % 36000
