"""From a tally to the numbers people read: the keys of metrics.json."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from enum import IntFlag
from typing import Any

import numpy as np

from testbed.formation.assumptions import largest_kappa
from testbed.formation.flags import Guard, Saturation
from testbed.metrics import estimates, wind
from testbed.metrics.block import NEVER, Ticks
from testbed.metrics.tally import Tally, Windows
from testbed.state import Array, Event, RunInfo

SCHEMA = 1  # of metrics.json; raised when a key changes its meaning or goes


def summarise(
    tally: Tally,
    *,
    windows: Windows,
    info: RunInfo,
    events: Sequence[Event],
    published: Mapping[str, Any] | None,
) -> dict[str, Any]:
    """The metrics document; `document.complete` puts in what only the runner knows.

    RMS errors are [HBH23] eqs. (30), (31) with the integral as the sum over frames. The percent
    error is that of its Table 1: the RMS of ‖q̃_i‖/‖χ_i‖, averaged over the followers. κ as
    measured is the largest with which Assumption 1 held: negative where a slot left the bounds.
    A lost aircraft counts until it was lost; behind a lost leader there are no slots.
    """
    followers = info.names[1:]
    paired = tally.separation_tick != NEVER
    closest = [info.names[i] for i in tally.separation_pair] if paired else None
    return {
        "schema": SCHEMA,
        "scenario": info.scenario_name,
        "seed": info.seed,
        "versions": dict(info.versions),
        "outcome": None,
        "simulated_s": _time(tally.last_tick, info) or 0.0,
        "wall_s": None,
        "real_time_factor": None,
        "portions": {
            name: _portion(tally, p, windows, info) for p, name in enumerate(windows.names)
        },
        "min_separation_m": _number(tally.separation),
        "min_separation_at_s": _time(tally.separation_tick, info),
        "min_separation_between": closest,
        "lost_at_s": _times(tally.lost, info.names, info),
        "engaged_at_s": _times(tally.engaged, followers, info),
        "max_error_m": _numbers(tally.largest_ever, followers),
        "leader_bank_deg": _number(math.degrees(tally.bank_ever)),
        "guards": _flags(Guard, tally.guarded, tally.guards, info),
        "saturations": _flags(Saturation, tally.saturated, tally.saturations, info),
        **_kappa(tally.speeds.smallest_ever, info),
        "kappa_at_s": _times(_tightest(tally, info), followers, info),
        "kappa_assumed_mps": dict(zip(followers, info.kappa_mps, strict=True)),
        "left_speed_set": {
            name: {
                "times": int(tally.speeds.left[i]),
                "first_s": _time(int(tally.speeds.first_left[i]), info),
            }
            for i, name in enumerate(followers)
        },
        "recovery": {
            name: {
                "last_saturated_s": _time(int(tally.last_saturated[i]), info),
                "inside_for_good_from_s": _time(int(tally.inside_since[i]), info),
            }
            for i, name in enumerate(followers)
        },
        "age_of_information_s": {name: {"mean": None, "max": None} for name in followers},
        "network": None,
        "mean_throttle": _numbers(tally.throttle / np.maximum(tally.alive, 1), info.names),
        "wind": wind.summarise(tally.wind, info.names, tally.alive),
        **estimates.summarise(tally.estimates, info.names, frames=tally.alive, paired=tally.paired),
        "published": None if published is None else dict(published),
        "events": [
            {"time_s": e.time_s, "level": e.level, "source": e.source, "text": e.text}
            for e in events
        ],
    }


def _portion(tally: Tally, p: int, windows: Windows, info: RunInfo) -> dict[str, Any]:
    followers = info.names[1:]
    count = int(tally.count[p])
    covered = count / info.frame_rate_hz
    start, end = float(windows.start_s[p]), float(windows.end_s[p])
    nothing = dict.fromkeys(followers)
    out: dict[str, Any] = {
        "window_s": [start, end],
        "covered_s": covered,
        "complete": covered >= end - start - 1.0 / info.frame_rate_hz,
        "rms_m": nothing,
        "mean_rms_m": None,
        "believed_rms_m": nothing,
        "believed_mean_rms_m": None,
        "percent_error": None,
        "max_error_m": nothing,
        "leader_bank_deg": None,
        **_kappa(tally.speeds.smallest[:, p], info),
    }
    if count:
        counted = tally.counted[p]
        some = counted > 0
        frames = np.where(some, counted, np.nan)
        rms = np.sqrt(tally.square[p] / frames)
        believed = np.sqrt(tally.believed[p] / frames)
        ratio = np.sqrt(tally.square_ratio[p] / frames)
        out["rms_m"] = _numbers(rms, followers)
        out["mean_rms_m"] = _mean(rms[some])
        out["believed_rms_m"] = _numbers(believed, followers)
        out["believed_mean_rms_m"] = _mean(believed[some])
        out["percent_error"] = _mean(100.0 * ratio[some])
        out["max_error_m"] = _numbers(np.where(some, tally.largest[p], np.nan), followers)
        out["leader_bank_deg"] = _number(math.degrees(tally.bank[p]))
    return out


def _bounds(info: RunInfo) -> Array:
    """s_lo and s_hi of the followers (2, n), m/s."""
    return np.array(info.speed_bounds_mps, dtype=np.float64).reshape(-1, 2).T


def _kappa(smallest: Array, info: RunInfo) -> dict[str, dict[str, Any]]:
    """κ as measured, and the slots' ground speeds, from the smallest of ± these (2, n)."""
    followers = info.names[1:]
    slowest, fastest = smallest[0], -smallest[1]
    kappa = largest_kappa(slowest, fastest, *_bounds(info))
    seen = zip(followers, slowest, fastest, strict=True)
    return {
        "kappa_mps": _numbers(np.where(np.isfinite(slowest), kappa, np.nan), followers),
        "slot_speed_mps": {name: [_number(low), _number(high)] for name, low, high in seen},
    }


def _tightest(tally: Tally, info: RunInfo) -> Ticks:
    """When each slot was closest to the bounds, or farthest beyond (n,)."""
    low, high = _bounds(info)
    slowest, fastest = tally.speeds.smallest_ever[0], -tally.speeds.smallest_ever[1]
    slow, fast = tally.speeds.smallest_tick
    tightest: Ticks = np.where(slowest - low <= high - fastest, slow, fast)
    return tightest


def _flags(
    kind: type[IntFlag], any_of_them: Ticks, each: Ticks, info: RunInfo
) -> dict[str, dict[str, Any]]:
    """For each follower: frames and seconds with any of these flags, and frames with each."""
    return {
        name: {
            "frames": int(any_of_them[i]),
            "seconds": int(any_of_them[i]) / info.frame_rate_hz,
            "by_kind": {str(flag.name).lower(): int(each[i, k]) for k, flag in enumerate(kind)},
        }
        for i, name in enumerate(info.names[1:])
    }


def _number(value: float) -> float | None:
    """A number JSON can hold: null stands for what is not one."""
    return float(value) if math.isfinite(value) else None


def _numbers(values: Array, names: Sequence[str]) -> dict[str, float | None]:
    return {name: _number(float(value)) for name, value in zip(names, values, strict=True)}


def _mean(values: Array) -> float | None:
    return _number(float(values.mean())) if values.size else None


def _time(tick: int, info: RunInfo) -> float | None:
    return None if tick == NEVER else tick / info.base_rate_hz


def _times(ticks: Ticks, names: Sequence[str], info: RunInfo) -> dict[str, float | None]:
    return {name: _time(int(tick), info) for name, tick in zip(names, ticks, strict=True)}
