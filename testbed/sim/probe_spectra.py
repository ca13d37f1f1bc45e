"""Spectra and coherence of what probes felt, with how far chance may carry them.

One tapered periodogram of the whole record, averaged over bands of frequency of constant ratio: so
the lowest bands keep the record's resolution and the highest have the narrowest confidence bands.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array, Truths

Indices = NDArray[np.intp]

BANDS_PER_OCTAVE = 6
CONFIDENCE = 0.95
FEWEST = 4.0  # degrees of freedom that say something of a coherence
# Of a Hann taper: squared correlations of ordinates one and two apart, (2/3)² and (1/6)².
NEXT, NEXT_BUT_ONE = 4.0 / 9.0, 1.0 / 36.0
SLOPE = 5.0 / 3.0  # power with which a spectrum falls at least, where it falls far
IMAGES = 12  # of a spectrum folded at the sampling rate, one by one


class Estimate(NamedTuple):
    """Spectra of P probes in B bands of frequency."""

    frequency_hz: Array  # (B,) mean of each band
    psd: Array  # (P, 3, B) one-sided, (m/s)²/Hz
    coherence: Array  # (3, B) co-spectrum of the first two probes over the root of their spectra
    freedom: Array  # (B,) degrees of freedom of each number
    ordinates_hz: Array  # (k,) frequencies that were averaged
    first: Indices  # (B,) where among them each band begins


def estimate(velocity: Array, rate_hz: float) -> Estimate:
    """Spectra of velocities (P, T, 3) sampled at a rate.

    The mean is taken out and the first two ordinates with it, which the taper mixes with the mean.
    The coherence is not a number if there is one probe, nor in bands of too few ordinates to tell.
    """
    count = velocity.shape[1]
    taper = np.hanning(count + 1)[:-1]  # periodic
    moving = velocity - velocity.mean(axis=1, keepdims=True)
    lines = np.fft.rfft(moving * taper[:, np.newaxis], axis=1)[:, 2 : (count + 1) // 2]
    lines = np.swapaxes(lines, 1, 2) * np.sqrt(2.0 / (rate_hz * np.square(taper).sum()))
    ordinates = np.arange(2, 2 + lines.shape[2])
    octaves = np.log2(ordinates[-1] / ordinates[0])
    edges = np.geomspace(2, ordinates[-1] + 1, max(2, int(octaves * BANDS_PER_OCTAVE)))
    first = np.unique(np.rint(edges[:-1]).astype(np.intp)) - 2
    width = np.diff(np.append(first, len(ordinates)))
    psd = band_mean(np.square(np.abs(lines)), first)
    shared = 2.0 * NEXT * (1.0 - 1.0 / width)
    shared += 2.0 * NEXT_BUT_ONE * np.maximum(0.0, 1.0 - 2.0 / width)
    freedom = 2.0 * width / (1.0 + shared)
    coherence = np.full(psd.shape[1:], np.nan)
    if len(lines) > 1:
        together = band_mean((lines[0] * lines[1].conj()).real, first)
        with np.errstate(invalid="ignore"):  # 0 / 0 where nothing moves
            coherence = together / np.sqrt(psd[0] * psd[1])
        coherence[:, ~_telling(freedom)] = np.nan
    frequency = ordinates * (rate_hz / count)
    return Estimate(
        frequency_hz=band_mean(frequency, first),
        psd=psd,
        coherence=coherence,
        freedom=freedom,
        ordinates_hz=frequency,
        first=first,
    )


def band_mean(values: Array, first: Indices) -> Array:
    """Means (..., B) of values (..., k) over the bands that begin at `first` (B,)."""
    width = np.diff(np.append(first, values.shape[-1]))
    means: Array = np.add.reduceat(values, first, axis=-1) / width
    return means


def folded(psd: Callable[[Array], Array], frequency_hz: Array, rate_hz: float) -> Array:
    """A one-sided spectrum (..., k) as sampling at a rate shows it: what lies above comes down.

    Beyond the images that are added up it is taken to fall on as a power of the frequency.
    """
    total = psd(frequency_hz)
    for image in range(1, IMAGES + 1):
        total = total + psd(image * rate_hz - frequency_hz) + psd(image * rate_hz + frequency_hz)
    images = IMAGES + 0.5
    ends = psd(np.array([images, 2.0 * images]) * rate_hz)
    with np.errstate(divide="ignore", invalid="ignore"):  # of what does not move
        steepness = np.log2(ends[..., :1] / ends[..., 1:])
    rest: Array = 2.0 * ends[..., :1] * images / (np.fmax(steepness, SLOPE) - 1.0)
    return total + rest


def psd_band(expected: Array, freedom: Array) -> tuple[Array, Array]:
    """Where 95 % of estimates of a spectrum (..., B) lie: χ² of their degrees of freedom (B,)."""
    from scipy.special import gammaincinv  # only figures need it

    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (2.0 * gammaincinv(0.5 * freedom, p) / freedom for p in (tail, 1.0 - tail))
    return expected * low, expected * high


def coherence_band(expected: Array, freedom: Array) -> tuple[Array, Array]:
    """Where 95 % of estimates of a real coherence (..., B) lie.

    With a real cross-spectrum the estimate is the correlation of as many pairs of normal numbers
    as there are degrees of freedom, whose inverse hyperbolic tangent is nearly normal (Fisher).
    Not a number where there are too few.
    """
    from scipy.special import ndtri

    enough = np.where(_telling(freedom), freedom - 2.0, np.nan)
    half = ndtri(0.5 * (1.0 + CONFIDENCE)) / np.sqrt(enough)
    centre = np.arctanh(np.clip(expected, -1.0 + 1e-12, 1.0 - 1e-12))
    centre = centre + expected / (2.0 * enough)
    return np.tanh(centre - half), np.tanh(centre + half)


def _telling(freedom: Array) -> Truths:
    """From which band on a coherence means something (B,)."""
    return np.logical_and.accumulate((freedom > FEWEST)[::-1])[::-1]
