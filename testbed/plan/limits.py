"""Build the monitors of separations and of the flight envelope, and warn of slots too close."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from math import inf

import numpy as np

from testbed.core.records import (
    Array,
    Event,
)
from testbed.flight.faults import FaultManager
from testbed.flight.limits import (
    FORMATION,
    MAX_EVENTS,
    OVERSPEED,
    OWN_OVERSPEED,
    STALL,
    EnvelopeMonitor,
    ProximityMonitor,
)
from testbed.plan.fleet import Fleet, FormationPlan
from testbed.scenario.sections import Limits


def build_proximity(fleet: FormationPlan, limits: Limits) -> ProximityMonitor:
    """Build the monitor with the limits of a scenario."""
    return ProximityMonitor(
        fleet.names,
        collision_m=limits.collision_m,
        separation_m=limits.separation_m,
        minimum_m=minimum_separations(fleet, limits),
        source=_source(limits),
        stops=limits.on_limit_exceeded == "stop",
    )


def minimum_separations(fleet: FormationPlan, limits: Limits) -> Array:
    """Return the minimum separation by aircraft (N,), m; NaN for a virtual leader, a point."""
    limit_m = limits.min_separation_m
    spans = [each.airframe.span for each in fleet.aircraft]
    minimum = np.array([span if limit_m is None else limit_m for span in spans])
    if fleet.leader.section.path.kind == "virtual":
        minimum[0] = np.nan
    return minimum


def separation_warnings(fleet: FormationPlan, limits: Limits) -> Iterator[Event]:
    """Warn of starts and of slots that are closer together than the minimum separation."""
    minimum, names = minimum_separations(fleet, limits), fleet.names
    starts = [(0.0, 0.0, 0.0), *(each.section.start_m for each in fleet.followers)]
    keys = ["leader.start", *(f"fleet.{i}.start_m" for i in range(len(fleet.followers)))]
    yield from _closer(limits, "start", np.array(starts), minimum, names, keys)
    # a slot at an altitude of its own is compared with others of that kind only
    offsets, altitudes = fleet.offsets, fleet.altitudes
    keys = ["leader", *(f"formation.offsets_m.{name}" for name in names[1:])]
    holds = np.array([False, *~np.isnan(altitudes)])
    offsets[1:, 2] = np.where(holds[1:], -altitudes, offsets[1:, 2])
    for some in (~holds, holds):
        compared = np.where(some, minimum, np.nan)
        yield from _closer(limits, "have slots", offsets, compared, names, keys)


def _closer(
    limits: Limits,
    what: str,
    places: Array,
    minimum: Array,
    names: Sequence[str],
    keys: Sequence[str],
) -> Iterator[Event]:
    """Warn of pairs of places (N, 3) that are closer than the minimum; of many, of the closest."""
    first, second = np.triu_indices(len(places), 1)
    distance = np.linalg.norm(places[second] - places[first], axis=1)
    limit = np.maximum(minimum[first], minimum[second])
    found = np.flatnonzero(distance < limit)
    if len(found) > MAX_EVENTS:
        others = len(found) - 1
        found = found[[distance[found].argmin()]]
    else:
        others = 0
    for pair in found.tolist():
        one, two = first[pair], second[pair]
        allowed = math.floor(100.0 * distance[pair]) / 100.0
        text = (
            f"{names[one]} and {names[two]} {what} {distance[pair]:.2f} m apart, closer than "
            f"{limit[pair]:.3g} m, {_source(limits)} (write {keys[one]} and {keys[two]} farther "
            f"apart, or limits.min_separation_m: {allowed:g} if that is intended)"
        )
        more = f"; {others} other pairs are closer than that, too" if others else ""
        yield Event(0.0, "warning", "run", text + more)


def _source(limits: Limits) -> str:
    """Name what the minimum separation is."""
    return "a wingspan" if limits.min_separation_m is None else "limits.min_separation_m"


def build_envelope_monitor(
    fleet: Fleet, keys: Limits, faults: FaultManager | None
) -> EnvelopeMonitor:
    """Build the monitor with the limits of a scenario.

    Args:
        fleet: the N aircraft; overspeed and stall are those of flight models.
        keys: the limits of the scenario.
        faults: of the scenario; None: none.
    """
    limits = np.full((3, len(fleet.aircraft)), inf)
    for row in fleet.model_rows:
        each, stall = fleet.aircraft[row], keys.stall_deg
        limits[OVERSPEED, row] = keys.overspeed_mps or OWN_OVERSPEED * each.params.airspeed_max
        limits[STALL, row] = math.radians(stall) if stall else each.airframe.stall_angle
    if keys.formation_lost_m is not None:
        limits[FORMATION, 1:] = keys.formation_lost_m
    stops = keys.on_limit_exceeded == "stop"
    return EnvelopeMonitor(fleet.names, limits, faults, stops=stops)
