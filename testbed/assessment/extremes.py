"""Extremes of one flight: how near each aircraft comes to its limits, and its battery."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from testbed.core.records import Array, Event, RunInfo
from testbed.core.samples import BlockObserver
from testbed.flight.limits import OWN_OVERSPEED
from testbed.metrics.model import Metrics
from testbed.plan.fleet import PlannedAircraft

_SETTLED_S = 20.0  # from there on climbs count: a flight begins with transients


class FlightExtremes(BlockObserver):
    """Collect largest banks, pitch angles, angles of attack, speeds and climbs, and the charge.

    Attributes:
        largest: by quantity, (N,) in degrees and m/s.
        smallest: the same.
        charge: (2, N) state of charge at the first and the last sample; NaN: no battery.
        climb_mps: largest climb of the leader, mean over a block of samples.
        sink_mps: its largest sink.
    """

    def __init__(self) -> None:
        self.largest: dict[str, Array] = {}
        self.smallest: dict[str, Array] = {}
        self.charge: Array = np.zeros((2, 0))
        self.climb_mps = self.sink_mps = 0.0

    def begin(self, info: RunInfo) -> None:
        """Start with the next sample."""
        self._rate_hz = info.base_rate_hz
        self.charge = np.full((2, len(info.names)), math.nan)
        self._begin_blocks(info)

    def add_events(self, events: Sequence[Event]) -> None:
        """Do nothing."""

    def take_block(self) -> None:
        """Compare the new samples with those before."""
        rows = self._take()
        if not len(rows.ticks):
            return
        columns, first = rows.columns, not self.largest
        euler = np.degrees(columns["truth.euler"])
        values = {
            "bank": np.abs(euler[..., 0]),
            "pitch": euler[..., 1],
            "alpha": np.degrees(columns["air.alpha"]),
            "airspeed": columns["truth.equivalent_airspeed"],
        }
        for name, each in values.items():
            with np.errstate(invalid="ignore"):
                low, high = np.fmin.reduce(each), np.fmax.reduce(each)
            self.largest[name] = high if first else np.fmax(self.largest[name], high)
            self.smallest[name] = low if first else np.fmin(self.smallest[name], low)
        charge = columns["air.state_of_charge"]
        self.charge[1] = charge[-1]
        if first:
            self.charge[0] = charge[0]
        if rows.ticks[0] / self._rate_hz >= _SETTLED_S:
            climb = -float(columns["truth.velocity_ned"][:, 0, 2].mean())
            self.climb_mps = max(self.climb_mps, climb)
            self.sink_mps = max(self.sink_mps, -climb)

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Take what is left."""
        self.take_block()


def limits_reached(
    found: FlightExtremes, metrics: Metrics, aircraft: Sequence[PlannedAircraft]
) -> list[dict[str, Any]]:
    """Return the limits of a flight, those that were reached most nearly first.

    Args:
        found: of the flight.
        metrics: of it.
        aircraft: the N of the flight.

    Returns:
        `limit`, `aircraft`, `value`, `bound`, `unit` and `used`, the share of the limit.
    """
    rows: list[dict[str, Any]] = []

    def add(limit: str, name: str, value: float, bound: float, unit: str, used: float) -> None:
        if math.isfinite(value) and math.isfinite(bound) and math.isfinite(used):
            row = {"limit": limit, "aircraft": name, "value": value, "bound": bound}
            rows.append({**row, "unit": unit, "used": used})

    for k, each in enumerate(aircraft):
        if not each.has_model:
            continue
        limits = {
            ("bank", "°"): (found.largest["bank"][k], each.params.roll_limit_deg),
            ("pitch up", "°"): (found.largest["pitch"][k], each.params.ptch_lim_max_deg),
            ("pitch down", "°"): (found.smallest["pitch"][k], each.params.ptch_lim_min_deg),
            ("angle of attack", "°"): (
                found.largest["alpha"][k],
                math.degrees(each.airframe.stall_angle),
            ),
            ("airspeed", "m/s"): (
                found.largest["airspeed"][k],
                OWN_OVERSPEED * each.params.airspeed_max,
            ),
        }
        for (limit, unit), (value, bound) in limits.items():
            add(limit, each.name, float(value), bound, unit, float(value) / bound if bound else 0.0)
    flown_s = metrics["simulated_s"] - metrics.get("begin_s", 0.0)
    for name, counts in metrics["saturations"].items():
        seconds = counts["seconds"]
        if seconds is not None and flown_s:
            add("commands at a limit", name, seconds, flown_s, "s", seconds / flown_s)
    separation, pair = metrics["min_separation_m"], metrics["min_separation_between"]
    if separation and pair:
        spans = {each.name: each.airframe.span for each in aircraft}
        span = max(spans[name] for name in pair)
        add("separation", " and ".join(pair), separation, span, "m", span / separation)
    for name, kappa in metrics["kappa_mps"].items():
        assumed = metrics["kappa_assumed_mps"][name]
        if kappa is not None and assumed:
            used = assumed / kappa if kappa > 0.0 else 2.0
            add("margin of the slot's speed to its bounds", name, kappa, assumed, "m/s", used)
    worst: dict[str, dict[str, Any]] = {}
    for row in rows:  # of each limit the aircraft that comes nearest
        if row["limit"] not in worst or row["used"] > worst[row["limit"]]["used"]:
            worst[row["limit"]] = row
    return sorted(worst.values(), key=lambda row: -row["used"])
