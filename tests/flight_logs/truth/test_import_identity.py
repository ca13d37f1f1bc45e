"""Logs with several vehicles, clocks and sensors: a table of one flight, or an error.

Each vehicle has values of its own in every column, and its heading is a clock. TESTBED_IMPORTS sets
the number of random logs.
"""

import os
import random
import struct

import numpy as np
import pytest
from flight_logs import (
    AUTO,
    EPOCH_US,
    FBWA,
    FORMATS,
    OLD_ATT,
    PARAMS,
    DataFlash,
    heartbeat,
    recorded,
    tlog_records,
    vehicle,
    write_dataflash,
    write_tlog,
)
from pymavlink.dialects.v20 import ardupilotmega as dialect

from testbed.core.errors import InputError
from testbed.flight_logs.flight_import import read_flight

FLIGHT = recorded()
LOGS = int(os.environ.get("TESTBED_IMPORTS", "12"))
SEED = 20261126
ROWS = 120  # of a flight, 25 per second
MODE = b"\xa3\x95" + bytes([FORMATS["MODE"][0]])
TURN = 0.02  # rad/s, of the heading
COLUMNS = {
    "phi_rad": (0.1, 0.15), "theta_rad": (0.02, 0.03), "psi_rad": (1.0, 0.9),
    "phi_cmd_rad": (0.11, 0.15), "theta_cmd_rad": (0.03, 0.03), "throttle_cmd": (0.5, 0.1),
    "p_radps": (0.01, 0.02), "q_radps": (0.02, 0.02), "r_radps": (0.03, 0.02),
    "airspeed_mps": (20.0, 2.0), "altitude_m": (100.0, 40.0), "v_down_mps": (0.1, 0.2),
    "alpha_rad": (0.04, 0.01), "beta_rad": (0.01, 0.01), "pwm_ail": (1500, 20),
    "pwm_ele": (1510, 20), "pwm_thr": (1520, 20), "pwm_rud": (1530, 20),
}  # of the first vehicle, and the difference to the next  # fmt: skip


def rows_of(number, count=ROWS, start=0.0):
    """Return the rows of vehicle `number`, whose heading tells the time since `start`."""
    rows = FLIGHT[:count].copy()
    rows["t_s"] = start + np.arange(count) / 25.0
    for name, (first, difference) in COLUMNS.items():
        rows[name] = first + number * difference
    rows["psi_rad"] += TURN * np.arange(count) / 25.0
    return rows


def wrong_rows(flight, number):
    """Count the rows that are not of vehicle `number`, or not at its time."""
    columns = flight.columns
    t = columns["t_s"]
    assert (np.diff(t) > 0.0).all()
    wrong = np.zeros(len(t), dtype=bool)
    for name, values in columns.items():
        if name in COLUMNS and name != "psi_rad":
            first, difference = COLUMNS[name]
            wrong |= np.abs(values - first - number * difference) > 0.1 * difference
    first, difference = COLUMNS["psi_rad"]
    own = (columns["psi_rad"] - first - number * difference) / TURN - t  # s, a constant
    return int(np.count_nonzero(wrong | (np.abs(own - np.median(own)) > 0.1)))


def place(records, us):
    return [(time + us, frame) for time, frame in records]


def tlog_one(rng, path):
    return write_tlog(path, tlog_records(rows_of(0), boot_ms=rng.randrange(10**6))), {0}


def tlog_two_of_one_id(rng, path):
    """Clocks that are equal, nearly equal, or far apart."""
    boots = [10**6, 10**6 + rng.choice([0, 1, 40, -500, 999, 5_000, -60_000, 600_000])]
    shift = rng.choice([0, 3_000, 20_000, 400_000])
    one, other = (tlog_records(rows_of(n), boot_ms=boots[n]) for n in range(2))
    return write_tlog(path, one, place(other, shift)), set()


def tlog_two_ids(rng, path):
    number = rng.randrange(2)
    logs = [tlog_records(rows_of(n), system=5 + n, boot_ms=1000 * n) for n in range(2)]
    return write_tlog(path, *logs), {number}, {"system": 5 + number}


def tlog_one_after_the_other(rng, path):
    """A reboot, or another vehicle: the longer flight."""
    counts = rng.sample([70, 100, 130], 2)
    us = round(1e6 * (counts[0] / 25.0 + rng.uniform(0.0, 3.0)))
    other = rng.randrange(2)
    one = tlog_records(rows_of(0, counts[0]), boot_ms=100_000)
    boot = rng.choice([0, 900_000])
    later = place(tlog_records(rows_of(other, counts[1]), boot_ms=boot), us)
    return write_tlog(path, one, later), {0 if counts[0] > counts[1] else other}


def tlog_receiver_steps(rng, path):
    step = rng.choice([-1, 1]) * rng.choice([2, 300, 86_400 * 20_000]) * 10**6
    records = tlog_records(rows_of(0), boot_ms=5_000)
    k = rng.randrange(1, len(records))
    step = max(step, -EPOCH_US)
    moved = records[:k] + place(records[k:], step)
    path.write_bytes(b"".join(struct.pack(">Q", us) + frame for us, frame in moved))
    return path, {0}


def tlog_damaged_receipts(rng, path):
    records = tlog_records(rows_of(0), boot_ms=5_000)
    for k in [0, *rng.sample(range(len(records)), 3)]:
        if rng.random() < 0.7:
            records[k] = (rng.choice([0, 1, 2**60, EPOCH_US + rng.randrange(10**8)]), records[k][1])
    path.write_bytes(b"".join(struct.pack(">Q", us) + frame for us, frame in records))
    return path, {0}


def tlog_other_component(rng, path):
    """A companion computer of the same system, and outputs of another port."""
    other = vehicle(1, rng.choice([2, 100, 191]))
    extra = []
    for us, frame in tlog_records(rows_of(1), boot_ms=7):
        message = dialect.MAVLink(None).decode(bytearray(frame))
        extra.append((us + 1, message.pack(other)))
    one = tlog_records(rows_of(0))
    aux = dialect.MAVLink_servo_output_raw_message(0, 1, *[1100] * 8)
    ports, sender = [], vehicle(1)
    for us, frame in one[::7]:
        sender.seq = dialect.MAVLink(None).decode(bytearray(frame)).get_seq()
        ports.append((us, aux.pack(sender)))
    return write_tlog(path, one, extra, ports), {0}


def tlog_two_links(rng, path):
    """Each message is received twice, with other sequence numbers."""
    records = tlog_records(rows_of(0))
    sender = vehicle(1)
    sender.seq = rng.randrange(256)
    again = []
    for us, frame in records:
        again.append((us + 15_000, dialect.MAVLink(None).decode(bytearray(frame)).pack(sender)))
        sender.seq = (sender.seq + 1) % 256
    return write_tlog(path, records, again), {0}


def tlog_damaged(rng, path):
    data = bytearray(write_tlog(path, tlog_records(rows_of(0))).read_bytes())
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(data))
        data[at : at + rng.randrange(1, 50)] = rng.randbytes(rng.randrange(50))
    path.write_bytes(data[: rng.randrange(len(data) // 2, len(data))])
    return path, {0, None}


def tlog_of_another_vehicle(rng, path):
    kind, autopilot = rng.choice([(2, 3), (10, 3), (12, 3), (1, 12), (13, 3), (4, 3)])
    frame = heartbeat(FBWA, kind, autopilot).pack(vehicle(1))
    records = tlog_records(rows_of(0), mode=rng.choice([None, FBWA]))
    return write_tlog(path, records, [(records[rng.randrange(50)][0], frame)]), set()


def bin_one(rng, path):
    del rng
    return write_dataflash(path, rows_of(0)), {0}


def bin_of_another_vehicle(rng, path):
    name = rng.choice(["ArduCopter", "APM:Copter", "APM:Rover", "Rover", "Sub", "Glider", "Xyz"])
    text = f"{name} {rng.choice(['V', 'v'])}{rng.randrange(9)}.{rng.randrange(9)} (0358a9c2)"
    return write_dataflash(path, rows_of(0), text=text, params={}), set()


def bin_several_sensors(rng, path):
    """Sensors of all numbers, in any order; the lowest is of vehicle 0."""
    numbers = rng.sample(range(4), rng.randrange(1, 4))
    log = DataFlash(FORMATS | {"BARO": (20, "QBff", "TimeUS,I,Alt,CRt")}, left_out=("POS",))
    log.add("MSG", 0, b"ArduPlane V4.7.0 (0358a9c2)")
    log.add("MODE", 0, FBWA, FBWA, 0)
    for row in rows_of(0):
        us = round(1e6 * row["t_s"])
        roll, pitch, yaw = np.degrees([row[n] for n in ("phi_rad", "theta_rad", "psi_rad")])
        command = np.degrees(row["phi_cmd_rad"]) * np.cos(row["theta_rad"])
        log.add("ATT", us, command, roll, np.degrees(row["theta_cmd_rad"]), pitch, 0, yaw, 0)
        for number in numbers:
            mine = row if number == min(numbers) else rows_of(1, 1)[0]
            rates = [mine[n] for n in ("p_radps", "q_radps", "r_radps")]
            log.add("IMU", us, number, *rates, 0, 0, 0)
            log.add("BARO", us, number, mine["altitude_m"], -mine["v_down_mps"])
            log.add("ARSP", us, number, mine["airspeed_mps"])
        log.add("AETR", us, 0, 0, 100.0 * row["throttle_cmd"], 0)
        log.add("RCOU", us, *(int(row[n]) for n in COLUMNS if n.startswith("pwm")))
    path.write_bytes(log.bytes)
    return path, {0}


def bin_two_logs(rng, path):
    """One after the other: files, or flights in one file."""
    start = rng.choice([0.0, 3.0, 60.0])
    first = write_dataflash(path, rows_of(0)).read_bytes()
    second = write_dataflash(path, rows_of(1, start=start)).read_bytes()
    whole = start > ROWS / 25.0 or rng.random() < 0.5
    path.write_bytes(first + (second if whole else second[second.index(b"\xa3\x95\x02") :]))
    return path, set()


def bin_two_mixed(rng, path):
    """The messages of two vehicles in turns."""
    shift = rng.choice([-0.5, 5.0, 90.0])
    parts = []
    for number, begin in ((0, 0.0), (1, shift)):
        data = write_dataflash(path, rows_of(number, start=100.0 + begin), modes=((0.0, FBWA),))
        data = data.read_bytes()
        head, *rest = data.split(b"\xa3\x95" + bytes([FORMATS["ATT"][0]]))
        parts.append((head, [b"\xa3\x95" + bytes([FORMATS["ATT"][0]]) + each for each in rest]))
    burst = rng.randrange(1, 4)
    data = parts[0][0]
    for k in range(0, ROWS, burst):
        data += b"".join(parts[0][1][k : k + burst]) + b"".join(parts[1][1][k : k + burst])
    path.write_bytes(data)
    return path, set()


def bin_damaged(rng, path):
    data = bytearray(write_dataflash(path, rows_of(0)).read_bytes())
    definitions = len(FORMATS) * 89 + 2000
    for _ in range(rng.randrange(1, 4)):
        at = rng.randrange(definitions, len(data))
        data[at : at + rng.randrange(1, 200)] = rng.randbytes(rng.randrange(200))
    path.write_bytes(data[: rng.randrange(len(data) * 2 // 3, len(data))])
    return path, {0, None}


def move_mode(path, number, us):
    """Give a MODE message another time."""
    data = bytearray(path.read_bytes())
    at = [k for k in range(len(data)) if data.startswith(MODE, k)][number]
    data[at + 3 : at + 11] = struct.pack("<Q", us)
    path.write_bytes(data)
    return path


def bin_mode_times(rng, path):
    """Vehicle 1 flies in AUTO, between two parts in FBWA; a MODE message has another time."""
    rows = rows_of(0, 200)
    rows[121:130] = rows_of(1, 200)[121:130]
    modes = ((0.0, FBWA), (rows["t_s"][120], AUTO), (rows["t_s"][130], FBWA))
    write_dataflash(path, rows, modes=modes)
    number = rng.randrange(1, 3)
    right = modes[number][0]
    time = rng.choice(
        [right, rng.uniform(0.0, right - 1.5), rng.uniform(right + 1.5, 7.9), 1e3, 1e12]
    )
    return move_mode(path, number, round(1e6 * time)), {0}


def declare(path, multipliers, ids, formats=FORMATS):
    """Write a log of vehicle 0 that declares multipliers of ATT, ids by field."""
    formats = formats | {
        "MULT": (21, "Qbd", "TimeUS,Id,Mult"),
        "FMTU": (22, "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
        "UNIT": (23, "QbZ", "TimeUS,Id,Label"),
    }
    log = DataFlash(formats)
    log.add("UNIT", 0, -5, b"damaged")
    for name, value in multipliers.items():
        log.add("MULT", 0, name, value)
    log.add("FMTU", 0, FORMATS["ATT"][0], b"", ids)
    write_dataflash(path, rows_of(0), formats=formats)
    path.write_bytes(bytes(log.bytes) + path.read_bytes()[len(formats) * 89 :])
    return path


MULTIPLIERS = {ord("0"): 1.0, ord("B"): float(np.float32(0.01)), ord("F"): 1e-6, ord("?"): 2.0}


def bin_multipliers(rng, path):
    hundredths = rng.random() < 0.5
    right = "F" + ("B" if hundredths else "0") * 6
    ids = list(right)
    for _ in range(rng.randrange(3)):
        ids[rng.randrange(7)] = rng.choice("0BF?-")
    read = (0, 1, 2, 3, 4, 6)  # without DesYaw
    wrong = any(ids[k] not in (right[k], *"?-") for k in read)
    formats = FORMATS | ({"ATT": OLD_ATT} if hundredths else {})
    declare(path, MULTIPLIERS, "".join(ids).encode(), formats)
    return path, set() if wrong else {0}


MAKERS = [
    tlog_one, tlog_two_of_one_id, tlog_two_ids, tlog_one_after_the_other, tlog_receiver_steps,
    tlog_damaged_receipts, tlog_other_component, tlog_two_links, tlog_damaged,
    tlog_of_another_vehicle, bin_one, bin_of_another_vehicle, bin_several_sensors, bin_two_logs,
    bin_two_mixed, bin_damaged, bin_mode_times, bin_multipliers,
]  # fmt: skip


def test_import_gives_one_flight_or_an_error(tmp_path):
    """`allowed` are the vehicles of which the table may be; None: an error is right, too."""
    faults = []
    for number in range(LOGS):
        maker = MAKERS[number % len(MAKERS)]
        rng = random.Random(SEED + number)
        path, allowed, *options = maker(rng, tmp_path / f"{number % 16}.log")
        lossy = maker in (bin_damaged, tlog_damaged)
        try:
            flight = read_flight(path, **(options[0] if options else {}))
        except InputError as error:
            if allowed and None not in allowed:
                faults.append(f"{number} {maker.__name__}: {error}")
            assert str(path) in str(error)
            continue
        wrong = {each: wrong_rows(flight, each) for each in range(2)}
        spoilt = 9 if maker is bin_damaged else 0  # values in it have no checksum
        right = [each for each in wrong if wrong[each] <= spoilt]
        complete = lossy or len(flight.columns["t_s"]) >= 69
        if not set(right) & allowed or not complete:
            rows = len(flight.columns["t_s"])
            faults.append(f"{number} {maker.__name__}: {rows} rows, wrong {wrong} {flight.notes}")
    assert not faults, "\n".join(faults[:20])


@pytest.mark.parametrize(
    ("changed", "moved"),
    [({"altitude_m": 5.0}, "positions"), ({"psi_rad": 0.5}, "attitudes")],
)
def test_import_two_vehicles_in_formation_is_an_error(tmp_path, changed, moved):
    """Two aircraft with one system id, the same clock, and all but one value the same."""
    rows, other = rows_of(0), rows_of(0)
    for name, step in changed.items():
        other[name] += step
    path = write_tlog(tmp_path / "a.tlog", tlog_records(rows), place(tlog_records(other), 20_000))
    with pytest.raises(InputError, match=f"system 1: several vehicles: {moved} jump .*SYSID"):
        read_flight(path)


def test_import_says_what_is_left_out(tmp_path):
    rng = random.Random(1)
    left_out = " ".join(read_flight(tlog_other_component(rng, tmp_path / "a.tlog")[0]).notes)
    assert "left out: 720 of system 1, component" in left_out
    assert "SERVO_OUTPUT_RAW of other ports, outputs above the 16th, were left out" in left_out
    links = " ".join(read_flight(tlog_two_links(rng, tmp_path / "a.tlog")[0]).notes)
    assert "sequence numbers step back" in links
    sensors = " ".join(read_flight(bin_several_sensors(rng, tmp_path / "a.bin")[0]).notes)
    assert "IMU: number" in sensors
    assert "left out: 120 of" in sensors
    later = place(tlog_records(rows_of(1)), 6 * 10**6)
    path = write_tlog(tmp_path / "a.tlog", tlog_records(rows_of(0), boot_ms=90_000), later)
    assert any("clock starts again at 6.0 s" in note for note in read_flight(path).notes)


@pytest.mark.parametrize(
    ("text", "params", "outcome"),
    [
        ("ArduPlane V4.5.7 (0358a9c2)", {}, "plane"),
        ("APM:Plane V3.6.0 (abcdef01)", {}, "plane"),
        ("Own V1.2 [ArduPlane V4.5.7 (0358a9c2)]", {}, "plane"),
        ("ChibiOS: d4fce84e", {"ROLL_LIMIT_DEG": 45.0}, "plane"),
        ("ChibiOS: d4fce84e", {"ATC_RAT_RLL_P": 0.1}, "unknown"),
        ("APM:Copter V3.4.6 (e707341b)", {}, "a log of APM:Copter; give one of ArduPlane"),
        ("Solo 2.4.2 (3d1ab6a5)", {}, "a log of Solo; give one of ArduPlane"),
    ],
)
def test_import_of_a_log_of(tmp_path, text, params, outcome):
    path = write_dataflash(tmp_path / "a.bin", rows_of(0, 20), text=text, params=params)
    if "log" in outcome:
        with pytest.raises(InputError, match=outcome):
            read_flight(path)
    else:
        doubted = any("does not say which vehicle" in note for note in read_flight(path).notes)
        assert doubted == (outcome == "unknown")


def test_import_of_a_log_with_build_of_another_vehicle(tmp_path):
    formats = FORMATS | {"VER": (21, "QBZ", "TimeUS,BU,FWS")}
    for build in (2, 3):
        log = DataFlash(formats)
        log.add("VER", 0, build, b"Own firmware")
        path = write_dataflash(
            tmp_path / "a.bin", rows_of(0, 20), text="x", params={}, formats=formats
        )
        path.write_bytes(bytes(log.bytes) + path.read_bytes()[len(formats) * 89 :])
        if build == 3:
            assert not any("which vehicle" in note for note in read_flight(path).notes)
        else:
            with pytest.raises(InputError, match="VER.BU is 2, not 3"):
                read_flight(path)


def test_import_checks_declared_units(tmp_path):
    formats = FORMATS | {
        "UNIT": (21, "QbZ", "TimeUS,Id,Label"),
        "FMTU": (22, "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
    }
    for unit in (b"d", b"-", b"r"):
        log = DataFlash(formats)
        for name, label in ((b"d", b"deg"), (b"-", b""), (b"r", b"rad"), (b"s", b"s")):
            log.add("UNIT", 0, name[0], label)
        log.add("FMTU", 0, FORMATS["ATT"][0], b"s" + 4 * unit, b"F0000")
        path = write_dataflash(tmp_path / "a.bin", rows_of(0, 20), formats=formats)
        path.write_bytes(bytes(log.bytes) + path.read_bytes()[len(formats) * 89 :])
        if unit == b"r":
            with pytest.raises(InputError, match=r"ATT.DesRoll is in rad; .* in deg"):
                read_flight(path)
        else:
            read_flight(path)


@pytest.mark.parametrize(
    ("ids", "field", "given"), [("FB", "DesRoll", "0.01"), ("C0", "TimeUS", "0.001")]
)
def test_import_refuses_other_multipliers(tmp_path, ids, field, given):
    path = declare(tmp_path / "a.bin", MULTIPLIERS | {ord("C"): 1e-3}, ids.encode())
    with pytest.raises(InputError, match=rf"ATT.{field} has the multiplier {given}; give a log of"):
        read_flight(path)


def test_import_takes_multipliers_that_say_nothing(tmp_path):
    """Ids without a multiplier, of none, unknown ones, and those that damage makes."""
    for wrong in ({}, {ord("x"): 0.0}, {ord("x"): float("nan")}, {-5: 1.0}, {ord("x"): 1.0}):
        path = declare(tmp_path / "a.bin", MULTIPLIERS | wrong, b"F-?x0")
        assert wrong_rows(read_flight(path), 0) == 0


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("time", [0.5, 7.5, 8.9, 1e3, 1e12])
def test_import_leaves_out_mode_at_another_time(tmp_path, number, time):
    """It steps back, jumps ahead, or lies behind the end: nothing of AUTO is taken for FBWA."""
    modes = ((0.0, FBWA), (3.0, AUTO), (5.0, FBWA))
    path = write_dataflash(tmp_path / "a.bin", rows_of(0, 200), modes=modes)
    flight = read_flight(move_mode(path, number, round(1e6 * time)))
    rows = flight.columns["t_s"]
    assert not ((rows > 3.0) & (rows < 5.0)).any()
    assert (rows[0], len(rows)) == (0.0, 76 - (number == 1))
    assert any(note.endswith("jump: 1 MODE") for note in flight.notes)
    assert any("unknown from a MODE that was left out" in note for note in flight.notes)


@pytest.mark.parametrize("us", [0, EPOCH_US + 7_500_000, EPOCH_US + 10**12])
def test_import_leaves_out_heartbeat_at_other_time(tmp_path, us):
    records = tlog_records(rows_of(0, 200), mode=lambda t: AUTO if t == 3.0 else FBWA)
    whole = [time for time, _ in records]
    at = [k for k, (_, frame) in enumerate(records) if frame[7:10] == b"\0\0\0"][3]
    records[at] = (us, records[at][1])
    assert whole[at] == EPOCH_US + 3_000_000
    path = tmp_path / "a.tlog"
    path.write_bytes(b"".join(struct.pack(">Q", us) + frame for us, frame in records))
    flight = read_flight(path)
    rows = flight.columns["t_s"]
    assert rows[0] == pytest.approx(4.0) and wrong_rows(flight, 0) == 0
    assert any(note.endswith("jump: 1 HEARTBEAT") for note in flight.notes)


def test_import_doubts_throttle_of_a_share(tmp_path):
    rows = rows_of(0, 20)
    for throttle, doubted in ((0.0057, True), (0.0, False), (0.3, False)):
        rows["throttle_cmd"] = throttle
        notes = read_flight(write_dataflash(tmp_path / "a.bin", rows)).notes
        assert any("never exceeds 1 %: AETR.Thr" in note for note in notes) == doubted


def test_import_missing_column_says_what_was_found(tmp_path):
    ctun = FORMATS | {"CTUN": (7, "Qf", "TimeUS,ThO")}
    log = DataFlash(ctun, left_out=("ARSP", "AETR"))
    for row in rows_of(0, 20):
        us = round(1e6 * row["t_s"])
        log.add("ATT", us, 0, 0, 0, 0, 0, 0, 0)
        log.add("CTUN", us, 50.0)
        log.add("RCOU", us, 1500, 1500, 0, 1500)
    (tmp_path / "a.bin").write_bytes(log.bytes)
    missing = read_flight(tmp_path / "a.bin", mode="any").missing
    assert missing["airspeed_mps"].startswith("no ARSP, CTUN has no As; have it logged")
    assert missing["pwm_thr"].startswith("RCOU.C3 is never a pulse, no AETR; ")
    params = PARAMS | {"SERVO3_FUNCTION": 0.0}
    path = write_tlog(tmp_path / "a.tlog", tlog_records(rows_of(0, 20), params=params))
    assert read_flight(path).missing["pwm_thr"].startswith("no output has SERVOn_FUNCTION 70; ")


def test_import_takes_the_core_that_flew(tmp_path):
    formats = FORMATS | {"XKF1": (23, "QBf", "TimeUS,C,VD"), "XKF4": (24, "QBb", "TimeUS,C,PI")}
    log = DataFlash(formats)
    for k in range(20):
        for core in range(2):
            log.add("XKF1", 40_000 * k, core, 7.0 + core)
            log.add("XKF4", 40_000 * k, core, 1)
    path = write_dataflash(tmp_path / "a.bin", rows_of(0, 20), formats=formats)
    path.write_bytes(bytes(log.bytes) + path.read_bytes()[len(formats) * 89 :])
    flight = read_flight(path)
    assert (flight.columns["v_down_mps"] == 8.0).all()
    assert "XKF1: number 1 is used; left out: 20 of 0" in flight.notes
