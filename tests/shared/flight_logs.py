"""Logs that an ArduPlane and a ground station would have written of a recorded flight.

DataFlash follows the public description of the format; frames are pymavlink's.
"""

import struct
import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from places import ROOT
from pymavlink.dialects.v20 import ardupilotmega as dialect

RECORDING = ROOT / "tests" / "data" / "arduplane_fbwa_rascal_steps.csv"
HOME = 300.0  # m above sea level
FBWA, AUTO = 5, 10
GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
LEAP_S = 18  # GPS time ahead of UTC since 2017
ATTITUDE = ("phi_rad", "theta_rad", "psi_rad")
PARAMS = {
    "STAB_PITCH_DOWN": 2.0,
    "TRIM_THROTTLE": 50.0,
    "SERVO1_FUNCTION": 4.0,
    "SERVO1_REVERSED": 0.0,
    "SERVO2_FUNCTION": 19.0,
    "SERVO2_REVERSED": 1.0,
    "SERVO3_FUNCTION": 70.0,
    "SERVO3_REVERSED": 0.0,
    "SERVO4_FUNCTION": 21.0,
    "SERVO4_REVERSED": 1.0,
}


def recorded():
    return np.genfromtxt(RECORDING, delimiter=",", names=True)


def true_over_equivalent(altitude):
    """Return true over equivalent airspeed by temperature and pressure of the ISA."""
    temperature = 288.15 - 0.0065 * (altitude + HOME)
    pressure = 101325.0 * (temperature / 288.15) ** 5.2558797
    return np.sqrt(1.225 / (pressure / (287.052874 * temperature)))


def demands_deg(row):
    """Return the demands of roll and pitch that ArduPlane logs.

    Roll is reduced by the pitch, a pitch below zero by the roll and below the trim throttle.
    """
    down = PARAMS["STAB_PITCH_DOWN"] * max(1.0 - row["throttle_cmd"] / 0.5, 0.0)
    roll = np.degrees(row["phi_cmd_rad"]) * np.cos(row["theta_rad"])
    pitch = np.degrees(row["theta_cmd_rad"])
    return roll, (pitch * np.cos(row["phi_rad"]) if pitch < 0.0 else pitch) - down


CODES = {"c": "h", "C": "H", "e": "i", "L": "i", "M": "B", "n": "4s", "N": "16s", "Z": "64s"}
FORMATS = {
    "FMT": (0x80, "BBnNZ", "Type,Length,Name,Format,Columns"),
    "PARM": (1, "QNff", "TimeUS,Name,Value,Default"),
    "MSG": (2, "QZ", "TimeUS,Message"),
    "MODE": (3, "QMBB", "TimeUS,Mode,ModeNum,Rsn"),
    "ATT": (4, "QffffffB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,AEKF"),
    "IMU": (5, "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ARSP": (6, "QBf", "TimeUS,I,Airspeed"),
    "CTUN": (7, "Qccccffff", "TimeUS,NavRoll,Roll,NavPitch,Pitch,ThO,RdO,As,E2T"),
    "AETR": (8, "Qffff", "TimeUS,Ail,Elev,Thr,Rudd"),
    "RCOU": (9, "QHHHH", "TimeUS,C1,C2,C3,C4"),
    "POS": (10, "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt"),
    "GPS": (11, "QBef", "TimeUS,I,Alt,VZ"),
    "AOA": (12, "Qff", "TimeUS,AOA,SSA"),
}
# With all fields of position, velocity and time.
WITH_POSITION = FORMATS | {
    "GPS": (11, "QBBIHBcLLefffB", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,U"),
    "XKF1": (13, "QBfff", "TimeUS,C,VN,VE,VD"),
    "XKF2": (14, "QBff", "TimeUS,C,VWN,VWE"),
}
WIND = (-2.0, 3.5)  # m/s to the north and east, as the autopilot would have estimated it
OLD_ATT = (4, "QccccCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw")


def coded(form):
    return "<" + "".join(CODES.get(c, c) for c in form)


class DataFlash:
    def __init__(self, formats=FORMATS, left_out=()):
        self.formats = {name: form for name, form in formats.items() if name not in left_out}
        self.bytes = bytearray()
        for name, (number, form, columns) in self.formats.items():
            self.add(
                "FMT", number, 3 + struct.calcsize(coded(form)), name.encode(), form.encode(),
                columns.encode(),
            )  # fmt: skip

    def add(self, name, *values):
        if name in self.formats:
            number, form, _ = self.formats[name]
            pairs = zip(form, values, strict=True)
            hundredth = [round(100 * value) if code in "cCeE" else value for code, value in pairs]
            self.bytes += bytes([0xA3, 0x95, number]) + struct.pack(coded(form), *hundredth)


def write_dataflash(path, rows, *, params=PARAMS, modes=((0.0, FBWA),), text="", **how):
    """Write a .bin of recorded rows; `modes` are (start, number)."""
    log = DataFlash(**how)
    log.add("MSG", 0, (text or "ArduPlane V4.7.0-dev").encode())
    for name, value in params.items():
        log.add("PARM", 0, name.encode(), value, value)
    modes = list(modes)
    for row in rows:
        us = round(1e6 * row["t_s"])
        while modes and modes[0][0] <= row["t_s"]:
            mode = modes.pop(0)[1]
            log.add("MODE", us, mode, mode, 0)
        demand, att = demands_deg(row), np.degrees([row[n] for n in ATTITUDE])
        # the older layout has one field less
        att = (us, demand[0], att[0], demand[1], att[1], 0.0, att[2], 0)
        layout = log.formats.get("ATT", FORMATS["ATT"])
        log.add("ATT", *att[: len(layout[1])])
        log.add("IMU", us, 1, 9.0, 9.0, 9.0, 0.0, 0.0, 0.0)  # another sensor, with wrong values
        log.add("IMU", us, 0, row["p_radps"], row["q_radps"], row["r_radps"], 0.0, 0.0, -9.8)
        ratio = true_over_equivalent(row["altitude_m"])
        log.add("ARSP", us, 0, row["airspeed_mps"] / ratio)
        percent = 100.0 * row["throttle_cmd"]
        eas = row["airspeed_mps"] / ratio
        log.add("CTUN", us, 0, 0, 0, 0, percent, 0.0, eas, ratio)
        surfaces = [row["pwm_ail"] - 1500, 1500 - row["pwm_ele"], 1500 - row["pwm_rud"]]
        log.add(
            "AETR", us, *(surfaces[0] * 11.25, surfaces[1] * 11.25, percent, surfaces[2] * 11.25)
        )
        log.add("RCOU", us, *(int(row[n]) for n in ("pwm_ail", "pwm_ele", "pwm_thr", "pwm_rud")))
        altitude = row["altitude_m"]
        log.add("POS", us, 0, 0, altitude + HOME, altitude, altitude)
        log.add("GPS", us, 0, altitude + HOME, row["v_down_mps"])
        log.add("AOA", us, np.degrees(row["alpha_rad"]), np.degrees(row["beta_rad"]))
    path.write_bytes(log.bytes)
    return path


def vehicle(system, component=1):
    return dialect.MAVLink(None, system, component)


def heartbeat(mode, kind=dialect.MAV_TYPE_FIXED_WING, autopilot=3):
    return dialect.MAVLink_heartbeat_message(kind, autopilot, 81, mode, 4, 3)


EPOCH_US = 1_700_000_000_000_000


def tlog_records(rows, *, system=1, params=PARAMS, mode=FBWA, boot_ms=0, late=None, left_out=()):
    """Return (µs, frame) of one vehicle; messages of a row arrive together, `late` s after it."""
    late = np.zeros(len(rows)) if late is None else late
    sender, records = vehicle(system), []

    def add(us, message):
        if message.get_type() not in left_out:
            records.append((us, message.pack(sender)))
            sender.seq = (sender.seq + 1) % 256

    for k, row in enumerate(rows):
        us = EPOCH_US + round(1e6 * (row["t_s"] + late[k]))
        ms = boot_ms + round(1e3 * row["t_s"])
        if k == 0:
            for number, (name, value) in enumerate(params.items()):
                param = (name.encode(), value, 9, len(params), number)
                add(us, dialect.MAVLink_param_value_message(*param))
        if k % 25 == 0 and mode is not None:
            add(us, heartbeat(mode(row["t_s"]) if callable(mode) else mode))
        attitude = [row[n] for n in ATTITUDE]
        attitude[2] = (attitude[2] + np.pi) % (2 * np.pi) - np.pi
        rates = [row[n] for n in ("p_radps", "q_radps", "r_radps")]
        add(us, dialect.MAVLink_attitude_message(ms, *attitude, *rates))
        demand = demands_deg(row)
        add(us, dialect.MAVLink_nav_controller_output_message(*demand, 0, 0, 0, 0, 0, 0))
        altitude, percent = row["altitude_m"], round(100 * row["throttle_cmd"])
        eas = row["airspeed_mps"] / true_over_equivalent(altitude)
        climb = -row["v_down_mps"]
        add(us, dialect.MAVLink_vfr_hud_message(eas, 22.0, 0, percent, altitude + HOME, climb))
        heights = [round(1e3 * (altitude + HOME)), round(1e3 * altitude)]
        down = round(100 * row["v_down_mps"])
        add(us, dialect.MAVLink_global_position_int_message(ms, 0, 0, *heights, 0, 0, down, 0))
        pulses = [int(row[n]) for n in ("pwm_ail", "pwm_ele", "pwm_thr", "pwm_rud")]
        add(us, dialect.MAVLink_servo_output_raw_message(1000 * ms, 0, *pulses, 0, 0, 0, 0))
        flow = np.degrees([row["alpha_rad"], row["beta_rad"]])
        add(us, dialect.MAVLink_aoa_ssa_message(1000 * ms, *flow))
    return records


def write_tlog(path, *streams):
    """Write a .tlog of several senders; its first record is of a ground station, at 0 s."""
    station = vehicle(255, 190)
    first = heartbeat(0, dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID).pack(station)
    records = sorted((r for stream in streams for r in stream), key=lambda record: record[0])
    with path.open("wb") as file:
        for us, frame in [(EPOCH_US, first), *records]:
            file.write(struct.pack(">Q", us) + frame)
    return path


def gps_time(unix_s):
    """Return week and ms of the week, of GPS time."""
    ms = round(1e3 * (unix_s - GPS_EPOCH.timestamp() + LEAP_S))
    return divmod(ms, 7 * 86400 * 1000)


def write_run_dataflash(path, log, name, *, boot_s=0.0, unix_s=1_777_627_800.0, without=()):
    """Write the .bin that the autopilot of an aircraft of a run would have written.

    Args:
        path: of the file.
        log: of the run, as `testbed.logs.read.read_log` reads it.
        name: of the aircraft.
        boot_s: time of the autopilot's clock at the beginning of the run.
        unix_s: UNIX time of the beginning, 2026-05-01T09:30:00Z.
        without: messages that are left out.
    """
    from testbed.core.geodetic import geodetic_from_ned

    k = log.info.names.index(name)
    truth = log.truth
    geodetic = geodetic_from_ned(truth.position_ned[:, k], log.info.origin)
    command, surfaces = log.command, log.surfaces
    file = DataFlash(WITH_POSITION, left_out=without)
    file.add("MSG", 0, b"ArduPlane V4.7.0-dev")
    for parameter, value in PARAMS.items():
        file.add("PARM", 0, parameter.encode(), value, value)
    file.add("MODE", round(1e6 * boot_s), AUTO if k == 0 else FBWA, AUTO if k == 0 else FBWA, 0)
    for i, t in enumerate(log.time_s):
        us = round(1e6 * (t + boot_s))
        roll, pitch, yaw = truth.euler[i, k]
        north, east, down = truth.velocity_ned[i, k]
        lat, lng, height = geodetic[i]
        e7 = round(1e7 * lat), round(1e7 * lng)
        throttle = surfaces.throttle[i, k]
        demand = demands_deg(
            {
                "throttle_cmd": throttle,
                "phi_cmd_rad": command.roll[i, k],
                "theta_cmd_rad": command.pitch[i, k],
                "theta_rad": pitch,
                "phi_rad": roll,
            }
        )
        angles = np.degrees([roll, pitch, yaw % (2.0 * np.pi)])
        file.add("ATT", us, demand[0], angles[0], demand[1], angles[1], 0.0, angles[2], 0)
        file.add("IMU", us, 0, *truth.rates_body[i, k], 0.0, 0.0, -9.8)
        equivalent = truth.equivalent_airspeed[i, k]
        file.add("ARSP", us, 0, equivalent)
        ratio = truth.airspeed[i, k] / equivalent
        file.add("CTUN", us, 0, 0, 0, 0, 100.0 * throttle, 0.0, equivalent, ratio)
        pulses = 500.0 * np.array(
            [surfaces.aileron[i, k], -surfaces.elevator[i, k], -surfaces.rudder[i, k]]
        )
        aileron, elevator, rudder = (round(1500.0 + each) for each in pulses)
        file.add("RCOU", us, aileron, elevator, round(1000.0 + 1000.0 * throttle), rudder)
        above = height - log.info.origin.elevation_m
        file.add("POS", us, *e7, height, above, above)
        file.add("XKF1", us, 0, north, east, down)
        file.add("XKF2", us, 0, *WIND)
        if i % 5 == 0:
            week, ms = gps_time(unix_s + t)
            speed, course = np.hypot(north, east), np.degrees(np.arctan2(east, north)) % 360.0
            fix = (us, 0, 3, ms, week, 12, 1.0, *e7, height, speed, course, down, 1)
            file.add("GPS", *fix)
    Path(path).write_bytes(file.bytes)


if __name__ == "__main__":
    from testbed.logs.read import read_log
    from testbed.logs.run_directory import find_run

    run, *names = sys.argv[1:]
    recorded_run = read_log(find_run(run))
    for number, each in enumerate(names or recorded_run.info.names):
        write_run_dataflash(f"{each}.bin", recorded_run, each, boot_s=20.0 + 7.3 * number)
