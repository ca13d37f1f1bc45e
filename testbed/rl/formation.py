"""PettingZoo environment: all followers hold their slots."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from pettingzoo import ParallelEnv

from testbed.core.errors import InputError
from testbed.rl.episodes import (
    NEAREST,
    OWN,
    Episodes,
    NoEpisodeError,
    Vector,
    action_space,
    observation_space,
    refuse_render_mode,
)
from testbed.runs.simulation import Simulation
from testbed.scenario.validate import shown_value


class FormationEnv(ParallelEnv):  # type: ignore[misc] # a library without types
    """All followers of a scenario hold their slots by pitch, roll and throttle.

    A follower that is lost or has left the formation is an agent no more; it flies its trim.

    Observation (22,) of each agent: each value is divided by its bound and limited to −1..1.
    Vectors are resolved in the follower's course frame: forward, right, down.

    | components | unit | bound |
    |---|---|---|
    | slot_forward, _right, _down: slot − own position | m | 50 |
    | relative_velocity_forward, _right, _down: leader − own | m/s | 20 |
    | leader_acceleration_forward, _right, _down | m/s² | 10 |
    | roll, pitch | rad | 1.6, 0.8 |
    | airspeed: true airspeed − that at the start | m/s | 15 |
    | roll_rate, pitch_rate, yaw_rate | rad/s | 3 |
    | message_age: of the leader's newest message | s | 2 |
    | last_pitch_action, last_roll_action, last_throttle_action | 1 | 1 |
    | nearest_forward, _right, _down: nearest other follower − own position | m | 50 |

    Action (3,) of each agent: pitch and roll, from minus to plus the middle loop's limits
    (rad), and throttle, 0 to 1; 0 is level flight at the airspeed of the start.

    Reward of a step: 1 − error / `limit_m` − `smoothness` · ‖change of the action‖², the error (m,
    distance from the slot) at most `limit_m`. Terminated: the follower is lost or farther than
    `limit_m` from its slot. Truncated: `duration_s` is over, or the leader is lost.

    Args:
        scenario: name or path.
        render_mode: there is none: write a log with `out`, and look at it with `testbed view`.
        task: further arguments of `testbed.rl.episodes.Task`.

    Raises:
        InputError: the scenario or an argument is wrong.
    """

    metadata = {"name": "formation_v0", "render_modes": []}

    def __init__(
        self,
        scenario: str = "simulation-3",
        render_mode: None = None,
        **task: Any,  # noqa: ANN401 - those of a dataclass
    ) -> None:
        refuse_render_mode(render_mode)
        self.render_mode = render_mode
        self._episodes = Episodes({"scenario": scenario, **task}, None, nearest=True)
        self.possible_agents = list(self._episodes.agents)
        self.agents: list[str] = []
        self.observation_spaces = {
            each: observation_space((*OWN, *NEAREST)) for each in self.possible_agents
        }
        self.action_spaces = {each: action_space() for each in self.possible_agents}
        self._generator = np.random.default_rng()

    def observation_space(self, agent: str) -> Box:
        """Return the space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """Return the space of an agent's actions."""
        return self.action_spaces[agent]

    @property
    def simulation(self) -> Simulation | None:
        """The flight of the present episode."""
        return self._episodes.simulation

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Vector], dict[str, dict[str, Any]]]:
        """Begin an episode.

        Args:
            seed: of the simulation and of the values that are drawn; None: the next ones.
            options: none has an effect.

        Returns:
            Observations and infos by agent.

        Raises:
            InputError: an argument is wrong. The present episode then goes on.
        """
        self._generator = self._episodes.begin_with(seed, options, self._generator)
        self.agents = list(self.possible_agents)
        return self._observations(), {each: self._episodes.info(each) for each in self.agents}

    def step(
        self, actions: dict[str, Vector]
    ) -> tuple[
        dict[str, Vector],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Fly one control period.

        Args:
            actions: of every agent.

        Returns:
            Observations, rewards, terminations, truncations and infos, by agent.

        Raises:
            InputError: an action is missing, or is not three numbers; before `reset` and after the
                end of all agents also a `gymnasium.error.ResetNeeded`. The episode then goes on as
                if there had been no call.
        """
        episodes, agents = self._episodes, self.agents
        if not agents:
            raise NoEpisodeError("there are no agents: call reset()")
        if not isinstance(actions, Mapping):
            raise InputError(f"actions: is {shown_value(actions)} (write {{agent: action}})")
        for name in (*actions, *agents):
            if name not in self.possible_agents:
                known = ", ".join(self.possible_agents)
                raise InputError(f"actions: {shown_value(name)} is no agent (there are {known})")
            if name in agents and name not in actions:
                raise InputError(f"actions: that of {name} is missing (write three numbers)")
        episodes.step({each: actions[each] for each in agents})
        observations = self._observations()
        rewards = {each: episodes.reward(each) for each in agents}
        terminations = {each: episodes.terminated(each) for each in agents}
        over = episodes.truncated
        truncations = {each: over and not terminations[each] for each in agents}
        infos = {each: episodes.info(each) for each in agents}
        self.agents = [each for each in agents if not (terminations[each] or truncations[each])]
        if not self.agents:
            for each in agents:
                infos[each]["metrics"] = episodes.metrics
        return observations, rewards, terminations, truncations, infos

    def close(self) -> None:
        """End the flight, and write its files where there are any."""
        self._episodes.close()

    def _observations(self) -> dict[str, Vector]:
        return {each: self._episodes.observation(each) for each in self.agents}
