"""How deviations grow from follower to follower, from the linearised followers.

A follower with the gains β_i for the leader and β_ij for others, B in sum, answers a deviation of
aircraft j from its slot by

    T_ij = β_ij / B · M(B)

where M is its closed loop: its position by a displacement of all positions that it uses. Together
the followers pass on at most (1 − β_i / B) · max |M|, which is 1 or less where the leader's share
β_i / B is at least 1 − 1 / max |M|.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from testbed.core.records import Array
from testbed.linear.predicted_response import Complex, StraightFormation

RECORD_S = 300.0  # of impulse responses, at least
HIGHEST_HZ = 3.0  # where peaks are looked for; beyond, responses are far below 1
_CLOSE = 1.003  # a peak this near 1 is that of a slow integral, and no growth


class HopGain(NamedTuple):
    """What a follower passes on of deviations of other followers, along one axis.

    Attributes:
        gain: of sinusoids, the largest Σ_j |T_ij|: the L2 gain of a chain's hop.
        frequency_hz: at which it is largest.
        peak_gain: of largest deviations, Σ_j Σ_k |h_ij(k)| of impulse responses: the L∞ gain.
        leader_share: β_i / B.
        needed_share: least share at which `gain` is 1 with the same B.
    """

    gain: float
    frequency_hz: float
    peak_gain: float
    leader_share: float
    needed_share: float


def hop_gains(formation: StraightFormation, axis: int) -> tuple[HopGain | None, ...]:
    """Return what each follower (n,) passes on; None: no other follower's position acts on it.

    Args:
        formation: linearised.
        axis: of AXES.
    """
    known: dict[tuple[float, ...], HopGain | None] = {}
    found = []
    for i in range(len(formation.names)):
        leader, *others = formation.gains[i, :, axis].tolist()
        # alike followers with the same gains pass on the same
        key = (leader, *sorted(each for each in others if each)) if formation.alike else (i,)
        if key not in known:
            known[key] = _hop_gain(formation, i, axis)
        found.append(known[key])
    return tuple(found)


def _hop_gain(formation: StraightFormation, follower: int, axis: int) -> HopGain | None:
    gains = formation.gains[follower, :, axis]
    senders = [j for j in range(1, len(gains)) if gains[j]]
    if not senders:
        return None
    count = 2 ** math.ceil(math.log2(RECORD_S / formation.dt))
    frequency = np.arange(count // 2 + 1) / (count * formation.dt)
    frequency[0] = 1e-3 * frequency[1]  # the integrals have no response at 0
    responses = np.array([formation.hop(follower, j, axis, frequency) for j in senders])
    passed = np.abs(responses).sum(axis=0)
    at = int(passed[frequency <= HIGHEST_HZ].argmax())
    share = float(gains[0] / gains.sum())
    largest = float(passed[at]) / (1.0 - share)  # max |M|
    return HopGain(
        float(passed[at]),
        float(frequency[at]) if at else 0.0,
        float(sum(np.abs(impulse_response(each)).sum() for each in responses)),
        share,
        needed_share(largest),
    )


def needed_share(largest: float, growth: float = 1.0, hops: int = 1) -> float:
    """Return the least share β_i / B with which a string of hops grows by at most a factor.

    ((1 − share) max |M|)^hops ≤ growth.

    Args:
        largest: max |M|, at this B.
        growth: along the whole string, 1 or more.
        hops: of it.
    """
    if largest < _CLOSE:
        return 0.0
    return max(0.0, 1.0 - math.pow(growth, 1.0 / hops) / largest)


def leader_growth(share: float, hops: int) -> float:
    """Return the slot error at the end of a string over that of a follower with no other ahead.

    Of a slow motion of the leader; all have the same sum of gains B. It is the sum of (1 − share)^k
    for k = 0 to `hops`: `hops` + 1 without gains for the leader, below 1 / share with them.
    """
    return float(sum((1.0 - share) ** k for k in range(hops + 1)))


def impulse_response(response: Complex) -> Array:
    """Return the impulse response (2 F − 2,) of a frequency response (F,) from 0 to 0.5 / dt."""
    ends = np.real(response[[0, -1]])
    found: Array = np.fft.irfft(np.concatenate((ends[:1], response[1:-1], ends[1:])))
    return found
