"""Build the middle loops of the followers from the profiles of their airframes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from testbed.core.records import Array, Records, allocate
from testbed.formation.law import FormationConfig
from testbed.formation.middle_loop import LOOP
from testbed.scenario import MiddleLoopGains as Profile
from testbed.scenario import Scenario
from testbed.sim.build_formation import profile_values

_SCALED = {
    f"{field}_{term}": f"{key}.{term}"
    for field, key, terms in (
        ("gamma", "flight_path", "pid"),
        ("course", "course", "pid"),
        ("speed", "speed", "pi"),
        ("altitude", "altitude", "pid"),
    )
    for term in terms
}
_UNSCALED = {
    "eta_speed": "eta_speed",
    "eta_bank": "eta_bank",
    "trim_throttle": "trim_throttle",
    "trim_airspeed": "trim_airspeed_mps",
    "roll_lead": "feed_forwards.roll_lead_s",
    "lead_filter": "feed_forwards.lead_filter_s",
    "eta_climb": "feed_forwards.eta_climb",
    "rate_filter": "rate_filter_s",
}
_DEGREES = {
    "pitch_limit": "limits.pitch_deg",
    "roll_limit": "limits.roll_deg",
    "turn_incidence": "feed_forwards.turn_incidence_deg",
}


def make_loops(
    profiles: Sequence[Profile],
    *,
    dt: float,
    speed_min: Array,
    speed_max: Array,
    altitude: Array | float = math.nan,
    scale: float = 1.0,
    incidence: float = 0.0,
    airspeed_error_as_printed: bool = False,
) -> Records:
    """Return middle loops (n,) of LOOP with the gains of profiles.

    Args:
        profiles: n of them.
        dt: control period, s.
        speed_min: (n,) m/s, of the commanded airspeed.
        speed_max: (n,) m/s.
        altitude: (n,) m to hold; nan: none.
        scale: multiplies every PID gain, as `controller.gain_scale`.
        incidence: fraction of θ − γ that is fed forward, 0 or 1.
        airspeed_error_as_printed: see LOOP.
    """
    loops = allocate(LOOP, len(profiles))
    for name, path in _SCALED.items():
        loops[name] = profile_values(profiles, path, scale)
    for name, path in _UNSCALED.items():
        loops[name] = profile_values(profiles, path)
    for name, path in _DEGREES.items():
        loops[name] = profile_values(profiles, path, math.radians(1.0))
    loops["incidence"], loops["dt"] = incidence, dt
    loops["speed_min"], loops["speed_max"], loops["altitude"] = speed_min, speed_max, altitude
    loops["airspeed_error_as_printed"] = airspeed_error_as_printed
    return loops


def build_loops(
    scenario: Scenario, config: FormationConfig, profiles: Sequence[Profile]
) -> Records:
    """Return the middle loops (n,) of LOOP of a scenario's followers."""
    controller = scenario.controller
    return make_loops(
        profiles,
        dt=config.dt,
        speed_min=config.speed_min,
        speed_max=config.speed_max,
        altitude=np.array([scenario.formation.altitudes_m.get(n, math.nan) for n in config.names]),
        scale=controller.gain_scale,
        incidence=float(controller.pitch_feedforward == "incidence"),
        airspeed_error_as_printed=controller.throttle_error == "airspeed",
    )
