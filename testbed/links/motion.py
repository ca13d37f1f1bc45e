"""Telemetry of the motion: what each autopilot believes, in MAVLink's units.

Messages and units: https://mavlink.io/en/messages/common.html.
"""

from __future__ import annotations

import math

from testbed.links.channels import pulses
from testbed.links.cockpit import Mode
from testbed.links.craft import Craft
from testbed.links.replies import Fields
from testbed.links.scene import I16, I32, U16, Scene, tame, whole

_E7 = 1e7  # of a degree
_UNKNOWN = 65535
_NO_FIX, _FIX_3D = 1, 3  # GPS_FIX_TYPE_3D_FIX
_DILUTION = 100  # of precision, hundredths: what a clear sky gives
_SATELLITES = 12
_RSSI_UNKNOWN = 255
_CENTRE_US, _HALF_US, _IDLE_US, _THROTTLE_US = 1500.0, 500.0, 1000.0, 1000.0
_CHANNELS, _OUTPUTS = 18, 4
_CALM = 1e-6  # m/s, of wind that comes from nowhere


def attitude(craft: Craft, scene: Scene) -> Fields:
    """ATTITUDE: rad and rad/s."""
    roll, pitch, yaw = scene.euler[craft.row]
    p, q, r = scene.rates_body[craft.row]
    return {
        "time_boot_ms": scene.boot_ms,
        "roll": roll,
        "pitch": pitch,
        "yaw": math.remainder(yaw, math.tau),
        "rollspeed": p,
        "pitchspeed": q,
        "yawspeed": r,
    }


def attitude_quaternion(craft: Craft, scene: Scene) -> Fields:
    """ATTITUDE_QUATERNION: w, x, y, z."""
    x, y, z, w = scene.quaternion_xyzw[craft.row]
    p, q, r = scene.rates_body[craft.row]
    return {
        "time_boot_ms": scene.boot_ms,
        "q1": w,
        "q2": x,
        "q3": y,
        "q4": z,
        "rollspeed": p,
        "pitchspeed": q,
        "yawspeed": r,
    }


def local_position_ned(craft: Craft, scene: Scene) -> Fields:
    """LOCAL_POSITION_NED: from the scenario's origin."""
    x, y, z = scene.position_ned[craft.row]
    vx, vy, vz = scene.velocity_ned[craft.row]
    return {"time_boot_ms": scene.boot_ms, "x": x, "y": y, "z": z, "vx": vx, "vy": vy, "vz": vz}


def global_position_int(craft: Craft, scene: Scene) -> Fields:
    """GLOBAL_POSITION_INT: the relative altitude is that above the origin, which is home."""
    latitude, longitude, height = scene.place[craft.row]
    vx, vy, vz = (whole(100.0 * each, I16) for each in scene.velocity_ned[craft.row])
    return {
        "time_boot_ms": scene.boot_ms,
        "lat": whole(latitude * _E7, I32),
        "lon": whole(longitude * _E7, I32),
        "alt": whole(height * 1e3, I32),
        "relative_alt": whole(-scene.position_ned[craft.row][2] * 1e3, I32),
        "vx": vx,
        "vy": vy,
        "vz": vz,
        "hdg": _hundredths(scene.euler[craft.row][2]),
    }


def gps_raw_int(craft: Craft, scene: Scene) -> Fields:
    """GPS_RAW_INT: what the autopilot believes stands for the fix, which is not in a frame."""
    latitude, longitude, height = scene.place[craft.row]
    north, east, _ = scene.velocity_ned[craft.row]
    fix = scene.has_fix(craft.row)
    return {
        "time_usec": round(scene.frame.time_s * 1e6),
        "fix_type": _FIX_3D if fix else _NO_FIX,
        "lat": whole(latitude * _E7, I32),
        "lon": whole(longitude * _E7, I32),
        "alt": whole(height * 1e3, I32),
        "eph": _DILUTION,
        "epv": _DILUTION,
        "vel": whole(100.0 * math.hypot(north, east), U16),
        "cog": _hundredths(math.atan2(east, north)),
        "satellites_visible": _SATELLITES if fix else 0,
    }


def vfr_hud(craft: Craft, scene: Scene) -> Fields:
    """VFR_HUD: the airspeed is equivalent, as a pitot tube has it."""
    north, east, down = scene.velocity_ned[craft.row]
    return {
        "airspeed": scene.equivalent_airspeed[craft.row],
        "groundspeed": math.hypot(north, east),
        "heading": round(math.degrees(scene.euler[craft.row][2])) % 360,
        "throttle": whole(100.0 * scene.surfaces[craft.row][2], U16),
        "alt": scene.place[craft.row][2],
        "climb": -down,
    }


def wind(craft: Craft, scene: Scene) -> Fields:
    """WIND: where it comes from, −180° to 180° as ArduPlane has it; in still air from north."""
    north, east, down = scene.wind_ned[craft.row]
    speed = math.hypot(north, east)
    return {
        "direction": math.degrees(math.atan2(-east, -north)) if speed >= _CALM else 0.0,
        "speed": speed,
        "speed_z": down,
    }


def servo_output_raw(craft: Craft, scene: Scene) -> Fields:
    """SERVO_OUTPUT_RAW: 1 aileron, 2 elevator, 3 throttle, 4 rudder, 1000 to 2000 µs.

    Long pulses roll right, pitch down and yaw left.
    """
    aileron, elevator, throttle, rudder = scene.surfaces[craft.row]
    turns = {1: aileron, 2: -elevator, 4: -rudder}
    fields: Fields = {f"servo{number}_raw": 0 for number in range(1, 9)}
    fields |= {
        f"servo{number}_raw": whole(_CENTRE_US + _HALF_US * turn, U16)
        for number, turn in turns.items()
    }
    fields["servo3_raw"] = whole(_IDLE_US + _THROTTLE_US * throttle, U16)
    return {"time_usec": round(scene.frame.time_s * 1e6) & 0xFFFFFFFF, "port": 0, **fields}


def rc_channels(craft: Craft, scene: Scene) -> Fields:
    """RC_CHANNELS: the sticks that ask for the command, whoever gives it."""
    roll, pitch, throttle = scene.command[craft.row]
    sticks = pulses(roll, pitch, throttle, craft.scales())
    fields: Fields = {f"chan{n}_raw": _UNKNOWN for n in range(_OUTPUTS + 1, _CHANNELS + 1)}
    fields |= {f"chan{n}_raw": whole(each, U16) for n, each in enumerate(sticks, 1)}
    return {
        "time_boot_ms": scene.boot_ms,
        "chancount": _OUTPUTS,
        "chan4_raw": round(_CENTRE_US),
        **fields,
        "rssi": _RSSI_UNKNOWN,
    }


def aoa_ssa(craft: Craft, scene: Scene) -> Fields:
    """AOA_SSA: of the air itself, deg; no autopilot of ours estimates them."""
    air = scene.frame.air
    return {
        "time_usec": round(scene.frame.time_s * 1e6),
        "AOA": math.degrees(tame(air.alpha[craft.row])),
        "SSA": math.degrees(tame(air.beta[craft.row])),
    }


def nav_controller_output(craft: Craft, scene: Scene) -> Fields:
    """NAV_CONTROLLER_OUTPUT: the attitude that is flown for, and the way to where it is to be.

    That is where its guidance takes it; in FBWA, a follower's slot, as the follower believes it to
    be; else nowhere, and all is zero. Errors are what is missing; the cross-track error is positive
    to the left, as ArduPlane has it.
    """
    roll, pitch, _ = scene.command[craft.row]
    return {
        "nav_roll": math.degrees(roll),
        "nav_pitch": math.degrees(pitch) - _pitch_down_deg(craft, scene),
        **_way(craft, scene),
    }


def _way(craft: Craft, scene: Scene) -> Fields:
    target, row = craft.cockpit.target, craft.row
    if target is not None:
        north, east, down = scene.position_ned[row]
        return _way_fields(
            (target.north - north, target.east - east),
            target.course,
            climb=target.altitude + down,
            speed_up=target.airspeed - tame(scene.frame.estimate.airspeed[row]),
            crosstrack=target.crosstrack,
        )
    if row == 0 or craft.cockpit.mode is not Mode.FBWA:
        return _way_fields((0.0, 0.0), 0.0, climb=0.0, speed_up=0.0, crosstrack=0.0)
    formation, row = scene.frame.formation, row - 1
    north, east, down = (tame(each) for each in formation.believed_ned[row])
    course = tame(formation.course_desired[row])
    return _way_fields(
        (-north, -east),
        course,
        climb=down,
        speed_up=tame(formation.speed_desired[row]) - tame(formation.speed[row]),
        crosstrack=north * math.sin(course) - east * math.cos(course),
    )


def _way_fields(
    way: tuple[float, float], course: float, *, climb: float, speed_up: float, crosstrack: float
) -> Fields:
    """From the way to a place, north and east m, its track's course rad, m and m/s missing."""
    north, east = way
    return {
        "nav_bearing": whole(math.degrees(math.remainder(course, math.tau)), I16),
        "target_bearing": whole(math.degrees(math.atan2(east, north)), I16),
        "wp_dist": whole(math.hypot(north, east), U16),
        "alt_error": climb,
        "aspd_error": speed_up,
        "xtrack_error": crosstrack,
    }


def _pitch_down_deg(craft: Craft, scene: Scene) -> float:
    """What the autopilot takes off the pitch it is told, deg; ArduPlane tells what is left."""
    known = craft.parameters()
    down, cruise = known.get("STAB_PITCH_DOWN", 0.0), known.get("TRIM_THROTTLE", 0.0)
    throttle = scene.surfaces[craft.row][2]
    return down * max(1.0 - 100.0 * throttle / cruise, 0.0) if cruise > 0.0 else 0.0


def formation_error(craft: Craft, scene: Scene) -> Fields | None:
    """NAMED_VALUE_FLOAT err_m: how far a follower is from its slot, m; the leader has none."""
    if craft.row == 0:
        return None
    error = (tame(each) for each in scene.frame.formation.error_ned[craft.row - 1])
    return {"time_boot_ms": scene.boot_ms, "name": "err_m", "value": math.hypot(*error)}


def _hundredths(angle: float) -> int:
    """A direction, rad, as hundredths of a degree from 0 to 35999."""
    return round(100.0 * math.degrees(angle)) % 36000
