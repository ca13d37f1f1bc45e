"""Search gains with SciPy in place of `testbed tune`: all flights of a generation at once.

usage: python examples/tune_with_scipy.py [FILE [GENERATIONS]]
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import NonlinearConstraint, differential_evolution

import testbed


def search(tuning: testbed.Tuning, generations: int, per_gain: int = 3) -> tuple[float, ...]:
    """Return the best gains that differential evolution finds between the bounds of a file."""
    space = tuning.space

    def costs(points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fly points (n, k) of the unit cube, in which a scale is even that is log in the file."""
        return tuning.evaluate([space.gains(point) for point in points.T]).costs

    def missed(points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the shortfalls (m, k) of the same points, which are not flown again."""
        return tuning.evaluate([space.gains(point) for point in points.T]).constraints.T

    constraints = NonlinearConstraint(missed, -np.inf, 0.0)
    found = differential_evolution(
        costs,
        bounds=[(0.0, 1.0)] * len(space.names),
        x0=space.point(space.start),
        constraints=constraints if tuning.tune.config.constraints else (),
        vectorized=True,
        updating="deferred",
        maxiter=generations,
        popsize=per_gain,
        polish=False,
        rng=1,
    )
    return space.gains(found.x)


def main(file: str = "x8-middle-loop", generations: str = "6") -> None:
    """Search, and compare the gains with those of the scenario on held-out seeds."""
    with testbed.Tuning(file) as tuning:
        gains = search(tuning, int(generations))
        for name, before, after in zip(tuning.space.names, tuning.before, gains, strict=True):
            print(f"{name}: {before:g} before, {after:g} after")
        print(f"{tuning.flights} flights")
        print(tuning.compare(gains))


if __name__ == "__main__":
    main(*sys.argv[1:])
