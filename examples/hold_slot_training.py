"""Train a policy that holds a slot, and compare it with the trim and with the paper's law.

Soft actor-critic of Stable-Baselines3 in the environment testbed/HoldSlot-v0, on one core. The trim
(all actions zero), the policy and the paper's law then fly the same episodes, with seeds that the
training has not used. Exits with 3 if the policy does not hold the slot better than the trim.

usage: make train
       or with Stable-Baselines3 installed: python examples/hold_slot_training.py [--steps N] …
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.env_checker import check_env

import testbed
import testbed.rl  # registers the environment
from testbed.scenario import Scenario
from testbed.scenario.aircraft import ByFormation
from testbed.scenario.arguments import with_changes

HELD_OUT = 1_000_000  # first seed of the comparison
DURATION_S, PERIOD_S, LIMIT_M = 30.0, 0.2, 50.0  # of the environment
REPORT = 2_000  # steps between two lines of progress

Policy = Callable[[np.ndarray], np.ndarray]


def make_env() -> gymnasium.Env:
    """Return the environment."""
    return gymnasium.make("testbed/HoldSlot-v0", duration_s=DURATION_S, limit_m=LIMIT_M)


def train(env: gymnasium.Env, steps: int, seed: int) -> SAC:
    """Train for a number of steps, and print the progress."""
    model = SAC(
        "MlpPolicy",
        env,
        gamma=0.97,  # per 0.2 s
        learning_rate=1e-3,
        learning_starts=1_000,
        policy_kwargs={"net_arch": [64, 64]},
        seed=seed,
    )
    begun = time.process_time()
    while model.num_timesteps < steps:
        model.learn(min(REPORT, steps - model.num_timesteps), reset_num_timesteps=False)
        rewards = [episode["r"] for episode in model.ep_info_buffer or ()]
        print(
            f"{model.num_timesteps:6} of {steps} steps, {time.process_time() - begun:4.0f} s of "
            f"processor time, reward of an episode {np.mean(rewards):6.1f} of 150",
            flush=True,
        )
    return model


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
    parser.add_argument("--steps", type=int, default=20_000, help="of training, 0.2 s each")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--episodes", type=int, default=20, help="of the comparison")
    parser.add_argument("--save", metavar="FILE", help="write the trained policy")
    options = parser.parse_args()
    torch.set_num_threads(1)
    env = make_env()
    check_env(env.unwrapped)
    model = train(env, options.steps, options.seed)
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
    if not means["policy"] < means["trim"]:
        raise SystemExit(3)


if __name__ == "__main__":
    main()
