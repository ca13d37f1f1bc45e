"""The page's formation and controller sections as the paper's law."""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path

import numpy as np

from testbed.formation import control_function
from testbed.formation.barrier import Barrier
from testbed.formation.law import PaperLaw
from testbed.formation.laws import SpeedSet
from testbed.formation.middle_loop import MiddleLoopGains
from testbed.scenario import Problem, Scenario, ScenarioError, load_middle_loop
from testbed.scenario.control import Formation
from testbed.state import Array


def make_offsets(page: Scenario) -> Array:
    """υ (n + 1, 3) m, the leader's zero first."""
    offsets = [page.formation.offsets_m[each.name] for each in page.fleet]
    return np.array([(0.0, 0.0, 0.0), *offsets])


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
    cut = [names[i] for i in cut_off(gains)]
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


def cut_off(gains: Array) -> list[int]:
    """Agents whose error (6) does not fix a position, per axis of NED; empty if A + B is regular.

    A + B (n, n) has the leader gains on its diagonal plus the Laplacian of the others. Its kernel
    says which agents could move together without any of them noticing.
    """
    n = len(gains)
    found: set[int] = set()
    for axis in range(3):
        neighbours = gains[:, 1:, axis]
        matrix = np.diag(gains[:, 0, axis] + neighbours.sum(axis=1)) - neighbours
        _, values, vectors = np.linalg.svd(matrix)
        kernel = vectors[values <= n * np.finfo(float).eps * max(values[0], 1e-300)]
        found.update(np.flatnonzero(np.abs(kernel).max(axis=0, initial=0.0) > 1e-6).tolist())
    return sorted(found)


def make_law(page: Scenario, folders: Sequence[Path], *, dt: float) -> PaperLaw:
    """The paper's law for the followers in these aircraft folders, stepped every `dt` s."""
    formation, controller = page.formation, page.controller
    n = len(page.fleet)
    mu = _control_function(formation)
    low, high = formation.speed_mps
    same = np.ones(n)
    profiles = [load_middle_loop(folder, controller.profile) for folder in folders]

    def row(path: str, scale: float = 1.0) -> Array:
        return scale * np.array([attrgetter(path)(profile) for profile in profiles], dtype=float)

    pid = controller.gain_scale
    first = profiles[0]
    rate_filter = row("rate_filter_s")
    return PaperLaw(
        offsets=make_offsets(page),
        gains=make_gains(page),
        k=formation.k * same,
        a=formation.a * same,
        b=formation.b * same,
        c=formation.c * same,
        pole=formation.speed_pole_per_s * same,
        control_function=mu,
        barrier=_barrier(formation),
        speeds=SpeedSet(
            low * same, high * same, (formation.kappa_mps - formation.k * mu.bound) * same
        ),
        middle=MiddleLoopGains(
            climb_p=row("flight_path.p", scale=pid),
            climb_i=row("flight_path.i", scale=pid),
            climb_d=row("flight_path.d", scale=pid),
            course_p=row("course.p", scale=pid),
            course_i=row("course.i", scale=pid),
            course_d=row("course.d", scale=pid),
            speed_p=row("speed.p", scale=pid),
            speed_i=row("speed.i", scale=pid),
            eta_speed=row("eta_speed"),
            eta_bank=row("eta_bank"),
            trim_throttle=row("trim_throttle"),
            trim_airspeed=row("trim_airspeed_mps"),
            pitch_limit=row("limits.pitch_deg", scale=math.radians(1.0)),
            roll_limit=row("limits.roll_deg", scale=math.radians(1.0)),
        ),
        dt=dt,
        from_timestamp=controller.extrapolate_from == "timestamp",
        airspeed_error_as_printed=controller.throttle_error == "airspeed",
        acceleration_blend=np.array(first.leader_acceleration_blend),
        rate_blend=dt / (dt + rate_filter),
    )


def _control_function(formation: Formation) -> control_function.ControlFunction:
    chosen = formation.control_function
    if chosen.example == 1:
        return control_function.example_1(chosen.nu1, chosen.nu2, chosen.m)
    return control_function.EXAMPLE_2 if chosen.example == 2 else control_function.EXAMPLE_3


def _barrier(formation: Formation) -> Barrier:
    chosen = formation.barrier
    return Barrier(chosen.example, 0.0 if chosen.example == 7 else chosen.nu)
