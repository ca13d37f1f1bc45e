"""Autopilot parameters under ArduPlane's names, and the records of fly-by-wire A made of them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.autopilot.fbwa import AIRSPEED_S, GAINS, PITCH_UNDERSPEED, PRESSURE_WEIGHT
from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY
from testbed.core.input_files import read_bounded_text
from testbed.core.records import Array, Records, allocate


class ParamError(InputError):
    """A `.param` file that cannot be read, or a parameter with an invalid value."""


@dataclass(frozen=True, slots=True)
class FbwaParams:
    """Parameters of fly-by-wire A and L1 guidance, with ArduPlane's units and defaults.

    Fields are the parameters' names in lower case. A rate limit of zero means no limit.
    """

    airspeed_min: float = 9.0  # m/s
    airspeed_cruise: float = 12.0  # m/s
    airspeed_max: float = 22.0  # m/s
    airspeed_stall: float = 0.0  # m/s, 0: use airspeed_min
    scaling_speed: float = 15.0  # m/s, at which the gains are not scaled
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
    rll_rate_smax: float = 150.0  # deg/s, of the slew limiter; 0: none
    ptch2srv_tconst: float = 0.5  # s
    ptch2srv_rmax_up: float = 0.0  # deg/s
    ptch2srv_rmax_dn: float = 0.0  # deg/s
    ptch2srv_rll: float = 1.0  # share of the pitch rate of a level turn
    ptch_rate_p: float = 0.04
    ptch_rate_i: float = 0.15  # 1/s
    ptch_rate_d: float = 0.0  # s
    ptch_rate_ff: float = 0.345
    ptch_rate_imax: float = 0.666  # rad of surface
    ptch_rate_fltt: float = 3.0  # Hz
    ptch_rate_flte: float = 0.0  # Hz
    ptch_rate_fltd: float = 12.0  # Hz
    ptch_rate_smax: float = 150.0  # deg/s, of the slew limiter; 0: none
    servo1_min: float = 1100.0  # µs, aileron; the total travel of a servo is 1000 to 2000 µs
    servo1_max: float = 1900.0  # µs
    servo2_min: float = 1100.0  # µs, elevator
    servo2_max: float = 1900.0  # µs
    servo4_min: float = 1100.0  # µs, rudder
    servo4_max: float = 1900.0  # µs
    ins_gyro_filter: float = 20.0  # Hz, cut-off; 0: no filter
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
# Names before version 4.5: the present name, and the factor of the value (centidegrees, cm/s).
OLD_NAMES = {
    "LIM_ROLL_CD": ("ROLL_LIMIT_DEG", 0.01),
    "LIM_PITCH_MAX": ("PTCH_LIM_MAX_DEG", 0.01),
    "LIM_PITCH_MIN": ("PTCH_LIM_MIN_DEG", 0.01),
    "TRIM_PITCH_CD": ("PTCH_TRIM_DEG", 0.01),
    "TRIM_ARSPD_CM": ("AIRSPEED_CRUISE", 0.01),
    "ARSPD_FBW_MIN": ("AIRSPEED_MIN", 1.0),
    "ARSPD_FBW_MAX": ("AIRSPEED_MAX", 1.0),
}
_OLDER_GAINS = ("RLL2SRV_P", "PTCH2SRV_P")  # before version 4.1, of another control law
# Channel of the surface in the parameters here, and the output functions that move it: aileron,
# elevator, rudder, left elevon, left V-tail. ArduPlane's default outputs are these channels.
_OUTPUTS = ((1, (4, 77)), (2, (19, 77, 79)), (4, (21, 79)))
_DEFAULT_FUNCTIONS = {1: 4, 2: 19, 3: 70, 4: 21}
_LEFT_ELEVON = 77
_RANGE, _MIXING_GAIN = (1100.0, 1900.0), 0.5  # ArduPlane's defaults
_MIN_SIZE, _MAX_SIZE = 1e-9, 1e9  # of values other than 0, so that quotients do not overflow
_MIN_TCONST = 0.05  # s, as in ArduPlane
_LEAST_MIN = 5.0  # m/s, AIRSPEED_MIN of the speed scaler, as in ArduPlane
_SITL_GYRO_HZ = 1000.0  # rate for which SITL's gyro filter is designed
# Largest cut-off of SITL by the bilinear transform, part of the autopilot's rate. Its lag at low
# frequencies is x / tan x of the true one, with x = π times this: 9 % too small.
_BILINEAR_CUTOFF = 1.0 / 6.0


def read_params(path: Path) -> FbwaParams:
    """Read the parameters of fly-by-wire A from a `.param` file; see `read_values`.

    The travel of a surface is that of the output that SERVOn_FUNCTION assigns to it, times
    MIXING_GAIN for elevons. Names that fly-by-wire A does not use are ignored, with one warning
    that has their number.

    Raises:
        ParamError: the file cannot be read, or a line or value is invalid.
    """
    path = Path(path)
    given = read_values(path)
    for name in _OLDER_GAINS:
        if name in given and name.replace("2SRV", "_RATE") not in given:
            raise ParamError(
                f"{path}:{given[name].line}: {name} is a gain of versions before 4.1 (write "
                "RLL_RATE_ and PTCH_RATE_ gains, as a newer version has them)"
            )
    named = {name.lower(): each for name, each in _surface_outputs(given).items()}
    used = {name: each for name, each in named.items() if name in _NAMES}
    params = FbwaParams(**{name: each.value for name, each in used.items()})
    for name, problem in _errors(params):
        line = used[name].line if name in used else 1
        raise ParamError(f"{path}:{line}: {problem}")
    taken = {each.name for each in used.values()}
    unknown = {
        each.name for name, each in given.items() if not is_virtual(name) and each.name not in taken
    }
    if unknown:
        some = ", ".join(sorted(unknown)[:3]) + (", …" if len(unknown) > 3 else "")
        warnings.warn(
            f"{path}: ignored {len(unknown)} parameters that fly-by-wire A does not use ({some})",
            stacklevel=2,
        )
    return params


def is_virtual(name: str) -> bool:
    """Return whether the virtual autopilot uses a parameter, by its present name."""
    is_output = name.startswith("SERVO") and name.endswith("_FUNCTION")
    return name.lower() in _NAMES or is_output or name == "MIXING_GAIN"


class GivenValue(NamedTuple):
    """A value of a `.param` file."""

    value: float
    line: int
    name: str  # as the file has it


def read_values(path: Path) -> dict[str, GivenValue]:
    """Read a `.param` file of a ground station, by ArduPlane's present names.

    Lines are of name and value, separated by comma or blanks, or of system, component, name, value
    and type, as QGroundControl writes them. `#` starts a comment. The last value of a name counts.
    Names before version 4.5 are converted, with their units (`OLD_NAMES`).

    Raises:
        ParamError: the file cannot be read, or a line is invalid.
    """
    found: dict[str, GivenValue] = {}
    lines = read_bounded_text(path, error=ParamError).splitlines()
    for number, line in enumerate(lines, start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) == 5 and words[0].isdigit() and words[1].isdigit():
            words = words[2:4]
        value = _number(words[1]) if len(words) == 2 else None
        if value is None or not words[0].replace("_", "").isalnum() or words[0][0].isdigit():
            raise ParamError(
                f"{path}:{number}: expected a name and a number, as in 'RLL_RATE_P 0.3' or "
                f"'RLL_RATE_P,0.3', found {line.strip()[:60]!r}"
            )
        name, factor = OLD_NAMES.get(words[0].upper(), (words[0].upper(), 1.0))
        found[name] = GivenValue(factor * value, number, words[0])
    return found


def _surface_outputs(given: Mapping[str, GivenValue]) -> dict[str, GivenValue]:
    """Move the ranges of the surfaces' outputs to channels 1, 2 and 4.

    Elevons of an airframe mix aileron and elevator with a gain of 1; those of ArduPlane with
    MIXING_GAIN, which their range here is scaled by, about its centre.
    """
    functions = dict(_DEFAULT_FUNCTIONS)
    for number in range(1, 17):
        if each := given.get(f"SERVO{number}_FUNCTION"):
            functions[number] = int(each.value)
    gain = given.get("MIXING_GAIN", GivenValue(_MIXING_GAIN, 1, "MIXING_GAIN")).value
    moved = dict(given)
    for channel, wanted in _OUTPUTS:
        output = next((n for n in sorted(functions) if functions[n] in wanted), channel)
        names = [f"SERVO{output}_{end}" for end in ("MIN", "MAX")]
        ends = [
            given.get(name, GivenValue(default, 1, name))
            for name, default in zip(names, _RANGE, strict=True)
        ]
        if functions.get(output) == _LEFT_ELEVON:
            centre, half = (ends[0].value + ends[1].value) / 2, (ends[1].value - ends[0].value) / 2
            ends = [
                each._replace(value=centre + side * gain * half)
                for each, side in zip(ends, (-1, 1), strict=True)
            ]
        for end, each in zip(("MIN", "MAX"), ends, strict=True):
            moved[f"SERVO{channel}_{end}"] = each
    return moved


def with_param(params: FbwaParams, name: str, value: float) -> FbwaParams:
    """Change one parameter, by its name in ArduPlane.

    Raises:
        ParamError: the parameter is unknown, or cannot have this value.
    """
    if name.lower() not in _NAMES:
        raise ParamError(f"{name}: not a parameter of fly-by-wire A")
    if not math.isfinite(value):
        raise ParamError(f"{name}: {value} is not a number")
    changed = replace(params, **{name.lower(): value})
    for _, error in _errors(changed):
        raise ParamError(error)
    return changed


def _errors(params: FbwaParams) -> Iterator[tuple[str, str]]:
    """Yield the field and the error of each invalid value."""
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
    if params.ins_gyro_filter and params.ins_gyro_filter < 1.0:
        yield (
            "ins_gyro_filter",
            f"INS_GYRO_FILTER is {params.ins_gyro_filter:g}; it is a whole number of Hz (write 0 "
            "for no filter, or 1 or more; 20 is usual)",
        )
    for name in sorted(_NAMES):
        value = getattr(params, name)
        if value and not _MIN_SIZE <= abs(value) <= _MAX_SIZE:
            yield name, f"{name.upper()} is {value:g}; a size is {_MIN_SIZE:g} to {_MAX_SIZE:g}"


@dataclass(frozen=True, slots=True)
class AutopilotTiming:
    """Delays of an autopilot from commands and motion to its surfaces.

    The latency was identified from the recording of ArduPlane with simulated physics at 200 Hz.
    """

    command_latency: float = 0.02  # s; RC is read once per loop, after the control law
    # Hz, physics rate of the SITL whose gyro filter the autopilot has; None: of an aircraft
    sitl_physics_hz: float | None = None


def sitl_gyro_cutoff(params: FbwaParams, physics_hz: float) -> float:
    """Compute the cut-off of SITL's gyro filter, Hz; 0: no filter.

    SITL samples its gyros once per frame of the physics, at most at 1000 Hz, and its filter is
    designed for 1000 Hz: it acts at INS_GYRO_FILTER times the ratio of both.

    Args:
        params: with INS_GYRO_FILTER.
        physics_hz: SIM_RATE_HZ, frames of the physics per second.
    """
    return params.ins_gyro_filter * min(physics_hz, _SITL_GYRO_HZ) / _SITL_GYRO_HZ


def make_gains(
    params: Sequence[FbwaParams], dt: float, timing: AutopilotTiming | None = None
) -> Records:
    """Convert N parameter sets to records (N,) of `fbwa.GAINS`.

    Args:
        params: N parameter sets.
        dt: period of the autopilots, s.
        timing: of all autopilots; None: the defaults.

    Raises:
        ValueError: the latency is negative.
    """
    timing = timing or AutopilotTiming()
    if timing.command_latency < 0.0:
        raise ValueError(f"{timing}: the command's latency must not be negative")

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
    periods = timing.command_latency / dt
    whole = int(periods + 1e-9)
    each = allocate(GAINS, len(params))
    each["dt"], each["command_periods"] = dt, whole
    each["command_fraction"] = max(0.0, periods - whole)
    each["sitl_physics_hz"] = timing.sitl_physics_hz or 0.0
    for record, one in zip(each, params, strict=True):
        record["gyro_b"], record["gyro_a"] = _gyro_filter(one, dt, timing.sitl_physics_hz)
    each["airspeed_periods"] = max(1, int(AIRSPEED_S / dt + 1e-9))
    each["pressure_weight"] = PRESSURE_WEIGHT
    each["airspeed_min"] = low
    each["stall_speed"] = np.where(stall > 0.0, stall, low)
    each["scaling_speed"] = scaling
    each["scaler_low"] = np.minimum(0.5, scaling / (2.0 * high))
    each["scaler_high"] = np.maximum(2.0, scaling / (0.7 * np.maximum(low, _LEAST_MIN)))
    each["roll_limit"] = roll_limit
    # from ROLL_LIMIT_DEG + 5°, at most from 85°
    margin = np.radians(5.0)
    each["fade_slope"] = 1.0 / np.maximum(np.pi / 2.0 - roll_limit - margin, margin)
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
    each["per_tconst"] = 1.0 / np.maximum(_MIN_TCONST, rows("rll2srv_tconst", "ptch2srv_tconst"))
    each["rate_low"] = -np.stack([limit("rll2srv_rmax"), limit("ptch2srv_rmax_dn")], axis=-1)
    each["rate_high"] = np.stack([limit("rll2srv_rmax"), limit("ptch2srv_rmax_up")], axis=-1)
    each["p"] = full * rows("rll_rate_p", "ptch_rate_p")
    each["i_dt"] = full * dt * rows("rll_rate_i", "ptch_rate_i")
    each["d"] = full * rows("rll_rate_d", "ptch_rate_d")
    each["ff"] = full * rows("rll_rate_ff", "ptch_rate_ff")
    each["i_max"] = full * rows("rll_rate_imax", "ptch_rate_imax")
    each["underspeed"] = np.stack([low, PITCH_UNDERSPEED * low], axis=-1)
    each["slew_max"] = rows("rll_rate_smax", "ptch_rate_smax")
    each["alpha_target"] = _alpha(rows("rll_rate_fltt", "ptch_rate_fltt"), dt)
    each["alpha_error"] = _alpha(rows("rll_rate_flte", "ptch_rate_flte"), dt)
    each["alpha_derivative"] = _alpha(rows("rll_rate_fltd", "ptch_rate_fltd"), dt)
    return each


def _alpha(frequency: Array, dt: float) -> Array:
    """Compute the weight of a new sample in a first-order low-pass; 0 Hz: no filter."""
    safe = np.where(frequency > 0.0, frequency, np.inf)
    return dt / (dt + 1.0 / (2.0 * np.pi * safe))


Biquad = tuple[tuple[float, float, float], tuple[float, float]]  # b0, b1, b2 and a1, a2


def _gyro_filter(params: FbwaParams, dt: float, sitl_physics_hz: float | None) -> Biquad:
    """Design the gyro filter of one autopilot, an aircraft's or SITL's."""
    if params.ins_gyro_filter <= 0.0:
        return (1.0, 0.0, 0.0), (0.0, 0.0)
    if sitl_physics_hz is None:
        return ramp_invariant_butterworth(params.ins_gyro_filter, dt)
    cutoff = sitl_gyro_cutoff(params, sitl_physics_hz)
    if cutoff * dt <= _BILINEAR_CUTOFF:
        return _bilinear_butterworth(cutoff, dt)
    return ramp_invariant_butterworth(cutoff, dt)


def ramp_invariant_butterworth(cutoff: float, dt: float) -> Biquad:
    """Compute the second-order Butterworth low-pass for samples, exact for ramps between them.

    A flight controller filters its gyros at 1 kHz or more, where the filter is as good as
    continuous, and its rate loop takes the output at a lower rate. The continuous filter, fed with
    straight lines between the samples (triangle hold), has the same output at the samples, stable
    for any cut-off. Its lag at low frequencies is sqrt(2) / (2 π cutoff): 11.25 ms for 20 Hz. The
    bilinear transform of 20 Hz at 50 Hz would have 4.6 ms.

    With T = dt, a = π sqrt(2) cutoff, d = exp(−aT) cos aT, ρ = exp(−aT) and k = 1 / (aT), the
    response to the ramp t / T is t / T − k + k exp(−at) cos at.

    Args:
        cutoff: Hz, greater than 0.
        dt: between samples, s.
    """
    x = math.pi * math.sqrt(2.0) * cutoff * dt
    k, decay = 1.0 / x, math.exp(-x)
    d, squared = decay * math.cos(x), decay * decay
    b = 1.0 - k * (1.0 - d), k * (1.0 - squared) - 2.0 * d, squared - k * (d - squared)
    return b, (-2.0 * d, squared)


def _bilinear_butterworth(cutoff: float, dt: float) -> Biquad:
    """Compute a second-order Butterworth low-pass by the bilinear transform, as SITL's."""
    warped = math.tan(math.pi * cutoff * dt)
    scale = 1.0 + math.sqrt(2.0) * warped + warped * warped
    b0 = warped * warped / scale
    a1 = 2.0 * (warped * warped - 1.0) / scale
    return (b0, 2.0 * b0, b0), (a1, 4.0 * b0 - 1.0 - a1)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
