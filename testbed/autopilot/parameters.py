"""Autopilot parameters under ArduPlane's names, and the records of fly-by-wire A made of them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from testbed.autopilot.fbwa import AIRSPEED_S, GAINS, PITCH_UNDERSPEED, PRESSURE_WEIGHT
from testbed.autopilot.known_parameters import probably_meant
from testbed.autopilot.param_file import GivenValue, ParamError, ParamFile, read_param_file
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, Records, allocate


class InvalidParamError(ParamError):
    """A parameter that cannot have its value; `name` is that of its field."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        super().__init__(text)


class ParamRange(NamedTuple):
    """Values of a parameter."""

    unit: str
    # least and largest that ArduPlane documents, wider where the tunes of aircraft/ are
    usual: tuple[float, float]
    flyable: tuple[float, float]  # least and largest that are not an error


def _param(
    default: float, unit: str, usual: tuple[float, float], flyable: tuple[float, float]
) -> Any:  # noqa: ANN401 - a field of a dataclass
    return field(default=default, metadata=ParamRange(unit, usual, flyable)._asdict())


@dataclass(frozen=True, slots=True)
class FbwaParams:
    """Parameters of fly-by-wire A and L1 guidance: defaults, units, usual and flyable values.

    Units and defaults are ArduPlane's. Fields are the parameters' names in lower case. A rate limit
    of zero means no limit. The total travel of a servo is 1000 to 2000 µs.

    Raises:
        InvalidParamError: a value is not flyable.
    """

    airspeed_min: float = _param(9.0, "m/s", (5, 100), (1, 400))
    airspeed_cruise: float = _param(12.0, "m/s", (5, 100), (1, 400))
    airspeed_max: float = _param(22.0, "m/s", (5, 100), (1, 400))
    airspeed_stall: float = _param(0.0, "m/s", (0, 75), (0, 400))  # 0: use airspeed_min
    scaling_speed: float = _param(15.0, "m/s", (5, 50), (1, 400))  # unscaled gains
    roll_limit_deg: float = _param(45.0, "deg", (5, 90), (1, 90))
    ptch_lim_max_deg: float = _param(20.0, "deg", (1, 90), (0, 90))
    ptch_lim_min_deg: float = _param(-25.0, "deg", (-90, -1), (-90, 0))
    ptch_trim_deg: float = _param(0.0, "deg", (-45, 45), (-45, 45))  # added to the pitch demand
    trim_throttle: float = _param(45.0, "%", (0, 100), (0, 100))
    thr_max: float = _param(100.0, "%", (10, 100), (0, 100))
    stab_pitch_down: float = _param(2.0, "deg", (0, 15), (0, 45))  # at zero throttle
    kff_rddrmix: float = _param(0.5, "", (0, 1), (0, 2))  # rudder per aileron
    rll2srv_tconst: float = _param(0.5, "s", (0.1, 1), (0.05, 10))
    rll2srv_rmax: float = _param(0.0, "deg/s", (0, 180), (0, 1000))  # 0: none
    rll_rate_p: float = _param(0.08, "", (0, 2), (0, 20))
    rll_rate_i: float = _param(0.15, "1/s", (0, 2), (0, 20))
    rll_rate_d: float = _param(0.0, "s", (0, 0.05), (0, 1))
    rll_rate_ff: float = _param(0.345, "", (0, 3), (0, 20))
    rll_rate_imax: float = _param(0.666, "rad", (0, 1), (0, 2))  # of surface
    rll_rate_fltt: float = _param(3.0, "Hz", (0, 100), (0, 1000))  # 0: off, as for all filters
    rll_rate_flte: float = _param(0.0, "Hz", (0, 100), (0, 1000))
    rll_rate_fltd: float = _param(12.0, "Hz", (0, 100), (0, 1000))
    rll_rate_smax: float = _param(150.0, "deg/s", (0, 200), (0, 10000))  # of slew; 0: none
    ptch2srv_tconst: float = _param(0.5, "s", (0.1, 1), (0.05, 10))
    ptch2srv_rmax_up: float = _param(0.0, "deg/s", (0, 180), (0, 1000))
    ptch2srv_rmax_dn: float = _param(0.0, "deg/s", (0, 180), (0, 1000))
    ptch2srv_rll: float = _param(1.0, "", (0.7, 1.5), (0, 3))  # of a level turn's
    ptch_rate_p: float = _param(0.04, "", (0, 2), (0, 20))
    ptch_rate_i: float = _param(0.15, "1/s", (0, 2), (0, 20))
    ptch_rate_d: float = _param(0.0, "s", (0, 0.05), (0, 1))
    ptch_rate_ff: float = _param(0.345, "", (0, 3), (0, 20))
    ptch_rate_imax: float = _param(0.666, "rad", (0, 1), (0, 2))  # of surface
    ptch_rate_fltt: float = _param(3.0, "Hz", (0, 100), (0, 1000))
    ptch_rate_flte: float = _param(0.0, "Hz", (0, 100), (0, 1000))
    ptch_rate_fltd: float = _param(12.0, "Hz", (0, 100), (0, 1000))
    ptch_rate_smax: float = _param(150.0, "deg/s", (0, 200), (0, 10000))  # of slew; 0: none
    servo1_min: float = _param(1100.0, "µs", (800, 2200), (800, 2200))  # aileron
    servo1_max: float = _param(1900.0, "µs", (800, 2200), (800, 2200))
    servo2_min: float = _param(1100.0, "µs", (800, 2200), (800, 2200))  # elevator
    servo2_max: float = _param(1900.0, "µs", (800, 2200), (800, 2200))
    servo4_min: float = _param(1100.0, "µs", (800, 2200), (800, 2200))  # rudder
    servo4_max: float = _param(1900.0, "µs", (800, 2200), (800, 2200))
    ins_gyro_filter: float = _param(20.0, "Hz", (0, 256), (0, 1000))  # cut-off; 0: no filter
    sched_loop_rate: float = _param(50.0, "Hz", (50, 400), (1, 2000))
    navl1_period: float = _param(17.0, "s", (1, 60), (1, 600))
    navl1_damping: float = _param(0.75, "", (0.6, 1), (0.1, 5))

    def __post_init__(self) -> None:
        """Check all values."""
        for name, text in _errors(self):
            raise InvalidParamError(name, text)


RANGES = {each.name: ParamRange(**each.metadata) for each in fields(FbwaParams)}


def unusual_values(params: FbwaParams) -> Iterator[str]:
    """Yield a text for each value outside the parameter's usual range."""
    for name, (unit, (low, high), _) in RANGES.items():
        if not low <= (value := getattr(params, name)) <= high:
            of = f" {unit}" if unit else ""
            yield f"{name.upper()} is {value:g}{of}; usual are {low:g} to {high:g}"


_OLDER_GAINS = ("RLL2SRV_P", "PTCH2SRV_P")  # before version 4.1, of another control law
# Channel of the surface in the parameters here, and the output functions that move it: aileron,
# elevator, rudder, left elevon, left V-tail. ArduPlane's default outputs are these channels.
_OUTPUTS = ((1, (4, 77)), (2, (19, 77, 79)), (4, (21, 79)))
_DEFAULT_FUNCTIONS = {1: 4, 2: 19, 3: 70, 4: 21}
_LEFT_ELEVON = 77
_RANGE, _MIXING_GAIN = (1100.0, 1900.0), 0.5  # ArduPlane's defaults
_MIN_SIZE = 1e-9  # of values other than 0, so that quotients do not overflow
_MIN_TCONST = 0.05  # s, as in ArduPlane
_LEAST_MIN = 5.0  # m/s, AIRSPEED_MIN of the speed scaler, as in ArduPlane
_SITL_GYRO_HZ = 1000.0  # rate for which SITL's gyro filter is designed
# Largest cut-off of SITL by the bilinear transform, part of the autopilot's rate. Its lag at low
# frequencies is x / tan x of the true one, with x = π times this: 9 % too small.
_BILINEAR_CUTOFF = 1.0 / 6.0


def read_params(path: Path) -> FbwaParams:
    """Read the parameters of fly-by-wire A from a `.param` file; see `read_param_file`.

    The travel of a surface is that of the output that SERVOn_FUNCTION assigns to it, times
    MIXING_GAIN for elevons. Names that fly-by-wire A does not use are ignored, with one warning
    that has their number, and one for each that is probably misspelt. A note on a name that it uses
    is a warning too.

    Raises:
        ParamError: the file cannot be read, or a line or value is invalid.
    """
    path = Path(path)
    file = read_param_file(path)
    for note in file.notes:
        if not note.name or is_virtual(note.name):
            warnings.warn(f"{path}: {note.text}", stacklevel=2)
    params = fbwa_params(file)
    taken = {each.name for each in _used_values(file).values()}
    unused = {
        name: each
        for name, each in file.values.items()
        if not is_virtual(name) and each.name not in taken
    }
    used = [name.upper() for name in RANGES]
    misspelt = {name: meant for name in unused if (meant := probably_meant(name, used))}
    for name, meant in misspelt.items():
        each = unused.pop(name)
        text = f"{each.name} is no parameter of fly-by-wire A: did you mean {meant}?"
        warnings.warn(f"{path}:{each.line}: {text} It is ignored", stacklevel=2)
    if unused:
        names = {each.name for each in unused.values()}
        some = ", ".join(sorted(names)[:3]) + (", …" if len(names) > 3 else "")
        warnings.warn(
            f"{path}: ignored {len(names)} parameters that fly-by-wire A does not use ({some}); "
            "`testbed arduplane params FILE` lists them",
            stacklevel=2,
        )
    return params


def fbwa_params(file: ParamFile) -> FbwaParams:
    """Take the parameters of fly-by-wire A from a file that was read; see `read_params`.

    Raises:
        ParamError: a value is invalid, or a gain is of another control law; with file and line.
    """
    path, given = file.path, file.values
    for name in _OLDER_GAINS:
        if name in given and name.replace("2SRV", "_RATE") not in given:
            raise ParamError(
                f"{path}:{given[name].line}: {name} is a gain of versions before 4.1 (write "
                "RLL_RATE_ and PTCH_RATE_ gains, as a newer version has them)"
            )
    used = _used_values(file)
    try:
        return FbwaParams(**{name: each.value for name, each in used.items()})
    except InvalidParamError as error:
        line = used[error.name].line if error.name in used else 1
        raise ParamError(f"{path}:{line}: {error}") from None


def _used_values(file: ParamFile) -> dict[str, GivenValue]:
    named = {name.lower(): each for name, each in _surface_outputs(file.values).items()}
    return {name: each for name, each in named.items() if name in RANGES}


def is_virtual(name: str) -> bool:
    """Return whether the virtual autopilot uses a parameter, by its present name."""
    is_output = name.startswith("SERVO") and name.endswith("_FUNCTION")
    return name.lower() in RANGES or is_output or name == "MIXING_GAIN"


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
    if name.lower() not in RANGES:
        raise ParamError(f"{name}: not a parameter of fly-by-wire A")
    return replace(params, **{name.lower(): value})


def _errors(params: FbwaParams) -> Iterator[tuple[str, str]]:
    """Yield the field and the error of each invalid value."""
    for name, (unit, _, (low, high)) in RANGES.items():
        value = getattr(params, name)
        if not low <= value <= high or 0.0 < abs(value) < _MIN_SIZE:
            of = f" {unit}" if unit else ""
            yield name, f"{name.upper()} is {value:g}{of}; it must be {low:g} to {high:g}"
    for channel in (1, 2, 4):
        low, high = (getattr(params, f"servo{channel}_{end}") for end in ("min", "max"))
        if not low < high:
            text = f"SERVO{channel}_MIN ({low:g}) must be less than SERVO{channel}_MAX ({high:g})"
            yield f"servo{channel}_max", text
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
