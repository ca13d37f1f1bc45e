"""Import of flight logs: a recorded flight is written as both kinds of log, and read back."""

import json
import math
import os
import random

import numpy as np
import pytest
from cases import ALL
from commands import environment
from flight_logs import (
    AUTO,
    FBWA,
    FORMATS,
    OLD_ATT,
    PARAMS,
    RECORDING,
    ROOT,
    heartbeat,
    recorded,
    tlog_records,
    vehicle,
    write_dataflash,
    write_tlog,
)
from fresh import run_fresh
from typer.testing import CliRunner

from testbed.cli.flight_logs import import_command
from testbed.cli.main import app
from testbed.commissioning.command_files import COMMANDS, RESPONSES
from testbed.commissioning.replay_commands import respond
from testbed.core.errors import InputError
from testbed.flight_logs import dataflash, tlog_flight
from testbed.flight_logs.flight_import import read_flight

FLIGHT = recorded()
SHORT = FLIGHT[:500]  # 20 s
LOGGED = FLIGHT if ALL else FLIGHT[:1500]
RASCAL = ROOT / "aircraft" / "rascal110"


def import_csv(path, out, **options):
    import_command(path, out, **options)
    return np.genfromtxt(out, delimiter=",", names=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("flights")


@pytest.fixture(scope="module")
def logs(folder):
    # a radio link that delays every row but the first by up to 39 ms
    late = np.random.default_rng(7).uniform(0.0, 0.039, len(LOGGED))
    late[0] = 0.0
    write_dataflash(folder / "flight.bin", LOGGED)
    # the first record is of the ground station, at 0 s
    write_tlog(folder / "flight.tlog", tlog_records(LOGGED, late=late, boot_ms=123_456))
    return folder


# One unit of the sixth digit in the CSV files (measured: no difference); GLOBAL_POSITION_INT has
# cm/s and mm.
SIX = 1e-5
TELEMETRY = {"v_down_mps": 0.00501, "altitude_m": 0.00051}


@pytest.mark.parametrize(("kind", "coarser"), [("bin", {}), ("tlog", TELEMETRY)])
def test_import_returns_the_flight(logs, kind, coarser):
    check_import(logs, kind, coarser, LOGGED)


def check_import(logs, kind, coarser, rows):
    imported = import_csv(logs / f"flight.{kind}", logs / f"{kind}.csv")
    assert imported.dtype.names == rows.dtype.names == COMMANDS + RESPONSES
    for name in rows.dtype.names:
        off = np.abs(imported[name] - rows[name])
        if name == "psi_rad":
            off = np.minimum(off, 2.0 * math.pi - off)
        room = coarser.get(name, 0.0) + SIX * np.maximum(np.abs(rows[name]), 0.1)
        if name.startswith("pwm"):
            room = np.zeros(len(off))
        assert (off <= room).all(), (name, off.max())


@pytest.mark.parametrize("kind", ["bin", "tlog"])
@pytest.mark.parametrize(
    ("name", "factor"), [("theta_rad", -1.0), ("airspeed_mps", 1.01), ("p_radps", 57.3)]
)
def test_import_of_another_flight_is_found(tmp_path, kind, name, factor):
    """A sign, a calibration and a unit."""
    other = SHORT.copy()
    other[name] *= factor
    if kind == "bin":
        write_dataflash(tmp_path / "flight.bin", other)
    else:
        write_tlog(tmp_path / "flight.tlog", tlog_records(other, boot_ms=123_456))
    with pytest.raises(AssertionError, match=name):
        check_import(tmp_path, kind, TELEMETRY, SHORT)


@pytest.mark.parametrize("kind", ["bin", "tlog"])
def test_import_replays_like_the_original(logs, kind):
    seconds = 40 if ALL else 15  # two steps or one
    rows = RECORDING.read_text().splitlines(keepends=True)[: 25 * seconds + 1]
    (logs / "original.csv").write_text("".join(rows))
    respond(RASCAL, logs / "original.csv", logs / "a.csv")
    import_csv(logs / f"flight.{kind}", logs / "commands.csv", end=seconds)
    respond(RASCAL, logs / "commands.csv", logs / "b.csv")
    a, b = (np.genfromtxt(logs / f"{n}.csv", delimiter=",", names=True) for n in "ab")
    assert len(a) == len(b) == 25 * seconds
    assert np.abs(a["phi_cmd_rad"]).max() > 0.3
    for name in ("phi_rad", "theta_rad"):
        # measured: no difference; allowed: the effect of a last digit of a command or the start
        assert np.abs(a[name] - b[name]).max() < 1e-5
    assert np.abs(a["airspeed_mps"] - b["airspeed_mps"]).max() < 1e-3


def test_import_has_the_rows_of_both_ends(logs):
    whole = read_flight(logs / "flight.bin").columns
    first, last = whole["t_s"][[100, 200]]
    part = read_flight(logs / "flight.bin", begin=first, end=last).columns
    for name in ("t_s", "phi_rad"):
        assert part[name].tolist() == whole[name][100:201].tolist()


def test_import_older_logs_in_centidegrees(folder):
    old = FORMATS | {"ATT": OLD_ATT}
    path = write_dataflash(folder / "old.bin", SHORT, formats=old)
    imported = read_flight(path).columns
    half = math.radians(0.005) + 1e-6
    for name in ("phi_rad", "theta_rad", "phi_cmd_rad", "theta_cmd_rad"):
        assert np.abs(imported[name] - SHORT[name]).max() < half


def test_import_columns_are_those_of_a_replay():
    for kind in (dataflash, tlog_flight):
        assert ("t_s", *kind.COLUMNS) == COMMANDS + RESPONSES


def test_import_adds_stab_pitch_down(folder):
    """Below the trim throttle ArduPlane logs a reduced pitch; the replay reduces it again."""
    params = {k: v for k, v in PARAMS.items() if k != "STAB_PITCH_DOWN"}
    lowered = read_flight(write_dataflash(folder / "p.bin", SHORT, params=params))
    found = read_flight(write_dataflash(folder / "q.bin", SHORT))
    down = np.radians(2.0 * (1.0 - SHORT["throttle_cmd"] / 0.5))
    off = found.columns["theta_cmd_rad"] - lowered.columns["theta_cmd_rad"]
    assert np.abs(off - down).max() < 1e-6
    assert any("STAB_PITCH_DOWN" in note for note in lowered.notes)
    assert not any("STAB_PITCH_DOWN" in note for note in found.notes)


def test_import_of_a_sitl_log_names_its_rate(folder):
    """SITL's gyro filter depends on its physics rate; a log of an aircraft has no such note."""
    sitl = write_dataflash(folder / "s.bin", SHORT, params=PARAMS | {"SIM_RATE_HZ": 1200.0})
    (note,) = [note for note in read_flight(sitl).notes if "gyro filter" in note]
    assert note.endswith("respond --sitl-rate 1200")
    own = read_flight(write_dataflash(folder / "a.bin", SHORT)).notes
    assert not any("gyro filter" in note for note in own)


@pytest.mark.parametrize("kind", ["bin", "tlog"])
def test_import_restores_commands_in_a_bank(folder, kind):
    """Nose down at 50° of bank: ArduPlane logs 64 % of it, and a roll less by the pitch."""
    rows = SHORT[100:200].copy()
    rows["phi_rad"] = rows["phi_cmd_rad"] = math.radians(50.0)
    rows["theta_rad"] = rows["theta_cmd_rad"] = math.radians(-12.0)
    path = folder / f"bank.{kind}"
    if kind == "bin":
        write_dataflash(path, rows)
    else:
        write_tlog(path, tlog_records(rows))
    columns = read_flight(path).columns
    for name in ("phi_cmd_rad", "theta_cmd_rad"):
        assert columns[name] == pytest.approx(rows[name], abs=1e-6)


def test_import_true_airspeed_from_either_ratio(folder):
    path = write_dataflash(folder / "e.bin", SHORT, left_out=("CTUN",))
    flight = read_flight(path)
    assert flight.sources["airspeed_mps"] == "ARSP.Airspeed × the standard atmosphere at POS.Alt"
    assert np.abs(flight.columns["airspeed_mps"] - SHORT["airspeed_mps"]).max() < 1e-3


def test_import_outputs_by_function_and_reversed(folder):
    """Aileron on output 4 and reversed, rudder on 1; the elevator not reversed."""
    params = PARAMS | {
        "SERVO1_FUNCTION": 21.0,
        "SERVO1_REVERSED": 1.0,
        "SERVO4_FUNCTION": 4.0,
        "SERVO4_REVERSED": 1.0,
        "SERVO2_REVERSED": 0.0,
    }
    imported = read_flight(write_dataflash(folder / "s.bin", SHORT, params=params)).columns
    assert np.array_equal(imported["pwm_rud"], SHORT["pwm_ail"])
    assert np.array_equal(imported["pwm_ail"], 3000.0 - SHORT["pwm_rud"])
    assert np.array_equal(imported["pwm_ele"], 3000.0 - SHORT["pwm_ele"])


def test_import_mixed_surfaces_from_demands(folder):
    elevons = PARAMS | {"SERVO1_FUNCTION": 77.0, "SERVO2_FUNCTION": 78.0, "SERVO4_FUNCTION": 0.0}
    flight = read_flight(write_dataflash(folder / "m.bin", SHORT, params=elevons))
    for name in ("pwm_ail", "pwm_ele", "pwm_rud"):
        assert flight.sources[name].startswith("AETR")
        assert np.abs(flight.columns[name] - SHORT[name]).max() < 1e-3
    assert flight.sources["pwm_thr"] == "RCOU.C3"


def test_import_throttle_sources(folder):
    """In the recording the motor output is one row later than its command."""
    ends = PARAMS | {"SERVO3_MIN": 1000.0, "SERVO3_MAX": 2000.0}
    rows = FLIGHT[2400:2800]
    sent = (rows["pwm_thr"] - 1000.0) / 1000.0
    assert (sent != rows["throttle_cmd"]).sum() == 2
    bare = ("AETR", "CTUN")
    for path, source, wanted in (
        (write_dataflash(folder / "t.bin", rows), "AETR.Thr", rows["throttle_cmd"]),
        (write_dataflash(folder / "u.bin", rows, params=ends, left_out=bare), "RCOU.C3", sent),
        (
            write_tlog(folder / "t.tlog", tlog_records(rows)),
            "VFR_HUD.throttle",
            rows["throttle_cmd"],
        ),
        (
            write_tlog(folder / "u.tlog", tlog_records(rows, params=ends)),
            "SERVO_OUTPUT_RAW.servo3_raw",
            sent,
        ),
    ):
        flight = read_flight(path)
        assert flight.sources["throttle_cmd"] == source
        assert np.abs(flight.columns["throttle_cmd"] - wanted).max() < 1e-6


def test_import_longest_interval_in_mode(folder):
    modes = ((0.0, AUTO), (3.0, FBWA), (8.0, AUTO), (9.0, FBWA), (19.0, AUTO))
    path = write_dataflash(folder / "modes.bin", SHORT, modes=modes)

    def ends(**options):
        time = read_flight(path, **options).columns["t_s"]
        return time[0], time[-1], len(time)

    rows = SHORT["t_s"]
    assert ends() == pytest.approx((9.015, 19.015, 251), abs=1e-9)
    assert any("3.0 to 8.0" in note for note in read_flight(path).notes)
    assert ends(end=9.0) == pytest.approx((3.015, 8.015, 126), abs=1e-9)
    assert ends(mode="any") == pytest.approx((rows[0], rows[-1], len(rows)), abs=1e-9)
    assert ends(mode="auto", begin=5.0, end=8.99) == pytest.approx((8.015, 8.975, 25), abs=1e-9)
    assert read_flight(path, mode="any").modes == ("AUTO", "FBWA")
    for options in ({"mode": "RTL"}, {"begin": 30.0}):
        with pytest.raises(InputError, match=r"nothing in \w+ .* AUTO 0.0 to 3.0, FBWA 3.0"):
            read_flight(path, **options)
    with pytest.raises(InputError, match="write any, or one of MANUAL"):
        read_flight(path, mode="HOVER")


def test_import_mode_between_heartbeats(folder):
    def mode(t):
        return FBWA if 5.0 < t < 12.0 else AUTO

    path = write_tlog(folder / "beats.tlog", tlog_records(SHORT, mode=mode))
    time = read_flight(path).columns["t_s"]
    assert (time[0], time[-1]) == pytest.approx((5.015, 11.015), abs=1e-6)


def test_import_pause_ends_an_interval(folder):
    rows = SHORT[(SHORT["t_s"] < 6.0) | (SHORT["t_s"] > 8.0)]
    flight = read_flight(write_dataflash(folder / "gap.bin", rows))
    assert flight.columns["t_s"][0] == pytest.approx(8.015)
    assert any("0.0 to 6.0" in note for note in flight.notes)


def test_import_reboot_starts_a_new_clock(folder):
    before = tlog_records(SHORT[:100], boot_ms=900_000)
    after = tlog_records(SHORT[150:], boot_ms=-5_000)
    time = read_flight(write_tlog(folder / "boot.tlog", before, after)).columns["t_s"]
    assert time == pytest.approx(SHORT["t_s"][150:], abs=1e-6)


def test_import_notes_slow_commands(folder):
    """Demands arrive twice per second, the default of ground stations."""
    path = folder / "slow.tlog"
    fast = tlog_records(SHORT, left_out=("NAV_CONTROLLER_OUTPUT",))
    others = ("ATTITUDE", "VFR_HUD", "GLOBAL_POSITION_INT", "SERVO_OUTPUT_RAW", "HEARTBEAT")
    slow = tlog_records(SHORT[::12], left_out=(*others, "AOA_SSA", "PARAM_VALUE"))
    flight = read_flight(write_tlog(path, fast, slow))
    (roll,) = [note for note in flight.notes if note.startswith("phi_cmd_rad")]
    assert "2.08 times a second; a step may be 0.48 s late" in roll
    held = SHORT["phi_cmd_rad"][np.arange(500) // 12 * 12]
    assert np.abs(flight.columns["phi_cmd_rad"] - held).max() < 1e-6


def test_import_several_vehicles_need_system(folder):
    other = SHORT.copy()
    other["phi_rad"] += 0.1
    path = write_tlog(
        folder / "two.tlog", tlog_records(SHORT), tlog_records(other[:250], system=7, mode=AUTO)
    )
    for options in ({}, {"system": 3}):
        with pytest.raises(InputError, match=r"one of 1 \(20 s FBWA\), 7 \(10 s AUTO\)"):
            read_flight(path, **options)
    seventh = read_flight(path, system=7, mode="AUTO").columns["phi_rad"]
    assert np.abs(seventh - other["phi_rad"][:250]).max() < 1e-6


def test_import_missing_columns_are_reported(folder):
    path = write_dataflash(folder / "few.bin", SHORT, left_out=("AOA", "ARSP", "IMU", "GPS"))
    flight = read_flight(path)
    assert set(flight.missing) == {
        *("alpha_rad", "beta_rad", "p_radps", "q_radps", "r_radps", "v_down_mps")
    }
    assert flight.sources["airspeed_mps"].startswith("CTUN.As")
    assert "no IMU; have it logged (LOG_BITMASK" in flight.missing["p_radps"]
    out = folder / "few.csv"
    imported = import_csv(path, out)
    assert "p_radps" not in imported.dtype.names
    respond(RASCAL, out, folder / "answer.csv")


@pytest.mark.parametrize(
    ("left_out", "text"),
    [
        (("ATT",), "no ATT; have it logged"),
        (("AETR", "CTUN", "RCOU"), "no AETR, no CTUN, no RCOU, so no throttle_cmd; have"),
    ],
)
def test_import_log_without_commands_is_an_error(folder, left_out, text):
    path = write_dataflash(folder / "none.bin", SHORT, left_out=left_out)
    with pytest.raises(InputError, match=text):
        read_flight(path)


def test_import_tlog_without_demands_is_an_error(folder):
    records = tlog_records(SHORT, left_out=("NAV_CONTROLLER_OUTPUT",))
    with pytest.raises(InputError, match="no NAV_CONTROLLER_OUTPUT, so no theta_cmd_rad; have it"):
        read_flight(write_tlog(folder / "none.tlog", records))
    with pytest.raises(InputError, match=r"no autopilot sent ATTITUDE; it has systems \[1\]"):
        read_flight(write_tlog(folder / "none.tlog", tlog_records(SHORT, left_out=("ATTITUDE",))))


def test_import_other_vehicles_are_an_error(folder):
    path = write_dataflash(folder / "copter.bin", SHORT, text="ArduCopter V4.5.7")
    with pytest.raises(InputError, match="a log of ArduCopter; give one of ArduPlane"):
        read_flight(path)
    px4 = [(us, heartbeat(0, autopilot=12).pack(vehicle(1))) for us, _ in tlog_records(SHORT[:1])]
    records = tlog_records(SHORT, mode=None)
    with pytest.raises(InputError, match="not ArduPlane .HEARTBEAT has autopilot 12"):
        read_flight(write_tlog(folder / "px4.tlog", records, px4))


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "this is empty"),
        (b"ULog\x01\x12\x35", "no ULog: its header is cut off"),
        (b"\x89MCAP0\r\n", "an MCAP log"),
        (b"FMT, 128, 89, FMT, BBnNZ", "as text; give the .bin"),
        (b"PK\x03\x04rest", "unpack it first"),
        (b"t_s,theta_cmd_rad\n0,0\n" * 100, "this is none of these"),
        (heartbeat(5).pack(vehicle(1)) * 20, "MAVLink without times"),
    ],
)
def test_import_other_files_are_identified(folder, content, text):
    path = folder / "flight.dat"
    path.write_bytes(content)
    with pytest.raises(InputError, match=text) as error:
        read_flight(path)
    assert str(path) in str(error.value)


def test_import_bad_arguments_are_errors(folder, logs):
    with pytest.raises(InputError, match="nothing.bin"):
        read_flight(folder / "nothing.bin")
    with pytest.raises(InputError, match="--system 3: .* leave it out"):
        read_flight(logs / "flight.bin", system=3)
    with pytest.raises(InputError, match="--out"):
        import_csv(logs / "flight.bin", folder / "no" / "where.csv")
    with pytest.raises(InputError, match="--from 9: not before --to 9"):
        import_csv(logs / "flight.bin", folder / "o.csv", begin=9.0, end=9.0)
    words = ("import", logs / "flight.bin", "--out", folder / "o.csv", "--to", "nan")
    done = CliRunner().invoke(app, list(map(str, words)))
    assert str(done.exception) == "--to nan: write a finite number"


def test_import_cut_log_is_noted(folder):
    whole = write_dataflash(folder / "whole.bin", SHORT).read_bytes()
    (folder / "cut.bin").write_bytes(whole[: len(whole) // 2])
    assert 240 < len(read_flight(folder / "cut.bin").columns["t_s"]) < 260
    whole = write_tlog(folder / "whole.tlog", tlog_records(SHORT)).read_bytes()
    (folder / "cut.tlog").write_bytes(whole[: len(whole) // 2 + 3])
    flight = read_flight(folder / "cut.tlog")
    assert 240 < len(flight.columns["t_s"]) < 260
    assert any("last record is cut off" in note for note in flight.notes)


def test_import_damaged_time_loses_one_row(folder):
    rows = SHORT.copy()
    rows["t_s"][100] = 1e6
    flight = read_flight(write_dataflash(folder / "time.bin", rows))
    assert len(flight.columns["t_s"]) == 499


def damage(good, rng):
    """Damage a file up to five times, half of them in the definitions at its start."""
    data = bytearray(good)
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(3, 1300)
        way, size = rng.randrange(5), rng.randrange(1, 200)
        if way == 0:
            data[at : at + size] = b""
        elif way == 1:
            data[at:at] = rng.randbytes(size)
        elif way == 2:
            data[at : at + size] = data[(other := rng.randrange(len(data))) : other + size]
        else:
            data[at : at + 1] = rng.randbytes(1)
    return bytes(data)


def test_import_damage_is_noted_or_an_error(folder, capfd):
    rng = random.Random(3)
    path = folder / "damaged.bin"
    good = write_dataflash(path, SHORT[:100]).read_bytes()
    fine = 0
    tries = int(os.environ.get("TESTBED_FRAMES", "1500")) // 30
    for _ in range(tries):
        path.write_bytes(damage(good, rng))
        try:
            fine += len(read_flight(path).columns["t_s"]) > 50
        except InputError as error:
            assert str(path) in str(error)
    assert fine > tries / 2  # measured: three of four
    assert capfd.readouterr().err == ""


def test_import_noise_is_counted(folder):
    path = folder / "noise.bin"
    good = write_dataflash(path, SHORT).read_bytes()
    half = good.index(bytes([0xA3, 0x95, FORMATS["ATT"][0]]), len(good) // 2)
    path.write_bytes(good[:half] + bytes(64) + good[half:])
    flight = read_flight(path)
    assert len(flight.columns["t_s"]) == len(SHORT)
    # and the AOA before them, 19 bytes, which no other message follows
    assert "83 bytes are damaged and were left out" in flight.notes


def test_import_damaged_definition_is_named(folder):
    path = folder / "defined.bin"
    good = write_dataflash(path, SHORT).read_bytes()
    path.write_bytes(good.replace(b"DesPitch,", b"DesPitch-"))
    with pytest.raises(InputError, match="no ATT; .* the definition of ATT is damaged"):
        read_flight(path)
    path.write_bytes(good.replace(b"GyrX,", b"GyrX-"))
    flight = read_flight(path)
    assert "the definition of IMU is damaged" in flight.missing["p_radps"]
    assert np.abs(flight.columns["phi_rad"] - SHORT["phi_rad"]).max() < 1e-6


def test_only_mit_modules_of_pymavlink_are_loaded(tmp_path):
    """Only its generated tables; the packages around them contain only a version."""
    write_dataflash(tmp_path / "flight.bin", SHORT)
    write_tlog(tmp_path / "flight.tlog", tlog_records(SHORT))
    code = f"""
import json, sys
from pathlib import Path
from testbed.mavlink.codec import Codec
from testbed.flight_logs.flight_import import read_flight
from testbed.mavlink.signing import Signing
from testbed.mavlink.tlog import TlogWriter
for kind in ("bin", "tlog"):
    read_flight(Path({str(tmp_path)!r}) / f"flight.{{kind}}")
link = Codec(1, 1, Signing(bytes(32)))
link.feed(link.pack("PARAM_REQUEST_LIST", target_system=1, target_component=1))
loaded = [m for name, m in sys.modules.items() if name.split(".")[0] == "pymavlink"]
print(json.dumps({{m.__name__: Path(m.__file__).read_text() for m in loaded}}))
"""
    done, output, errors = run_fresh(code, folder=ROOT, paths=[ROOT], env=environment(80))
    assert done == 0, errors
    sources = json.loads(output)
    tables = "pymavlink.dialects.v20.ardupilotmega"
    packages = {"pymavlink", "pymavlink.dialects", "pymavlink.dialects.v20"}
    assert sources.keys() == packages | {tables}
    assert "auto-generated by mavgen.py" in sources[tables][:200]
    assert not any("GPL" in text or "General Public" in text for text in sources.values())
    assert all(len(sources[name].splitlines()) <= 2 for name in packages)
