"""A flight becomes logs, the logs become a leader and a formation, which are compared with it."""

import csv
import json
import math
import re
import shutil
from datetime import datetime, timedelta

import numpy as np
import pytest
import yaml
from cases import ALL, some
from flight_logs import ROOT, WIND, write_run_dataflash
from pymavlink.dialects.v20 import ardupilotmega as dialect
from typer.testing import CliRunner

import testbed
from testbed.cli.main import app
from testbed.commissioning.command_files import read_commands
from testbed.core.errors import InputError
from testbed.core.geodetic import local_frame
from testbed.core.records import NedOrigin
from testbed.flight_logs.column_map import read_mapped
from testbed.flight_logs.flight_import import read_flight
from testbed.flight_logs.recorded_motion import complete, default_origin
from testbed.flight_logs.tracks import read_tracks
from testbed.guidance.recorded_path import read_recording, sample_recording
from testbed.logs.read import read_log
from testbed.mavlink.codec import decode
from testbed.reports import figures
from testbed.runs.external_options import ExternalOptions
from testbed.views.scene import overlay_scenes, scene_of

ORIGIN = {"latitude_deg": -16.8, "longitude_deg": 179.9995, "elevation_m": 10.0}
SCENARIO = {
    "extends": "simulation-3",
    "scenario": {
        "name": "three",
        "duration_s": 36,
        "windows": {"rectangles": None, "circles": None, "joined": [15, 36]},
        "origin": ORIGIN,
    },
}
NAMES = ("leader", "uav1", "uav2", "uav3")
BOOT_S = {name: 20.0 + 7.3 * k for k, name in enumerate(NAMES)}
# Half a unit of the last digit of latitude and longitude, 1e-7°, and of height, mm; m.
FRAME = local_frame(NedOrigin(**ORIGIN))
HALF = np.array([0.5e-7 * FRAME.metres_per_latitude, 0.5e-7 * FRAME.metres_per_longitude, 0.5e-3])
ROUNDING_M = float(np.linalg.norm(HALF)) / math.sqrt(3.0)  # RMS of errors that are uniform in it
CM_PER_S = 0.005  # half a unit of GLOBAL_POSITION_INT's velocities, m/s
# A position error of both aircraft, and that of the leader's velocity at a slot 50 m away.
SLOT_ERROR_M = math.sqrt(2.0) * ROUNDING_M + 50.0 * CM_PER_S / 22.0


def invoke(folder, *words, code=0):
    """Run a command in this process; return what it prints."""
    done = CliRunner().invoke(app, [str(word) for word in words])
    if code:
        assert isinstance(done.exception, InputError), done.output
        return str(done.exception)
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Fly four aircraft over the 180th meridian; return the folder with the logs of the flight."""
    folder = tmp_path_factory.mktemp("flown")
    (folder / "three.yaml").write_text(yaml.safe_dump(SCENARIO))
    testbed.run(folder / "three.yaml", out=folder / "run", external=ExternalOptions(tlog=True))
    log = read_log(folder / "run" / "run.mcap")
    for name in NAMES:
        write_run_dataflash(folder / f"{name}.bin", log, name, boot_s=BOOT_S[name])
    return folder


@pytest.fixture(scope="module")
def flight(flown):
    return read_log(flown / "run" / "run.mcap")


def logs(flown, kind):
    return [flown / "run/run.tlog"] if kind == "tlog" else [flown / f"{n}.bin" for n in NAMES]


@pytest.fixture(scope="module")
def formations(flown):
    """Return the directory of the formation from each kind of log."""
    for kind in ("tlog", "bin"):
        words = ("import-formation", flown / "three.yaml", *logs(flown, kind))
        invoke(flown, *words, "--out", flown / kind)
    return flown


@pytest.fixture(scope="module")
def leaders(flown):
    """Return the folder with the leader's recording from each kind of log."""
    about = ("--scenario", flown / "three.yaml", "--mode", "any")
    tlog = ("import", flown / "run/run.tlog", "--system", 1)
    invoke(flown, *tlog, *about, "--out", flown / "tlog.csv")
    invoke(flown, "import", flown / "leader.bin", *about, "--out", flown / "bin.csv")
    return flown


@pytest.mark.parametrize("kind", ["tlog", "bin"])
def test_leader_of_a_log_flies_its_path(leaders, flight, kind):
    """At the rows within rounding; between rows at 10 Hz the cubic adds less than it again."""
    recording = read_recording(leaders / f"{kind}.csv")
    found = sample_recording(recording, flight.time_s)
    off = found.position_ned - flight.truth.position_ned[:, 0]
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert 0.5 * ROUNDING_M < rms < 1.2 * ROUNDING_M  # it is that of rounding, and no more
    at_rows = np.isin(np.round(flight.time_s, 6), np.round(recording.time - recording.time[0], 6))
    assert at_rows.sum() > 100
    assert (np.abs(off[at_rows]) <= HALF + 1e-4).all()  # 0.1 mm: CSV, and float32 of heights
    speed = np.abs(found.velocity_ned - flight.truth.velocity_ned[:, 0])[at_rows]
    assert speed.max() <= (CM_PER_S if kind == "tlog" else 0.0) + 5e-4  # six digits in the CSV
    # a clock 0.1 s off moves it by 2.2 m
    late = sample_recording(recording, flight.time_s[flight.time_s >= 0.1] - 0.1)
    moved = late.position_ned - flight.truth.position_ned[flight.time_s >= 0.1, 0]
    assert np.linalg.norm(moved, axis=1).min() > 2.0


def test_import_keeps_rates_and_wind(leaders):
    """A .tlog with demands twice a second, in still air; a .bin with wind."""
    of_bin = read_commands(leaders / "bin.csv")
    assert of_bin.wind_mps == pytest.approx(np.tile(WIND, (len(of_bin.time_s), 1)), abs=1e-6)
    assert of_bin.rates_hz["wind_north_mps"] == of_bin.rates_hz["q_radps"] == 25.0
    found = read_commands(leaders / "tlog.csv")
    assert found.rates_hz["phi_cmd_rad"] == pytest.approx(2.0, rel=0.05)
    assert found.rates_hz["phi_rad"] == pytest.approx(10.0, rel=0.05)
    assert np.abs(found.wind_mps).max() < 1e-6
    written = json.loads((leaders / "tlog.sources.json").read_text(encoding="utf-8"))
    assert written["log"] == "run.tlog"
    assert written["columns"]["phi_cmd_rad"]["source"] == "NAV_CONTROLLER_OUTPUT.nav_roll"


def numpy_errors(flown):
    """RMS slot errors by name, from the CSV files alone, over the rows of the window."""
    about = ("--scenario", flown / "three.yaml", "--mode", "any")
    files = [flown / "tlog.csv", *(flown / f"row{system}.csv" for system in (2, 3, 4))]
    for system, out in enumerate(files[1:], 2):
        invoke(flown, "import", flown / "run/run.tlog", "--system", system, *about, "--out", out)
    tables = [np.genfromtxt(file, delimiter=",", names=True) for file in files]
    leader = tables[0]
    inside = (leader["t_s"] >= 15.0) & (leader["t_s"] < 36.0)
    north, east, down = (leader[f"v_{axis}_mps"] for axis in ("north", "east", "down"))
    horizontal = np.hypot(north, east)
    speed = np.hypot(horizontal, down)
    forward = np.stack([north, east, down], axis=-1) / speed[:, None]
    right = np.stack([-east, north, 0.0 * north], axis=-1) / horizontal[:, None]
    axes = (forward, right, np.cross(forward, right))
    offsets = testbed.load_scenario("simulation-3").formation.offsets_m
    found = {}
    for name, table in zip(NAMES[1:], tables[1:], strict=True):
        assert np.abs(table["unix_s"] - leader["unix_s"]).max() < 1e-3
        slot = sum(length * axis for length, axis in zip(offsets[name], axes, strict=True))
        error = sum(
            (table[each] - leader[each] - slot[:, k])[inside] ** 2
            for k, each in enumerate(("north_m", "east_m", "down_m"))
        )
        found[name] = math.sqrt(np.mean(error))
    return found


@pytest.mark.parametrize("kind", ["tlog", "bin"])
def test_formation_of_logs_has_the_flights_errors(formations, kind):
    """The RMS of a sum differs from that of a part by at most the RMS of the other part."""
    real = json.loads((formations / kind / "metrics.json").read_text())
    own = json.loads((formations / "run" / "metrics.json").read_text())
    assert real["recorded"] and real["outcome"] == "completed" and real["network"] is None
    window, other = real["windows"]["joined"], own["windows"]["joined"]
    assert window["complete"] and 0.3 < window["mean_rms_m"] < 2.0
    for name in NAMES[1:]:
        assert abs(window["rms_m"][name] - other["rms_m"][name]) < SLOT_ERROR_M
    assert real["joined_at_s"] == pytest.approx(own["joined_at_s"], abs=0.05)
    assert real["min_separation_m"] == pytest.approx(own["min_separation_m"], abs=0.03)
    assert real["saturations"]["uav1"]["seconds"] is None  # of a law that no log has


def test_formation_errors_by_another_route(formations, leaders):
    """NumPy on the CSV files; the run has samples between their rows too, 25 for 10."""
    real = json.loads((formations / "tlog" / "metrics.json").read_text())
    rms = real["windows"]["joined"]["rms_m"]
    for name, other in numpy_errors(formations).items():
        assert rms[name] == pytest.approx(other, rel=0.03)


def test_formation_log_is_that_of_a_run(formations, flight, monkeypatch):
    log = read_log(formations / "bin" / "run.mcap")
    assert log.finished and log.info.names == NAMES and log.info.origin == NedOrigin(**ORIGIN)
    assert log.info.start_unix_ns == 1_777_627_800_000_000_000
    assert np.array_equal(log.time_s, flight.time_s)
    roll = np.abs(log.truth.euler[..., 0] - flight.truth.euler[..., 0])
    assert roll.max() < 1e-5
    assert np.abs(log.surfaces.aileron - flight.surfaces.aileron).max() < 1e-3 + 1e-9
    assert np.isnan(log.air.wind_ned).all()
    monkeypatch.setattr(figures, "MAKERS", ())  # drawing takes seconds
    invoke(formations, "report", formations / "bin", "--out", formations / "bin.html")
    assert "Real aircraft flew this run" in (formations / "bin.html").read_text()
    exported = ("--format", "npz", "--out", formations / "bin.npz")
    invoke(formations, "export", formations / "bin", *exported)
    assert np.load(formations / "bin.npz")["state_roll_rad"].shape == (len(log.time_s), 4)


def test_formation_clocks_are_aligned_by_gps_time(flown):
    origin = NedOrigin(**ORIGIN)
    tracks, start = read_tracks([str(each) for each in logs(flown, "bin")], NAMES, origin)
    assert start == pytest.approx(1_777_627_800.0, abs=1e-6)
    for each in tracks:
        assert each.offset_s == pytest.approx(start - BOOT_S[each.name], abs=1e-3)
        assert each.clock == "GPS.GWk/GMS" and each.time[0] == pytest.approx(0.0, abs=1e-6)


def test_formation_with_another_clock_is_off(flown, formations):
    """A tenth of a second is 2.2 m of the way, behind the slot."""
    words = ("import-formation", flown / "three.yaml", *logs(flown, "bin"), "--out", flown / "off")
    start = ("--start", "2026-05-01T09:30:00Z")
    printed = invoke(flown, *words, "--offset", "uav1=0.1", *start)
    assert "GPS.GWk/GMS, +0.1 s" in " ".join(printed.split())
    rms = json.loads((flown / "off" / "metrics.json").read_text())["windows"]["joined"]["rms_m"]
    own = json.loads((flown / "bin" / "metrics.json").read_text())["windows"]["joined"]["rms_m"]
    assert rms["uav1"] == pytest.approx(2.2, abs=0.5)
    assert rms["uav2"] == pytest.approx(own["uav2"], abs=1e-9)


@pytest.fixture(scope="module")
def records(flown):
    """Return (record, message) of the .tlog."""
    data, at, found = (flown / "run/run.tlog").read_bytes(), 0, []
    while at < len(data):
        end = at + 8 + 12 + data[at + 9]
        found.append((data[at:end], decode(data[at + 8 : end])))
        at = end
    return found


def without(records, name, system=None, begin_ms=-math.inf, end_ms=math.inf):
    """Return a .tlog without some messages: of a system, between two times of its clock."""
    return b"".join(
        record
        for record, message in records
        if message.name != name
        or message.system != (system or message.system)
        or not begin_ms < message.fields["time_boot_ms"] < end_ms
    )


def test_formation_by_times_of_receipt_is_noted(flown, records):
    """Without SYSTEM_TIME the receiver's clock is used; here both are the same."""
    (flown / "receipt.tlog").write_bytes(without(records, "SYSTEM_TIME"))
    words = ("import-formation", flown / "three.yaml", flown / "receipt.tlog")
    printed = " ".join(invoke(flown, *words, "--out", flown / "receipt").split())
    assert "leader: unix_s: times of receipt, as no SYSTEM_TIME has a time" in printed
    found = json.loads((flown / "receipt/metrics.json").read_text())["windows"]["joined"]
    own = json.loads((flown / "run/metrics.json").read_text())["windows"]["joined"]
    assert found["mean_rms_m"] == pytest.approx(own["mean_rms_m"], abs=SLOT_ERROR_M)


def test_formation_leaves_out_gaps(flown, records):
    (flown / "gap.tlog").write_bytes(without(records, "GLOBAL_POSITION_INT", 3, 10_000, 12_500))
    words = ("import-formation", flown / "three.yaml", flown / "gap.tlog", "--out", flown / "gap")
    assert "left out: 0.0 to 10.0 s" in " ".join(invoke(flown, *words).split())
    log = read_log(flown / "gap" / "run.mcap")
    assert (log.time_s[0], log.time_s[-1]) == pytest.approx((12.52, 36.0), abs=0.03)
    assert any("left out: 0 to 10 s" in event.text for event in log.events)
    # the import of one aircraft says where; a part of it has positions
    tlog = ("import", flown / "gap.tlog", "--system", 3, "--mode", "any", "--out", flown / "g.csv")
    found = " ".join(invoke(flown, *tlog).split())
    assert "as leader not possible: GLOBAL_POSITION_INT" in found and "--from and --to" in found
    assert ",down_m" not in (flown / "g.csv").read_text()
    assert "as leader path: {kind: replay" in " ".join(invoke(flown, *tlog, "--from", 13).split())


def test_formation_of_csv_recordings(leaders, formations):
    """Recordings of `testbed import` are logs too, about whatever origin."""
    names = []
    for name in NAMES:
        out = leaders / f"{name}.csv"
        invoke(leaders, "import", leaders / f"{name}.bin", "--mode", "any", "--out", out)
        names.append(out)
    out = leaders / "csv"
    invoke(leaders, "import-formation", leaders / "three.yaml", *names, "--out", out)
    found = json.loads((out / "metrics.json").read_text())["windows"]["joined"]["rms_m"]
    other = json.loads((formations / "bin/metrics.json").read_text())["windows"]["joined"]["rms_m"]
    assert found == pytest.approx(other, abs=1e-4)  # digits of the CSV files


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("leader.bin", "uav1.bin"), "2 logs .* for 4 aircraft .*leader's first"),
        (("run/run.tlog:1",) * 3 + ("run/run.tlog:9",), "--system 9: not in .*write one of 1"),
        (("run/run.tlog",) * 4, "run.tlog: several vehicles; write one of .*run.tlog:1,"),
        (("three.yaml",) * 4, "three.yaml: this is none of these"),
    ],
)
def test_formation_of_wrong_logs_is_an_error(flown, words, text):
    files = [flown / word for word in words]
    words = ("import-formation", flown / "three.yaml", *files, "--out", flown / "none")
    with pytest.raises(InputError, match=text):
        raise InputError(invoke(flown, *words, code=2))
    assert not (flown / "none").exists()


def test_formation_far_from_the_origin_is_an_error(flown):
    words = ("import-formation", "simulation-3", *logs(flown, "bin"), "--out", flown / "none")
    found = invoke(flown, *words, code=2)
    assert "km from the origin, 38°, 0°; write another one: scenario.origin:" in found


@pytest.mark.parametrize("start", some(["1970-01-01T00:00:00Z", "1971-06-01T00:00:00Z"], 1))
def test_formation_long_after_its_start_is_an_error(flown, start):
    """What the error says can be written: a time at most a day before the logs."""
    words = ("import-formation", flown / "three.yaml", *logs(flown, "bin"), "--out", flown / "day")
    found = invoke(flown, *words, "--start", start, code=2)
    assert f"time 0 is {start[:-1]}" in found
    (begun,) = re.findall(r"s later, at (\S+); write --start with a time at most a day", found)
    assert not (flown / "day").exists()
    allowed = datetime.fromisoformat(begun) - timedelta(hours=23, minutes=59)
    invoke(flown, *words, "--start", allowed.isoformat())
    times = read_log(flown / "day" / "run.mcap").time_s
    assert times[0] == pytest.approx(86_340.0, abs=0.05) and np.all(np.diff(times) > 0.0)
    shutil.rmtree(flown / "day")


def test_formation_without_time_of_day_needs_offset(flown):
    log = read_log(flown / "run" / "run.mcap")
    for name in NAMES:
        path = flown / f"no-gps-{name}.bin"
        write_run_dataflash(path, log, name, boot_s=BOOT_S[name], without=("GPS",))
    files = [str(flown / f"no-gps-{name}.bin") for name in NAMES]
    origin = NedOrigin(**ORIGIN)
    with pytest.raises(InputError, match="no unix_s: .* write --offset leader=S"):
        read_tracks(files, NAMES, origin)
    offsets = {name: 1e9 - BOOT_S[name] for name in NAMES}
    tracks, start = read_tracks(files, NAMES, origin, offsets_s=offsets)
    assert start == pytest.approx(1e9) and {each.clock for each in tracks} == {"--offset"}


# CSV of another maker, with its map


MAP = {
    "t_s": {"column": "time ms", "unit": "ms"},
    "latitude_deg": {"column": "lat"},
    "longitude_deg": {"column": "lon"},
    "height_m": {"column": "alt ft", "unit": "ft"},
    "ground_speed_mps": {"column": "GS kn", "unit": "kn"},
    "course_rad": {"column": "track", "unit": "deg"},
    "v_down_mps": {"column": "climb fpm", "unit": "ft/min", "sign": -1},
    "roll_rad": {"column": "roll", "unit": "deg"},
    "yaw_rad": {"column": "heading", "unit": "deg"},
    "airspeed_mps": {"column": "TAS", "unit": "km/h"},
}


@pytest.fixture(scope="module")
def foreign(flown, flight):
    """Write the leader's flight with a climb of 2 m/s as a CSV file in other units."""
    path, truth = flown / "foreign.csv", flight.truth
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([each["column"] for each in MAP.values()])
        for k in range(0, len(flight.time_s), 5):
            t = flight.time_s[k]
            north, east, down = truth.position_ned[k, 0]
            v_north, v_east, _ = truth.velocity_ned[k, 0]
            longitude = ORIGIN["longitude_deg"] + east / FRAME.metres_per_longitude
            row = (
                1e3 * t,
                f"{ORIGIN['latitude_deg'] + north / FRAME.metres_per_latitude:.9f}",
                f"{(longitude + 180.0) % 360.0 - 180.0:.9f}",
                (ORIGIN["elevation_m"] - down + 2.0 * t) / 0.3048,
                math.hypot(v_north, v_east) * 3600.0 / 1852.0,
                math.degrees(math.atan2(v_east, v_north)) % 360.0,
                2.0 / 0.3048 * 60.0,
                math.degrees(truth.euler[k, 0, 0]),
                math.degrees(truth.euler[k, 0, 2]) % 360.0,
                truth.airspeed[k, 0] * 3.6,
            )
            writer.writerow(row)
    return path


def write_map(path, columns):
    path.write_text(yaml.safe_dump(columns, sort_keys=False))
    return path


def test_map_converts_units_and_signs(foreign, flight, tmp_path):
    """To NED in m, m/s and rad; what is not in the file is derived, and said."""
    out, path = tmp_path / "out.csv", write_map(tmp_path / "map.yaml", MAP)
    words = ("import", foreign, "--columns", path, "--scenario", foreign.parent / "three.yaml")
    printed = " ".join(invoke(tmp_path, *words, "--out", out).split())
    assert "p_radps, q_radps derived: differences of the attitude" in printed
    assert "throttle 0: not recorded" in printed
    found, rows = read_recording(out), slice(None, None, 5)
    climb = 2.0 * flight.time_s[rows]
    off = found.position_ned - flight.truth.position_ned[rows, 0] + climb[:, None] * [0, 0, 1]
    assert np.abs(off).max() < 1e-3
    velocity = flight.truth.velocity_ned[rows, 0] * [1, 1, 0] - [0, 0, 2.0]
    assert np.abs(found.velocity_ned - velocity).max() < 1e-3
    assert np.abs(found.euler[:, 0] - flight.truth.euler[rows, 0, 0]).max() < 1e-5
    assert np.abs(found.airspeed - flight.truth.airspeed[rows, 0]).max() < 1e-3


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"ground_speed_mps": {"column": "GS kn"}}, "contradicts (north|east)_m, which changes"),
        ({"course_rad": {"column": "track"}}, "course_rad: is up to .*; write unit: deg"),
        ({"v_down_mps": {"column": "climb fpm", "unit": "ft/min"}}, "v_down_mps: contradicts down"),
        (
            {"height_m": {"column": "alt ft"}},
            "contradicts down_m, which changes 3.28",
        ),
        ({"roll_rad": {"column": "roll"}}, "roll_rad: is up to .*; write unit: deg"),
        ({"roll_rad": {"column": "roll", "unit": "deg", "sign": -1}}, "is to the left in turns"),
        ({"yaw_rad": {"column": "roll", "unit": "deg"}}, "yaw_rad: is .*° from the course"),
        ({"longitude_deg": {"column": "lat"}}, "contradicts (north|east)_m"),
        ({"latitude_deg": None}, r"map.yaml:\d+:\d+: longitude_deg: needs latitude_deg too"),
        ({"t_s": None}, "has no time .write t_s"),
        (
            {"yaw_rad": {"column": "hedding"}},
            "no column of .*: did you mean 'heading'",
        ),
        (
            {"height_m": {"column": "alt ft", "unit": "feet"}},
            "unit: is 'feet': did you mean 'ft'",
        ),
        ({"rol_rad": {"column": "roll"}}, "rol_rad: is not a key .*did you mean 'roll_rad'"),
        ({"t_s": "time ms"}, "t_s: .*map of keys and values"),
    ],
)
def test_wrong_map_is_an_error_with_its_place(foreign, tmp_path, change, text):
    columns = {name: each for name, each in (MAP | change).items() if each is not None}
    path = write_map(tmp_path / "map.yaml", columns)
    with pytest.raises(InputError, match=text) as error:
        read_mapped(foreign, path)
    assert str(error.value).startswith(f"{path}:")


def test_map_of_positions_alone_gives_a_leader(foreign, flight, tmp_path):
    """The bank is that of a coordinated turn, which the flight's is within a few degrees."""
    columns = {name: MAP[name] for name in ("t_s", "latitude_deg", "longitude_deg", "height_m")}
    motion = read_mapped(foreign, write_map(tmp_path / "map.yaml", columns))
    full = complete(motion, default_origin(motion, None))
    assert full.sources["roll_rad"] == "derived: bank of a coordinated turn"
    assert full.sources["airspeed_mps"] == "derived: ground speed, as without wind"
    roll = flight.truth.euler[::5, 0, 0]
    assert np.abs(roll).max() > math.radians(30.0)
    assert np.sqrt(np.mean((full.columns["roll_rad"] - roll) ** 2)) < math.radians(4.0)


def test_map_without_attitude_is_complete(tmp_path):
    """The yaw is then the course, also where velocities are given."""
    names = ("north_m", "east_m", "down_m", "v_north_mps", "v_east_mps", "v_down_mps")
    rows = [(0.1 * k, 1.2 * k, 1.6 * k, -100.0, 12.0, 16.0, 0.0) for k in range(100)]
    path = tmp_path / "straight.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([("t", *names), *rows])
    columns = {"t_s": {"column": "t"}} | {name: {"column": name} for name in names}
    motion = read_mapped(path, write_map(tmp_path / "map.yaml", columns))
    full = complete(motion, None)
    assert full.columns["yaw_rad"] == pytest.approx(math.atan2(16.0, 12.0), abs=1e-6)
    backwards = columns | {"v_north_mps": {"column": "v_north_mps", "sign": -1}}
    with pytest.raises(InputError, match="contradicts north_m"):
        read_mapped(path, write_map(tmp_path / "wrong.yaml", backwards))


def test_import_of_zero_position_has_no_leader(records, tmp_path):
    """ArduPlane sends latitude and longitude 0 where it knows none."""
    out = []
    for record, message in records:
        frame = record[8:]
        if message.name == "GLOBAL_POSITION_INT":
            boot_ms = message.fields["time_boot_ms"]
            zero = dialect.MAVLink_global_position_int_message(boot_ms, *([0] * 8))
            frame = zero.pack(dialect.MAVLink(None, message.system, 1))
        out.append(record[:8] + frame)
    (tmp_path / "zero.tlog").write_bytes(b"".join(out))
    found = read_flight(tmp_path / "zero.tlog", system=2)
    assert "GLOBAL_POSITION_INT knows no position" in found.no_position
    assert "latitude_deg" not in found.columns


def test_recorded_run_beside_simulated_is_ghosts(formations):
    real = scene_of(read_log(formations / "bin" / "run.mcap").info)
    simulated = scene_of(read_log(formations / "run" / "run.mcap").info)
    both = overlay_scenes(simulated, real, ("A", "B"), (False, True))
    assert both.ghosts == (4, 5, 6, 7) and both.runs[1].endswith(", recorded")
    assert overlay_scenes(real, real, ("A", "B"), (True, True)).ghosts == ()
    if ALL:  # tests/views shows two runs beside each other
        out = formations / "both.rrd"
        invoke(formations, "view", formations / "run", formations / "bin", "--rrd", out)
        assert out.stat().st_size > 100_000


def test_columns_of_a_replay_are_documented():
    text = (ROOT / "docs" / "from-a-log.md").read_text(encoding="utf-8")
    from testbed.flight_logs.column_map import FACTORS, ColumnMap
    from testbed.guidance.recorded_path import COLUMNS

    for name in (*COLUMNS, *ColumnMap.model_fields):
        assert f"`{name}`" in text, name
    for unit in FACTORS:
        assert f"`{unit}`" in text, unit
