"""Episodes of a scenario whose followers are commanded by actions; observations and actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pydantic import Field

from testbed.commands.autopilot_session import MANUAL_ANGLE_LIMIT
from testbed.core.errors import InputError
from testbed.core.exclusive import Exclusive, exclusive
from testbed.core.files import report_write_errors
from testbed.core.records import Array, FbwaCommand, Indices, Records, UIntArray
from testbed.core.velocity_frame import velocity_frame
from testbed.flight.world import World
from testbed.runs.simulation import Simulation
from testbed.scenario import (
    Scenario,
    ScenarioError,
    middle_loop_gains,
    open_scenario,
    set_duration,
)
from testbed.scenario.aircraft import External
from testbed.scenario.arguments import (
    check_argument,
    check_arguments,
    check_path,
    to_plain,
    with_changes,
)
from testbed.scenario.fields import MAX_DISTANCE_M, NotNegative, Seconds, Section, Whole, is_number
from testbed.scenario.load import parse_setting
from testbed.scenario.sections import Distance, Header
from testbed.scenario.validate import shown_value
from testbed.scenario.yaml_io import to_inline

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
ACTIONS = FbwaCommand._fields  # pitch, roll, throttle


def observation_space(components: tuple[Component, ...]) -> Box:
    """Return the space of an observation with these components."""
    return Box(-1.0, 1.0, (len(components),), np.float32)


def action_space() -> Box:
    """Return the space of an action: pitch, roll and throttle, see `CommandRange`."""
    return Box(-1.0, 1.0, (len(ACTIONS),), np.float32)


class CommandRange(NamedTuple):
    """Commands of followers (...,) for the actions -1, 0 and 1; linear between them.

    Each has pitch and roll (rad) and throttle (0..1).
    """

    lowest: Array  # (..., 3)
    trim: Array  # (..., 3) level flight at the airspeed of the start
    highest: Array  # (..., 3)

    def commands(self, actions: Array) -> Array:
        """Return the commands (..., 3) of actions, limited to -1..1."""
        part = np.clip(np.asarray(actions, dtype=np.float64), -1.0, 1.0)
        span = np.where(part < 0.0, self.trim - self.lowest, self.highest - self.trim)
        commands: Array = self.trim + part * span
        return commands


class Slots(NamedTuple):
    """The slots of m followers in each of K flights."""

    offsets: Array  # (K, N, 3) m, forward, right, down in the leader's velocity frame, by slot
    altitudes: Array  # (K, m) m above the origin, of the horizontal variant; NaN: none


def observe(
    own: Records,
    links: Records,
    time_s: Array,
    where: tuple[Indices, UIntArray, Slots],
    airspeeds: Array,
    actions: Vector,
    *,
    nearest: bool,
) -> Vector:
    """Compute what m followers in each of K flights observe: own estimates, messages received.

    Args:
        own: (K, m) of MOTION, their estimates.
        links: (K, m, N) of LINK, the newest messages that they have received.
        time_s: (K,) s, of the flights.
        where: their rows (m,) among the N aircraft, the slots that they have (K, m), and all slots.
        airspeeds: (K, m) m/s, at the start.
        actions: (K, m, 3) the last ones.
        nearest: add the components `NEAREST`.

    Returns:
        (K, m, c) of `OWN`, then of `NEAREST`; a value that is not finite is 0.
    """
    position, velocity = own["position_ned"], own["velocity_ned"]
    frames = _frames(velocity * (1.0, 1.0, 0.0))

    def resolve(vectors: Array) -> Array:
        resolved: Array = (vectors[..., np.newaxis, :] @ frames)[..., 0, :]
        return resolved

    age = time_s[:, np.newaxis, np.newaxis] - links["stamp_s"]  # (K, m, N) NaN: no message
    received_ned = links["position_ned"] + age[..., np.newaxis] * links["velocity_ned"]
    leader_velocity = links["velocity_ned"][..., 0, :]
    slots_ned = _slots_ned(where, received_ned[..., 0, :], leader_velocity)
    values = [
        resolve(slots_ned - position),
        resolve(leader_velocity - velocity),
        resolve(links["acceleration_ned"][..., 0, :]),
        own["euler"][..., :2],
        (own["airspeed"] - airspeeds)[..., np.newaxis],
        own["rates_body"],
        age[..., :1].copy(),
        actions,
    ]
    missing = np.isnan(age[..., 0])
    for each in values[:3]:
        each[missing] = 0.0
    values[6][missing] = _BOUNDS[_AGE]
    if nearest:
        values.append(resolve(_nearest(received_ned, where[0], position)))
    flat = np.concatenate(values, axis=-1)
    limited = np.clip(flat / _BOUNDS[: flat.shape[-1]], -1.0, 1.0)
    observation: Vector = np.nan_to_num(limited).astype(np.float32)
    return observation


_BOUNDS = np.array([each.bound for each in (*OWN, *NEAREST)])
_AGE = [each.name for each in OWN].index("message_age")


def _frames(velocity: Array) -> Array:
    """Return the velocity frames (K, m, 3, 3) of velocities (K, m, 3), m/s."""
    return velocity_frame(velocity.reshape(-1, 3)).reshape(*velocity.shape, 3)


def _slots_ned(where: tuple[Indices, UIntArray, Slots], leader: Array, velocity: Array) -> Array:
    """Return the positions of slots (K, m, 3), m, behind leaders at positions with velocities."""
    _, index, slots = where
    holds_altitude = ~np.isnan(slots.altitudes)
    level = np.where(holds_altitude[..., np.newaxis], velocity * (1.0, 1.0, 0.0), velocity)
    offsets = slots.offsets[np.arange(len(index))[:, np.newaxis], index]
    there: Array = leader + (_frames(level) @ offsets[..., np.newaxis])[..., 0]
    there[..., 2] = np.where(holds_altitude, -slots.altitudes, there[..., 2])
    return there


def _nearest(received_ned: Array, rows: Indices, position: Array) -> Array:
    """Return the nearest other followers (K, m, 3), relative to positions, m; the bound: none."""
    relative = received_ned - position[..., np.newaxis, :]  # (K, m, N, 3)
    relative[..., 0, :] = np.nan
    relative[:, np.arange(len(rows)), rows] = np.nan
    distance = np.linalg.norm(relative, axis=-1)
    distance[np.isnan(distance)] = np.inf
    found = np.argmin(distance, axis=-1)
    near = np.take_along_axis(relative, found[..., np.newaxis, np.newaxis], axis=2)[..., 0, :]
    none = np.isinf(distance.min(axis=-1))
    near[none] = NEAREST[0].bound
    return near


Ranges = Mapping[str, "tuple[float, float] | list[Any]"]

DEFAULT_SCENARIO = "hold-slot"
DEFAULT_RANGES: Ranges = {
    "leader.path.curve.radius_m": (100.0, 250.0),
    "leader.path.curve.direction": ["clockwise", "anticlockwise"],
    "fleet.uav1.start_m.0": (-20.0, -5.0),
    "fleet.uav1.start_m.1": (0.0, 10.0),
    "fleet.uav1.start_m.2": (-5.0, 5.0),
}


class Task(Section):
    """An episode: scenario, control period, limits and reward.

    Attributes:
        scenario: name or path.
        overrides: `key=value` as for `--set`.
        control_ticks: control period in ticks of the autopilots, 0.02 s each at 50 Hz.
        duration_s: of an episode, s.
        limit_m: a follower farther than this from its slot has left the formation, m.
        collision_m: distance below which two aircraft are lost, m, where the scenario has no
            `limits.collision_m`.
        smoothness: weight of the change of the action in the reward.
        out: folder for a run directory of each episode, `episode-00001` and on: the next number
            that is free; None: nothing is written.
    """

    scenario: str = Field(DEFAULT_SCENARIO, min_length=1, description="Name or path.")
    overrides: tuple[str, ...] = Field((), description="Texts key=value.")
    control_ticks: Whole = Field(10, ge=1, le=10_000, description="Ticks of the autopilots.")
    duration_s: Annotated[Seconds, Header.model_fields["duration_s"]] = Field(30.0)
    limit_m: Annotated[Distance, Field(le=MAX_DISTANCE_M)] = Field(50.0, description="Metres.")
    collision_m: Annotated[Distance, Field(le=MAX_DISTANCE_M)] = Field(3.0, description="Metres.")
    smoothness: NotNegative = Field(0.05, le=1000, description="Weight of the change.")
    out: str | None = Field(None, min_length=1, description="Path of a folder.")


class _Episode(Simulation):
    """A flight whose run directory is created once it is built: refused ones leave none."""

    def __init__(self, scenario: Scenario, seed: int, create: Callable[[], Path] | None) -> None:
        """Build it; `create` makes the directory, None: nothing is written."""
        self._create = create
        super().__init__(scenario, seed=seed)

    def _open_directory(self, world: World) -> Path | None:
        if self._create is not None:
            self._out = self._create()
        return super()._open_directory(world)


class NoEpisodeError(InputError, gymnasium.error.ResetNeeded):
    """A step before the first episode, or after the end of one."""


class Episodes:
    """Fly one episode after the other; errors, rewards and endings are those of the truth.

    Attributes:
        agents: names of the followers that take actions, in the order of the fleet.
        simulation: the present flight; None before the first.
        drawn: values that were drawn for it, by key.
    """

    def __init__(
        self, arguments: Mapping[str, object], agents: Sequence[str] | None, *, nearest: bool
    ) -> None:
        """Read the scenario.

        Args:
            arguments: those of `Task`, and `randomize`: by key of the scenario, a range
                (low, high) or a list of values, drawn for each episode; None: those of `hold-slot`
                for that scenario, none for others.
            agents: names of followers; None: all.
            nearest: observations include the nearest other follower.

        Raises:
            InputError: an argument or the scenario is wrong, or a follower has no virtual
                autopilot.
        """
        self.task = task = check_arguments(
            Task, {k: arguments[k] for k in arguments if k != _DRAWN}
        )
        self._exclusive = Exclusive(f"the episodes of {task.scenario}")
        self._nearest = nearest
        self._folder = None if task.out is None else check_path("out", task.out)
        self._file = open_scenario(task.scenario)
        for text in task.overrides:
            _refuse_fixed(f"overrides: {text}", parse_setting(text).keys)
        scenario = self._file.resolve(task.overrides)
        ranges = arguments.get(_DRAWN)
        if ranges is None:
            ranges = DEFAULT_RANGES if task.scenario == DEFAULT_SCENARIO else {}
        self._drawn_from = _checked_ranges(ranges)
        for end in (0, -1):  # of each range or list: wrong keys and bounds show before an episode
            self._resolve({key: each[end] for key, each in self._drawn_from.items()})
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

    @exclusive
    def begin_with(
        self, seed: int | None, options: object, generator: np.random.Generator
    ) -> np.random.Generator:
        """Begin an episode with the arguments of `reset`, and return the generator it used.

        Args:
            seed: of the simulation and of the drawn values; None: the next ones.
            options: none has an effect; PettingZoo's own tests give some.
            generator: that of the episode before.

        Raises:
            InputError: an argument is wrong, or as `begin` raises it.
        """
        if not (options is None or isinstance(options, Mapping)):
            raise InputError(f"options: is {shown_value(options)} (leave it out)")
        if seed is not None:
            checked = check_argument("seed", seed, Header, "seed")
            generator, _ = seeding.np_random(checked)
            self.begin(checked, generator)
            return generator
        before = generator.bit_generator.state
        try:
            self.begin(int(generator.integers(_SEEDS)), generator)
        except BaseException:
            generator.bit_generator.state = before
            raise
        return generator

    def begin(self, seed: int, generator: np.random.Generator) -> None:
        """Begin an episode, at the first tick of the autopilots after the start.

        Args:
            seed: of the simulation.
            generator: draws the values of `randomize`.

        Raises:
            InputError: the seed or a drawn value cannot be flown. The present episode then goes
                on.
        """
        scenario, drawn = self.draw(generator)
        simulation = _Episode(scenario, seed, self._create_directory if self._folder else None)
        airspeeds = simulation.state.truth.airspeed.copy()
        ranges = command_ranges(scenario, simulation.commands)
        state = simulation.step()  # one tick at the trim: the first messages arrive
        if simulation.outcome is not None:
            texts = [each.text for each in simulation.events]
            simulation.close()
            raise InputError(
                f"the episode ends at its start: {'; '.join(texts)} (draw other starts)"
            )
        self.close()
        self.simulation, self.state, self.drawn = simulation, state, drawn
        self._steps = 0
        self._ranges, self._airspeeds = ranges, airspeeds
        self._slots = {name: slots_of([scenario], [name]) for name in self.agents}
        self._begun_s = simulation.time_s
        self._actions = {name: np.zeros(len(ACTIONS), np.float32) for name in self.agents}
        self._changes = dict.fromkeys(self.agents, 0.0)
        self._errors: dict[str, list[float]] = {name: [] for name in self.agents}

    def draw(self, generator: np.random.Generator) -> tuple[Scenario, dict[str, Any]]:
        """Return the scenario of an episode, and the values of `randomize` in it.

        Raises:
            InputError: a drawn value is wrong.
        """
        drawn = {key: _draw(generator, each) for key, each in self._drawn_from.items()}
        return self._commanded(self._resolve(drawn)), drawn

    @exclusive
    def step(self, actions: Mapping[str, Vector]) -> None:
        """Fly one control period.

        Args:
            actions: (3,) by follower, for pitch, roll and throttle. A follower without one flies
                its trim.

        Raises:
            NoEpisodeError: there is no episode.
            InputError: an action is wrong, or the flight has ended. The episode then goes on as if
                there had been no call.
        """
        flight = self._flight
        still = np.zeros(len(ACTIONS), np.float32)
        checked = {name: _checked_action(name, actions.get(name, still)) for name in self.agents}
        commands: dict[str, FbwaCommand[float]] = {
            name: FbwaCommand._make(self._ranges[name].commands(each).tolist())
            for name, each in checked.items()
        }
        self.state = flight.step(commands, until=self._begun_s + (self._steps + 1) * self._period_s)
        self._steps += 1
        for name, each in checked.items():
            action = np.clip(each, -1.0, 1.0).astype(np.float32)
            self._changes[name] = float(((action - self._actions[name]) ** 2).sum())
            self._actions[name] = action
        for name in self.agents:
            self._errors[name].append(self.error_m(name))

    def observation(self, name: str) -> Vector:
        """Return what a follower observes; see `observe`."""
        records = self.state.records
        assert records is not None, "a sample of a flight has them"
        aircraft, followers, links = records
        row = np.array([self._rows[name]])
        observed: Vector = observe(
            aircraft["estimate"][np.newaxis, row],
            links[np.newaxis, row - 1],
            np.array([self.state.time_s]),
            (row, followers["slot_index"][np.newaxis, row - 1], self._slots[name]),
            self._airspeeds[np.newaxis, row],
            self._actions[name][np.newaxis, np.newaxis],
            nearest=self._nearest,
        )
        mine: Vector = observed[0, 0]
        return mine

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
    def metrics(self) -> Mapping[str, Any]:
        """The metrics of the flight up to now, as in metrics.json."""
        return self._flight.metrics

    def close(self) -> None:
        """End the flight; repeatable."""
        if self.simulation is not None:
            self.simulation.close()

    @property
    def _flight(self) -> Simulation:
        if self.simulation is None:
            raise NoEpisodeError("there is no episode yet: call reset()")
        return self.simulation

    def _create_directory(self) -> Path:
        """Create the directory of the next episode; processes that share a folder take turns.

        Raises:
            InputError: it cannot be created.
        """
        folder = self._folder
        assert folder is not None
        with report_write_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
            while True:
                self._count += 1
                directory = folder / f"episode-{self._count:05d}"
                with suppress(FileExistsError):
                    directory.mkdir()
                    return directory

    def _resolve(self, drawn: Mapping[str, Any]) -> Scenario:
        """Return the scenario with drawn values.

        Raises:
            InputError: one of them is wrong.
        """
        settings = [f"{key}={to_inline(value)}" for key, value in drawn.items()]
        try:
            return self._file.resolve([*self.task.overrides, *settings])
        except ScenarioError as error:
            first = error.problems[0]
            raise InputError(f"{_DRAWN}: {'.'.join(first.path)}: {first.text}") from None

    def _commanded(self, scenario: Scenario) -> Scenario:
        fleet = tuple(
            with_changes(each, commanded_by=External()) if each.name in self.agents else each
            for each in scenario.fleet
        )
        collision_m = scenario.limits.collision_m
        limits = with_changes(
            scenario.limits,
            on_loss="continue",
            collision_m=self.task.collision_m if collision_m is None else collision_m,
        )
        changed = with_changes(scenario, fleet=fleet, limits=limits)
        return set_duration(changed, self.task.duration_s)


def command_ranges(
    scenario: Scenario, trims: Mapping[str, Sequence[float]]
) -> dict[str, CommandRange]:
    """Return the commands of followers: the middle loop's limits around their trims."""
    ranges = {}
    for each in scenario.fleet:
        if each.name in trims:
            limits = middle_loop_gains(scenario, each.aircraft).limits
            pitch, roll = (
                min(math.radians(limit), MANUAL_ANGLE_LIMIT)
                for limit in (limits.pitch_deg, limits.roll_deg)
            )
            ranges[each.name] = CommandRange(
                np.array([-pitch, -roll, 0.0]),
                np.array(trims[each.name]),
                np.array([pitch, roll, 1.0]),
            )
    return ranges


def _checked_action(name: str, action: object) -> Array:
    """Return an action (3,).

    Raises:
        InputError: it does not have three numbers.
    """
    try:
        numbers = np.asarray(action, np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(math.nan)
    if numbers.shape != (len(ACTIONS),) or np.isnan(numbers).any():
        raise InputError(
            f"action of {name}: is {shown_value(action)} (write three numbers from -1 to 1: "
            f"{', '.join(ACTIONS)})"
        )
    return numbers


_DRAWN = "randomize"
_SEEDS = 2**31  # of episodes without a seed of their own
# Keys that an episode sets itself, and what to write instead.
_FIXED = {
    ("scenario", "seed"): "the seed is that of reset(seed=...)",
    ("scenario", "duration_s"): "write the argument duration_s",
    ("limits", "on_loss"): "an episode continues without a lost follower",
}


def _refuse_fixed(what: str, keys: tuple[str, ...]) -> None:
    if keys in _FIXED:
        raise InputError(f"{what}: has no effect here ({_FIXED[keys]})")


def _checked_ranges(ranges: object) -> Ranges:
    """Return ranges as plain numbers, and lists.

    Raises:
        InputError: one is neither, or is empty.
    """
    if not isinstance(ranges, Mapping):
        raise InputError(f"{_DRAWN}: is {shown_value(ranges)} (write {{key: (low, high)}})")
    checked: dict[str, tuple[float, float] | list[Any]] = {}
    for key, values in ranges.items():
        at = f"{_DRAWN}: {key}"
        if not isinstance(key, str) or not all(key.split(".")) or "=" in key:
            raise InputError(f"{at}: is not a key of the scenario (write air.wind.speed_mps)")
        _refuse_fixed(at, tuple(key.split(".")))
        plain = to_plain(at, values)
        if isinstance(values, list) and values:
            checked[key] = plain
            continue
        if not (isinstance(values, tuple) and len(values) == 2 and all(map(is_number, plain))):
            text = f"{at}: {shown_value(values)} (write (low, high), or a list of values)"
            raise InputError(text)
        low, high = plain
        if not low <= high or not math.isfinite(float(high) - float(low)):
            remedy = f"({high}, {low})" if high < low else "two finite numbers"
            raise InputError(f"{at}: {shown_value(values)} is not a range (write {remedy})")
        checked[key] = float(low), float(high)
    return checked


def _draw(generator: np.random.Generator, values: tuple[float, float] | list[Any]) -> Any:  # noqa: ANN401
    """Draw a value from a range (low, high), or from a list."""
    if isinstance(values, list):
        return values[int(generator.integers(len(values)))]
    return float(generator.uniform(*values))


def slots_of(scenarios: Sequence[Scenario], followers: Sequence[str]) -> Slots:
    """Return the slots of some followers of scenarios with the same aircraft."""
    names, formations = scenarios[0].aircraft_names[1:], [each.formation for each in scenarios]
    offsets = [[(0.0, 0.0, 0.0), *(one.offsets_m[name] for name in names)] for one in formations]
    altitudes = [[one.altitudes_m.get(name, math.nan) for name in followers] for one in formations]
    return Slots(np.array(offsets), np.array(altitudes))


def refuse_render_mode(mode: object) -> None:
    """Refuse a render mode.

    Raises:
        InputError: there is one.
    """
    if mode is not None:
        raise InputError(
            f"render_mode: is {shown_value(mode)} (there is none: write a log with out, and look "
            "at it with `testbed view`)"
        )
