"""Autopilot parameters under their ArduPlane names, read from a `.param` file."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np

from testbed.errors import InputError
from testbed.frames import GRAVITY
from testbed.state import Array
from testbed.vehicle.tables import GAINS, FbwaGains


class ParamError(InputError):
    """A `.param` file that cannot be read."""


@dataclass(frozen=True, slots=True)
class FbwaParams:
    """What fly-by-wire A and L1 guidance use, in ArduPlane's units; defaults are ArduPlane's.

    Fields are the parameters' names in lower case. A rate limit of zero means none.
    """

    airspeed_min: float = 9.0  # m/s
    airspeed_cruise: float = 12.0  # m/s
    airspeed_max: float = 22.0  # m/s
    airspeed_stall: float = 0.0  # m/s, 0: airspeed_min stands in
    scaling_speed: float = 15.0  # m/s, where the surface gains are as given
    roll_limit_deg: float = 45.0  # deg
    ptch_lim_max_deg: float = 20.0  # deg
    ptch_lim_min_deg: float = -25.0  # deg
    ptch_trim_deg: float = 0.0  # deg, added to the pitch demand
    trim_throttle: float = 45.0  # %
    thr_max: float = 100.0  # %
    stab_pitch_down: float = 2.0  # deg, at zero throttle
    kff_rddrmix: float = 0.5  # rudder per aileron
    rll2srv_tconst: float = 0.5  # s
    rll2srv_rmax: float = 0.0  # deg/s
    rll_rate_p: float = 0.08
    rll_rate_i: float = 0.15  # 1/s
    rll_rate_d: float = 0.0  # s
    rll_rate_ff: float = 0.345
    rll_rate_imax: float = 0.666  # rad of surface
    rll_rate_fltt: float = 3.0  # Hz, 0: off, as for all filters
    rll_rate_flte: float = 0.0  # Hz
    rll_rate_fltd: float = 12.0  # Hz
    rll_rate_smax: float = 150.0  # deg/s; the slew limiter is not modelled
    ptch2srv_tconst: float = 0.5  # s
    ptch2srv_rmax_up: float = 0.0  # deg/s
    ptch2srv_rmax_dn: float = 0.0  # deg/s
    ptch2srv_rll: float = 1.0  # of the pitch rate a level turn needs
    ptch_rate_p: float = 0.04
    ptch_rate_i: float = 0.15  # 1/s
    ptch_rate_d: float = 0.0  # s
    ptch_rate_ff: float = 0.345
    ptch_rate_imax: float = 0.666  # rad of surface
    ptch_rate_fltt: float = 3.0  # Hz
    ptch_rate_flte: float = 0.0  # Hz
    ptch_rate_fltd: float = 12.0  # Hz
    ptch_rate_smax: float = 150.0  # deg/s; the slew limiter is not modelled
    servo1_min: float = 1100.0  # µs, aileron; a servo's whole travel is 1000 to 2000 µs
    servo1_max: float = 1900.0  # µs
    servo2_min: float = 1100.0  # µs, elevator
    servo2_max: float = 1900.0  # µs
    servo4_min: float = 1100.0  # µs, rudder
    servo4_max: float = 1900.0  # µs
    sched_loop_rate: float = 50.0  # Hz
    navl1_period: float = 17.0  # s
    navl1_damping: float = 0.75


_NAMES = frozenset(field.name for field in fields(FbwaParams))
_POSITIVE = (
    "airspeed_min",
    "airspeed_max",
    "scaling_speed",
    "roll_limit_deg",
    "sched_loop_rate",
    "navl1_period",
    "navl1_damping",
)
_SMALLEST, _LARGEST = 1e-9, 1e9  # of what is not 0: quotients of others are beyond all numbers
_SHORTEST_TCONST = 0.05  # s, ArduPlane's own floor


def read_params(path: Path) -> FbwaParams:
    """Read a `.param` file: a name and a value per line, separated by a comma or blanks.

    `#` begins a comment. A name given twice keeps its last value. Names that fly-by-wire A does
    not use change nothing; a single warning says how many they were.

    Raises:
        ParamError: naming file and line, if the file cannot be read or a line is malformed.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ParamError(f"{path}: cannot read this parameter file: {error}") from error
    values: dict[str, float] = {}
    where: dict[str, int] = {}
    unknown: set[str] = set()
    for number, line in enumerate(lines, start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        value = _number(words[1]) if len(words) == 2 else None
        if value is None or not words[0].replace("_", "").isalnum() or words[0][0].isdigit():
            raise ParamError(
                f"{path}:{number}: expected a name and a number, as in 'RLL_RATE_P 0.3' or "
                f"'RLL_RATE_P,0.3', found {line.strip()[:60]!r}"
            )
        name = words[0].lower()
        if name in _NAMES:
            values[name], where[name] = value, number
        else:
            unknown.add(words[0])
    params = FbwaParams(**values)
    for name, fault in _faults(params):
        raise ParamError(f"{path}:{where.get(name, 1)}: {fault}")
    if unknown:
        some = ", ".join(sorted(unknown)[:3]) + (", …" if len(unknown) > 3 else "")
        warnings.warn(
            f"{path}: ignored {len(unknown)} parameters that fly-by-wire A does not use ({some})",
            stacklevel=2,
        )
    return params


def with_param(params: FbwaParams, name: str, value: float) -> FbwaParams:
    """The parameters with one of them changed, by its name in ArduPlane.

    Raises:
        ParamError: there is no such parameter, or it cannot have this value.
    """
    if name.lower() not in _NAMES:
        raise ParamError(f"{name}: not a parameter of fly-by-wire A")
    if not math.isfinite(value):
        raise ParamError(f"{name}: {value} is not a number")
    changed = replace(params, **{name.lower(): value})
    for _, fault in _faults(changed):
        raise ParamError(fault)
    return changed


def _faults(params: FbwaParams) -> Iterator[tuple[str, str]]:
    """What no autopilot can fly with: the parameter's field, and what is wrong with it."""
    for name in _POSITIVE:
        if not getattr(params, name) > 0.0:
            yield name, f"{name.upper()} must be greater than 0"
    for channel in (1, 2, 4):
        low, high = (getattr(params, f"servo{channel}_{end}") for end in ("min", "max"))
        if not 800.0 <= low < high <= 2200.0:
            name = f"servo{channel}_{'max' if 800.0 <= low else 'min'}"
            text = f"SERVO{channel}_MIN and _MAX ({low:g}, {high:g}) must rise within 800 to 2200"
            yield name, text
    if params.airspeed_max <= params.airspeed_min:
        yield (
            "airspeed_max",
            f"AIRSPEED_MAX ({params.airspeed_max:g}) must be greater than AIRSPEED_MIN "
            f"({params.airspeed_min:g})",
        )
    for name in sorted(_NAMES):
        value = getattr(params, name)
        if value and not _SMALLEST <= abs(value) <= _LARGEST:
            yield name, f"{name.upper()} is {value:g}; a size is {_SMALLEST:g} to {_LARGEST:g}"


@dataclass(frozen=True, slots=True)
class AutopilotTiming:
    """What delays an autopilot between a command or a motion and its surfaces.

    The defaults are those found in the recording of ArduPlane on simulated physics of 200 Hz: there
    its gyro filter, laid out for a sampling rate of 1000 Hz and 20 Hz of bandwidth, acts at a
    fifth of both.
    """

    command_latency: float = 0.02  # s, the receiver is read once a loop, after the control
    gyro_filter_hz: float = 4.0  # Hz, of a second-order Butterworth low-pass; 0: none


def stack(
    params: Sequence[FbwaParams], dt: float, timing: AutopilotTiming | None = None
) -> FbwaGains:
    """Prepare N parameter sets for the law at a period of dt seconds.

    Raises:
        ValueError: if the latency is negative or the gyro's filter is too fast for the period.
    """
    timing = timing or AutopilotTiming()
    if timing.command_latency < 0.0 or not 0.0 <= timing.gyro_filter_hz < 0.5 / dt:
        raise ValueError(
            f"{timing}: the command's latency must not be negative and the gyro's filter must lie "
            f"between 0 and {0.5 / dt:g} Hz, half the autopilot's rate"
        )

    def row(name: str) -> Array:
        return np.array([getattr(one, name) for one in params], dtype=np.float64)

    def rows(roll: str, pitch: str) -> Array:
        return np.stack([row(roll), row(pitch)], axis=-1)

    def limit(name: str) -> Array:
        value = np.radians(row(name))
        return np.where(value > 0.0, value, np.inf)

    def travel(channel: int) -> Array:
        return (row(f"servo{channel}_max") - row(f"servo{channel}_min")) / 1000.0

    full = math.degrees(1.0) / 45.0
    scaling, low, high = row("scaling_speed"), row("airspeed_min"), row("airspeed_max")
    roll_limit = np.radians(row("roll_limit_deg"))
    stall = row("airspeed_stall")
    trim = row("trim_throttle") / 100.0
    b0, a1, a2 = _butterworth(timing.gyro_filter_hz, dt)
    periods = timing.command_latency / dt
    whole = int(periods + 1e-9)
    each = np.zeros(len(params), dtype=GAINS)
    each["airspeed_min"] = low
    each["stall_speed"] = np.where(stall > 0.0, stall, low)
    each["scaling_speed"] = scaling
    each["scaler_low"] = np.minimum(0.5, scaling / (2.0 * high))
    each["scaler_high"] = np.maximum(2.0, scaling / (0.7 * low))
    each["roll_limit"] = roll_limit
    each["fade_slope"] = 1.0 / np.maximum(np.pi / 2.0 - roll_limit - np.radians(5.0), 1e-3)
    each["pitch_low"] = np.radians(row("ptch_lim_min_deg"))
    each["pitch_high"] = np.radians(row("ptch_lim_max_deg"))
    each["pitch_trim"] = np.radians(row("ptch_trim_deg"))
    each["throttle_max"] = row("thr_max") / 100.0
    each["throttle_trim"] = trim
    each["pitch_down"] = np.radians(row("stab_pitch_down")) / np.where(trim > 0.0, trim, np.inf)
    each["turn"] = GRAVITY * row("ptch2srv_rll")
    each["rudder_mix"] = row("kff_rddrmix")
    each["travel"] = np.stack([travel(1), travel(2)], axis=-1)
    each["rudder_travel"] = travel(4)
    each["per_tconst"] = 1.0 / np.maximum(
        _SHORTEST_TCONST, rows("rll2srv_tconst", "ptch2srv_tconst")
    )
    each["rate_low"] = -np.stack([limit("rll2srv_rmax"), limit("ptch2srv_rmax_dn")], axis=-1)
    each["rate_high"] = np.stack([limit("rll2srv_rmax"), limit("ptch2srv_rmax_up")], axis=-1)
    each["p"] = full * rows("rll_rate_p", "ptch_rate_p")
    each["i_dt"] = full * dt * rows("rll_rate_i", "ptch_rate_i")
    each["d"] = full * rows("rll_rate_d", "ptch_rate_d")
    each["ff"] = full * rows("rll_rate_ff", "ptch_rate_ff")
    each["i_max"] = full * rows("rll_rate_imax", "ptch_rate_imax")
    each["alpha_target"] = _alpha(rows("rll_rate_fltt", "ptch_rate_fltt"), dt)
    each["alpha_error"] = _alpha(rows("rll_rate_flte", "ptch_rate_flte"), dt)
    each["alpha_derivative"] = _alpha(rows("rll_rate_fltd", "ptch_rate_fltd"), dt)
    return FbwaGains(
        dt=dt,
        command_periods=whole,
        command_fraction=max(0.0, periods - whole),
        gyro_b0=b0,
        gyro_a1=a1,
        gyro_a2=a2,
        each=each,
    )


def _alpha(frequency: Array, dt: float) -> Array:
    """Share of a new sample in a first-order low-pass of this cut-off in Hz; 0 Hz lets all by."""
    safe = np.where(frequency > 0.0, frequency, np.inf)
    return dt / (dt + 1.0 / (2.0 * np.pi * safe))


def _butterworth(frequency: float, dt: float) -> tuple[float, float, float]:
    """b0, a1, a2 of a second-order Butterworth low-pass, by the bilinear transform."""
    if frequency == 0.0:
        return 1.0, 2.0, 1.0  # numerator and denominator are the same: lets all by
    warped = math.tan(math.pi * frequency * dt)
    scale = 1.0 + math.sqrt(2.0) * warped + warped * warped
    b0 = warped * warped / scale
    a1 = 2.0 * (warped * warped - 1.0) / scale
    return b0, a1, 4.0 * b0 - 1.0 - a1


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
