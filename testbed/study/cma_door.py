"""The only place that knows pycma: CMA-ES in the unit cube, with dice of its own.

Hansen, The CMA Evolution Strategy: A Tutorial, arXiv:1604.00772.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from testbed.state import Array
from testbed.streams import stream

CONVERGED = 1e-3  # step in every direction, as a share of the bounds, below which a search ends
FEWEST = 2  # gains: pycma has no covariance of one


def usual_population(n: int) -> int:
    """Points of a generation in n directions: 4 + ⌊3 ln n⌋, as the tutorial has it."""
    return 4 + int(3.0 * math.log(n))


class Strategy:
    """A search for the smallest cost in [0, 1]^n; what it asks depends on costs and seed alone."""

    def __init__(self, start: Array, *, step: float, population: int | None, seed: int) -> None:
        """Begin round a point.

        Args:
            start: (n,), n at least `FEWEST`.
            step: first standard deviation in every direction.
            population: points of a generation; None for the usual number.
            seed: of the stream "tune/search".
        """
        import cma

        dice = stream(seed, "tune/search")

        def normal(*shape: int) -> Array:
            return dice.standard_normal(shape)

        options = {
            "popsize": population or usual_population(start.size),
            "bounds": [0.0, 1.0],
            "seed": math.nan,  # leave numpy's global dice alone
            "randn": normal,
            "verbose": -9,
            "verb_log": 0,
            "tolx": CONVERGED,
        }
        self._search = cma.CMAEvolutionStrategy(start.tolist(), step, options)

    @property
    def population(self) -> int:
        """Points of a generation."""
        return int(self._search.popsize)

    @property
    def ended(self) -> str:
        """Why it goes no further; empty: it does."""
        return ", ".join(self._search.stop())

    def ask(self) -> list[Array]:
        """The points (n,) of the next generation."""
        return [np.clip(np.asarray(each), 0.0, 1.0) for each in self._search.ask()]

    def tell(self, points: Sequence[Array], costs: Sequence[float]) -> None:
        """Take in what they cost."""
        self._search.tell(list(points), list(costs))
