"""Train a policy that holds a slot, and compare it with the trim and with the paper's law.

Proximal policy optimisation of Stable-Baselines3 on 64 flights at the same time, in this process.
The trim (all actions zero), the policy and the paper's law then fly the same episodes, with seeds
that the training has not used. Exits with 3 if the policy does not hold the slot better than the
trim.

usage: make train
       or with Stable-Baselines3 installed: python examples/hold_slot_training.py [--steps N] …
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import VecEnv

import testbed
import testbed.rl  # registers the environment
from testbed.scenario import Scenario
from testbed.scenario.aircraft import ByFormation
from testbed.scenario.arguments import with_changes

ID = "testbed/HoldSlot-v0"
HELD_OUT = 1_000_000  # first seed of the comparison
DURATION_S, PERIOD_S, LIMIT_M = 30.0, 0.2, 50.0  # of the environment
OPTIONS = {"duration_s": DURATION_S, "limit_m": LIMIT_M}
ROLLOUT = 32  # steps of each flight between two updates of the policy

Policy = Callable[[np.ndarray], np.ndarray]


class ManyFlights(VecEnv):
    """The vector environment, as Stable-Baselines3 takes one.

    Attributes:
        ended: mean slot error of each episode that has ended, m.
    """

    def __init__(self, flights: int, seed: int) -> None:
        """Build the flights."""
        self.envs = gymnasium.make_vec(ID, num_envs=flights, autoreset_mode="SameStep", **OPTIONS)
        self.first_seed, self.ended = seed, list[float]()
        spaces = self.envs.single_observation_space, self.envs.single_action_space
        super().__init__(flights, *spaces)

    def reset(self) -> np.ndarray:
        """Begin all episodes."""
        return self.envs.reset(seed=self.first_seed)[0]

    def step_async(self, actions: np.ndarray) -> None:
        """Keep the actions for `step_wait`."""
        self.actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Fly one control period of all episodes."""
        seen, rewards, terminated, truncated, infos = self.envs.step(self.actions)
        over = terminated | truncated
        further: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for k in np.flatnonzero(over):
            self.ended.append(float(infos["final_info"]["mean_slot_error_m"][k]))
            further[k]["terminal_observation"] = infos["final_obs"][k]
            further[k]["TimeLimit.truncated"] = bool(truncated[k])
        return seen, rewards.astype(np.float32), over, further

    def close(self) -> None:
        """End the flights."""
        self.envs.close()

    def env_is_wrapped(self, wrapper_class: type, indices: object = None) -> list[bool]:  # noqa: ARG002
        """Return that no flight has a wrapper of its own."""
        return [False] * self.num_envs

    def get_attr(self, attr_name: str, indices: object = None) -> list[Any]:  # noqa: ARG002
        """Return an attribute, the same of all flights."""
        return [getattr(self.envs, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: object, indices: object = None) -> None:
        """Set nothing: flights have no attributes of their own."""
        raise NotImplementedError

    def env_method(self, method_name: str, *args: object, **kwargs: object) -> list[Any]:
        """Call nothing: flights have no methods of their own."""
        raise NotImplementedError


def train(envs: ManyFlights, steps: int, seed: int) -> tuple[PPO, list[tuple[int, float]]]:
    """Train for a number of steps, and print the progress.

    Returns:
        The policy, and for each line of the progress the steps and the mean slot error, m, of the
        episodes that have ended since the line before.
    """
    torch.manual_seed(seed)
    size = ROLLOUT * envs.num_envs
    model = PPO(
        "MlpPolicy",
        envs,
        n_steps=ROLLOUT,
        batch_size=size // 4,
        n_epochs=6,
        gamma=0.95,  # per 0.2 s
        gae_lambda=0.9,
        learning_rate=1e-3,
        policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
        seed=seed,
        device="cpu",
    )
    begun, curve = time.perf_counter(), []
    while model.num_timesteps < steps:
        model.learn(max(steps // 10, size), reset_num_timesteps=False)
        error = float(np.mean(envs.ended)) if envs.ended else np.nan
        curve.append((model.num_timesteps, error))
        print(
            f"{model.num_timesteps:7} of {steps} steps, {time.perf_counter() - begun:4.0f} s, "
            f"{len(envs.ended):4} episodes, mean slot error {error:5.1f} m",
            flush=True,
        )
        envs.ended.clear()
    return model, curve


def draw(curve: Sequence[tuple[int, float]], means: Mapping[str, float], file: str) -> None:
    """Draw the mean slot error against the steps, beside those of the comparison."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    hours, errors = zip(
        *((steps * PERIOD_S / 3600.0, error) for steps, error in curve), strict=True
    )
    axes.plot(hours, errors, marker="o", color="#0072b2")
    axes.annotate(
        "policy, while it learns", (hours[1], errors[1]), (10.0, 4.0), textcoords="offset points"
    )
    colours = {"trim": "#d55e00", "policy": "#0072b2", "paper's law": "#009e73"}
    for (name, colour), at, side in zip(
        colours.items(), (-1, 0, -1), ("right", "left", "right"), strict=True
    ):
        axes.axhline(means[name], color=colour, dashes=(4, 3))
        text = f"{name}, learned" if name == "policy" else name
        axes.annotate(
            f"{text}, {means[name]:.1f} m", (hours[at], means[name]), (0.0, 5.0 if at else -14.0),
            textcoords="offset points", ha=side,
        )  # fmt: skip
    axes.set_title("A policy learns to hold a slot", loc="left", weight="bold")
    axes.set(xlabel="simulated flight, h", ylabel="mean distance from the slot, m", yscale="log")
    ticks = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
    axes.set_yticks(ticks, [f"{each:g}" for each in ticks])
    axes.set_ylim(1.0, 60.0)
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(file, dpi=120)


def fly_policy(env: gymnasium.Env, seed: int, policy: Policy) -> tuple[list[float], Scenario]:
    """Fly an episode; return the slot error at each step, m, and the scenario that was flown."""
    observation, _ = env.reset(seed=seed)
    errors, over = [], False
    while not over:
        observation, _, terminated, truncated, info = env.step(policy(observation))
        errors.append(info["slot_error_m"])
        over = terminated or truncated
    return errors, env.unwrapped.simulation.scenario


def fly_law(scenario: Scenario) -> list[float]:
    """Fly the scenario of an episode with its formation law; return the same errors."""
    fleet = tuple(with_changes(each, commanded_by=ByFormation()) for each in scenario.fleet)
    simulation = testbed.Simulation(with_changes(scenario, fleet=fleet))
    begun_s, errors = simulation.step().time_s, []
    while simulation.outcome is None:
        sample = simulation.step(until=begun_s + (len(errors) + 1) * PERIOD_S)
        errors.append(float(np.linalg.norm(sample.formation.error_ned[0])))
    return errors


def error_table(episodes: Sequence[Sequence[float]]) -> np.ndarray:
    """Return errors (episodes, steps), m, at most the limit, which counts after an early end."""
    errors = np.full((len(episodes), round(DURATION_S / PERIOD_S)), LIMIT_M)
    for row, episode in zip(errors, episodes, strict=True):
        row[: len(episode)] = np.minimum(episode, LIMIT_M)
    return errors


def main() -> None:
    """Train, compare, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--steps", type=int, default=400_000, help="of training, 0.2 s each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--flights", type=int, default=64, help="at the same time")
    parser.add_argument("--episodes", type=int, default=20, help="of the comparison")
    parser.add_argument("--save", metavar="FILE", help="write the trained policy")
    parser.add_argument("--plot", metavar="FILE", help="draw the learning curve")
    options = parser.parse_args()
    torch.set_num_threads(1)
    env = gymnasium.make(ID, **OPTIONS)
    check_env(env.unwrapped)
    envs = ManyFlights(options.flights, options.seed)
    model, curve = train(envs, options.steps, options.seed)
    envs.close()
    if options.save:
        model.save(options.save)

    def policy(observation: np.ndarray) -> np.ndarray:
        return model.predict(observation, deterministic=True)[0]

    flown: dict[str, list[list[float]]] = {"trim": [], "policy": [], "paper's law": []}
    for seed in range(HELD_OUT, HELD_OUT + options.episodes):
        errors, scenario = fly_policy(env, seed, lambda _: np.zeros(3, np.float32))
        flown["trim"].append(errors)
        flown["policy"].append(fly_policy(env, seed, policy)[0])
        flown["paper's law"].append(fly_law(scenario))
    env.close()
    print(f"{options.episodes} episodes of {DURATION_S:g} s with seeds that were not trained on:")
    means = {}
    for name, episodes in flown.items():
        errors = error_table(episodes)
        means[name] = errors.mean()
        second = errors[:, errors.shape[1] // 2 :].mean()
        left = np.mean((errors == LIMIT_M).any(axis=1))
        print(
            f"  {name:12}{means[name]:6.2f} m mean slot error, {second:6.2f} m in the second half; "
            f"{left:4.0%} left the formation"
        )
    if options.plot:
        draw(curve, means, options.plot)
    if not means["policy"] < means["trim"]:
        raise SystemExit(3)


if __name__ == "__main__":
    main()
