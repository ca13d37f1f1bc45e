"""A recorded flight as leader: exact at its rows, consistent between them, refused when broken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from close_arrays import assert_close
from places import ROOT

from testbed.core.frames import euler_rates, wrap_pi
from testbed.guidance.recorded_path import COLUMNS, read_recording, sample_recording

DATA = ROOT / "scenarios" / "data" / "arduplane-auto-leader-rascal.csv"


def orbit(time: np.ndarray) -> np.ndarray:
    """A level coordinated circle of 120 m at 22 m/s with 25° of bank, as rows of a recording."""
    angle = 22.0 / 120.0 * time
    turn, bank, zero = 22.0 / 120.0, np.radians(25.0), np.zeros_like(time)
    return np.column_stack(
        [time, 120.0 * np.sin(angle), -120.0 * np.cos(angle), zero - 100.0]
        + [22.0 * np.cos(angle), 22.0 * np.sin(angle), zero]
        + [zero + bank, zero, np.mod(angle, 2.0 * np.pi)]
        + [zero, zero + turn * np.sin(bank), zero + turn * np.cos(bank)]
        + [zero + 22.0, zero + 0.25]
    )


def write(path: Path, rows: np.ndarray, stamp: str = "%.3f") -> Path:
    formats = [stamp] + ["%.9f"] * (rows.shape[1] - 1)
    np.savetxt(path, rows, delimiter=",", header=",".join(COLUMNS), comments="", fmt=formats)
    return path


def test_recording_is_interpolated_exactly(tmp_path: Path) -> None:
    rows = orbit(0.035 + 0.08 * np.arange(900))
    recording = read_recording(write(tmp_path / "orbit.csv", rows))
    at_rows = sample_recording(recording, recording.time - recording.time[0])
    assert_close(at_rows.position_ned, recording.position_ned, 1e-9)
    assert_close(at_rows.velocity_ned, recording.velocity_ned, 1e-9)

    time = np.arange(0.1, 70.0, 0.005)
    track = sample_recording(recording, time)
    truth = orbit(time + 0.035)
    # Hermite: h⁴/384 · |p⁗| = 0.08⁴/384 · 0.136 < 1e-7 m; the file's ninth decimal is below
    assert_close(track.position_ned, truth[:, 1:4], 1e-7)
    # slopes by central differences: h²/6 · |v‴| = 0.0011 · 0.136 = 1.5e-4 m/s² at the rows
    assert_close(track.velocity_ned, truth[:, 4:7], 1e-4)
    assert_close(np.linalg.norm(track.acceleration_ned, axis=1), 22.0**2 / 120.0, 3e-4)
    assert_close(wrap_pi(track.euler[:, 2] - truth[:, 9]), 0.0, 1e-7)
    assert np.abs(track.euler[:, 2]).max() <= np.pi
    # the acceleration is the derivative of the velocity: differences of 5 ms, jerk 0.74 m/s³
    slope = np.gradient(track.velocity_ned, time, axis=0)[1:-1]
    assert_close(slope, track.acceleration_ned[1:-1], 1e-3)


def test_rounded_stamps_are_put_on_their_grid(tmp_path: Path) -> None:
    time = 0.035 + 0.08 * np.arange(200)
    rounded = read_recording(write(tmp_path / "rounded.csv", orbit(time), "%.2f"))
    assert np.diff(rounded.time) == pytest.approx(0.08, abs=1e-12)
    uneven = time + np.where(np.arange(200) % 7 == 0, 0.02, 0.0)  # more than a rounding
    kept = read_recording(write(tmp_path / "uneven.csv", orbit(uneven)))
    assert kept.time == pytest.approx(uneven, abs=1e-9)


def test_recorded_leader_is_consistent() -> None:
    recording = read_recording(DATA)
    assert len(recording.time) == 13750
    assert_close(np.diff(recording.time), 0.08, 1e-9)
    step = np.diff(recording.position_ned, axis=0) / 0.08
    mean = 0.5 * (recording.velocity_ned[1:] + recording.velocity_ned[:-1])
    settled = recording.time[1:] > 60.0
    # rounding of two positions to 1 mm: 12.5 mm/s; trapezium rule: h²/12 · jerk (10 m/s³) 5 mm/s
    assert np.abs(step - mean)[settled].max() < 0.02

    time = np.arange(60.0, 1080.0, 0.02)
    track = sample_recording(recording, time)
    assert np.degrees(np.abs(track.euler[:, 0]).max()) == pytest.approx(50.7, abs=0.1)
    # the gyros tell the same turn as the acceleration: horizontal speed times the yaw rate
    circle = (time > 520.0) & (time < 1050.0)
    load = np.hypot(*track.acceleration_ned[circle, :2].T)
    turn = euler_rates(track.euler, track.rates_body)[circle, 2]
    expected = np.hypot(*track.velocity_ned[circle, :2].T) * turn
    # beside it, in a root sum of squares, changes of speed of up to 0.5 m/s²: 1 % of 4 m/s²
    assert np.median(load / expected) == pytest.approx(1.0, abs=0.01)


def test_recording_shorter_than_run_is_an_error(tmp_path: Path) -> None:
    path = write(tmp_path / "short.csv", orbit(0.08 * np.arange(101)))
    recording = read_recording(path)
    sample_recording(recording, np.array([0.0, 8.0]))
    with pytest.raises(ValueError, match=r"short.csv: .* lasts 8.00 s.*duration_s to 8 or less"):
        sample_recording(recording, np.array([0.0, 8.1]))


@pytest.mark.parametrize(
    "line, text, words",
    [
        (1, "t_s,north_m", r"bad.csv:1: missing column east_m"),
        (4, "0.08,1,2", r"bad.csv:4: 3 values under 15 columns"),
        (5, "0.24," + "x," * 13 + "0", r"bad.csv:5: north_m is 'x'; write a number"),
        (5, "0.24,nan," + "0," * 12 + "0", r"bad.csv:5: north_m is nan"),
        (5, "0.08," + "0," * 13 + "0", r"bad.csv:5: t_s goes from 0.16 to 0.08.*sort the rows"),
        (1, ",".join([*COLUMNS, "t_s"]), r"bad.csv:1: column t_s is there several times"),
        (
            5,
            "0.24,9" + ",0" * 13,
            r"bad.csv:5: the position is 1\d\d.* from line 4: rows of several",
        ),
        (
            5,
            "0.24," + "0," * 7 + "2" + ",0" * 6,
            r"bad.csv:5: pitch_rad is 2; allowed are -1.571 to 1.571 rad",
        ),
        (11, "9.00," + "0," * 13 + "0", r"bad.csv:11: .*a gap of more than 1 s"),
    ],
)
def test_broken_recording_error_names_the_line(
    tmp_path: Path, line: int, text: str, words: str
) -> None:
    path = write(tmp_path / "bad.csv", orbit(0.08 * np.arange(10)))
    lines = path.read_text().splitlines()
    lines[line - 1] = text
    path.write_text("\n".join(lines))
    with pytest.raises(ValueError, match=words):
        read_recording(path)


def test_empty_file_is_an_error(tmp_path: Path) -> None:
    empty = tmp_path / "empty.csv"
    empty.write_text("")
    with pytest.raises(ValueError, match="missing column t_s"):
        read_recording(empty)
    empty.write_text(",".join(COLUMNS) + "\n")
    with pytest.raises(ValueError, match="0 rows of numbers"):
        read_recording(empty)
