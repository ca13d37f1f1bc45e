"""Build offsets, graph and limits of the followers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from testbed.core.records import Array
from testbed.formation.law import FormationConfig
from testbed.scenario import MiddleLoopGains as Profile
from testbed.scenario import Problem, Scenario, ScenarioError

_OF_FOLLOWERS = (
    "speed_min",
    "speed_max",
    "speed_pole",
    "pitch_limit",
    "roll_limit",
    "trim_throttle",
    "trim_airspeed",
)


def build_config(scenario: Scenario, profiles: Sequence[Profile], *, dt: float) -> FormationConfig:
    """Build the configuration of all n followers, which step every `dt` s."""
    controller, names = scenario.controller, follower_names(scenario)
    leader_s, neighbour_s = controller.leader_timeout_s, controller.neighbour_timeout_s
    low, high = np.array([agent_value(scenario, name, "speed_mps") for name in names]).T
    poles = [agent_value(scenario, name, "speed_pole_per_s") for name in names]
    return FormationConfig(
        names=names,
        agents=np.arange(1, len(names) + 1, dtype=np.intp),
        offsets=build_offsets(scenario),
        gains=build_gains(scenario),
        speed_min=low.copy(),
        speed_max=high.copy(),
        speed_pole=np.array(poles, dtype=np.float64),
        pitch_limit=profile_values(profiles, "limits.pitch_deg", scale=math.radians(1.0)),
        roll_limit=profile_values(profiles, "limits.roll_deg", scale=math.radians(1.0)),
        trim_throttle=profile_values(profiles, "trim_throttle"),
        trim_airspeed=profile_values(profiles, "trim_airspeed_mps"),
        dt=dt,
        leader_timeout_s=leader_s,
        neighbour_timeout_s=leader_s if neighbour_s is None else neighbour_s,
    )


def select_followers(config: FormationConfig, rows: Sequence[int]) -> FormationConfig:
    """Select some followers; all N aircraft stay possible neighbours."""
    chosen = np.array(rows, dtype=np.intp)
    return FormationConfig(
        names=tuple(config.names[i] for i in rows),
        agents=config.agents[chosen],
        offsets=config.offsets,
        gains=config.gains[chosen],
        **{name: getattr(config, name)[chosen] for name in _OF_FOLLOWERS},
        dt=config.dt,
        leader_timeout_s=config.leader_timeout_s,
        neighbour_timeout_s=config.neighbour_timeout_s,
    )


def agent_value(scenario: Scenario, name: str, key: str) -> Any:  # noqa: ANN401 - the key's own
    """Return a value of the formation for one follower: its own, or that of all."""
    own = scenario.formation.agents.get(name)
    value = getattr(own, key) if own else None
    return getattr(scenario.formation, key) if value is None else value


def build_offsets(scenario: Scenario) -> Array:
    """Return υ (N, 3) m, the leader's zero first."""
    offsets = [scenario.formation.offsets_m[name] for name in follower_names(scenario)]
    return np.array([(0.0, 0.0, 0.0), *offsets])


def build_altitudes(scenario: Scenario) -> Array:
    """Return held altitudes (n,) m; NaN where the law controls all axes."""
    altitudes = scenario.formation.altitudes_m
    return np.array([altitudes.get(name, math.nan) for name in follower_names(scenario)])


def build_gains(scenario: Scenario) -> Array:
    """Return β (n, N, 3): of the leader, then of each follower.

    Raises:
        ScenarioError: A + B is singular: a follower has no position reference.
    """
    names, formation = follower_names(scenario), scenario.formation
    n = len(names)
    gains = np.zeros((n, n + 1, 3))
    for i, name in enumerate(names):
        gains[i, 0] = formation.leader_gains.get(name, 0.0)
        for j, other in enumerate(names):
            gains[i, j + 1] = formation.neighbour_gains.get(name, {}).get(other, 0.0)
    # a follower that holds its own altitude is no vertical reference for others
    holds_altitude = ~np.isnan(build_altitudes(scenario))
    gains[:, 1:, 2] = np.where(holds_altitude, 0.0, gains[:, 1:, 2])
    unreachable = [names[i] for i in unreachable_agents(gains, holds_altitude)]
    if unreachable:
        raise ScenarioError(
            [
                Problem(
                    None,
                    f"formation: no position reference for {', '.join(unreachable)}: A + B is "
                    "singular (write a leader gain for one of them, or a neighbour gain for an "
                    "agent that has one)",
                )
            ]
        )
    return gains


def unreachable_agents(gains: Array, holds_altitude: Array | None = None) -> list[int]:
    """Return agents without a position reference; none if A + B is regular.

    A + B (n, n) of an axis has the leader gains on its diagonal, plus the Laplacian of the
    neighbour gains. The agents with components in its kernel could move together without a change
    of the error (6).

    Args:
        gains: β (n, N, 3), per axis of NED.
        holds_altitude: (n,) agents that need no vertical reference; None: none.
    """
    n = len(gains)
    fixed = np.zeros(n, dtype=bool) if holds_altitude is None else holds_altitude
    found: set[int] = set()
    for axis in range(3):
        neighbours = gains[:, 1:, axis]
        matrix = np.diag(gains[:, 0, axis] + neighbours.sum(axis=1)) - neighbours
        if axis == 2:
            matrix = np.where(fixed[:, np.newaxis], np.eye(n), matrix)
        _, values, vectors = np.linalg.svd(matrix)
        kernel = vectors[values <= n * np.finfo(float).eps * max(values[0], 1e-300)]
        found.update(np.flatnonzero(np.abs(kernel).max(axis=0, initial=0.0) > 1e-6).tolist())
    return sorted(found)


def follower_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the followers, in fleet order."""
    return tuple(each.name for each in scenario.fleet)


def profile_values(profiles: Sequence[Profile], path: str, scale: float = 1.0) -> Array:
    """Return one number of every profile (n,), by its dotted key."""
    return scale * np.array([attrgetter(path)(profile) for profile in profiles], dtype=np.float64)
