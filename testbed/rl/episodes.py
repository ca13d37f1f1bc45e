"""Episodes of a scenario whose followers are commanded by actions; observations and actions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from testbed.core.errors import InputError
from testbed.core.records import Array, Sample
from testbed.core.velocity_frame import velocity_frame
from testbed.scenario import Scenario, middle_loop_gains, open_scenario, set_duration
from testbed.scenario.aircraft import External
from testbed.sim.build_control import build_altitudes, build_offsets
from testbed.sim.simulation import Simulation

Vector = NDArray[np.float32]


class Component(NamedTuple):
    """One component of an observation."""

    name: str
    unit: str
    bound: float  # of its absolute value


def _axes(name: str, unit: str, bound: float) -> tuple[Component, ...]:
    return tuple(Component(f"{name}_{axis}", unit, bound) for axis in ("forward", "right", "down"))


# Vectors are resolved in the follower's own course frame: forward along its course, right, down.
OWN = (
    *_axes("slot", "m", 50.0),  # slot − own position
    *_axes("relative_velocity", "m/s", 20.0),  # leader − own
    *_axes("leader_acceleration", "m/s²", 10.0),
    Component("roll", "rad", 1.6),
    Component("pitch", "rad", 0.8),
    Component("airspeed", "m/s", 15.0),  # true airspeed − that at the start
    Component("roll_rate", "rad/s", 3.0),
    Component("pitch_rate", "rad/s", 3.0),
    Component("yaw_rate", "rad/s", 3.0),
    Component("message_age", "s", 2.0),  # of the leader's newest message; 2: none yet
    Component("last_pitch_action", "1", 1.0),
    Component("last_roll_action", "1", 1.0),
    Component("last_throttle_action", "1", 1.0),
)
# The nearest other follower by its newest message, minus the own position; the bound without one.
NEAREST = _axes("nearest", "m", 50.0)
ACTIONS = ("pitch", "roll", "throttle")


def observation_space(components: tuple[Component, ...]) -> Box:
    """Return the space of an observation with these components."""
    return Box(-1.0, 1.0, (len(components),), np.float32)


def action_space() -> Box:
    """Return the space of an action: pitch, roll and throttle, see `CommandRange`."""
    return Box(-1.0, 1.0, (len(ACTIONS),), np.float32)


class CommandRange(NamedTuple):
    """Commands of a follower for the actions -1, 0 and 1; linear between them.

    Each has pitch and roll (rad) and throttle (0..1).
    """

    lowest: Array  # (3,)
    trim: Array  # (3,) level flight at the airspeed of the start
    highest: Array  # (3,)

    def command(self, action: Vector) -> tuple[float, float, float]:
        """Return pitch, roll and throttle of an action (3,), limited to -1..1."""
        part = np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0)
        span = np.where(part < 0.0, self.trim - self.lowest, self.highest - self.trim)
        pitch, roll, throttle = (self.trim + part * span).tolist()
        return pitch, roll, throttle


class Slot(NamedTuple):
    """The slot of a follower."""

    offsets: Array  # (N, 3) m, forward, right, down in the leader's velocity frame, by slot
    altitude: float  # m above the origin, of the horizontal variant of the law; NaN: none


def observe(
    sample: Sample, row: int, slot: Slot, airspeed: float, action: Vector, *, nearest: bool
) -> Vector:
    """Compute the observation of a follower from its own estimate and the messages it received.

    Args:
        sample: the present state.
        row: of the follower among the N aircraft.
        slot: of the follower.
        airspeed: at the start, m/s.
        action: (3,) the last one.
        nearest: add the components `NEAREST`.

    Returns:
        (k,) of `OWN`, then of `NEAREST`; a value that is not finite is 0.
    """
    assert sample.records is not None
    links = sample.records[2][row - 1]
    own = sample.estimate
    position, velocity = own.position_ned[row], own.velocity_ned[row]
    course_frame = velocity_frame(velocity[None] * (1.0, 1.0, 0.0))[0]
    age = sample.time_s - links["stamp_s"]  # (N,) NaN: no message
    received_ned = links["position_ned"] + age[:, None] * links["velocity_ned"]  # (N, 3)
    leader_velocity = links["velocity_ned"][0]
    where = _slot_ned(sample, row, slot, received_ned[0], leader_velocity)
    values = [
        (where - position) @ course_frame,
        (leader_velocity - velocity) @ course_frame,
        links["acceleration_ned"][0] @ course_frame,
        own.euler[row, :2],
        (own.airspeed[row] - airspeed,),
        own.rates_body[row],
        (age[0],),
        action,
    ]
    if np.isnan(age[0]):
        values[0] = values[1] = values[2] = np.zeros(3)
        values[6] = (_BOUNDS[_AGE],)
    if nearest:
        values.append(_nearest(received_ned, row, position) @ course_frame)
    flat = np.concatenate(values)
    limited = np.clip(flat / _BOUNDS[: len(flat)], -1.0, 1.0)
    observation: Vector = np.nan_to_num(limited).astype(np.float32)
    return observation


_BOUNDS = np.array([each.bound for each in (*OWN, *NEAREST)])
_AGE = [each.name for each in OWN].index("message_age")


def _slot_ned(sample: Sample, row: int, slot: Slot, leader: Array, velocity: Array) -> Array:
    """Return the position of the slot (3,), m, behind a leader at a position with a velocity."""
    holds_altitude = not np.isnan(slot.altitude)
    level = velocity * (1.0, 1.0, 0.0) if holds_altitude else velocity
    offset = slot.offsets[sample.formation.slot_index[row - 1]]
    where: Array = leader + velocity_frame(level[None])[0] @ offset
    if holds_altitude:
        where[2] = -slot.altitude
    return where


def _nearest(received_ned: Array, row: int, position: Array) -> Array:
    """Return the nearest other follower, relative to a position (3,), m; the bound: none."""
    relative = np.delete(received_ned, (0, row), axis=0) - position
    distance = np.linalg.norm(relative, axis=1)
    if not np.isfinite(distance).any():
        return np.full(3, NEAREST[0].bound)
    found: Array = relative[np.nanargmin(distance)]
    return found


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
