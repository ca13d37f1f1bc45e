"""Logs that PX4 would have written of a recorded flight, by the public description of ULog.

https://docs.px4.io/main/en/dev_log/ulog_file_format.html
"""

import struct
import sys
from pathlib import Path

import numpy as np

from testbed.core.frames import quaternion_xyzw
from testbed.core.geodetic import geodetic_from_ned
from testbed.core.records import NedOrigin

SYNC = b"\x2f\x73\x13\x20\x25\x0c\xbb\x12"
CODES = {"uint64_t": "Q", "uint8_t": "B", "int32_t": "i", "float": "f", "double": "d", "bool": "?"}
ORIGIN = NedOrigin(47.4, 8.55, 488.0)
EARTH_M = 6_371_000.0  # of PX4's local frame
UNIX_US = 1_777_627_800_000_000  # at 0 s of the rows, 2026-05-01T09:30:00Z
WIND = (-2.0, 3.5)
QUADROTOR, FIXED_WING, TAILSITTER, QUADPLANE = 2, 1, 20, 22
FORMATS = {
    "vehicle_attitude": "float[4] q",
    "vehicle_attitude_setpoint": "float roll_body;float pitch_body;float[3] thrust_body",
    "vehicle_angular_velocity": "float[3] xyz",
    "airspeed_validated": "float true_airspeed_m_s",
    "actuator_controls_0": "float[8] control",
    "vehicle_global_position": "double lat;double lon;float alt",
    "vehicle_local_position": (
        "double ref_lat;double ref_lon;float x;float y;float z;float vx;float vy;float vz;"
        "float ref_alt;bool xy_global;bool z_global;uint8_t[2] _padding0"
    ),
    "vehicle_gps_position": (
        "uint64_t time_utc_usec;int32_t lat;int32_t lon;int32_t alt;float vel_n_m_s;"
        "float vel_e_m_s;float vel_d_m_s;uint8_t fix_type"
    ),
    "wind": "float windspeed_north;float windspeed_east;float variance_north",
    "vehicle_status": (
        "uint8_t nav_state;uint8_t system_type;uint8_t vehicle_type;bool is_vtol;"
        "bool is_vtol_tailsitter"
    ),
    "vtol_vehicle_status": "uint8_t vehicle_vtol_state",
    "cpuload": "float load",  # which is not read
}
OLD = {
    "vehicle_attitude": "float rollspeed;float pitchspeed;float yawspeed;float[4] q",
    "vehicle_attitude_setpoint": "float roll_body;float pitch_body;float thrust",
    "airspeed": "float true_airspeed_m_s",
    "vehicle_local_position": FORMATS["vehicle_local_position"],
    "vehicle_gps_position": FORMATS["vehicle_gps_position"],
    "wind_estimate": "float windspeed_north;float windspeed_east;float covariance_north",
    "actuator_controls_0": FORMATS["actuator_controls_0"],
    "vehicle_status": "uint8_t nav_state;uint8_t system_type;bool is_rotary_wing;bool is_vtol",
    "vtol_vehicle_status": "bool vtol_in_rw_mode;bool vtol_in_trans_mode",
}  # 1.6
NEW = {name: fields for name, fields in FORMATS.items() if name != "actuator_controls_0"} | {
    "vehicle_attitude_setpoint": "float[4] q_d;float[3] thrust_body",
    "vehicle_gps_position": (
        "uint64_t time_utc_usec;double latitude_deg;double longitude_deg;double altitude_msl_m;"
        "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type"
    ),
}  # 1.16


def message(kind, payload):
    return struct.pack("<HB", len(payload), ord(kind)) + payload


def keyed(kind, key, value):
    return message(kind, bytes([len(key)]) + key.encode() + value)


def definition(topic, fields):
    return message("F", f"{topic}:uint64_t timestamp;{fields};".encode())


class Ulog:
    """A log as bytes; a topic is subscribed at its first message."""

    def __init__(self, formats=FORMATS, *, params=(), system="PX4"):
        self.formats, self.numbers = formats, {}
        self.bytes = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))
        self.bytes += message("B", bytes(40))
        self.bytes += keyed("I", f"char[{len(system)}] sys_name", system.encode())
        for topic, fields in formats.items():
            self.bytes += definition(topic, fields)
        for name, value in dict(params).items():
            self.bytes += keyed("P", f"int32_t {name}", struct.pack("<i", value))

    def add(self, topic, us, **values):
        """Add a message; of the values those that are fields of the topic."""
        if topic not in self.formats:
            return
        if topic not in self.numbers:
            self.numbers[topic] = len(self.numbers)
            payload = struct.pack("<BH", 0, self.numbers[topic]) + topic.encode()
            self.bytes += message("A", payload)
        data = struct.pack("<HQ", self.numbers[topic], us)
        for each in self.formats[topic].split(";"):
            kind, name = each.split(" ")
            kind, _, count = kind.partition("[")
            if not name.startswith("_padding"):
                found = np.atleast_1d(values[name])
                assert len(found) == int(count.rstrip("]") or 1)
                data += struct.pack(f"<{len(found)}{CODES[kind]}", *found)
        self.bytes += message("D", data)

    def sync(self):
        self.bytes += message("S", SYNC)


def project(latitude, longitude, reference):
    """Return x and y of PX4's local frame: azimuthal equidistant, on a sphere."""
    lat, ref = np.radians(latitude), np.radians(reference.latitude_deg)
    east = np.radians(longitude - reference.longitude_deg)
    u = np.cos(lat) * np.sin(east)
    v = np.cos(ref) * np.sin(lat) - np.sin(ref) * np.cos(lat) * np.cos(east)
    up = np.sin(ref) * np.sin(lat) + np.cos(ref) * np.cos(lat) * np.cos(east)
    angle = np.arctan2(np.hypot(u, v), up)
    scale = EARTH_M * np.where(angle > 0.0, angle / np.hypot(u, v).clip(1e-300), 1.0)
    return scale * v, scale * u


def circle(time):
    """Return position and velocity (M, 3), m about the origin, of a climbing turn of 300 m."""
    angle = 22.0 / 300.0 * time
    position = [300.0 * np.sin(angle), 300.0 * (1.0 - np.cos(angle)), -100.0 - time]
    velocity = [22.0 * np.cos(angle), 22.0 * np.sin(angle), -np.ones_like(time)]
    return np.stack(position, axis=-1), np.stack(velocity, axis=-1)


def write_ulog(
    path,
    rows,
    *,
    left_out=(),
    formats=FORMATS,
    system_type=FIXED_WING,
    vehicle_type=2,
    vtol=None,
    tailsitter=False,
    params=None,
    wind_variance=0.1,
    boot_s=20.0,
    motion=None,
    origin=ORIGIN,
    **how,
):
    """Write a .ulg of recorded rows.

    Args:
        path: of the file.
        rows: (M,) of tests/data, with commands.
        left_out: topics.
        formats: fields by topic.
        system_type: MAV_TYPE, also of the parameter, if `params` are not given.
        vehicle_type: of vehicle_status.
        vtol: vehicle_vtol_state of a time; None: it is no VTOL.
        tailsitter: of vehicle_status.
        params: whole numbers by name.
        wind_variance: of the estimates of the wind; 0: there is none.
        boot_s: time of the autopilot's clock at 0 s.
        motion: position and velocity (M, 3) about the origin, m, m/s; None: a circle.
        origin: of the positions.
        how: of `Ulog`.
    """
    left_out = {*left_out, *(() if vtol else ("vtol_vehicle_status",))}
    kept = {name: fields for name, fields in formats.items() if name not in left_out}
    params = {"MAV_TYPE": system_type} if params is None else params
    log = Ulog(kept, params=params, **how)
    time = rows["t_s"]
    position, velocity = circle(time) if motion is None else motion
    geodetic = geodetic_from_ned(position, origin)
    x, y = project(geodetic[:, 0], geodetic[:, 1], origin)
    attitude = np.stack([rows[n] for n in ("phi_rad", "theta_rad", "psi_rad")], axis=-1)
    quaternion = quaternion_xyzw(attitude)[:, [3, 0, 1, 2]]
    for k, row in enumerate(rows):
        us = round(1e6 * (row["t_s"] + boot_s))
        lat, lon, height = geodetic[k]
        north, east, down = velocity[k]
        if k % 12 == 0:
            log.sync()
            kind = {"system_type": system_type, "vehicle_type": vehicle_type}
            kind |= {"is_vtol": vtol is not None, "is_rotary_wing": vehicle_type == 1}
            kind["is_vtol_tailsitter"] = tailsitter
            log.add("vehicle_status", us, nav_state=3, **kind)
            if vtol:
                state = vtol(row["t_s"])
                rotary = {"vtol_in_rw_mode": state == 3, "vtol_in_trans_mode": state in (1, 2)}
                log.add("vtol_vehicle_status", us, vehicle_vtol_state=state, **rotary)
            for topic in ("wind", "wind_estimate"):
                spread = {"variance_north": wind_variance, "covariance_north": wind_variance}
                log.add(topic, us, windspeed_north=WIND[0], windspeed_east=WIND[1], **spread)
            log.add("cpuload", us, load=0.5)
        rates = [row[n] for n in ("p_radps", "q_radps", "r_radps")]
        speeds = dict(zip(("rollspeed", "pitchspeed", "yawspeed"), rates, strict=True))
        log.add("vehicle_attitude", us, q=quaternion[k], **speeds)
        roll, pitch = demands(row)
        throttle = row["throttle_cmd"]
        demand = {"roll_body": roll, "pitch_body": pitch, "thrust": throttle}
        demand["q_d"] = quaternion_xyzw(np.array([roll, pitch, 1.0]))[[3, 0, 1, 2]]
        log.add("vehicle_attitude_setpoint", us, thrust_body=(throttle, 0.0, 0.0), **demand)
        log.add("vehicle_angular_velocity", us, xyz=rates)
        for topic in ("airspeed_validated", "airspeed"):
            log.add(topic, us, true_airspeed_m_s=row["airspeed_mps"])
        controls = (row["pwm_ail"] - 1500) / 500, (1500 - row["pwm_ele"]) / 500
        controls += (1500 - row["pwm_rud"]) / 500, (row["pwm_thr"] - 1000) / 1000
        log.add("actuator_controls_0", us, control=(*controls, 0, 0, 0, 0))
        log.add("vehicle_global_position", us, lat=lat, lon=lon, alt=height)
        reference = {"ref_lat": origin.latitude_deg, "ref_lon": origin.longitude_deg}
        reference["ref_alt"] = origin.elevation_m
        local = {"x": x[k], "y": y[k], "z": position[k, 2], "vx": north, "vy": east, "vz": down}
        log.add("vehicle_local_position", us, xy_global=True, z_global=True, **reference, **local)
        fix = {"time_utc_usec": UNIX_US + round(1e6 * row["t_s"]), "fix_type": 3}
        fix |= {"vel_n_m_s": north, "vel_e_m_s": east, "vel_d_m_s": down}
        whole = {"lat": round(1e7 * lat), "lon": round(1e7 * lon), "alt": round(1e3 * height)}
        degrees = {"latitude_deg": lat, "longitude_deg": lon, "altitude_msl_m": height}
        log.add("vehicle_gps_position", us, **fix, **whole, **degrees)
    path.write_bytes(log.bytes)
    return path


def demands(row):
    """Return the setpoints of roll and pitch that a replay of the row's commands leads to."""
    roll = row["phi_cmd_rad"] * np.cos(row["theta_rad"])
    pitch = row["theta_cmd_rad"]
    return roll, pitch * np.cos(row["phi_rad"]) if pitch < 0.0 else pitch


def write_run_ulog(path, log, name, *, boot_s=0.0):
    """Write the .ulg that the autopilot of an aircraft of a run would have written, as PX4.

    Args:
        path: of the file.
        log: of the run, as `testbed.logs.read.read_log` reads it.
        name: of the aircraft.
        boot_s: time of the autopilot's clock at the beginning of the run.
    """
    k = log.info.names.index(name)
    truth, command, surfaces = log.truth, log.command, log.surfaces
    euler, rates, throttle = truth.euler[:, k], truth.rates_body[:, k], surfaces.throttle[:, k]
    columns = {
        "t_s": log.time_s,
        **dict(zip(("phi_rad", "theta_rad", "psi_rad"), euler.T, strict=True)),
        **dict(zip(("p_radps", "q_radps", "r_radps"), rates.T, strict=True)),
        "phi_cmd_rad": command.roll[:, k],
        "theta_cmd_rad": command.pitch[:, k],
        "throttle_cmd": throttle,
        "airspeed_mps": truth.airspeed[:, k],
        "pwm_ail": 1500.0 + 500.0 * surfaces.aileron[:, k],
        "pwm_ele": 1500.0 - 500.0 * surfaces.elevator[:, k],
        "pwm_thr": 1000.0 + 1000.0 * throttle,
        "pwm_rud": 1500.0 - 500.0 * surfaces.rudder[:, k],
    }
    rows = np.rec.fromarrays([*columns.values()], names=[*columns])
    motion = truth.position_ned[:, k], truth.velocity_ned[:, k]
    write_ulog(path, rows, motion=motion, origin=log.info.origin, boot_s=boot_s)


if __name__ == "__main__":
    from testbed.logs.read import read_log
    from testbed.logs.run_directory import find_run

    run, *names = sys.argv[1:]
    recorded_run = read_log(find_run(run))
    for number, each in enumerate(names or recorded_run.info.names):
        write_run_ulog(Path(f"{each}.ulg"), recorded_run, each, boot_s=20.0 + 7.3 * number)
