"""Measure the speed of the environments for reinforcement learning.

Processor time of steps and of resets in one process, and the wall-clock rate of several processes.
Actions are zero, the trim; environments are reset as their episodes end.

usage: python benchmarks/environments.py [--steps N] [--processes N]
"""

from __future__ import annotations

import argparse
import time

import gymnasium
import numpy as np

from testbed.rl.formation import FormationEnv

ID = "testbed/HoldSlot-v0"
TRIM = np.zeros(3, np.float32)


def hold_slot(steps: int) -> tuple[float, float]:
    """Return the processor time of a step and of a reset of one follower, s."""
    env = gymnasium.make(ID)
    env.reset(seed=1)
    stepping, resetting = [], []
    while len(stepping) < steps:
        begun = time.process_time()
        *_, terminated, truncated, _ = env.step(TRIM)
        stepping.append(time.process_time() - begun)
        if terminated or truncated:
            begun = time.process_time()
            env.reset()
            resetting.append(time.process_time() - begun)
    return float(np.mean(stepping)), float(np.mean(resetting))


def formation(steps: int) -> float:
    """Return the processor time of a step of three followers, s."""
    env = FormationEnv("simulation-3")
    env.reset(seed=1)
    stepping = []
    while len(stepping) < steps:
        begun = time.process_time()
        env.step(dict.fromkeys(env.agents, TRIM))
        stepping.append(time.process_time() - begun)
        if not env.agents:
            env.reset()
    return float(np.mean(stepping))


def vector(steps: int, processes: int) -> float:
    """Return steps per second of all environments together, with resets."""
    envs = gymnasium.make_vec(ID, num_envs=processes, vectorization_mode="async")
    envs.reset(seed=1)
    actions = np.zeros((processes, 3), np.float32)
    envs.step(actions)
    begun = time.perf_counter()
    for _ in range(steps):
        envs.step(actions)
    rate = steps * processes / (time.perf_counter() - begun)
    envs.close()
    return rate


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    hold_slot(100), formation(1)  # compile the kernels
    step_s, reset_s = hold_slot(options.steps)
    print(f"HoldSlot-v0: a step {1e3 * step_s:.2f} ms, a reset {1e3 * reset_s:.0f} ms")
    print(f"FormationEnv of simulation-3: a step {1e3 * formation(options.steps):.2f} ms")
    rate = vector(options.steps, options.processes)
    print(f"HoldSlot-v0 in {options.processes} processes, with resets: {rate:.0f} steps per second")


if __name__ == "__main__":
    main()
