"""Positions, times and names of logs from elsewhere: longitudes, no fix, leap seconds, ROS 2."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from testbed.cli.main import app
from testbed.core.errors import InputError
from testbed.core.geodetic import has_position, ned_from_geodetic
from testbed.core.identifiers import changed_names, identifiers
from testbed.core.records import NedOrigin
from testbed.flight_logs.column_map import read_mapped
from testbed.flight_logs.flight_log import MessageTable
from testbed.flight_logs.log_position import (
    DATAFLASH,
    FIRST_WEEK,
    TELEMETRY,
    gps_clock,
    read_wind_estimate,
    unix_from_gps,
    unix_time,
)
from testbed.flight_logs.recorded_motion import MAX_AWAY_M, NED, complete, read_csv
from testbed.scenario import load_scenario

COLUMNS = {"t_s": "Time", "latitude_deg": "Lat", "longitude_deg": "Lon", "height_m": "Alt"}


def track(path, latitude, longitude, *, turn=0.0, zeros=(), other=()):
    """Write 20 s of a circle of 200 m at 20 m/s as CSV, and a map of its columns.

    Rows `zeros` are at 0°, 0°, and rows `other` at 50° north, 10° east.
    """
    lines = ["Time,Lat,Lon,Alt"]
    for k in range(200):
        angle = 0.01 * k
        north, east = 200.0 * math.sin(angle), 200.0 * (1.0 - math.cos(angle))
        place = latitude + north / 111133.0, longitude + east / 111319.0
        if turn:
            place = place[0], place[1] % turn
        place = (0.0, 0.0) if k in zeros else (50.0, 10.0) if k in other else place
        lines.append(f"{k / 10},{place[0]:.8f},{place[1]:.8f},400")
    path.write_text("\n".join(lines), encoding="utf-8")
    mapped = [f"{name}: {{column: {column}}}" for name, column in COLUMNS.items()]
    path.with_suffix(".yaml").write_text("\n".join(mapped), encoding="utf-8")
    return path


def run(*words, code=0):
    done = CliRunner().invoke(app, [str(word) for word in words])
    assert done.exit_code == code, (done.output, done.exception)
    return str(done.exception) if code else done.output


@pytest.mark.parametrize("longitude", [190.0, 179.999, -0.0005])
def test_longitudes_of_0_to_360_are_the_same_flight(tmp_path, longitude):
    """Over the 180th and the prime meridian; the origin is one that a scenario takes."""
    origins, paths = [], []
    for name, turn in (("plain", 0.0), ("turned", 360.0)):
        path = track(tmp_path / f"{name}.csv", -17.0, longitude, turn=turn)
        out = tmp_path / f"{name}-leader.csv"
        printed = run("import", path, "--columns", path.with_suffix(".yaml"), "--out", out)
        origins.append(re.search(r"origin +(\{.*\})", printed)[1])
        recording = read_csv(out)
        paths.append(recording.stack(NED))
        assert np.abs(recording.columns["longitude_deg"]).max() <= 180.0
    assert origins[0] == origins[1]
    load_scenario("simulation-3", [f"scenario.origin={origins[0]}"])
    np.testing.assert_allclose(paths[0], paths[1], atol=1e-3)
    assert np.ptp(paths[0][:, 0]) > 150.0 and np.abs(paths[0]).max() < 500.0


def test_rows_without_a_fix_are_left_out(tmp_path):
    path = track(tmp_path / "island.csv", -17.0, 10.0, zeros=range(3))
    out = tmp_path / "leader.csv"
    printed = run("import", path, "--columns", path.with_suffix(".yaml"), "--out", out)
    note = "rows at latitude and longitude 0, where the receiver knew no position, are left out: 3,"
    assert note in " ".join(printed.split()) and "t_s 0 to 0.2" in printed
    recording = read_csv(out)
    assert recording.columns["t_s"][0] == 0.3 and len(recording.columns["t_s"]) == 197
    np.testing.assert_allclose(recording.columns["latitude_deg"], -17.0, atol=0.01)


def test_recording_of_names_leaves_them_out_too(tmp_path):
    """By `read_csv`, as of import-formation; all rows at 0°, 0° are an error."""
    path = track(tmp_path / "island.csv", -17.0, 10.0, zeros=range(3))
    text = path.read_text(encoding="utf-8").replace("Time,Lat,Lon,Alt", ",".join(COLUMNS))
    path.write_text(text, encoding="utf-8")
    found = read_csv(path)
    assert len(found.columns["t_s"]) == 197 and "are left out: 3" in found.notes[0]
    path = track(tmp_path / "none.csv", -17.0, 10.0, zeros=range(200))
    with pytest.raises(InputError, match="are 0 in 200 of 200 rows: the receiver knew no position"):
        read_mapped(path, path.with_suffix(".yaml"))


def test_position_on_an_axis_is_known():
    """Only both zeros mean no position; so does no number."""
    latitude, longitude = np.array([0.0, 0.0, 1.0, np.nan]), np.array([0.0, 1.0, 0.0, 1.0])
    assert has_position(latitude, longitude).tolist() == [False, True, True, False]


def test_origin_that_an_error_names_works(tmp_path):
    """The suggested origin is accepted by a scenario, and the flight is about it."""
    path = track(tmp_path / "far.csv", -17.0, 190.0, turn=360.0)
    motion = read_mapped(path, path.with_suffix(".yaml"))
    with pytest.raises(InputError, match="km from the origin, 38°, 0°; write another") as caught:
        complete(motion, NedOrigin(38.0, 0.0, 300.0))
    setting = str(caught.value).partition("scenario.origin: ")[2]
    scenario = load_scenario("simulation-3", [f"scenario.origin={setting}"])
    full = complete(motion, NedOrigin(**scenario.scenario.origin.model_dump()))
    assert np.abs(full.stack(NED)).max() < 500.0


def test_positions_without_a_common_origin_are_named(tmp_path):
    """No origin is near all of them: none is suggested, and the rows' removal works."""
    path = track(tmp_path / "apart.csv", -17.0, 10.0, other=(150, 151))
    with pytest.raises(InputError) as caught:
        read_mapped(path, path.with_suffix(".yaml"))
    text = str(caught.value)
    assert "scenario.origin" not in text
    assert "position 151 of 200 is 7," in text and "remove the rows whose position" in text
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(lines[:151] + lines[153:]), encoding="utf-8")
    assert len(read_mapped(path, path.with_suffix(".yaml")).columns["t_s"]) == 198


def test_distance_is_that_of_the_flat_frame(tmp_path):
    """A track 49 km from the origin is taken, one of 51 km is not."""
    path = track(tmp_path / "near.csv", 38.0, 0.0)
    motion = read_mapped(path, path.with_suffix(".yaml"))
    for away, refused in ((49e3, False), (51e3, True)):
        origin = NedOrigin(38.0 - away / 111000.0, 0.0, 300.0)
        geodetic = motion.stack(("latitude_deg", "longitude_deg", "height_m"))
        assert (np.abs(ned_from_geodetic(geodetic, origin)).max() > MAX_AWAY_M) == refused
        if refused:
            with pytest.raises(InputError, match="51 km from the origin"):
                complete(motion, origin)
        else:
            complete(motion, origin)


def log_of(week, gms=1e8):
    """Return a log of three GPS fixes of a week, 1 s apart from 10 s on."""
    time = 10.0 + np.arange(3.0)
    fields = {"GWk": np.full(3, float(week)), "GMS": gms + 1e3 * np.arange(3.0)}
    log = SimpleNamespace(tables={"GPS": MessageTable(time, fields)}, receiver_start_unix_s=None)
    log.motion = SimpleNamespace(unix=(gps_clock,))
    log.of_same_flight = lambda series, rows: series
    return log, time


@pytest.mark.parametrize(
    ("week", "unix_s"),
    [(1800, 1_404_704_784), (1900, 1_465_184_783), (2300, 315_964_800 + 2300 * 604_800 + 1e5 - 18)],
)
def test_gps_time_has_the_leap_seconds_of_its_year(week, unix_s):
    """16 s in 2014, 17 s in 2016, 18 s since 2017."""
    log, time = log_of(week)
    found, source, notes = unix_time(log, time)
    assert found[0] == pytest.approx(unix_s, abs=1e-6)
    assert source == "GPS.GWk/GMS" and notes == ()


def test_leap_second_begins_with_its_second():
    """GPS time of 2016-12-31T23:59:59 and of 2017-01-01T00:00:00 UTC are 2 s apart."""
    new_year = 1_483_228_800.0
    gps = new_year - 315_964_800.0 + np.array([17.0 - 1.0, 18.0])
    assert unix_from_gps(gps).tolist() == [new_year - 1.0, new_year]


def test_week_before_arduplane_is_of_a_rollover():
    """1276 is of 2004, and what a receiver writes in 2024; the first real week is not."""
    log, time = log_of(1276)
    found, _, notes = unix_time(log, time)
    assert found[0] == pytest.approx(315_964_800 + 2300 * 604_800 + 1e5 - 18, abs=1e-6)
    assert "GPS.GWk has weeks before 1563, in 2009" in notes[0] and "1024 weeks later" in notes[0]
    log, time = log_of(FIRST_WEEK)
    assert unix_time(log, time)[2] == ()


@pytest.mark.parametrize("sources", [DATAFLASH, TELEMETRY], ids=["bin", "tlog"])
def test_wind_estimates_are_read(sources):
    """XKF2 has where the wind blows to, WIND where it comes from; a log without has none."""
    time = np.arange(3.0)
    tables = {
        "XKF2": {"VWN": np.full(3, -3.0), "VWE": np.full(3, 4.0)},
        "WIND": {"speed": np.full(3, 5.0), "direction": np.full(3, math.degrees(-0.9272952180))},
    }
    log = SimpleNamespace(
        tables={name: MessageTable(time, fields) for name, fields in tables.items()},
        motion=sources,
        of_same_flight=lambda series, rows: series,
    )
    found = read_wind_estimate(log, time)
    assert found["wind_north_mps"].values == pytest.approx(np.full(3, -3.0))
    assert found["wind_east_mps"].values == pytest.approx(np.full(3, 4.0))
    log.tables = {}
    assert read_wind_estimate(log, time) == {}


def test_exact_names_are_given_away_first():
    """A name that is an identifier is its own; which became which is known."""
    names = ("uav-1", "uav_1", "2nd", "uav_1_2", "uav.1")
    assert identifiers(names) == ("uav_1_3", "uav_1", "aircraft_2nd", "uav_1_2", "uav_1_4")
    changed = ("uav-1", "uav_1_3"), ("2nd", "aircraft_2nd"), ("uav.1", "uav_1_4")
    assert changed_names(names) == changed
    assert identifiers(names[1:2]) == ("uav_1",) and changed_names(("a", "b_c")) == ()
    assert identifiers(("a_b", "a-b")) == ("a_b", "a_b_2")
