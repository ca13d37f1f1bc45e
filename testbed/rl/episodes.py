"""Fly episodes of a scenario whose followers are commanded by actions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from testbed.core.errors import InputError
from testbed.rl.spaces import ACTIONS, CommandRange, Slot, Vector, observe
from testbed.scenario import Scenario, middle_loop_gains, open_scenario, set_duration
from testbed.scenario.aircraft import External
from testbed.sim.build_control import build_altitudes, build_offsets
from testbed.sim.simulation import Simulation

Ranges = Mapping[str, "tuple[float, float] | list[Any]"]

DEFAULT_SCENARIO = "hold-slot"
DEFAULT_RANGES: Ranges = {
    "leader.path.curve.radius_m": (100.0, 250.0),
    "leader.path.curve.direction": ["clockwise", "anticlockwise"],
    "fleet.uav1.start_m.0": (-20.0, -5.0),
    "fleet.uav1.start_m.1": (0.0, 10.0),
    "fleet.uav1.start_m.2": (-5.0, 5.0),
}


@dataclass(frozen=True, kw_only=True)
class Task:
    """An episode: scenario, control period, limits and reward.

    Args:
        scenario: name or path.
        overrides: `key=value` as for `--set`.
        randomize: by key of the scenario, a range (low, high) or a list of values, drawn for each
            episode; None: those of `hold-slot` for that scenario, none for others.
        control_ticks: control period in ticks of the autopilots, 0.02 s each at 50 Hz.
        duration_s: of an episode, s.
        limit_m: a follower farther than this from its slot has left the formation, m.
        collision_m: distance below which two aircraft are lost, m, where the scenario has no
            `limits.collision_m`.
        smoothness: weight of the change of the action in the reward.
        out: folder for a run directory of each episode; None: nothing is written.
    """

    scenario: str | Path = DEFAULT_SCENARIO
    overrides: Sequence[str] = ()
    randomize: Ranges | None = None
    control_ticks: int = 10
    duration_s: float = 30.0
    limit_m: float = 50.0
    collision_m: float = 3.0
    smoothness: float = 0.05
    out: Path | str | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: one is out of range.
        """
        for name in ("control_ticks", "duration_s", "limit_m"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name}: {getattr(self, name)} (write a number above 0)")

    @property
    def ranges(self) -> Ranges:
        """What is drawn for each episode."""
        if self.randomize is None:
            return DEFAULT_RANGES if self.scenario == DEFAULT_SCENARIO else {}
        return self.randomize


class Episodes:
    """Fly one episode after the other; errors, rewards and endings are those of the truth.

    Attributes:
        agents: names of the followers that take actions, in the order of the fleet.
        simulation: the present flight; None before the first.
        drawn: values that were drawn for it, by key.
    """

    def __init__(self, task: Task, agents: Iterable[str] | None, *, nearest: bool) -> None:
        """Read the scenario.

        Args:
            task: the episode.
            agents: names of followers; None: all.
            nearest: observations include the nearest other follower.

        Raises:
            InputError: the scenario is wrong, or a follower has no virtual autopilot.
        """
        self.task, self._nearest = task, nearest
        self._file = open_scenario(task.scenario)
        scenario = self._file.resolve(task.overrides)
        fleet = {each.name: each for each in scenario.fleet}
        self.agents = list(fleet) if agents is None else list(agents)
        for name in self.agents:
            if name not in fleet:
                raise InputError(f"{name}: no such follower (there are {', '.join(fleet)})")
            if fleet[name].vehicle != "jsbsim":
                raise InputError(f"{name} is an ideal vehicle, which takes no pitch and roll")
        self._rows = {name: scenario.aircraft_names.index(name) for name in self.agents}
        self._period_s = task.control_ticks / scenario.rates.autopilot_hz
        self.simulation: Simulation | None = None
        self.drawn: dict[str, Any] = {}
        self._count = 0

    def begin(self, seed: int, generator: np.random.Generator) -> None:
        """Begin an episode, at the first tick of the autopilots after the start.

        Args:
            seed: of the simulation.
            generator: draws the values of `Task.ranges`.
        """
        self.close()
        self.drawn = {key: _draw(generator, key, each) for key, each in self.task.ranges.items()}
        drawn = [f"{key}={value}" for key, value in self.drawn.items()]
        scenario = self._commanded(self._file.resolve([*self.task.overrides, *drawn]))
        self._count += 1
        out = self.task.out and Path(self.task.out) / f"episode-{self._count:05d}"
        self.simulation = Simulation(scenario, seed=seed, out=out or None)
        self._steps = 0
        self._ranges = self._command_ranges(scenario)
        self._slots = _slots(scenario)
        self._airspeeds = self.simulation.state.truth.airspeed.copy()
        self.state = self.simulation.step()  # one tick at the trim: the first messages arrive
        self._begun_s = self.simulation.time_s
        if self.simulation.outcome is not None:
            texts = [each.text for each in self.simulation.events]
            raise InputError(
                f"the episode ends at its start: {'; '.join(texts)} (draw other starts)"
            )
        self._actions = {name: np.zeros(len(ACTIONS), np.float32) for name in self.agents}
        self._changes = dict.fromkeys(self.agents, 0.0)
        self._errors: dict[str, list[float]] = {name: [] for name in self.agents}

    def step(self, actions: Mapping[str, Vector]) -> None:
        """Fly one control period.

        Args:
            actions: (3,) by follower, for pitch, roll and throttle. A follower without one flies
                its trim.
        """
        commands = {}
        for name in self.agents:
            action = actions.get(name, np.zeros(len(ACTIONS), np.float32))
            commands[name] = self._ranges[name].command(action)
            action = np.clip(np.asarray(action, np.float32), -1.0, 1.0)
            self._changes[name] = float(((action - self._actions[name]) ** 2).sum())
            self._actions[name] = action
        self._steps += 1
        self.state = self._flight.step(commands, until=self._begun_s + self._steps * self._period_s)
        for name in self.agents:
            self._errors[name].append(self.error_m(name))

    def observation(self, name: str) -> Vector:
        """Return what a follower observes; see `spaces.observe`."""
        row = self._rows[name]
        return observe(
            self.state,
            row,
            self._slots[row],
            self._airspeeds[row],
            self._actions[name],
            nearest=self._nearest,
        )

    def error_m(self, name: str) -> float:
        """Return the distance of a follower from its slot, m."""
        return float(np.linalg.norm(self.state.formation.error_ned[self._rows[name] - 1]))

    def reward(self, name: str) -> float:
        """Return 1 − error / limit − smoothness · ‖change of the action‖², the error at most 1."""
        error = min(self.error_m(name) / self.task.limit_m, 1.0)
        return 1.0 - error - self.task.smoothness * self._changes[name]

    def terminated(self, name: str) -> bool:
        """Return whether a follower is lost or has left the formation."""
        lost = bool(self.state.lost[self._rows[name]])
        return lost or not self.error_m(name) <= self.task.limit_m

    @property
    def truncated(self) -> bool:
        """Whether the time is over, or the leader is lost."""
        return self._flight.outcome is not None or bool(self.state.lost[0])

    def info(self, name: str) -> dict[str, Any]:
        """Return time and error now, and mean and RMS error (m) of the episode so far."""
        now = {"time_s": self.state.time_s, "slot_error_m": self.error_m(name)}
        errors = self._errors[name]
        if not errors:
            return now | {"seed": self._flight.scenario.scenario.seed}
        mean = math.fsum(errors) / len(errors)
        rms = math.sqrt(math.fsum(each * each for each in errors) / len(errors))
        return now | {"mean_slot_error_m": mean, "rms_slot_error_m": rms}

    @property
    def metrics(self) -> dict[str, Any]:
        """The metrics of the flight up to now, as in metrics.json."""
        return self._flight.metrics

    def close(self) -> None:
        """End the flight; repeatable."""
        if self.simulation is not None:
            self.simulation.close()

    @property
    def _flight(self) -> Simulation:
        if self.simulation is None:
            raise InputError("there is no episode yet: call reset()")
        return self.simulation

    def _commanded(self, scenario: Scenario) -> Scenario:
        """Return the scenario of an episode."""
        external = {"commanded_by": External()}
        fleet = tuple(
            each.model_copy(update=external) if each.name in self.agents else each
            for each in scenario.fleet
        )
        collision_m = scenario.limits.collision_m
        limits = scenario.limits.model_copy(
            update={
                "on_loss": "continue",
                "collision_m": self.task.collision_m if collision_m is None else collision_m,
            }
        )
        changed = scenario.model_copy(update={"fleet": fleet, "limits": limits})
        return set_duration(changed, self.task.duration_s)

    def _command_ranges(self, scenario: Scenario) -> dict[str, CommandRange]:
        """Return the commands of each follower: the middle loop's limits around its trim."""
        ranges = {}
        for each in scenario.fleet:
            if each.name in self.agents:
                limits = middle_loop_gains(scenario, each.aircraft).limits
                pitch, roll = math.radians(limits.pitch_deg), math.radians(limits.roll_deg)
                ranges[each.name] = CommandRange(
                    np.array([-pitch, -roll, 0.0]),
                    np.array(self._flight.commands[each.name]),
                    np.array([pitch, roll, 1.0]),
                )
        return ranges


def _draw(generator: np.random.Generator, key: str, values: object) -> Any:  # noqa: ANN401
    """Draw a value from a range (low, high), or from a list.

    Raises:
        InputError: it is neither.
    """
    if isinstance(values, list) and values:
        return values[int(generator.integers(len(values)))]
    if isinstance(values, tuple) and len(values) == 2:
        return float(generator.uniform(*values))
    raise InputError(f"randomize: {key}: {values!r} (write (low, high), or a list of values)")


def _slots(scenario: Scenario) -> dict[int, Slot]:
    """Return the slots of the followers, by their rows among the N aircraft."""
    offsets = build_offsets(scenario)
    return {
        row: Slot(offsets, float(altitude))
        for row, altitude in enumerate(build_altitudes(scenario), start=1)
    }
