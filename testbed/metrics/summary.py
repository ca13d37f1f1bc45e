"""The numbers of a run from its accumulator: the keys of metrics.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import IntFlag
from typing import Any, cast

import numpy as np

from testbed.core.flags import LimiterFlag, Saturation
from testbed.core.frames import wind_from_deg
from testbed.core.records import Array, BoolArray, Event, RunInfo
from testbed.formation.assumptions import largest_kappa
from testbed.metrics.accumulator import ESTIMATE_KEYS, NEVER, Accumulator, Ticks
from testbed.metrics.model import Metrics, SlotSpeed

SCHEMA = 2  # of metrics.json; raised when a key is renamed, removed or changes its meaning
CALM_MPS = 1e-6  # a slower wind is rounding
RINGING_KEYS = ("seconds", "last_s", "period_s", "damping_ratio")

_DEGREES = np.array([1.0, 1.0, 1.0, math.degrees(1.0), math.degrees(1.0), 1.0])


def summarise(
    total: Accumulator,
    *,
    windows: Mapping[str, tuple[float, float]],
    info: RunInfo,
    events: Sequence[Event],
    published: Mapping[str, Any] | None,
) -> Metrics:
    """Compute the metrics document; `document.finalise` adds the numbers of the runner.

    RMS errors are [HBH23] eqs. (30), (31) with the integral as the sum over samples. The percent
    error is that of its Table 1: the RMS of ‖q̃_i‖/‖χ_i‖, averaged over the followers. The
    measured κ is the largest with which Assumption 1 held: negative where the speed of a slot left
    the bounds. A lost aircraft counts until it was lost; behind a lost leader there are no slots.
    """
    followers = info.names[1:]
    paired = total.min_separation_tick != NEVER
    closest = [info.names[i] for i in total.min_separation_pair] if paired else None
    relative = np.sqrt(total.relative_square / np.maximum(total.slot_samples, 1))
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "scenario": info.scenario_name,
        "seed": info.seed,
        "versions": dict(info.versions),
        "engine": info.engine or None,
        "outcome": None,
        **({"begin_s": begin_s} if (begin_s := _time(total.first_tick, info)) else {}),
        "simulated_s": _time(total.last_tick, info) or 0.0,
        "wall_s": None,
        "real_time_factor": None,
        "windows": {
            name: _window(total, p, span, info) for p, (name, span) in enumerate(windows.items())
        },
        "min_separation_m": _number(total.min_separation),
        "min_separation_at_s": _time(total.min_separation_tick, info),
        "min_separation_between": closest,
        "min_separation_outside_windows_m": _number(total.min_separation_outside),
        "lost_at_s": _times(total.lost_tick, info.names, info),
        "joined_at_s": _times(total.joined_tick, followers, info),
        "max_error_m": _by_name(total.max_error, followers),
        "leader_bank_deg": _number(math.degrees(total.max_bank)),
        "limiter_flags": _flags(LimiterFlag, total.limited_samples, total.limiter_samples, info),
        "saturations": _flags(Saturation, total.saturated_samples, total.saturation_samples, info),
        "ringing": _ringing(total, followers),
        **_slot_speed(total.min_speed, total.max_speed, info),
        "kappa_at_s": _times(_tightest(total, info), followers, info),
        "kappa_assumed_mps": dict(zip(followers, info.kappa_mps, strict=True)),
        "left_speed_set": {
            name: {
                "times": int(total.left_speed_set[i]),
                "first_s": _time(int(total.first_left_tick[i]), info),
            }
            for i, name in enumerate(followers)
        },
        "recovery": {
            name: {
                "last_saturated_s": _time(int(total.last_saturated_tick[i]), info),
                "in_slot_since_s": _time(int(total.in_slot_since[i]), info),
            }
            for i, name in enumerate(followers)
        },
        "age_of_information_s": {name: {"mean": None, "max": None} for name in followers},
        "network": None,
        "mean_throttle": _by_name(total.throttle_sum / np.maximum(total.samples, 1), info.names),
        "wind": _wind(total, info.names),
        "estimate_error": _estimate_error(total, info.names),
        "relative_position_error_m": _by_name(relative, followers),
        "published": None if published is None else dict(published),
        "events": [
            {"time_s": e.time_s, "level": e.level, "source": e.source, "text": e.text}
            for e in events
        ],
    }
    return cast("Metrics", document)


def _window(total: Accumulator, p: int, span: tuple[float, float], info: RunInfo) -> dict[str, Any]:
    followers = info.names[1:]
    count = int(total.window_samples[p])
    covered = count / info.sample_rate_hz
    start, end = float(span[0]), float(span[1])
    nothing = dict.fromkeys(followers)
    out: dict[str, Any] = {
        "window_s": [start, end],
        "covered_s": covered,
        "complete": covered >= end - start - 1.0 / info.sample_rate_hz,
        "rms_m": nothing,
        "mean_rms_m": None,
        "estimated_rms_m": nothing,
        "estimated_mean_rms_m": None,
        "percent_error": None,
        "max_error_m": nothing,
        "leader_bank_deg": None,
        "min_separation_m": _number(total.window_min_separation[p]),
        **_slot_speed(total.window_min_speed[p], total.window_max_speed[p], info),
    }
    if count:
        counted = total.window_slot_samples[p]
        some = counted > 0
        samples = np.where(some, counted, np.nan)
        rms = np.sqrt(total.square_error[p] / samples)
        estimated = np.sqrt(total.square_estimated_error[p] / samples)
        ratio = np.sqrt(total.square_error_ratio[p] / samples)
        out["rms_m"] = _by_name(rms, followers)
        out["mean_rms_m"] = _mean(rms[some])
        out["estimated_rms_m"] = _by_name(estimated, followers)
        out["estimated_mean_rms_m"] = _mean(estimated[some])
        out["percent_error"] = _mean(100.0 * ratio[some])
        largest = np.where(some, total.window_max_error[p], np.nan)
        out["max_error_m"] = _by_name(largest, followers)
        out["leader_bank_deg"] = _number(math.degrees(total.window_max_bank[p]))
    return out


def _bounds(info: RunInfo) -> Array:
    """s_lo and s_hi of the followers (2, n), m/s."""
    return np.array(info.speed_bounds_mps, dtype=np.float64).reshape(-1, 2).T


def _slot_speed(slowest: Array, fastest: Array, info: RunInfo) -> SlotSpeed:
    """The measured κ, and the range of the slots' speeds (n,), m/s."""
    followers = info.names[1:]
    kappa = largest_kappa(slowest, fastest, *_bounds(info))
    ranges = zip(followers, slowest, fastest, strict=True)
    return {
        "kappa_mps": _by_name(np.where(np.isfinite(slowest), kappa, np.nan), followers),
        "slot_speed_mps": {name: [_number(low), _number(high)] for name, low, high in ranges},
    }


def _tightest(total: Accumulator, info: RunInfo) -> Ticks:
    """Ticks (n,) at which each slot's speed was closest to the bounds, or farthest beyond."""
    low, high = _bounds(info)
    slower = total.min_speed - low <= high - total.max_speed
    tightest: Ticks = np.where(slower, total.min_speed_tick, total.max_speed_tick)
    return tightest


def _flags(
    kind: type[IntFlag], any_of_them: Ticks, each: Ticks, info: RunInfo
) -> dict[str, dict[str, Any]]:
    """By follower: samples and seconds with any of these flags, and samples with each."""
    return {
        name: {
            "samples": int(any_of_them[i]),
            "seconds": int(any_of_them[i]) / info.sample_rate_hz,
            "by_kind": {str(flag.name).lower(): int(each[i, k]) for k, flag in enumerate(kind)},
        }
        for i, name in enumerate(info.names[1:])
    }


def _ringing(total: Accumulator, followers: Sequence[str]) -> dict[str, dict[str, float | None]]:
    """By follower: for how long its bank rang, when last, with which period and damping ratio.

    The duration is null unless more than half of the samples could be assessed.
    """
    numbers = total.ringing.numbers()
    numbers[2 * total.ringing.assessed <= total.slot_samples, 0] = np.nan
    return {
        name: {key: _number(value) for key, value in zip(RINGING_KEYS, row, strict=True)}
        for name, row in zip(followers, numbers.tolist(), strict=True)
    }


def _wind(total: Accumulator, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Mean wind, RMS of gusts, largest speed and effect of wakes by aircraft."""
    samples = np.maximum(total.samples, 1)[:, None]
    mean = total.wind_sum / samples
    gusts = np.sqrt(np.maximum(total.wind_square / samples - mean**2, 0.0))
    gusts[gusts < CALM_MPS] = 0.0
    north, east = mean[:, 0], mean[:, 1]
    from_deg, known = wind_from_deg(mean), np.hypot(north, east) > CALM_MPS
    return {
        name: {
            "mean_ned_mps": [_number(value) for value in mean[i].tolist()],
            "mean_mps": _number(float(np.hypot(north[i], east[i]))),
            "from_deg": _number(float(from_deg[i])) if known[i] else None,
            "gusts_rms_ned_mps": [_number(value) for value in gusts[i].tolist()],
            "max_mps": _number(float(total.max_wind[i])),
            "max_wake_delta_cl": _number(float(total.max_wake_delta_cl[i])),
        }
        for i, name in enumerate(names)
    }


def _estimate_error(total: Accumulator, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """By aircraft: RMS of estimate minus truth, and its largest horizontal position error."""
    rms = np.sqrt(total.estimate_square / np.maximum(total.samples, 1)[:, None]) * _DEGREES
    keys = (*ESTIMATE_KEYS, "max_horizontal_m")
    rows = np.column_stack((rms, total.max_horizontal)).tolist()
    return {
        name: {key: _number(value) for key, value in zip(keys, row, strict=True)}
        for name, row in zip(names, rows, strict=True)
    }


def _number(value: float) -> float | None:
    """Convert a number to JSON: null for NaN and infinity."""
    return float(value) if math.isfinite(value) else None


def _by_name(values: Array, names: Sequence[str]) -> dict[str, float | None]:
    return {name: _number(float(value)) for name, value in zip(names, values, strict=True)}


def _mean(values: Array) -> float | None:
    return _number(float(values.mean())) if values.size else None


def _time(tick: int, info: RunInfo) -> float | None:
    return None if tick == NEVER else tick / info.base_rate_hz


def _times(ticks: Ticks, names: Sequence[str], info: RunInfo) -> dict[str, float | None]:
    return {name: _time(int(tick), info) for name, tick in zip(names, ticks, strict=True)}


METRICS = ("recovery.", "max_error_m.", "lost_at_s.")  # beginnings of the names that are read
_RECOVERY, _SLOT = "recovery.", ".in_slot_since_s"


def count_out_of_slot(metrics: Mapping[str, Array], where: BoolArray) -> int:
    """Count flights that end with a follower that is not lost out of its slot.

    Args:
        metrics: values (R,) by name, NaN for null.
        where: (R,) the flights to count.
    """
    out = np.zeros(where.shape, dtype=np.bool_)
    for name, since in metrics.items():
        if name.startswith(_RECOVERY) and name.endswith(_SLOT):
            follower = name[len(_RECOVERY) : -len(_SLOT)]
            known = metrics.get(f"max_error_m.{follower}")
            lost = metrics.get(f"lost_at_s.{follower}")
            flew = np.zeros_like(out) if known is None else ~np.isnan(known)
            out |= flew & np.isnan(since) & (True if lost is None else np.isnan(lost))
    return int((out & where).sum())
