"""Oscillations in sampled signals: frequency and damping ratio, by the matrix pencil method."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array

MAX_ORDER = 16  # poles that are fitted, twice the number of oscillations
RANK = 1e-5  # singular values below this share of the largest are left out
NEGLIGIBLE = 0.01  # share of the largest part's RMS value
SLOWEST_HZ = 0.1
FASTEST_SAMPLES_HZ = 25.0  # more samples per second cost time and show nothing more


@dataclass(frozen=True, slots=True)
class Oscillation:
    """A sinusoid that decays or grows exponentially."""

    frequency_hz: float  # of its zero crossings
    damping: float  # ratio; negative if it grows


def find_oscillations(response: Array, dt: float) -> list[Oscillation]:
    """Return the oscillations in signals, the least damped first.

    Hua and Sarkar, IEEE Trans. ASSP 38 (1990) 814, on the stacked Hankel matrices of the signals.
    Parts of the response below 0.1 Hz, and those whose RMS value over the record is below a
    hundredth of the largest part's in every signal, are left out.

    Args:
        response: (K, m), m signals with the same modes; zero if nothing moves.
        dt: s, between samples.
    """
    stride = max(1, math.floor(1.0 / (dt * FASTEST_SAMPLES_HZ) + 1e-9))
    signals, dt = response[::stride], stride * dt
    largest = np.abs(signals).max(axis=0)
    if not largest.any():
        return []
    signals = signals[:, largest > 0.0] / largest[largest > 0.0]
    count = len(signals)
    span = count // 3
    hankel = np.vstack(
        [np.lib.stride_tricks.sliding_window_view(signal, span) for signal in signals.T]
    )
    # The right singular vectors, as eigenvectors of a smaller matrix: an SVD by two threads of a
    # busy machine takes a hundred times longer; einsum has no threads.
    squares, right = np.linalg.eigh(np.einsum("ki,kj->ij", hankel, hankel))
    order = min(MAX_ORDER, int((squares > RANK**2 * squares[-1]).sum()))
    basis = right[:, -order:]
    poles = np.linalg.eigvals(np.linalg.pinv(basis[:-1]) @ basis[1:]).astype(complex)
    poles = poles[np.abs(poles) > 1e-6]
    shapes = poles ** np.arange(count)[:, np.newaxis]
    heights = np.sqrt((np.abs(shapes) ** 2).mean(axis=0))
    factors = np.linalg.lstsq(shapes / heights, signals.astype(complex), rcond=None)[0]
    parts = np.abs(factors).max(axis=1)
    rates = np.log(poles) / dt
    found = [
        Oscillation(float(rate.imag) / (2.0 * math.pi), float(-rate.real / abs(rate)))
        for rate, part in zip(rates, parts, strict=True)
        if part > NEGLIGIBLE * parts.max() and rate.imag > 2.0 * math.pi * SLOWEST_HZ
    ]
    return sorted(found, key=lambda each: each.damping)
