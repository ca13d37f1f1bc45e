"""Vector environments: many episodes at the same time, in one process, as rows of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pydantic import Field

from testbed.core.errors import InputError
from testbed.core.exclusive import Exclusive, exclusive
from testbed.core.records import Array, BoolArray, FbwaCommand
from testbed.rl.episodes import (
    ACTIONS,
    NEAREST,
    OWN,
    CommandRange,
    Episodes,
    NoEpisodeError,
    Slots,
    Vector,
    action_space,
    command_ranges,
    observation_space,
    observe,
    refuse_render_mode,
    slots_of,
)
from testbed.runs.batch import Batch
from testbed.scenario.aircraft import AircraftSection
from testbed.scenario.arguments import check_argument, check_arguments, check_count
from testbed.scenario.fields import Section, Whole
from testbed.scenario.sections import Header
from testbed.scenario.validate import shown_value

Info = dict[str, Any]
_MASK = "reset_mask"  # of Gymnasium's vector environments
_MODES = {each.value: each for each in AutoresetMode if each is not AutoresetMode.DISABLED}


class VectorTask(Section):
    """Arguments of vector environments beside those of an episode.

    Attributes:
        starts: how many starts are drawn from `randomize`, at random, when the environment is made;
            each episode begins at one of them.
        starts_seed: of these.
    """

    starts: Whole = Field(0, ge=0, le=100_000, description="0: a quarter more than flights.")
    starts_seed: Whole = Field(0, ge=0, lt=2**63, description="Number.")


class VectorEpisodes(VectorEnv[Any, Any, Any]):
    """Episodes of F flights at the same time; m followers of each take actions.

    Environment f · m + j is follower j of flight f. Actions, observations, rewards and ends are
    those of the environments for one flight, and the numbers of an episode are those of
    `testbed.Simulation` with its scenario, seed and commands, to the bit. The m followers of a
    flight end together: where one is lost or has left the formation it is terminated, and the
    others are truncated.

    Attributes:
        batch: of all flights; those that fly now are in the rows `flown`.
        flown: (F,) rows of the batch.
        followers: the m names.
    """

    def __init__(
        self,
        flights: int,
        followers: Sequence[str] | None,
        arguments: dict[str, Any],
        autoreset_mode: AutoresetMode | str,
        threads: int | None,
        *,
        nearest: bool,
    ) -> None:
        """Draw and build the flights.

        Args:
            flights: F.
            followers: names; None: all of the scenario.
            arguments: of `VectorTask` and of `Episodes`.
            autoreset_mode: see there of Gymnasium: of the next step, or of the same one.
            threads: that fly; None: one for each available processor.
            nearest: observations include the nearest other follower.

        Raises:
            InputError: the scenario or an argument is wrong.
        """
        mode = getattr(autoreset_mode, "value", autoreset_mode)
        if mode not in _MODES:
            raise InputError(
                f"autoreset_mode: is {shown_value(mode)} (write one of {', '.join(_MODES)})"
            )
        self.metadata = {"render_modes": [], "autoreset_mode": _MODES[mode]}
        own = {key: arguments[key] for key in VectorTask.model_fields if key in arguments}
        task = check_arguments(VectorTask, own)
        rest = {key: each for key, each in arguments.items() if key not in own}
        if rest.get("out") is not None:
            raise InputError("out: has no effect here (write files of episodes with one flight)")
        self._episodes = episodes = Episodes(rest, followers, nearest=nearest)
        self._exclusive = Exclusive(f"the episodes of {episodes.task.scenario}")
        self._task, self._nearest, self._flights = episodes.task, nearest, flights
        self.followers = tuple(episodes.agents)
        count = max(task.starts or flights + flights // 4, flights) + 4
        generator = np.random.default_rng(task.starts_seed)
        drawn = [episodes.draw(generator) for _ in range(count)]
        self.drawn = [each for _, each in drawn]
        self._build([each for each, _ in drawn], threads)
        self.num_envs = flights * len(self.followers)
        self.single_observation_space = observation_space((*OWN, *(NEAREST if nearest else ())))
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._begun = False

    def _build(self, scenarios: Sequence[Any], threads: int | None) -> None:
        """Build all flights, and fly each to the first tick of its autopilots."""
        self.batch = batch = Batch(scenarios, threads=threads)
        names, size = list(batch.names), len(batch)
        self._rows = np.array([names.index(each) for each in self.followers])
        trims = batch.commands[:, self._rows]
        ranges = []
        for scenario, row in zip(scenarios, trims.tolist(), strict=True):
            own = command_ranges(scenario, dict(zip(self.followers, row, strict=True)))
            ranges.append([own[name] for name in self.followers])
        self._ranges = CommandRange(*np.moveaxis(np.array(ranges), 2, 0))
        self._slots = slots_of(scenarios, self.followers)
        self._airspeeds = batch.aircraft["truth"]["airspeed"][:, self._rows].copy()
        self._tick_s = 1.0 / scenarios[0].rates.autopilot_hz
        batch.step(self._tick_s)  # one tick at the trim: the first messages arrive
        for row in range(size):
            if batch.outcomes[row] is not None:
                texts = "; ".join(each.text for each in batch.events(row))
                raise InputError(f"an episode ends at its start: {texts} (draw other starts)")
        self._begun_s = batch.times_s.copy()
        self.flown = np.arange(self._flights)

    @exclusive
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vector, Info]:
        """Begin new episodes.

        Args:
            seed: of the seeds of the flights, and of the choice of their starts; None: the next
                ones.
            options: `reset_mask` (num_envs,) of the environments that begin anew, all followers of
                a flight or none; the others go on. None: all begin.

        Returns:
            Observations (num_envs, c); infos, with `seed` and `start` of each flight.

        Raises:
            InputError: an argument is wrong, or the environment is closed. The episodes then go on
                as if there had been no call.
            NoEpisodeError: some are to go on, and there is no episode yet.
        """
        self._refuse_closed()
        chosen = self._flights_to_begin(options)
        if seed is not None:
            checked = check_argument("seed", seed, Header, "seed")
            self._np_random, self._np_random_seed = seeding.np_random(checked)
        flights, m = self._flights, len(self.followers)
        if not self._begun:
            self._steps = np.zeros(flights, dtype=np.int64)
            self._actions = np.zeros((flights, m, len(ACTIONS)), np.float32)
            self._sums = np.zeros((2, flights, m))  # of errors and of their squares
            self._over = np.zeros(flights, dtype=bool)
            self._begun = True
        self._over[chosen] = False
        self._begin(chosen)
        return self._observe(), self._info(self._errors())

    def _refuse_closed(self) -> None:
        if self.closed:
            raise InputError("the environment is closed (make another one)")

    def _flights_to_begin(self, options: object) -> NDArray[np.intp]:
        """Return the flights that a reset begins anew.

        Raises:
            InputError, NoEpisodeError: see `reset`.
        """
        if options is None or options == {}:
            return np.arange(self._flights)
        if not isinstance(options, dict) or set(options) != {_MASK}:
            raise InputError(
                f"options: is {shown_value(options)} (write {_MASK}, an array of true and false, "
                "or leave it out)"
            )
        mask = np.asarray(options[_MASK])
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise InputError(
                f"options: {_MASK}: is {shown_value(options[_MASK])} (write {self.num_envs} times "
                "true or false, one of them true)"
            )
        of_flights = mask.reshape(self._flights, -1)
        if (of_flights.any(axis=1) != of_flights.all(axis=1)).any():
            raise InputError(
                f"options: {_MASK}: the {len(self.followers)} followers of a flight begin together "
                "(write true for all of them, or for none)"
            )
        if not (self._begun or mask.all()):
            raise NoEpisodeError("there is no episode yet that could go on: call reset() first")
        return np.flatnonzero(of_flights.any(axis=1))

    def _begin(self, flights: NDArray[np.intp]) -> None:
        """Begin episodes of some flights, at starts that do not fly now."""
        if not len(flights):
            return
        batch, generator = self.batch, self.np_random
        free = np.setdiff1d(np.arange(len(batch)), np.delete(self.flown, flights))
        rows = generator.choice(free, len(flights), replace=False)
        seeds = generator.integers(2**31, size=len(flights))
        batch.reset(rows.tolist(), seeds.tolist())
        times = batch.times_s.copy()
        times[rows] += self._tick_s
        batch.step(times)
        self.flown[flights] = rows
        self._steps[flights] = 0
        self._actions[flights] = 0.0
        self._sums[:, flights] = 0.0

    @exclusive
    def step(self, actions: Vector) -> tuple[Vector, Array, BoolArray, BoolArray, Info]:
        """Fly one control period of all flights.

        Args:
            actions: (num_envs, 3) pitch, roll and throttle, limited to -1..1.

        Returns:
            Observations (num_envs, c), rewards, terminated, truncated (num_envs,), and infos. With
            the mode NextStep the step after the end of an episode begins the next one, with reward
            0; with SameStep it has begun already, and `final_obs` and `final_info` are those of the
            end.

        Raises:
            InputError: the actions are not numbers of this shape, or the environment is closed. The
                episodes then go on as if there had been no call.
            NoEpisodeError: there is no episode yet.
        """
        self._refuse_closed()
        if not self._begun:
            raise NoEpisodeError("there is no episode yet: call reset()")
        shape = self._actions.shape
        asked = _checked_actions(actions, shape)
        new = asked.astype(np.float32)
        going = np.flatnonzero(~self._over)
        commands = self._commands(asked)
        rows, periods = self.flown[going], self._steps[going] + 1
        for name, values in zip(FbwaCommand._fields, np.moveaxis(commands, -1, 0), strict=True):
            self.batch.commands[name][rows[:, np.newaxis], self._rows] = values[going]
        until = self.batch.times_s.copy()
        period_s = self._task.control_ticks * self._tick_s
        until[rows] = self._begun_s[rows] + periods * period_s
        self.batch.step(until)
        self._steps[going] += 1
        changes = ((new - self._actions) ** 2).sum(axis=-1).astype(np.float64)
        self._actions[going] = new[going]
        begun = np.flatnonzero(self._over)
        self._begin(begun)
        errors = self._errors()
        self._sums[:, going] += errors[going], errors[going] ** 2
        limit_m = self._task.limit_m
        rewards = 1.0 - np.minimum(errors / limit_m, 1.0) - self._task.smoothness * changes
        terminated, truncated = self._ends(errors)
        for each in (rewards, terminated, truncated):
            each[begun] = 0
        self._over[:] = (terminated | truncated).any(axis=1)
        observations, infos = self._observe(), self._info(errors)
        if self.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP and self._over.any():
            of_ends = np.repeat(self._over, shape[1])
            self._begin(np.flatnonzero(self._over))
            self._over[:] = False
            shown = {key: each for key, each in infos.items() if not key.startswith("_")}
            final_info = {key: np.where(of_ends, each, 0) for key, each in shown.items()}
            final_obs, observations = observations, self._observe()
            infos = self._info(self._errors())
            infos |= {"final_obs": final_obs, "final_info": final_info}
            infos |= {"_final_obs": of_ends, "_final_info": of_ends}
        flat = (each.reshape(-1) for each in (rewards, terminated, truncated))
        return observations, *flat, infos  # type: ignore[return-value]

    def _commands(self, actions: Array) -> Array:
        """Return the commands (F, m, 3) of actions."""
        ranges = CommandRange(*(each[self.flown] for each in self._ranges))
        return ranges.commands(actions)

    def _errors(self) -> Array:
        """Return the distances (F, m) of the followers from their slots, m."""
        rows = self.flown[:, np.newaxis], self._rows - 1
        errors: Array = np.linalg.norm(self.batch.followers["error_ned"][rows], axis=-1)
        return errors

    def _ends(self, errors: Array) -> tuple[BoolArray, BoolArray]:
        """Return which followers (F, m) are terminated and truncated."""
        lost = self.batch.aircraft["lost"][self.flown]
        terminated = lost[:, self._rows] | ~(errors <= self._task.limit_m)
        ended = np.array([self.batch.outcomes[row] is not None for row in self.flown.tolist()])
        over = ended | lost[:, 0] | terminated.any(axis=1)
        return terminated, over[:, np.newaxis] & ~terminated

    def _observe(self) -> Vector:
        batch, flown = self.batch, self.flown
        at = flown[:, np.newaxis], self._rows
        followers = flown[:, np.newaxis], self._rows - 1
        slots = Slots(*(each[flown] for each in self._slots))
        observed = observe(
            batch.aircraft["estimate"][at],
            batch.links[followers],
            batch.times_s[flown],
            (self._rows, batch.followers["slot_index"][followers], slots),
            self._airspeeds[flown],
            self._actions,
            nearest=self._nearest,
        )
        return observed.reshape(self.num_envs, -1)

    def _info(self, errors: Array) -> Info:
        """Return what is known of the episodes; of each the numbers so far."""
        m, count = len(self.followers), np.maximum(self._steps, 1)[:, np.newaxis]
        flown = self.flown.tolist()
        seeds = [self.batch.seeds[row] for row in flown]
        shown = {
            "time_s": np.repeat(self.batch.times_s[self.flown], m),
            "slot_error_m": errors.reshape(-1),
            "mean_slot_error_m": (self._sums[0] / count).reshape(-1),
            "rms_slot_error_m": np.sqrt(self._sums[1] / count).reshape(-1),
            "seed": np.repeat(seeds, m),
            "start": np.repeat(self.flown, m),
        }
        return shown | {f"_{key}": np.ones(self.num_envs, dtype=bool) for key in shown}


class HoldSlotVectorEnv(VectorEpisodes):
    """Many episodes of `HoldSlotEnv` at the same time, in one process.

    `gymnasium.make_vec("testbed/HoldSlot-v0", num_envs=64)` makes it. Observations, actions and
    rewards are those of `HoldSlotEnv`.

    Args:
        num_envs: number of episodes at the same time.
        follower: its name.
        render_mode: there is none.
        autoreset_mode: of Gymnasium, NextStep or SameStep.
        threads: that fly; None: one for each available processor.
        task: arguments of `testbed.rl.episodes.Task` but `out`, and those of `VectorTask`.

    Raises:
        InputError: the scenario or an argument is wrong.
    """

    def __init__(
        self,
        num_envs: int = 1,
        follower: str = "uav1",
        render_mode: None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        **task: Any,  # noqa: ANN401 - those of a dataclass
    ) -> None:
        refuse_render_mode(render_mode)
        name: str = check_argument("follower", follower, AircraftSection, "name")
        flights = check_count("num_envs", num_envs)
        super().__init__(flights, [name], task, autoreset_mode, threads, nearest=False)


class FormationVectorEnv(VectorEpisodes):
    """Many flights in which all followers hold their slots, each with the same policy.

    Observations, actions and rewards are those of `FormationEnv`; see `VectorEpisodes` for the
    order of the followers.

    Args:
        num_flights: number of flights at the same time.
        scenario: name or path.
        autoreset_mode: of Gymnasium, NextStep or SameStep.
        threads: that fly; None: one for each available processor.
        task: further arguments of `testbed.rl.episodes.Task` but `out`, and those of `VectorTask`.

    Raises:
        InputError: the scenario or an argument is wrong.
    """

    def __init__(
        self,
        num_flights: int = 1,
        scenario: str = "simulation-3",
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        **task: Any,  # noqa: ANN401 - those of a dataclass
    ) -> None:
        flights, arguments = check_count("num_flights", num_flights), {"scenario": scenario, **task}
        super().__init__(flights, None, arguments, autoreset_mode, threads, nearest=True)


def _checked_actions(actions: object, shape: tuple[int, ...]) -> Array:
    """Return actions (F, m, 3), limited to -1..1.

    Raises:
        InputError: they are not numbers of this shape.
    """
    flat = (shape[0] * shape[1], shape[2])
    try:
        numbers = np.asarray(actions, np.float64)
    except (TypeError, ValueError, OverflowError):
        numbers = np.array(np.nan)
    if numbers.shape != flat or np.isnan(numbers).any():
        raise InputError(
            f"actions: {shown_value(np.shape(numbers))} (write numbers from -1 to 1, {flat}: "
            f"{', '.join(ACTIONS)} of each environment)"
        )
    return np.clip(numbers, -1.0, 1.0).reshape(shape)
