"""From an airframe's profile to the middle loop's gains."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from testbed.formation.law import Team
from testbed.formation.middle_loop import MiddleLoop, MiddleLoopGains
from testbed.scenario import MiddleLoopGains as Profile
from testbed.scenario import Scenario
from testbed.sim.teams import column

# What `controller.gain_scale` multiplies.
_PID = {
    f"{ours}_{part}": f"{theirs}.{part}"
    for ours, theirs, parts in (
        ("climb", "flight_path", "pid"),
        ("course", "course", "pid"),
        ("speed", "speed", "pi"),
        ("altitude", "altitude", "pid"),
    )
    for part in parts
}
_PLAIN = {
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


def middle_gains(
    profiles: Sequence[Profile], *, scale: float = 1.0, incidence: float = 0.0
) -> MiddleLoopGains:
    """The gains of n agents, whose airframes have these profiles.

    Args:
        profiles: n of them.
        scale: multiplies every PID gain.
        incidence: share of θ − γ that is fed forward, 0 or 1.
    """
    columns = {name: column(profiles, path, scale) for name, path in _PID.items()}
    columns |= {name: column(profiles, path) for name, path in _PLAIN.items()}
    columns |= {name: column(profiles, path, math.radians(1.0)) for name, path in _DEGREES.items()}
    columns["incidence"] = np.full(len(profiles), incidence)
    return MiddleLoopGains(**columns)


def make_middle_loop(page: Scenario, team: Team, profiles: Sequence[Profile]) -> MiddleLoop:
    """The middle loops of a team whose airframes have these profiles."""
    controller = page.controller
    return MiddleLoop(
        gains=middle_gains(
            profiles,
            scale=controller.gain_scale,
            incidence=float(controller.pitch_feedforward == "incidence"),
        ),
        speed_low=team.speed_low,
        speed_high=team.speed_high,
        altitude=np.array([page.formation.altitudes_m.get(n, math.nan) for n in team.names]),
        airspeed_error_as_printed=controller.throttle_error == "airspeed",
        dt=team.dt,
    )
