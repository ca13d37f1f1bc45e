"""Recorded flights of leaders: read from CSV, and sampled at the ticks of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.core.csv_table import CsvTable, read_table
from testbed.core.errors import InputError
from testbed.core.frames import euler_rates, wrap_pi
from testbed.core.interpolation import hermite
from testbed.core.ranges import RECORDED
from testbed.core.records import Array

COLUMNS = tuple(
    "t_s north_m east_m down_m v_north_mps v_east_mps v_down_mps roll_rad pitch_rad yaw_rad "
    "p_radps q_radps r_radps airspeed_mps throttle".split()
)
_MAX_JUMP_M, _MAX_SHARE = 3.0, 0.5  # beyond what the velocity explains, and of that
MAX_GAP_S = 1.0  # between two rows, for cubic interpolation


@dataclass(frozen=True, slots=True)
class RecordedFlight:
    """A recorded flight: M rows at increasing times (s), SI units, NED, yaw unwrapped."""

    time: Array  # (M,)
    position_ned: Array  # (M, 3)
    velocity_ned: Array  # (M, 3)
    euler: Array  # (M, 3)
    rates_body: Array  # (M, 3)
    airspeed: Array  # (M,) true
    throttle: Array  # (M,)
    source: str


@dataclass(frozen=True, slots=True)
class SampledTrajectory:
    """The motion of a leader at T ticks."""

    position_ned: Array  # (T, 3) m
    velocity_ned: Array  # (T, 3) m/s
    acceleration_ned: Array  # (T, 3) m/s²
    euler: Array  # (T, 3) rad
    rates_body: Array  # (T, 3) rad/s
    airspeed: Array  # (T,) true, m/s
    throttle: Array  # (T,) 0..1


def read_recording(path: Path) -> RecordedFlight:
    """Read a recording with the columns `COLUMNS` in any order; other columns are ignored.

    Time stamps that are rounded values of an even grid are replaced by the grid: a stamp rounded to
    0.01 s is an error of up to 0.1 m at 22 m/s.

    Raises:
        InputError: the file is not such a recording; the message has file, line and remedy.
    """
    table = read_table(path)
    data = table.numbers({name: RECORDED[name] for name in COLUMNS})
    if len(data) < 2:
        raise InputError(f"{path}: {len(data)} rows of numbers; a flight needs at least two")
    table.check_time_steps(data[:, 0], MAX_GAP_S, "cut here")
    _check_motion(table, data)
    return RecordedFlight(
        time=_even_times(data[:, 0], table.column("t_s")),
        position_ned=data[:, 1:4].copy(),
        velocity_ned=data[:, 4:7].copy(),
        euler=np.unwrap(data[:, 7:10], axis=0),
        rates_body=data[:, 10:13].copy(),
        airspeed=data[:, 13].copy(),
        throttle=data[:, 14].copy(),
        source=str(path),
    )


def _check_motion(table: CsvTable, data: Array) -> None:
    """Check that the rows are of one flight: positions go where velocities lead.

    Raises:
        InputError: naming the row.
    """
    elapsed = np.diff(data[:, 0])
    velocity = 0.5 * (data[1:, 4:7] + data[:-1, 4:7])
    speed = np.linalg.norm(velocity, axis=1)
    led = velocity * elapsed[:, None]
    error = np.linalg.norm(np.diff(data[:, 1:4], axis=0) - led, axis=1)
    jumps = error > _MAX_JUMP_M + _MAX_SHARE * speed * elapsed
    if jumps.any():
        k = int(np.argmax(jumps))
        raise table.error_at(
            k + 2,
            f"the position is {error[k]:.1f} m from where the velocity leads from line "
            f"{table.lines[k + 1]}: rows of several flights, or other units; keep one flight, in m "
            "and m/s, or cut here",
        )


def sample_recording(recording: RecordedFlight, time: Array) -> SampledTrajectory:
    """Sample a recording at simulation times (T,) s; time 0 is its first row.

    Position, velocity and angles are cubic Hermite curves through the rows: position with the
    recorded velocity as slope, angles with the recorded rates, velocity with its central
    differences. The acceleration is the derivative of that velocity, and continuous; the second
    derivative of the position would amplify its rounding.

    Raises:
        InputError: the recording is shorter than the run.
    """
    at = recording.time[0] + time
    tolerance = 1e-9 * max(1.0, abs(recording.time[-1]))  # rounding of the sum
    if at[-1] > recording.time[-1] + tolerance:
        length = recording.time[-1] - recording.time[0]
        raise InputError(
            f"{recording.source}: the recording lasts {length:.2f} s, the scenario "
            f"{time[-1]:.2f} s; set scenario.duration_s to {np.floor(length):.0f} or less"
        )
    at = np.minimum(at, recording.time[-1])
    acceleration = np.gradient(recording.velocity_ned, recording.time, axis=0)
    angle_rates = euler_rates(recording.euler, recording.rates_body)
    rows = recording.time
    position, _ = hermite(at, rows, recording.position_ned, recording.velocity_ned)
    velocity, acceleration = hermite(at, rows, recording.velocity_ned, acceleration)
    euler, _ = hermite(at, rows, recording.euler, angle_rates)
    euler[:, 2] = wrap_pi(euler[:, 2])
    rates = [np.interp(at, rows, recording.rates_body[:, axis]) for axis in range(3)]
    return SampledTrajectory(
        position_ned=position,
        velocity_ned=velocity,
        acceleration_ned=acceleration,
        euler=euler,
        rates_body=np.stack(rates, axis=-1),
        airspeed=np.interp(at, rows, recording.airspeed),
        throttle=np.interp(at, rows, recording.throttle),
    )


def _even_times(time: Array, stamps: list[str]) -> Array:
    """Return the even grid (M,) s that `time` was rounded from, if any.

    Stamps of as many digits before the point have as many behind it, of which a writer may leave
    out zeros: they were rounded at the last nonzero digit of all of them.
    """
    step = float(np.round(np.median(np.diff(time)), 6))
    parts = [stamp.partition(".") for stamp in stamps]
    digits = [len(behind.rstrip("0")) for _, _, behind in parts]
    most: dict[int, int] = {}
    for (before, _, _), count in zip(parts, digits, strict=True):
        most[len(before)] = max(count, most.get(len(before), 0))
    decimals = np.array([most[len(before)] for before, _, _ in parts])
    rounding = 0.5 * 10.0**-decimals + 1e-6  # and that of stamps stored as floats before
    since_first = step * np.arange(len(time))
    earliest = np.max(time - rounding - since_first)  # the first row, if all are on the grid
    latest = np.min(time + rounding - since_first)
    if earliest > latest:
        return time.copy()
    first = min(max(time[0], earliest), latest)
    even: Array = first + since_first
    return even
