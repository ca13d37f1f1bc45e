"""The aircraft of a scenario, with the files that they name, and the formation that they fly.

`plan_formation` reads each file and solves for the gains once, `measured_fleet.resolve` with the
airframes as JSBSim measures them. Builders take the result, and the section of the scenario that
they build.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from testbed.autopilot.parameters import FbwaParams, read_params
from testbed.core.reads import Deferred, current, deferred, unrecorded
from testbed.core.records import Airframe, Array, BoolArray, NedOrigin
from testbed.scenario import (
    MiddleLoopGains,
    Problem,
    Scenario,
    ScenarioError,
    SingleAircraft,
    find_aircraft,
    find_tune,
    load_guidance,
    middle_loop_gains,
)
from testbed.scenario.aircraft import AircraftSection, ArduPlane, Follower, Leader, Mission
from testbed.scenario.control import (
    Agent,
    BarrierFunction,
    ControlFunction,
    Formation,
    PointingGain,
    SpeedModel,
    SpeedRange,
)
from testbed.scenario.middle_loop import Guidance
from testbed.scenario.set_keys import register_section


class AgentParameters:
    """Parameters of the law for one follower: its own, or those of all; see `Formation`."""

    k: float
    a: float
    b: float
    c: PointingGain
    kappa_mps: float
    speed_mps: SpeedRange
    speed_desired_mps: SpeedRange | None
    speed_pole_per_s: float
    speed_model: SpeedModel | None
    control_function: ControlFunction
    barrier: BarrierFunction
    own_keys: frozenset[str]  # keys of the follower that differ from those of all

    def __init__(self, formation: Formation, agent: Agent) -> None:
        """Take them from the formation, or from the follower's own."""
        with unrecorded():
            own = {key for key in Agent.model_fields if getattr(agent, key) is not None}
        self.own_keys = frozenset(own)
        self._formation, self._agent = formation, agent

    def __getattr__(self, key: str) -> Any:  # noqa: ANN401 - of the field
        """Read a parameter where it is used: what is never read has no effect."""
        if key not in Agent.model_fields:
            raise AttributeError(key)
        return getattr(self._agent if key in self.own_keys else self._formation, key)


@dataclass(frozen=True, slots=True)
class PlannedAircraft:
    """One aircraft: its section of the scenario, and what the files that it names contain."""

    row: int  # among the N aircraft; the leader's is 0
    section: AircraftSection
    folder: Path  # of the airframe
    airframe: Airframe
    tune_file: Path
    params: FbwaParams  # of the autopilot
    guidance: Guidance
    has_model: bool  # a JSBSim flight model, behind an autopilot
    is_ideal: bool  # an extended unicycle
    is_scripted: bool  # a leader that repeats a recording or a formula

    @property
    def name(self) -> str:
        """Name in logs and views."""
        return self.section.name

    @property
    def arduplane(self) -> ArduPlane | None:
        """The section of the ArduPlane that flies it; None: another autopilot, or none."""
        if not self.has_model:
            return None
        autopilot = self.section.autopilot
        return autopilot if isinstance(autopilot, ArduPlane) else None

    @property
    def takes_commands(self) -> bool:
        """Whether an external program can command it by way of the testbed."""
        return self.has_model and self.arduplane is None


@dataclass(frozen=True, slots=True)
class PlannedFollower(PlannedAircraft):
    """A follower, with its gains and its parameters of the law."""

    section: Follower
    gains: MiddleLoopGains
    agent: AgentParameters
    offset: tuple[float, float, float]  # υ, m: forward, right, down
    altitude: float  # m, that it holds; NaN: the law controls all axes


@dataclass(frozen=True, slots=True)
class PlannedLeader(PlannedAircraft):
    """The aircraft that the formation follows."""

    section: Leader


@dataclass(frozen=True, slots=True)
class Fleet:
    """The N aircraft of a flight."""

    aircraft: tuple[PlannedAircraft, ...]
    origin: NedOrigin

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the N aircraft."""
        return tuple(each.name for each in self.aircraft)

    @property
    def model_rows(self) -> tuple[int, ...]:
        """Rows of the M aircraft with flight models."""
        return tuple(each.row for each in self.aircraft if each.has_model)


@dataclass(frozen=True, slots=True)
class FormationPlan(Fleet):
    """A leader, first of the N aircraft, and the graph of its n followers."""

    leader: PlannedLeader
    followers: tuple[PlannedFollower, ...]
    all_weights: Array  # β (n, N, 3): of the leader, then of each follower
    read_weights: Deferred  # the keys that they are made of

    @property
    def weights(self) -> Array:
        """β (n, N, 3): of the leader, then of each follower."""
        self.read_weights.use()
        return self.all_weights

    @property
    def offsets(self) -> Array:
        """υ (N, 3) m, the leader's zero first."""
        return np.array([(0.0, 0.0, 0.0), *(each.offset for each in self.followers)])

    @property
    def altitudes(self) -> Array:
        """Altitudes (n,) m that followers hold; NaN where the law controls all axes."""
        return np.array([each.altitude for each in self.followers])

    def of_followers(self, value: Callable[[PlannedFollower], float]) -> Array:
        """Return a number of each follower (n,)."""
        return np.array([value(each) for each in self.followers], dtype=np.float64)


Measure: TypeAlias = Callable[[Path], Airframe]  # of the folder of an aircraft


def plan_single(flight: SingleAircraft, measure: Measure) -> Fleet:
    """Read the files of one aircraft that flies without a formation.

    Raises:
        ScenarioError, ParamError, AircraftError: see `plan_formation`.
    """
    folder = find_aircraft(flight.only.aircraft)
    files = _read_files(0, flight.only, folder, read_params, load_guidance, measure)
    return Fleet((PlannedAircraft(**files),), _origin(flight))


def plan_formation(scenario: Scenario, measure: Measure) -> FormationPlan:
    """Read the files of all aircraft of a scenario, and solve for the formation's gains.

    Args:
        scenario: that is flown.
        measure: returns the properties of an airframe, which laws do not need.

    Raises:
        ScenarioError, ParamError, AircraftError: a folder has no valid aircraft, parameters or
            gains; or a follower has no position reference.
    """
    folders = [find_aircraft(each.aircraft) for each in scenario.aircraft]
    readers = cache(read_params), cache(load_guidance), measure
    gains = cache(lambda folder: _read_gains(scenario, folder))
    scripted = not isinstance(scenario.leader.path, Mission)
    files = [
        _read_files(row, section, folder, *readers, is_scripted=scripted and row == 0)
        for row, (section, folder) in enumerate(zip(scenario.aircraft, folders, strict=True))
    ]
    formation, followers = scenario.formation, scenario.fleet
    leader = PlannedLeader(**files[0])
    planned = tuple(
        PlannedFollower(
            **own,
            gains=gains(own["folder"]),
            agent=agent_parameters(formation, each.name),
            offset=formation.offsets_m[each.name],
            altitude=formation.altitudes_m.get(each.name, math.nan),
        )
        for each, own in zip(followers, files[1:], strict=True)
    )
    with deferred() as read_weights:
        weights = solve_weights(formation, [each.name for each in followers])
    return FormationPlan(
        (leader, *planned), _origin(scenario), leader, planned, weights, read_weights
    )


def _origin(scenario: Scenario | SingleAircraft) -> NedOrigin:
    origin = scenario.scenario.origin
    return NedOrigin(origin.latitude_deg, origin.longitude_deg, origin.elevation_m)


def _read_gains(scenario: Scenario, folder: Path) -> MiddleLoopGains:
    """Read the gains of an airframe; a gain that is read is the use of its key."""
    with unrecorded():
        gains = middle_loop_gains(scenario, folder)
    if (reads := current()) is not None:
        also = [("controller", "profile"), ("controller", "middle_loop")]
        register_section(reads, gains, [("controller", "gains")], also)
    return gains


def _read_files(
    row: int,
    section: AircraftSection,
    folder: Path,
    params: Callable[[Path], FbwaParams],
    guidance: Callable[[Path], Guidance],
    measure: Measure,
    *,
    is_scripted: bool = False,
) -> dict[str, Any]:
    """Return the fields of `PlannedAircraft`, with what the files contain by their readers."""
    flies = not is_scripted and section.vehicle == "jsbsim"
    guided = row == 0 and not is_scripted  # an ideal leader's guidance has parameters of the tune
    with nullcontext() if flies or guided else unrecorded():
        tune_file = find_tune(folder, section.tune)
    return {
        "row": row,
        "section": section,
        "folder": folder,
        "airframe": measure(folder),
        "tune_file": tune_file,
        "params": params(tune_file),
        "guidance": guidance(folder),
        "has_model": flies,
        "is_ideal": not is_scripted and not flies,
        "is_scripted": is_scripted,
    }


def agent_parameters(formation: Formation, name: str) -> AgentParameters:
    """Return the parameters of the law for one follower."""
    return AgentParameters(formation, formation.agents.get(name, Agent()))


def solve_weights(formation: Formation, names: Sequence[str]) -> Array:
    """Return β (n, N, 3) of n followers: of the leader, then of each follower.

    Raises:
        ScenarioError: A + B is singular: a follower has no position reference.
    """
    n = len(names)
    weights = np.zeros((n, n + 1, 3))
    for i, name in enumerate(names):
        weights[i, 0] = formation.leader_gains.get(name, 0.0)
        for j, other in enumerate(names):
            weights[i, j + 1] = formation.neighbour_gains.get(name, {}).get(other, 0.0)
    # a follower that holds its own altitude is no vertical reference for others
    holds_altitude = np.array([name in formation.altitudes_m for name in names])
    weights[:, 1:, 2] = np.where(holds_altitude, 0.0, weights[:, 1:, 2])
    unreachable = [names[i] for i in unreachable_agents(weights, holds_altitude)]
    if unreachable:
        text = (
            f"formation: no position reference for {', '.join(unreachable)}: A + B is singular "
            "(write a leader gain for one of them, or a neighbour gain for an agent that has one)"
        )
        raise ScenarioError([Problem(None, text)])
    return weights


def unreachable_agents(weights: Array, holds_altitude: BoolArray | None = None) -> list[int]:
    """Return agents without a position reference; none if A + B is regular.

    A + B (n, n) of an axis has the leader gains on its diagonal, plus the Laplacian of the
    neighbour gains. The agents with components in its kernel could move together without a change
    of the error (6).

    Args:
        weights: β (n, N, 3), per axis of NED.
        holds_altitude: (n,) agents that need no vertical reference; None: none.
    """
    n = len(weights)
    fixed = np.zeros(n, dtype=bool) if holds_altitude is None else holds_altitude
    found: set[int] = set()
    solved: list[Array] = []  # axes mostly have the same matrix
    for axis in range(3):
        neighbours = weights[:, 1:, axis]
        matrix = np.diag(weights[:, 0, axis] + neighbours.sum(axis=1)) - neighbours
        if axis == 2:
            matrix = np.where(fixed[:, np.newaxis], np.eye(n), matrix)
        if any(np.array_equal(matrix, other) for other in solved):
            continue
        solved.append(matrix)
        _, values, vectors = np.linalg.svd(matrix)
        kernel = vectors[values <= n * np.finfo(float).eps * values.max(initial=1e-300)]
        found.update(np.flatnonzero(np.abs(kernel).max(axis=0, initial=0.0) > 1e-6).tolist())
    return sorted(found)
