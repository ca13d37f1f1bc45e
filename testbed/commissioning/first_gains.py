"""First gains of an aircraft, by rule from its step responses and trims.

The rate loops get the feed-forward that gives the demanded rate in the steady state; P is a share
of it that grows with the lag of the response, and the attitude loops are slower than the rates. The
gains of the middle loop keep their bandwidth below that of the loops inside. These are gains to
begin with, not the best ones: `check_flight` flies them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from testbed.autopilot.parameters import FbwaParams
from testbed.commissioning.step_responses import StepResponses
from testbed.core.frames import GRAVITY

FULL_OUTPUT = math.radians(45.0)  # of a surface, which ArduPlane's gains are per
ROLL_LIMIT_DEG = 45.0
PITCH_LIMIT_DEG = 20.0
# Ends of ArduPlane's ranges, beyond which each flight has a warning.
LARGEST_ROLL_RATE_DEG = 180.0  # deg/s
LEAST_AIRSPEED = 5.0  # m/s


@dataclass(frozen=True, slots=True)
class LevelFlight:
    """Trims about cruise, and the ends of level flight; airspeeds are true, m/s."""

    airspeed: float
    lowest: float  # of level flight
    highest: float
    pitch: float  # rad, at `airspeed`
    throttle: float  # the same
    throttle_per_speed: float  # per m/s
    throttle_per_climb: float  # per sine of the flight path angle
    throttle_per_bank: float  # per 1/cos² φ − 1
    incidence_per_load: float  # rad per unit of load factor
    path_lag_s: float  # of the flight path behind the pitch, 1/|Z_w|


def first_params(steps: StepResponses, level: LevelFlight) -> FbwaParams:
    """Compute autopilot parameters from the responses of an aircraft."""
    eas2tas = steps.airspeed / steps.equivalent_airspeed
    roll_ff = FULL_OUTPUT / steps.roll_rate * eas2tas
    pitch_ff = FULL_OUTPUT / steps.pitch_rate * eas2tas
    roll_tconst = max(0.2, 1.6 * steps.roll_s + 0.06)
    pitch_tconst = max(0.4, 1.6 * steps.pitch_s + 0.06)
    short_period = math.sqrt(
        steps.pitch_acceleration / (steps.pitch_rate * level.path_lag_s)
    )  # rad/s, of the two poles of q/δe
    pitch_p = min(pitch_ff, FULL_OUTPUT * min(0.5 * short_period, 6.0) / steps.pitch_acceleration)
    speed = steps.equivalent_airspeed
    stall = level.lowest / eas2tas
    slowest = min(max(1.2 * stall, LEAST_AIRSPEED), 0.9 * speed)
    values: dict[str, float] = {
        "airspeed_min": slowest,
        "airspeed_cruise": speed,
        "airspeed_max": max(min(1.35 * speed, level.highest / eas2tas), 1.05 * speed),
        "airspeed_stall": stall,
        "scaling_speed": speed,
        "roll_limit_deg": ROLL_LIMIT_DEG,
        "ptch_lim_max_deg": PITCH_LIMIT_DEG,
        "ptch_lim_min_deg": -PITCH_LIMIT_DEG,
        "ptch_trim_deg": math.degrees(level.pitch),
        "trim_throttle": 100.0 * level.throttle,
        "kff_rddrmix": steps.rudder_mix,
        "rll2srv_tconst": roll_tconst,
        "rll2srv_rmax": min(0.6 * math.degrees(steps.roll_rate), LARGEST_ROLL_RATE_DEG),
        "rll_rate_ff": roll_ff,
        "rll_rate_p": roll_ff * min(max(6.0 * steps.roll_s - 0.5, 0.1), 0.5),
        "rll_rate_i": roll_ff * min(1.0, 1.0 / (3.0 * roll_tconst)),
        "rll_rate_fltt": 10.0,
        "rll_rate_fltd": 20.0,
        "ptch2srv_tconst": pitch_tconst,
        "ptch2srv_rmax_up": math.degrees(1.5 * GRAVITY / steps.airspeed),
        "ptch2srv_rmax_dn": math.degrees(1.5 * GRAVITY / steps.airspeed),
        "ptch_rate_ff": pitch_ff,
        "ptch_rate_p": pitch_p,
        "ptch_rate_i": pitch_ff * min(1.0, 0.4 / pitch_tconst),
        "ptch_rate_fltt": 10.0,
        "ptch_rate_fltd": 20.0,
        **{f"servo{n}_{end}": us for n in (1, 2, 4) for end, us in (("min", 1000), ("max", 2000))},
    }
    return FbwaParams(**{name: _rounded(value) for name, value in values.items()})


def softened(params: FbwaParams, axis: str) -> FbwaParams:
    """Return parameters with half the P and I of an axis, and 1.5 times its time constant.

    Args:
        params: to change.
        axis: "roll" or "pitch".
    """
    rate, angle = {"roll": ("rll_rate", "rll2srv"), "pitch": ("ptch_rate", "ptch2srv")}[axis]
    changes = {f"{rate}_p": 0.5, f"{rate}_i": 0.5, f"{angle}_tconst": 1.5}
    return replace(
        params,
        **{name: _rounded(factor * getattr(params, name)) for name, factor in changes.items()},
    )


def first_middle_loop(
    steps: StepResponses, level: LevelFlight, params: FbwaParams
) -> dict[str, Any]:
    """Compute a profile of the middle loop; see `scenario.MiddleLoopGains`."""
    course_rate = min(1.0, 0.24 / (params.rll2srv_tconst + 0.3 * steps.roll_s))
    course = course_rate * level.airspeed / GRAVITY
    path = min(max(0.45 * level.path_lag_s / params.ptch2srv_tconst, 0.4), 1.5)
    speed = (
        min(0.84, 0.5 / steps.throttle_s) / steps.throttle_acceleration
        if steps.throttle_acceleration > 0.0
        else 0.0
    )
    return {
        "flight_path": _gains(p=path, i=0.15 * path),
        "course": _gains(p=course, i=0.01 * course),
        "course_feedback": "inside_arctangent",
        "speed": _gains(p=speed, i=0.13 * speed),
        # less throttle for more speed is a matter of slow flight, and no feed-forward
        "eta_speed": _rounded(max(level.throttle_per_speed, 0.0)),
        "eta_bank": _rounded(max(level.throttle_per_bank, 0.0)),
        "trim_throttle": _rounded(level.throttle),
        "trim_airspeed_mps": _rounded(level.airspeed),
        "feed_forwards": {
            "turn_incidence_deg": _rounded(math.degrees(level.incidence_per_load)),
            "eta_climb": _rounded(max(level.throttle_per_climb, 0.0)),
        },
        "limits": {"pitch_deg": PITCH_LIMIT_DEG, "roll_deg": ROLL_LIMIT_DEG},
    }


def first_guidance(middle_loop: Mapping[str, Any], level: LevelFlight) -> dict[str, float]:
    """Compute the gains with which the aircraft leads; see `scenario.Guidance`."""
    return {
        "path": middle_loop["flight_path"]["p"],
        "path_integral": middle_loop["flight_path"]["i"],
        "incidence_per_load": _rounded(level.incidence_per_load),
        "speed": middle_loop["speed"]["p"],
        "speed_integral": middle_loop["speed"]["i"],
        "throttle_per_climb": _rounded(max(level.throttle_per_climb, 0.0) / level.airspeed),
        "throttle_per_bank": _rounded(max(level.throttle_per_bank, 0.0)),
    }


def _gains(**values: float) -> dict[str, float]:
    return {name: _rounded(value) for name, value in values.items()}


def _rounded(value: float) -> float:
    """Round to three digits, as no derived gain has more; the last ones of speeds are kept."""
    return float(f"{value:.4g}" if abs(value) >= 1.0 else f"{value:.3g}")
