"""The spectra and the coherence that probes should find, in closed form."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.air.airframe import MEAN, WING
from testbed.air.coherence import cross_spectra
from testbed.air.spectra import psd
from testbed.scenario import Scenario
from testbed.sim.probe_spectra import IMAGES, Estimate, band_mean, folded
from testbed.sim.probes import Course, Felt
from testbed.state import Array

GRID = 1500  # frequencies of a closed form; between them it is interpolated


class Expected(NamedTuple):
    """Of u, v and w in B bands of frequency, as sampled at the probes' rate."""

    psd: Array  # (3, B) (m/s)²/Hz
    coherence: Array  # (3, B)


def expected(page: Scenario, flown: Course, felt: Felt, found: Estimate) -> Expected | None:
    """What the page's turbulence promises in the bands of an estimate; None: there is none."""
    model = page.air.turbulence.model
    if model == "none":
        return None
    top = 2.0 * (IMAGES + 1) * flown.rate_hz
    grid = np.geomspace(found.ordinates_hz[0], top, GRID)

    def bands(spectra: Array) -> Array:
        """Of spectra (3, GRID)."""

        def between(frequency_hz: Array) -> Array:
            places = np.log(frequency_hz)
            return np.stack([np.interp(places, np.log(grid), row) for row in spectra])

        return band_mean(folded(between, found.ordinates_hz, flown.rate_hz), found.first)

    if model != "coherent":
        own = psd(model, grid, flown.airspeed, felt.sigma, felt.length, felt.span)[:3]
        return Expected(bands(own), np.zeros((3, len(found.first))))
    alone = bands(over_wings(grid, flown.airspeed, felt, 0.0))
    together = bands(over_wings(grid, flown.airspeed, felt, flown.separation or 0.0))
    with np.errstate(invalid="ignore"):  # a component that does not move is like no other
        return Expected(alone, together / alone)


def over_wings(frequency_hz: Array, airspeed: float, felt: Felt, apart: float) -> Array:
    """Cross-spectra (3, F) of a field averaged over two wings side by side, m apart.

    The average of the field at points of each wing is a sum of the cross-spectra of all pairs.
    """
    at = 0.5 * felt.span * WING
    total = np.zeros((3, len(frequency_hz)))
    for weight, place in zip(MEAN, at, strict=True):
        for other_weight, other in zip(MEAN, apart + at, strict=True):
            total += (weight * other_weight) * cross_spectra(
                frequency_hz, airspeed, felt.sigma, felt.length, float(other - place)
            )
    return total
