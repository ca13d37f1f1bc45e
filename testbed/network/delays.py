"""Distributions of delay as functions of a standard normal, and netem's tables of them.

A delay is g(z), where z is a first-order autoregressive normal process: its distribution is exact
whatever its correlation. The coefficient of the process is computed such that the delays, not z,
have the correlation of the scenario. g is `packet_random.jitter`; the functions here make tables
before a run.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testbed.core.records import Array
from testbed.network.links import NETEM_TABLE, PARETO, PARETONORMAL

# Pareto with this shape and scale 1; mean 3/2, variance 3/4.
PARETO_SHAPE = 3.0
PARETO_MEAN = 1.5
PARETO_DEVIATION = math.sqrt(0.75)
PARETO_WITH_Z = 0.6783527895499961  # mean of z pareto(z); a test integrates it
NORMAL_SHARE = 0.25  # of paretonormal, as in iproute2; both parts grow with the same z
NETEM_PARETO = 4.0 / 3.0  # iproute2's scale of its pareto table

TABLE_STEPS = 1024  # of a table of quantiles
NANOSECONDS = 1e9  # in which netem counts, in a second
NETEM_SCALE = 8192  # table entry of one standard deviation
LARGEST_ENTRY = 32767


def quantile(share: NDArray[np.floating[Any]]) -> Array:
    """Return the z (…) that has this share 0..1 of a standard normal below it."""
    from scipy.special import ndtri  # slow to import, and few scenarios need it

    z: Array = ndtri(share)
    return z


@cache
def table_z() -> Array:
    """Return the z of the entries of a table of netem (NETEM_TABLE,)."""
    return quantile((np.arange(NETEM_TABLE) + 0.5) / NETEM_TABLE)


def mixed_deviation() -> float:
    """Return the standard deviation of a quarter normal and three quarters of iproute2's Pareto."""
    scale = (1.0 - NORMAL_SHARE) * NETEM_PARETO * PARETO_DEVIATION
    return math.sqrt(NORMAL_SHARE**2 + scale**2 + 2.0 * NORMAL_SHARE * scale * PARETO_WITH_Z)


def log_moments(mean: float, deviation: float) -> tuple[float, float]:
    """Return mean and standard deviation of the logarithm of a lognormal number with these."""
    variance = math.log1p((deviation / mean) ** 2)
    return math.log(mean) - 0.5 * variance, math.sqrt(variance)


def quantiles(samples: Array) -> Array:
    """Return the quantiles (TABLE_STEPS + 1,) of measured delays (K,)."""
    return np.quantile(samples, np.linspace(0.0, 1.0, TABLE_STEPS + 1))


def normal_correlation(value_of: Callable[[Array], Array], wanted: float) -> float:
    """Return the correlation of two normals z whose values g(z) have the wanted correlation.

    Mehler's formula: normals of correlation ρ have values of correlation Σ s_k ρ^k, where s_k is
    the share of the variance of g in its k-th Hermite polynomial.

    Args:
        value_of: g.
        wanted: 0 to below 1.
    """
    if wanted == 0.0:
        return 0.0
    from scipy.optimize import brentq  # slow to import, and few scenarios need it

    z = np.linspace(-_REACH, _REACH, _GRID)
    weight = np.exp(-0.5 * z * z) / math.sqrt(2.0 * math.pi) * (z[1] - z[0])
    value = value_of(z)
    value = value - (value * weight).sum()
    variance = (value * value * weight).sum()
    if variance == 0.0:
        return 0.0
    shares = np.empty(_TERMS)
    before, now = np.zeros_like(z), np.ones_like(z)
    for k in range(1, _TERMS + 1):
        before, now = now, (z * now - math.sqrt(k - 1.0) * before) / math.sqrt(k)
        shares[k - 1] = (value * now * weight).sum() ** 2 / variance
    powers = np.arange(1, _TERMS + 1)
    rest = max(1.0 - float(shares.sum()), 0.0)

    def correlation(rho: float) -> float:
        # the part that no term has, very long tails, counts like the last term
        return float((shares * rho**powers).sum()) + rest * rho**_TERMS

    return float(brentq(lambda rho: correlation(rho) - wanted, 0.0, 1.0, xtol=1e-12))


_REACH, _GRID, _TERMS = 14.0, 20001, 80


def netem_table(jitter: int, standard: Callable[[Array], Array] | None = None) -> NDArray[np.int16]:
    """Return the 4096 numbers from which netem draws a delay, in 1/8192 of the spread.

    Those of normal, pareto and paretonormal are those of iproute2's files, to within 1.

    Args:
        jitter: NORMAL, PARETO or PARETONORMAL; others are quantiles of `standard`.
        standard: a function of z (K,) with mean 0 and standard deviation 1.
    """
    j = np.arange(NETEM_TABLE)
    normal = NETEM_SCALE * quantile((4.0 * j + 0.5) / (4.0 * NETEM_TABLE))
    tail = (1.0 - j / NETEM_TABLE) ** (-1.0 / PARETO_SHAPE) - PARETO_MEAN
    heavy = np.minimum(np.rint(NETEM_SCALE * NETEM_PARETO * tail), LARGEST_ENTRY)
    if jitter == PARETO:
        entries = heavy
    elif jitter == PARETONORMAL:
        entries = np.rint(NORMAL_SHARE * normal + (1.0 - NORMAL_SHARE) * heavy)
    else:
        entries = np.rint(NETEM_SCALE * standard(table_z()) if standard else normal)
    return np.clip(entries, -LARGEST_ENTRY - 1, LARGEST_ENTRY).astype(np.int16)
