"""Who the followers are: offsets, graph and limits, from the page to the team of a law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np

from testbed.formation.law import Team
from testbed.scenario import MiddleLoopGains as Profile
from testbed.scenario import Problem, Scenario, ScenarioError
from testbed.state import Array


def make_team(page: Scenario, profiles: Sequence[Profile], *, dt: float) -> Team:
    """All n followers, stepped every `dt` s."""
    controller = page.controller
    silent_after, stale_after = controller.silence.after_s, controller.staleness.after_s
    low, high = np.array([agent_value(page, name, "speed_mps") for name in follower_names(page)]).T
    return Team(
        names=follower_names(page),
        agents=np.arange(1, len(page.fleet) + 1, dtype=np.intp),
        offsets=make_offsets(page),
        gains=make_gains(page),
        speed_low=low.copy(),
        speed_high=high.copy(),
        speed_pole=_each(page, "speed_pole_per_s"),
        pitch_limit=column(profiles, "limits.pitch_deg", scale=math.radians(1.0)),
        roll_limit=column(profiles, "limits.roll_deg", scale=math.radians(1.0)),
        trim_throttle=column(profiles, "trim_throttle"),
        trim_airspeed=column(profiles, "trim_airspeed_mps"),
        dt=dt,
        silent_after=silent_after,
        stale_after=silent_after if stale_after is None else stale_after,
    )


def part_of(team: Team, rows: Sequence[int]) -> Team:
    """The team of these followers alone, in which nobody else is forgotten as a neighbour."""
    chosen = np.array(rows, dtype=np.intp)
    return Team(
        names=tuple(team.names[i] for i in rows),
        agents=team.agents[chosen],
        offsets=team.offsets,
        gains=team.gains[chosen],
        **{
            name: getattr(team, name)[chosen]
            for name in (
                "speed_low",
                "speed_high",
                "speed_pole",
                "pitch_limit",
                "roll_limit",
                "trim_throttle",
                "trim_airspeed",
            )
        },
        dt=team.dt,
        silent_after=team.silent_after,
        stale_after=team.stale_after,
    )


def agent_value(page: Scenario, name: str, key: str) -> Any:  # noqa: ANN401 - the key's own
    """A value of the formation for one follower: its own, or that of all."""
    own = page.formation.agents.get(name)
    value = getattr(own, key) if own else None
    return getattr(page.formation, key) if value is None else value


def make_offsets(page: Scenario) -> Array:
    """υ (n + 1, 3) m, the leader's zero first."""
    offsets = [page.formation.offsets_m[each.name] for each in page.fleet]
    return np.array([(0.0, 0.0, 0.0), *offsets])


def make_altitudes(page: Scenario) -> Array:
    """Altitudes (n,) m that the horizontal variant holds; nan where the law flies all three."""
    held = page.formation.altitudes_m
    return np.array([held.get(each.name, math.nan) for each in page.fleet])


def make_gains(page: Scenario) -> Array:
    """β (n, n + 1, 3): for the leader, then for each follower.

    Raises:
        ScenarioError: A + B is singular: some agents hang on nothing.
    """
    names = [each.name for each in page.fleet]
    n = len(names)
    gains = np.zeros((n, n + 1, 3))
    for i, name in enumerate(names):
        gains[i, 0] = page.formation.leader_gains.get(name, 0.0)
        for j, other in enumerate(names):
            gains[i, j + 1] = page.formation.neighbour_gains.get(name, {}).get(other, 0.0)
    # who holds an altitude of its own is no measure of where another should be above or below it
    held = ~np.isnan(make_altitudes(page))
    gains[:, 1:, 2] = np.where(held, 0.0, gains[:, 1:, 2])
    cut = [names[i] for i in cut_off(gains, ~np.isnan(make_altitudes(page)))]
    if cut:
        raise ScenarioError(
            [
                Problem(
                    None,
                    f"formation: {', '.join(cut)} cannot tell where to be: A + B is singular "
                    "(write a leader gain for one of them, or a neighbour gain for an agent that "
                    "has one)",
                )
            ]
        )
    return gains


def cut_off(gains: Array, horizontal: Array | None = None) -> list[int]:
    """Agents whose error (6) does not fix a position, per axis of NED; empty if A + B is regular.

    A + B (n, n) has the leader gains on its diagonal plus the Laplacian of the others. Its kernel
    says which agents could move together without any of them noticing. Agents that are
    `horizontal` (n,) hold their altitude by themselves.
    """
    n = len(gains)
    alone = np.zeros(n, dtype=bool) if horizontal is None else horizontal
    found: set[int] = set()
    for axis in range(3):
        neighbours = gains[:, 1:, axis]
        matrix = np.diag(gains[:, 0, axis] + neighbours.sum(axis=1)) - neighbours
        if axis == 2:
            matrix = np.where(alone[:, np.newaxis], np.eye(n), matrix)
        _, values, vectors = np.linalg.svd(matrix)
        kernel = vectors[values <= n * np.finfo(float).eps * max(values[0], 1e-300)]
        found.update(np.flatnonzero(np.abs(kernel).max(axis=0, initial=0.0) > 1e-6).tolist())
    return sorted(found)


def follower_names(page: Scenario) -> tuple[str, ...]:
    """The followers in fleet order."""
    return tuple(each.name for each in page.fleet)


def _each(page: Scenario, key: str) -> Array:
    return np.array(
        [agent_value(page, name, key) for name in follower_names(page)], dtype=np.float64
    )


def column(profiles: Sequence[Profile], path: str, scale: float = 1.0) -> Array:
    """One number of every profile (n,), by its dotted key."""
    return scale * np.array([attrgetter(path)(profile) for profile in profiles], dtype=np.float64)
