"""The page's formation and controller sections as laws and middle loops."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from testbed.errors import InputError
from testbed.formation import barrier, control_function, leader
from testbed.formation.geometry import GRAVITY
from testbed.formation.law import Law, Team
from testbed.formation.laws import SpeedSet
from testbed.formation.paper_law import PaperLaw
from testbed.scenario import MiddleLoopGains as Profile
from testbed.scenario import Scenario, gains_of
from testbed.scenario.gains import Estimators
from testbed.sim.clock import Clock
from testbed.sim.control import Group
from testbed.sim.law_contract import check_law
from testbed.sim.middle_loops import make_middle_loop
from testbed.sim.own_law import build_law
from testbed.sim.teams import agent_value, make_team, part_of
from testbed.state import Array, FbwaCommand

_SOURCES = {"none": leader.NOTHING, "broadcast": leader.BROADCAST, "turn": leader.TURN}


def make_groups(
    page: Scenario, folders: Sequence[Path], clock: Clock
) -> tuple[tuple[Group, ...], tuple[str, ...]]:
    """The followers of these aircraft folders, by the moments at which they step.

    Returns:
        The groups, and what is to be said of a law that is not the paper's.
    """
    profiles = [gains_of(page, folder) for folder in folders]
    whole = make_team(page, profiles, dt=clock.control / clock.base_rate_hz)
    groups, notes = [], []
    for rows in clock.groups:
        team = part_of(whole, rows)
        ours = [profiles[i] for i in rows]
        law: Law = make_paper_law(page, team, ours)
        if page.controller.law != "paper":
            told = replace(team, paper=law)
            law, origin = build_law(page.controller.law, page.controller.options, told)
            _check_own(page, team, law)
            notes.append(f"the law {type(law).__name__} runs {origin}")
        groups.append(
            Group(
                rows=np.array(rows, dtype=np.intp),
                team=team,
                law=law,
                middle=make_middle_loop(page, team, ours),
                ideal=np.array([page.fleet[row].vehicle == "ideal" for row in rows]),
                trusted=isinstance(law, PaperLaw),
            )
        )
    return tuple(groups), tuple(dict.fromkeys(notes))


def _check_own(page: Scenario, team: Team, law: Law) -> None:
    kind = check_law(law, team)
    ideal = [each.name for each in page.fleet if each.vehicle == "ideal"]
    stuck = [name for name in team.names if name in ideal]
    if kind is FbwaCommand and stuck:
        raise InputError(
            f"controller.law: {type(law).__name__} commands fly-by-wire A, which an ideal vehicle "
            f"cannot fly (write vehicle: jsbsim for {', '.join(stuck)}, or return a "
            "UnicycleCommand)"
        )


def make_paper_law(page: Scenario, team: Team, profiles: Sequence[Profile]) -> PaperLaw:
    """The paper's law for a team whose airframes have these profiles."""
    controller, names = page.controller, team.names

    def each(key: str) -> Array:
        return np.array([agent_value(page, name, key) for name in names], dtype=np.float64)

    functions = [
        make_control_function(agent_value(page, name, "control_function")) for name in names
    ]
    k, pole = each("k"), team.speed_pole
    turns = [agent_value(page, name, "c") for name in names]
    chosen = [controller.estimators.over(profile.estimators) for profile in profiles]
    silence = controller.silence
    round_ = math.tan(math.radians(silence.bank_deg)) if silence.then == "loiter" else 0.0
    return PaperLaw(
        agents=team.agents,
        offsets=team.offsets,
        gains=team.gains,
        k=k,
        a=each("a"),
        b=each("b"),
        c=np.array([each.constant for each in turns]),
        c_speed=np.array([each.per_speed_squared for each in turns]),
        pole=pole,
        control_function=control_function.per_agent(functions),
        barrier=barrier.per_agent(
            [make_barrier(agent_value(page, name, "barrier")) for name in names]
        ),
        speeds=_speed_set(page, team, k, functions),
        horizontal=np.array([name in page.formation.altitudes_m for name in names]),
        bounds_of_airspeed=controller.bounds_of == "airspeed",
        from_timestamp=controller.extrapolate_from == "timestamp",
        with_acceleration=_which(chosen, "extrapolation", "acceleration"),
        acceleration_source=np.array([_SOURCES[one.leader_acceleration] for one in chosen]),
        acceleration_blend=np.array([one.leader_acceleration_blend for one in chosen]),
        difference_blend=np.array([one.leader_difference_blend for one in chosen]),
        turn_acceleration=_which(chosen, "turn_acceleration", "roll_rate"),
        silent_after=team.silent_after,
        stale_after=team.stale_after,
        hold=controller.staleness.then == "hold",
        silent_airspeed=team.trim_airspeed,
        silent_turn=GRAVITY * round_ / team.trim_airspeed,
    )


def barriers_of(groups: Sequence[Group]) -> tuple[tuple[int, float], ...]:
    """Example and ν of every follower's barrier; none if the law is not the paper's."""
    found: dict[int, tuple[int, float]] = {}
    for group in groups:
        if not isinstance(group.law, PaperLaw):
            return ()
        example, nu = (np.broadcast_to(each, group.rows.shape) for each in group.law.barrier)
        found |= dict(zip(group.rows, zip(example.tolist(), nu.tolist(), strict=True), strict=True))
    return tuple(found[row] for row in sorted(found))


def roll_limits(groups: Sequence[Group]) -> tuple[float, ...]:
    """The largest bank that each follower's control may command, rad."""
    limits = {
        int(row): float(limit)
        for group in groups
        for row, limit in zip(group.rows, group.team.roll_limit, strict=True)
    }
    return tuple(limits[row] for row in sorted(limits))


def make_control_function(chosen: Any) -> control_function.ControlFunction:  # noqa: ANN401 - a union
    """μ as the page has it."""
    if chosen.example == 1:
        return control_function.example_1(chosen.nu1, chosen.nu2, chosen.m)
    return control_function.EXAMPLE_2 if chosen.example == 2 else control_function.EXAMPLE_3


def make_barrier(chosen: Any) -> barrier.Barrier:  # noqa: ANN401 - a union
    """The function h as the page has it."""
    return barrier.Barrier(chosen.example, 0.0 if chosen.example == 7 else chosen.nu)


def _speed_set(
    page: Scenario,
    team: Team,
    k: Array,
    functions: Sequence[control_function.ControlFunction],
) -> SpeedSet:
    """S, and S_d as the page has it or by fact 1."""
    low, high = team.speed_low, team.speed_high
    kappa = np.array([agent_value(page, name, "kappa_mps") for name in team.names])
    margin = kappa - k * np.array([each.bound for each in functions])
    desired_low, desired_high = low + margin, high - margin
    for i, name in enumerate(team.names):
        asked = agent_value(page, name, "speed_desired_mps")
        if asked is not None:
            desired_low[i], desired_high[i] = asked
    return SpeedSet(low, high, desired_low, desired_high)


def _which(chosen: Sequence[Estimators], key: str, value: str) -> Any:  # noqa: ANN401 - bool (n,)
    return np.array([getattr(one, key) == value for one in chosen])
