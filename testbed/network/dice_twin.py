"""The compiled twin of `dice`, `philox` and `delays`: the same steps for one packet.

A test holds it to the numpy functions by way of `fates`. numba compiles each function at its first
call.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import cos, erfc, exp, isnan, log, pi, sqrt

import numpy as np

from testbed.compiled import twin
from testbed.network.channel import WHOLE
from testbed.network.delays import (
    NANOSECONDS,
    NETEM_PARETO,
    NETEM_SCALE,
    NETEM_TABLE,
    NORMAL_SHARE,
    PARETO_DEVIATION,
    PARETO_MEAN,
    TABLE_STEPS,
    mixed_deviation,
)
from testbed.network.links import (
    BERNOULLI,
    DELAY,
    EMPIRICAL,
    FOUR_STATE,
    GILBERT_ELLIOTT,
    LOGNORMAL,
    LOSS,
    NO_JITTER,
    NORMAL,
    PARETO,
    UNIFORM,
)
from testbed.network.philox import BUMPS, MULTIPLIERS, ROUNDS

LOW, HALF, ONE = np.uint64(0xFFFFFFFF), np.uint64(32), np.uint64(1)
M0, M1 = np.uint64(MULTIPLIERS[0]), np.uint64(MULTIPLIERS[1])
B0, B1 = np.uint64(BUMPS[0]), np.uint64(BUMPS[1])
UNIT = 2.0**-32
HEAVY = (1.0 - NORMAL_SHARE) * NETEM_PARETO * PARETO_DEVIATION
MIXED = mixed_deviation()
ALWAYS = np.uint64(WHOLE)


@twin
def philox(key, counter, copy, block):
    k0, k1 = key[0], key[1]
    number = np.uint64(counter)
    x0, x1, x2, x3 = number & LOW, number >> HALF, np.uint64(copy), np.uint64(block)
    for _ in range(ROUNDS):
        p0, p1 = M0 * x0, M1 * x2
        x0, x1, x2, x3 = (p1 >> HALF) ^ x1 ^ k0, p1 & LOW, (p0 >> HALF) ^ x3 ^ k1, p0 & LOW
        k0, k1 = (k0 + B0) & LOW, (k1 + B1) & LOW
    return x0, x1, x2, x3


@twin
def unit(word):
    return (float(word) + 0.5) * UNIT


@twin
def blended(link, state, event, word):
    blend = link.blend[event]
    if blend == 0:
        return word
    before = state.blended[event]
    dice = (word * (ALWAYS - blend) + before * (blend + ONE)) >> HALF
    state.blended[event] = dice
    return dice


@twin
def happens(link, state, event, word):
    if link.netem:
        share = link.share[event]
        happened = False
        if share > 0:
            happened = share >= blended(link, state, event, word)
    else:
        chance = link.after_one[event] if state.had[event] else link.after_none[event]
        happened = unit(word) < chance
    state.had[event] = happened
    return happened


@twin
def loses(link, state, word, second):
    p = link.p
    if link.loss == BERNOULLI:
        return happens(link, state, LOSS, word)
    u = unit(word)
    if link.loss == GILBERT_ELLIOTT:
        bad = state.chain
        lost = unit(second) < (p[2] if bad else p[3])
        if u < (p[1] if bad else p[0]):
            state.chain = 1 - bad
        return lost
    if link.loss == FOUR_STATE:
        at = state.chain
        if at == 0:
            after = 3 if u < p[4] else (2 if u < p[4] + p[0] else 0)
        elif at == 1:
            after = 2 if u < p[3] else 1
        elif at == 2:
            after = 1 if u < p[2] else (0 if u < p[2] + p[1] else 2)
        else:
            after = 0
        state.chain = after
        return after >= 2
    return False


@twin
def varied(link, z, quantiles):
    kind = link.jitter
    if kind == NORMAL:
        return link.spread * z
    if kind == LOGNORMAL:
        return exp(link.shape[0] + link.shape[1] * z) - link.delay
    below = 0.5 * erfc(-z / sqrt(2.0))
    if kind == UNIFORM:
        return link.spread * (2.0 * below - 1.0)
    if kind == EMPIRICAL:
        at = below * TABLE_STEPS
        k = min(int(at), TABLE_STEPS - 1)
        table = quantiles[link.table]
        return table[k] + (at - k) * (table[k + 1] - table[k])
    heavy = ((0.5 * erfc(z / sqrt(2.0))) ** (-1.0 / 3.0) - PARETO_MEAN) / PARETO_DEVIATION
    if kind == PARETO:
        return link.spread * heavy
    return link.spread * (NORMAL_SHARE * z + HEAVY * heavy) / MIXED


@twin
def exact_delay(link, state, word, second, quantiles):
    if link.jitter == NO_JITTER:
        return link.delay
    normal = sqrt(-2.0 * log(unit(word))) * cos(2.0 * pi * unit(second))
    if isnan(state.z):
        state.z = normal
    else:
        state.z = link.rho * state.z + sqrt(1.0 - link.rho * link.rho) * normal
    return max(link.delay + varied(link, state.z, quantiles), 0.0)


@twin
def netem_delay(link, state, word, tables):
    if link.jitter == NO_JITTER:
        return link.delay
    dice = blended(link, state, DELAY, word)
    spread = np.rint(link.spread * NANOSECONDS)
    if link.jitter == UNIFORM:
        more = float(dice % np.uint64(max(2.0 * spread, 1.0))) - spread
    else:
        entry = tables[link.table, int(dice % np.uint64(NETEM_TABLE))]
        more = np.rint(spread * entry / NETEM_SCALE)
    return max(link.delay + more / NANOSECONDS, 0.0)
