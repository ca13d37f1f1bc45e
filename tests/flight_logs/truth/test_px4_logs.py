"""Logs of PX4: a recorded flight is written as ULog, and read back; other vehicles; damage.

TESTBED_FRAMES sets the number of damaged logs.
"""

import json
import math
import os
import random
import struct
import time
from types import SimpleNamespace

import numpy as np
import pytest
from flight_logs import RECORDING, ROOT, recorded
from px4_logs import (
    FORMATS,
    NEW,
    OLD,
    ORIGIN,
    QUADPLANE,
    QUADROTOR,
    SYNC,
    TAILSITTER,
    UNIX_US,
    WIND,
    circle,
    definition,
    message,
    write_ulog,
)
from typer.testing import CliRunner

from testbed.cli.main import app
from testbed.commissioning.command_files import COMMANDS, RESPONSES, read_commands
from testbed.commissioning.replay_commands import respond
from testbed.core.errors import InputError
from testbed.core.geodetic import geodetic_from_ned
from testbed.flight_logs import ulog_file
from testbed.flight_logs.flight_import import read_flight, read_motions
from testbed.flight_logs.flight_log import MessageTable
from testbed.flight_logs.px4_flight import COLUMNS
from testbed.guidance.recorded_path import read_recording, sample_recording

FLIGHT = recorded()[:500]  # 20 s
BOOT_S = 20.0
SHORT = FLIGHT[:100]
RASCAL = ROOT / "aircraft" / "rascal110"
POSITIONS = ("vehicle_global_position", "vehicle_local_position", "vehicle_gps_position")
# Half a unit of a GPS position, 1e-7° and mm; of float32 at 488 + 100 m and at 300 m: m.
HALF = {
    "vehicle_global_position": (1e-4, 1e-4, 5e-5),
    "vehicle_local_position": (1e-4, 1e-4, 5e-5),
    "vehicle_gps_position": (0.0056 + 1e-4, 0.0038 + 1e-4, 5.5e-4),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("px4")


@pytest.fixture(scope="module")
def flight(folder):
    return write_ulog(folder / "flight.ulg", FLIGHT)


def run(*words, code=0):
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, (done.output, done.exception)
    return str(done.exception) if code else " ".join(done.output.split())


@pytest.fixture(scope="module")
def imported(folder, flight):
    """Import the flight; return the CSV file and what is printed."""
    about = folder / "about.yaml"
    origin = f"{{latitude_deg: 47.4, longitude_deg: 8.55, elevation_m: {ORIGIN.elevation_m}}}"
    about.write_text(f"extends: simulation-3\nscenario: {{name: about, origin: {origin}}}\n")
    out = folder / "leader.csv"
    return out, run("import", flight, "--scenario", about, "--out", out)


def test_ulg_returns_the_flight(imported):
    """Every column of a replay but alpha and beta, which PX4 does not log; in single precision."""
    found = np.genfromtxt(imported[0], delimiter=",", names=True)
    assert len(found) == len(FLIGHT)
    derived = {"altitude_m": -circle(FLIGHT["t_s"])[0][:, 2], "v_down_mps": -np.ones(len(FLIGHT))}
    for name in (*COMMANDS, *RESPONSES):
        if name in ("alpha_rad", "beta_rad"):
            assert name not in found.dtype.names
            continue
        wanted = derived.get(name, FLIGHT[name] + (BOOT_S if name == "t_s" else 0.0))
        off = np.abs(found[name] - wanted)
        if name == "psi_rad":
            off = np.minimum(off, 2.0 * math.pi - off)
        assert (off <= 1e-5 * np.maximum(np.abs(wanted), 0.1)).all(), (name, off.max())


@pytest.mark.parametrize("release", [OLD, NEW], ids=["1.6", "1.16"])
def test_ulg_of_other_releases_is_the_same(folder, flight, release):
    """Fields were renamed; 1.16 has no controls. Quaternions in single precision."""
    found = read_flight(write_ulog(folder / "release.ulg", FLIGHT, formats=release))
    wanted = read_flight(flight)
    gone = {"pwm_ail", "pwm_ele", "pwm_thr", "pwm_rud"} if release is NEW else set()
    assert found.columns.keys() == wanted.columns.keys() - gone
    assert found.missing.keys() == gone
    for name, values in found.columns.items():
        near = 1e-9 if name in ("latitude_deg", "longitude_deg") else 1e-6
        np.testing.assert_allclose(values, wanted.columns[name], rtol=1e-7, atol=near)


def test_ulg_keeps_rates_and_wind(imported):
    found = read_commands(imported[0])
    assert found.wind_mps == pytest.approx(np.tile(WIND, (len(FLIGHT), 1)), abs=1e-6)
    rates = json.loads(imported[0].with_suffix(".sources.json").read_text())["columns"]
    assert rates["q_radps"] == {"source": "vehicle_angular_velocity.xyz[1]", "rate_hz": 25.0}
    assert rates["wind_east_mps"]["source"] == "wind.windspeed_east"
    assert rates["wind_east_mps"]["rate_hz"] == pytest.approx(25.0 / 12.0, rel=1e-3)


@pytest.mark.parametrize("source", POSITIONS)
def test_ulg_leader_flies_its_path(folder, imported, source):
    """Within rounding; what is used in place of the position of the EKF is said."""
    first = POSITIONS.index(source)
    out, printed = imported
    if first:
        path = write_ulog(folder / "other.ulg", FLIGHT, left_out=POSITIONS[:first])
        out = folder / "other.csv"
        printed = run("import", path, "--scenario", folder / "about.yaml", "--out", out)
    assert f"as leader path: {{kind: replay, file: {out}}}, 19.96 s" in printed
    assert ("is used in its place" in printed) == (first > 0)
    begin, recording = FLIGHT["t_s"][0], read_recording(out)
    for since in (FLIGHT["t_s"] - begin, FLIGHT["t_s"][:-1] + 0.02 - begin):  # at rows, between
        found = sample_recording(recording, since)
        position, velocity = circle(since + begin)
        assert (np.abs(found.position_ned - position) <= HALF[source]).all()
        assert np.abs(found.velocity_ned - velocity).max() < 2e-4


def test_ulg_replays_like_the_original(folder, imported):
    """Single precision of commands and start; of the same rows from another file."""
    rows = RECORDING.read_text().splitlines(keepends=True)[:251]  # 10 s
    (folder / "original.csv").write_text("".join(rows))
    lines = imported[0].read_text().splitlines(keepends=True)[:251]
    (folder / "commands.csv").write_text("".join(lines))
    respond(RASCAL, folder / "original.csv", folder / "a.csv")
    respond(RASCAL, folder / "commands.csv", folder / "b.csv", altitude=SHORT["altitude_m"][0])
    a, b = (np.genfromtxt(folder / f"{n}.csv", delimiter=",", names=True) for n in "ab")
    assert len(a) == len(b) == 250
    for name in ("phi_rad", "theta_rad"):
        assert np.abs(a[name] - b[name]).max() < 1e-5
    assert np.abs(a["airspeed_mps"] - b["airspeed_mps"]).max() < 1e-3


def test_ulg_is_a_log_of_a_formation(flight):
    """On UNIX time, by GPS; its modes are those of PX4."""
    ((system, found),) = read_motions(flight).items()
    assert system is None and found.modes == ("AUTO_MISSION",)
    unix = 1e-6 * UNIX_US + found.columns["t_s"] - BOOT_S
    assert np.abs(found.columns["unix_s"] - unix).max() < 1e-5
    assert read_flight(flight, mode="auto_mission").columns["t_s"].shape == (len(FLIGHT),)
    with pytest.raises(InputError, match="nothing in STAB mode; .* AUTO_MISSION 20.0 to"):
        read_flight(flight, mode="STAB")
    with pytest.raises(InputError, match="--mode FBWA: write any, or one of MANUAL, ALTCTL"):
        read_flight(flight, mode="FBWA")
    with pytest.raises(InputError, match="--system 1: .* is of one vehicle; leave it out"):
        read_flight(flight, system=1)


def test_ulg_has_at_most_50_rows_a_second(folder):
    rows = np.repeat(SHORT, 8)
    rows["t_s"] = np.arange(len(rows)) / 200.0
    found = read_flight(write_ulog(folder / "fast.ulg", rows))
    steps = np.diff(found.columns["t_s"])
    assert len(steps) == len(rows) // 4 - 1 and steps == pytest.approx(np.full(len(steps), 0.02))
    assert any("200 of 800 messages are rows" in note for note in found.notes)


@pytest.mark.parametrize(
    ("left_out", "text"),
    [
        (("vehicle_attitude",), "no vehicle_attitude; have it logged .SDLOG_PROFILE"),
        (
            (*POSITIONS, "vehicle_attitude_setpoint"),
            "no vehicle_attitude_setpoint, .*so no theta_cmd_rad; have it logged",
        ),
    ],
)
def test_ulg_without_a_needed_topic_is_an_error(folder, left_out, text):
    path = write_ulog(folder / "few.ulg", SHORT, left_out=left_out)
    with pytest.raises(InputError, match=text):
        read_flight(path)


def test_ulg_columns_without_topics_are_left_out(folder):
    """Without setpoints it is a leader, without positions it is replayed."""
    few = ("vehicle_attitude_setpoint", "vehicle_angular_velocity", "wind", "airspeed_validated")
    found = read_flight(write_ulog(folder / "few.ulg", SHORT, left_out=few))
    assert found.missing.keys() == {
        *COMMANDS[1:], "p_radps", "q_radps", "r_radps", "airspeed_mps"
    }  # fmt: skip
    assert "no vehicle_angular_velocity, " in found.missing["p_radps"]
    assert "wind_north_mps" not in found.columns and "latitude_deg" in found.columns
    found = read_flight(write_ulog(folder / "few.ulg", SHORT, wind_variance=0.0))
    assert "wind_north_mps" not in found.columns
    found = read_flight(write_ulog(folder / "few.ulg", SHORT, left_out=POSITIONS))
    assert found.columns.keys() >= {*COMMANDS} and "latitude_deg" not in found.columns
    assert "no vehicle_global_position with lat, lon, alt" in found.no_position


@pytest.mark.parametrize(
    ("how", "text"),
    [
        ({"system_type": QUADROTOR, "vehicle_type": 1}, r"is a quadrotor .MAV_TYPE 2.; give a log"),
        ({"system_type": QUADROTOR, "left_out": ("vehicle_status",)}, "is a quadrotor"),
        ({"vehicle_type": 1, "params": {}}, "is a multirotor; give a log of a fixed-wing aircraft"),
        ({"vehicle_type": 1, "formats": OLD}, "is a multirotor; give a log of a fixed-wing"),
        ({"system_type": 10, "vehicle_type": 3}, "is a ground vehicle"),
        ({"system_type": 6, "vehicle_type": 0}, r"is no aircraft with a wing .MAV_TYPE 6"),
        ({"system_type": TAILSITTER, "vtol": lambda t: 4}, "is a tailsitter, whose logged"),
        ({"system_type": QUADPLANE, "vtol": lambda t: 4, "tailsitter": True}, "is a tailsitter"),
        ({"system_type": QUADPLANE, "vtol": lambda t: 3}, "is never in wing-borne flight .by vtol"),
        ({"system": "ArduPilot"}, "a log of ArduPilot; give one of PX4"),
    ],
)
def test_ulg_of_another_vehicle_is_an_error(folder, how, text):
    path = write_ulog(folder / "other.ulg", SHORT, **how)
    with pytest.raises(InputError, match=text) as caught:
        read_flight(path)
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_ulg_of_an_unknown_vehicle_is_noted(folder):
    path = write_ulog(folder / "x.ulg", SHORT, left_out=("vehicle_status",), params={})
    note = "the log does not say which vehicle it is of: taken for a fixed-wing aircraft"
    assert note in read_flight(path).notes


@pytest.mark.parametrize("old", [False, True])
def test_ulg_of_a_vtol_is_its_wing_borne_part(folder, old):
    """From the message that says so to the one that says otherwise, each 0.48 s."""
    path = write_ulog(
        folder / "vtol.ulg",
        FLIGHT,
        system_type=QUADPLANE,
        vehicle_type=1,
        vtol=lambda t: 4 if 5.0 < t < 12.0 else 2 if t < 14.0 else 3,
        formats=OLD if old else FORMATS,
    )
    found = read_flight(path)
    begin, end = found.columns["t_s"][[0, -1]] - BOOT_S
    rows = FLIGHT["t_s"]
    assert begin == pytest.approx(rows[rows[::12].searchsorted(5.0) * 12])
    assert end == pytest.approx(rows[rows[::12].searchsorted(12.0) * 12 - 1])
    assert any("% of the attitudes are of wing-borne flight" in note for note in found.notes)


def test_ulg_other_instances_are_noted(folder):
    good = write_ulog(folder / "two.ulg", SHORT).read_bytes()
    other = message("A", struct.pack("<BH", 1, 900) + b"airspeed_validated")
    other += message("D", struct.pack("<HQf", 900, 21_000_000, 99.0))
    (folder / "two.ulg").write_bytes(good + other)
    found = read_flight(folder / "two.ulg")
    assert found.columns["airspeed_mps"].max() < 40.0
    assert "airspeed_validated: instance 0 is used; left out: 1 of 1" in found.notes


def test_ulg_appended_data_follow_a_cut_message(folder):
    """As a crash dump: the last message before the offset is cut off."""
    good = bytearray(write_ulog(folder / "a.ulg", SHORT).read_bytes())
    half = good.index(message("S", SYNC), len(good) // 2)
    cut = good[:half] + message("D", bytes(60))[:20]
    cut[16 + 3 + 8] = 1
    cut[16 + 3 + 16 : 16 + 3 + 24] = struct.pack("<Q", len(cut))
    (folder / "a.ulg").write_bytes(cut + good[half:])
    found = read_flight(folder / "a.ulg")
    assert len(found.columns["t_s"]) == len(SHORT)
    assert "the last message is cut off after 20 bytes" in found.notes


def test_ulg_of_a_newer_format_is_an_error(folder):
    good = bytearray(write_ulog(folder / "n.ulg", SHORT).read_bytes())
    good[16 + 3 + 9] = 1
    (folder / "n.ulg").write_bytes(good)
    with pytest.raises(InputError, match="n.ulg: a ULog with flags of a newer format"):
        read_flight(folder / "n.ulg")


def test_ulg_cut_keeps_complete_messages(folder):
    """Cut at 40 places; the header alone has no attitude."""
    good = write_ulog(folder / "cut.ulg", SHORT).read_bytes()
    begin = good.index(message("S", SYNC))
    for stop in np.linspace(begin + 2000, len(good) - 1, 40).astype(int):
        (folder / "cut.ulg").write_bytes(good[:stop])
        found = read_flight(folder / "cut.ulg")
        share = (stop - begin) / (len(good) - begin)
        assert len(found.columns["t_s"]) == pytest.approx(share * len(SHORT), abs=3)
    for stop, text in (
        (7, "its header is cut off"),
        (16, "no vehicle_attitude"),
        (500, "no vehic"),
    ):
        (folder / "cut.ulg").write_bytes(good[:stop])
        with pytest.raises(InputError, match=f"cut.ulg: .*{text}"):
            read_flight(folder / "cut.ulg")


@pytest.mark.parametrize(("added", "lost"), [(bytes(500), 0), (b"", 1), (b"", 30), (b"\5\0\1", 0)])
def test_ulg_damage_costs_what_follows_to_a_sync(folder, added, lost):
    """Reading goes on at the next message of synchronisation, 0.48 s later at most."""
    good = write_ulog(folder / "noise.ulg", FLIGHT).read_bytes()
    sync = message("S", SYNC)
    at = good.index(sync, len(good) // 2) + 600
    (folder / "noise.ulg").write_bytes(good[:at] + added + good[at + lost :])
    found = read_flight(folder / "noise.ulg")
    assert len(FLIGHT) - 12 <= len(found.columns["t_s"]) < len(FLIGHT)
    (note,) = [each for each in found.notes if "bytes are damaged and were left out" in each]
    left = good.index(sync, at) - at - lost + len(added)
    assert left <= int(note.split()[0]) < left + 100  # and the message before


def test_ulg_messages_of_no_topic_are_counted(folder):
    """A second subscription of a number does not take the messages of the first."""
    good = write_ulog(folder / "no.ulg", SHORT).read_bytes()
    half = good.index(message("S", SYNC), len(good) // 2)
    extra = message("D", struct.pack("<HQ", 999, 0))
    extra += b"".join(message("A", struct.pack("<BH", 0, k) + b"cpuload") for k in range(11))
    (folder / "no.ulg").write_bytes(good[:half] + extra + good[half:])
    found = read_flight(folder / "no.ulg")
    assert len(found.columns["t_s"]) == len(SHORT)
    assert "13 bytes are damaged and were left out" in found.notes


def test_ulg_position_out_of_range_is_not_known(folder):
    good = write_ulog(folder / "far.ulg", SHORT).read_bytes()
    position, _ = circle(SHORT["t_s"])
    latitude = struct.pack("<d", geodetic_from_ned(position, ORIGIN)[50, 0])
    assert good.count(latitude) == 1
    (folder / "far.ulg").write_bytes(good.replace(latitude, struct.pack("<d", 1e300)))
    found = read_flight(folder / "far.ulg").columns["latitude_deg"]
    assert len(found) == len(SHORT) and np.ptp(found) < 0.01


def test_ulg_airspeed_is_that_which_came_more_often():
    """Never below 0, as a sensor at rest shows; of equals the validated one."""
    (source,) = COLUMNS["airspeed_mps"]
    for counts, name in (((10, 2), "airspeed_validated"), ((2, 10), "airspeed"), ((3, 3), None)):
        tables = {
            topic: MessageTable(
                np.arange(float(count)), {"true_airspeed_m_s": np.full(count, -1.0)}
            )
            for topic, count in zip(("airspeed_validated", "airspeed"), counts, strict=True)
        }
        found = source(SimpleNamespace(tables=tables))
        assert found.source == f"{name or 'airspeed_validated'}.true_airspeed_m_s"
        assert found.values.tolist() == [0.0] * max(counts)


def test_ulg_damaged_definition_is_named(folder):
    good = write_ulog(folder / "d.ulg", SHORT).read_bytes()
    bad = good.replace(b"float[3] xyz;", b"float[3]_xyz;").replace(
        b"vehicle_status:uint64_t timestamp;", b"vehicle_status:uint64_t timestomp;"
    )
    (folder / "d.ulg").write_bytes(bad)
    found = read_flight(folder / "d.ulg")
    names = "vehicle_angular_velocity, vehicle_status"
    assert f"the definition of {names} is damaged" in found.notes
    assert found.missing.keys() == {"p_radps", "q_radps", "r_radps"}
    assert len(found.columns["t_s"]) == len(SHORT)


def damage(good, rng):
    """Damage a log up to five times, half of them in the definitions at its start."""
    data = bytearray(good)
    for _ in range(rng.randrange(1, 6)):
        at = rng.randrange(len(data)) if rng.random() < 0.5 else rng.randrange(7, 1500)
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


def test_ulg_damage_is_noted_or_an_error(folder, capfd):
    rng = random.Random(20261130)
    path = folder / "damaged.ulg"
    good = write_ulog(path, SHORT).read_bytes()
    fine, tries = 0, int(os.environ.get("TESTBED_FRAMES", "5000")) // 100
    for _ in range(tries):
        path.write_bytes(damage(good, rng))
        try:
            fine += len(read_flight(path).columns["t_s"]) > 25
        except InputError as error:
            assert str(path) in str(error) and "\n" not in str(error)
    assert fine > tries / 4
    assert capfd.readouterr() == ("", "")


HEAD = b"ULog\x01\x12\x35\x01" + bytes(8)
ADD = message("A", struct.pack("<BH", 0, 1) + b"vehicle_attitude")
ROW = message("D", struct.pack("<HQ", 1, 1) + bytes(16))
HOSTILE = {
    "large array": definition("vehicle_attitude", "float[65535] q") + ADD + ROW,
    "many arrays": (
        definition("vehicle_attitude", ";".join(f"float[9999] n{k}" for k in range(200)))
        + ADD
        + ROW
    ),
    "itself": definition("vehicle_attitude", "vehicle_attitude[99] q") + ADD + ROW,
    "each other": definition("vehicle_attitude", "b[9999] q")
    + definition("b", "vehicle_attitude q"),
    "no time": message("F", b"vehicle_attitude:float[4] q;") + ADD + ROW,
    "two names": definition("vehicle_attitude", "float q;float q") + ADD + ROW,
    "parameter": message("P", b"\x10int32_t MAV_TYPE"),
    "subscriptions": definition("vehicle_attitude", "float[4] q") + 50_000 * ADD,
    "empty messages": 300_000 * b"\0\0D",
    "zeros": bytes(1_000_000),
    "lengths": 300_000 * b"\xff\xffD",
    "cut definition": message("F", b"b:float c;") + b"\xff\xffF",
    "flags": message("B", bytes(8) + b"\1" + bytes(7) + struct.pack("<3Q", 2**63, 5, 2**64 - 1)),
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE)
def test_ulg_hostile_content_is_an_error_soon(folder, content, capfd):
    """Most of them alone would keep pyulog busy, fill the memory, or raise in it."""
    path = folder / "hostile.ulg"
    path.write_bytes(HEAD + content)
    start = time.process_time()
    with pytest.raises(InputError, match=r"hostile.ulg: .*vehicle_attitude"):
        read_flight(path)
    assert time.process_time() - start < 2.0
    assert capfd.readouterr() == ("", "")


def test_ulg_has_bounded_numbers_of_topics(folder):
    path = folder / "many.ulg"
    path.write_bytes(HEAD + b"".join(definition(f"t{k}", "float a") for k in range(5001)))
    with pytest.raises(InputError, match="many.ulg: defines more than 5,000 topics; give a log"):
        read_flight(path)


def test_ulg_errors_of_pyulog_have_the_file(folder, monkeypatch, capfd):
    """Whatever it raises, without what it prints; lack of memory stays what it is."""
    path = write_ulog(folder / "x.ulg", SHORT)
    for error in (KeyError("a"), RuntimeError("b\nc"), RecursionError(), MemoryError()):

        def decode(data, error=error):
            print("Warning")
            raise error

        monkeypatch.setattr("pyulog.ULog", decode)
        with pytest.raises((InputError, MemoryError)) as caught:
            ulog_file.read_topics(path, {"vehicle_attitude": ("q[0]",)}, ())
        text = str(caught.value)
        if not isinstance(error, MemoryError):
            assert f"{path}: pyulog cannot decode it: " in text and "\n" not in text
        assert isinstance(caught.value, MemoryError) == isinstance(error, MemoryError)
    assert capfd.readouterr() == ("", "")
