"""Random outcomes of one packet: events, loss, delay, with their correlation between packets.

With arithmetic `exact`, probabilities, correlations and distributions are those of the scenario.
With `netem` they are those of the integer arithmetic of Linux's net/sched/sch_netem.c.
"""

from __future__ import annotations

from math import cos, erfc, exp, isnan, log, pi, sqrt

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.records import Array, Record, Records
from testbed.network.delays import (
    NANOSECONDS,
    NETEM_PARETO,
    NETEM_SCALE,
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
    NETEM_ONE,
    NETEM_TABLE,
    NO_JITTER,
    NORMAL,
    PARETO,
    UNIFORM,
)
from testbed.network.philox import HALF, ONE, Word, unit

ALWAYS = np.uint64(NETEM_ONE)
PARETO_PART = (1.0 - NORMAL_SHARE) * NETEM_PARETO * PARETO_DEVIATION
MIXED_DEVIATION = mixed_deviation()


@kernel
def correlated_word(p: Record, state: Record, event: int, word: Word) -> Word:
    """Return a random word blended with the last one of the event, as netem's get_crandom().

    netem adds one to the blend and takes 2^32 as one, so that the sum stays within 64 bits.

    Args:
        p: record of LINK_PARAMETERS.
        state: record of LINK_STATE; `blended` is written.
        event: LOSS to DELAY.
        word: of 32 bits, uint64.
    """
    blend = p.blend[event]
    if blend == 0:
        return word
    before = state.blended[event]
    blended = (word * (ALWAYS - blend) + before * (blend + ONE)) >> HALF
    state.blended[event] = blended
    return blended


@kernel
def event_occurs(p: Record, state: Record, event: int, word: Word) -> bool:
    """Return whether a packet has an event; see `correlated_word`. `state.had` is written."""
    if p.netem:
        share = p.share[event]
        occurs = False
        if share > 0:
            occurs = share >= correlated_word(p, state, event, word)
    else:
        probability = p.after_one[event] if state.had[event] else p.after_none[event]
        occurs = unit(word) < probability
    state.had[event] = occurs
    return occurs


@kernel
def loss_occurs(p: Record, state: Record, word: Word, second: Word) -> bool:
    """Return whether the loss model loses a packet.

    States of FOUR_STATE: 0 received in a gap, 1 received in a burst, 2 lost in a burst, 3 lost in
    a gap (S. Salsano, F. Ludovici, A. Ordine and D. Giannuzzi, 2012, and netem's `loss state`).

    Args:
        p: record of LINK_PARAMETERS.
        state: record of LINK_STATE; `chain` or `had` is written.
        word: random, of 32 bits, uint64.
        second: another.
    """
    if p.loss == BERNOULLI:
        return event_occurs(p, state, LOSS, word)
    u = unit(word)
    if p.loss == GILBERT_ELLIOTT:
        bad = state.chain
        lost = unit(second) < (p.p[2] if bad else p.p[3])
        if u < (p.p[1] if bad else p.p[0]):
            state.chain = 1 - bad
        return bool(lost)
    if p.loss == FOUR_STATE:
        last = state.chain
        if last == 0:
            after = 3 if u < p.p[4] else (2 if u < p.p[4] + p.p[0] else 0)
        elif last == 1:
            after = 2 if u < p.p[3] else 1
        elif last == 2:
            after = 1 if u < p.p[2] else (0 if u < p.p[2] + p.p[1] else 2)
        else:
            after = 0
        state.chain = after
        return after >= 2
    return False


@kernel
def jitter(p: Record, z: float, table: Record) -> float:
    """Return the jitter of the delay, s, of a standard normal z.

    Args:
        p: record of LINK_PARAMETERS.
        z: of a standard normal distribution.
        table: record of DELAY_TABLE, of the link.
    """
    kind = p.jitter
    if kind == NORMAL:
        return float(p.spread * z)
    if kind == LOGNORMAL:
        return float(exp(p.lognormal[0] + p.lognormal[1] * z) - p.delay)
    below = 0.5 * erfc(-z / sqrt(2.0))
    if kind == UNIFORM:
        return float(p.spread * (2.0 * below - 1.0))
    if kind == EMPIRICAL:
        at = below * TABLE_STEPS
        k = min(int(at), TABLE_STEPS - 1)
        low, high = table.values[k], table.values[k + 1]
        return float(low + (at - k) * (high - low))
    pareto = ((0.5 * erfc(z / sqrt(2.0))) ** (-1.0 / 3.0) - PARETO_MEAN) / PARETO_DEVIATION
    if kind == PARETO:
        return float(p.spread * pareto)
    mixed = NORMAL_SHARE * z + PARETO_PART * pareto
    return float(p.spread * mixed / MIXED_DEVIATION)


@entry
def jitter_values(parameters: Records, z: Array, tables: Records) -> Array:
    """Return `jitter` of one link for many z, s, for tables and correlations.

    Args:
        parameters: (1,) of LINK_PARAMETERS.
        z: (K,) of a standard normal distribution.
        tables: (1,) of DELAY_TABLE.
    """
    values = np.empty(len(z))
    for k in range(len(z)):
        values[k] = jitter(parameters[0], z[k], tables[0])
    return values


@kernel
def exact_delay(p: Record, state: Record, word: Word, second: Word, table: Record) -> float:
    """Return a packet's delay, s, from a first-order autoregressive normal process.

    Its normal numbers are those of Box and Muller.

    Args:
        p: record of LINK_PARAMETERS.
        state: record of LINK_STATE; `z` is written.
        word: random, of 32 bits, uint64.
        second: another.
        table: record of DELAY_TABLE, of the link.
    """
    if p.jitter == NO_JITTER:
        return float(p.delay)
    normal = sqrt(-2.0 * log(unit(word))) * cos(2.0 * pi * unit(second))
    if isnan(state.z):
        state.z = normal
    else:
        state.z = p.rho * state.z + sqrt(1.0 - p.rho * p.rho) * normal
    return max(float(p.delay + jitter(p, state.z, table)), 0.0)


@kernel
def netem_delay(p: Record, state: Record, word: Word, table: Record) -> float:
    """Return a packet's delay, s, as netem's tabledist(); times are whole nanoseconds there.

    Args:
        p: record of LINK_PARAMETERS.
        state: record of LINK_STATE; `blended` is written.
        word: random, of 32 bits, uint64.
        table: record of DELAY_TABLE, of the link.
    """
    if p.jitter == NO_JITTER:
        return float(p.delay)
    drawn = correlated_word(p, state, DELAY, word)
    spread = np.rint(p.spread * NANOSECONDS)
    if p.jitter == UNIFORM:
        more = float(drawn % np.uint64(max(2.0 * spread, 1.0))) - spread
    else:
        entry = table.values[int(drawn % np.uint64(NETEM_TABLE))]
        more = np.rint(spread * entry / NETEM_SCALE)
    return max(float(p.delay + more / NANOSECONDS), 0.0)
