"""Gymnasium environment: one follower holds its slot."""

from __future__ import annotations

from typing import Any

import gymnasium

from testbed.core.errors import InputError
from testbed.rl.episodes import (
    OWN,
    Episodes,
    Vector,
    action_space,
    observation_space,
    refuse_render_mode,
)
from testbed.runs.simulation import Simulation
from testbed.scenario.aircraft import AircraftSection
from testbed.scenario.arguments import check_argument
from testbed.scenario.validate import shown_value


class HoldSlotEnv(gymnasium.Env[Any, Any]):
    """One follower of a scenario holds its slot by pitch, roll and throttle.

    All other aircraft fly as in the scenario.

    Observation (19,): each value is divided by its bound and limited to −1..1. Vectors are resolved
    in the follower's course frame: forward, right, down.

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

    Action (3,): pitch and roll, from minus to plus the middle loop's limits
    (rad), and throttle, 0 to 1; 0 is level flight at the airspeed of the start.

    Reward of a step: 1 − error / `limit_m` − `smoothness` · ‖change of the action‖², the error (m,
    distance from the slot) at most `limit_m`. Terminated: the follower is lost or farther than
    `limit_m` from its slot. Truncated: `duration_s` is over, or the leader is lost.

    Args:
        follower: its name.
        render_mode: there is none: write a log with `out`, and look at it with `testbed view`.
        task: arguments of `testbed.rl.episodes.Task`.

    Raises:
        InputError: the scenario or an argument is wrong.
    """

    metadata = {"render_modes": []}

    def __init__(
        self,
        follower: str = "uav1",
        render_mode: None = None,
        **task: Any,  # noqa: ANN401 - those of a dataclass
    ) -> None:
        refuse_render_mode(render_mode)
        self.render_mode = render_mode
        self._name: str = check_argument("follower", follower, AircraftSection, "name")
        self._episodes = Episodes(task, [self._name], nearest=False)
        self.observation_space = observation_space(OWN)
        self.action_space = action_space()

    @property
    def simulation(self) -> Simulation | None:
        """The flight of the present episode."""
        return self._episodes.simulation

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Vector, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: of the simulation and of the values that are drawn; None: the next ones.
            options: there are none; leave it out.

        Returns:
            The observation; info, with `seed` that of the simulation.

        Raises:
            InputError: an argument is wrong. The present episode then goes on.
        """
        if options:
            raise InputError(f"options: is {shown_value(options)} (leave it out: there are none)")
        generator = self._episodes.begin_with(seed, options, self.np_random)
        if seed is not None:
            super().reset(seed=int(seed))
            self.np_random.bit_generator.state = generator.bit_generator.state
        return self._episodes.observation(self._name), self._episodes.info(self._name)

    def step(self, action: Vector) -> tuple[Vector, float, bool, bool, dict[str, Any]]:
        """Fly one control period; return observation, reward, terminated, truncated and info.

        Args:
            action: (3,) pitch, roll and throttle, limited to -1..1.

        Raises:
            InputError: the action is not three numbers, or the flight has ended; before `reset`
                also a `gymnasium.error.ResetNeeded`. The episode then goes on as if there had been
                no call.
        """
        episodes, name = self._episodes, self._name
        episodes.step({name: action})
        terminated = episodes.terminated(name)
        truncated = episodes.truncated and not terminated
        info = episodes.info(name)
        if terminated or truncated:
            info["metrics"] = episodes.metrics
        return episodes.observation(name), episodes.reward(name), terminated, truncated, info

    def close(self) -> None:
        """End the flight, and write its files where there are any."""
        self._episodes.close()
