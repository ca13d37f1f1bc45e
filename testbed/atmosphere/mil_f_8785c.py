"""Turbulence intensities and scale lengths over height, MIL-F-8785C sections 3.7.2 and 3.7.3.

Heights are above the ground, in m; below 10 ft the values are those at 10 ft. Lengths follow
MIL-F-8785C; MIL-HDBK-1797 writes the same spectra with the lateral and vertical lengths halved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.frames import FOOT
from testbed.core.records import Array

KNOT = 1852.0 / 3600.0  # m/s
LOWEST = 10.0 * FOOT
LOW = 1000.0 * FOOT  # up to here the low-altitude model
HIGH = 2000.0 * FOOT  # from here the medium and high-altitude model; linear between
ISOTROPIC_LENGTH = {"dryden": 1750.0 * FOOT, "von-karman": 2500.0 * FOOT}


class Intensity(NamedTuple):
    """The parameters of an intensity of turbulence, below LOW and above HIGH."""

    w20: float  # m/s, wind at 20 ft
    probability: float  # that the intensity is exceeded


INTENSITIES = {
    "light": Intensity(15.0 * KNOT, 1e-2),
    "moderate": Intensity(30.0 * KNOT, 1e-3),
    "severe": Intensity(45.0 * KNOT, 1e-5),
}

# MIL-F-8785C figure 7, as the Aerospace Blockset and JSBSim's FGWinds both read it: ft/s.
CHART_HEIGHT = FOOT * np.array(
    [500, 1750, 3750, 7500, 15000, 25000, 35000, 45000, 55000, 65000, 75000, 80000]
)
CHART_PROBABILITY = np.array([2e-1, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6])
CHART = FOOT * np.array(
    [
        [3.2, 2.2, 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [4.2, 3.6, 3.3, 1.6, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [6.6, 6.9, 7.4, 6.7, 4.6, 2.7, 0.4, 0.0, 0.0, 0.0, 0.0, 0.0],
        [8.6, 9.6, 10.6, 10.1, 8.0, 6.6, 5.0, 4.2, 2.7, 0.0, 0.0, 0.0],
        [11.8, 13.0, 16.0, 15.1, 11.6, 9.7, 8.1, 8.2, 7.9, 4.9, 3.2, 2.1],
        [15.6, 17.6, 23.0, 23.6, 22.1, 20.0, 16.0, 15.1, 12.1, 7.9, 6.2, 5.1],
        [18.7, 21.5, 28.4, 30.2, 30.7, 31.0, 25.2, 23.1, 17.5, 10.7, 8.4, 7.2],
    ]
)


def high_altitude_weight(height: Array) -> Array:
    """Return the weight of the medium and high-altitude model (...).

    It is 0 up to LOW and 1 from HIGH.
    """
    weight: Array = np.clip((height - LOW) / (HIGH - LOW), 0.0, 1.0)
    return weight


def _anisotropy(height: Array) -> Array:
    """Return 0.177 + 0.000823 h (...), with h in ft between 10 and 1000.

    It is 1 at the upper end.
    """
    return 0.177 + 0.000823 * np.clip(height, LOWEST, LOW) / FOOT


def scale_lengths(height: Array, spectrum: str) -> Array:
    """Return L_u, L_v, L_w (..., 3) m at heights (...); figure 10 and section 3.7.2.

    Args:
        height: above the ground, m.
        spectrum: "dryden" or "von-karman", which differ from LOW upwards.
    """
    height = np.asarray(height, dtype=np.float64)
    low = np.clip(height, LOWEST, LOW)
    horizontal = low / _anisotropy(height) ** 1.2
    lengths = np.stack([horizontal, horizontal, low], axis=-1)
    return lengths + high_altitude_weight(height)[..., None] * (
        ISOTROPIC_LENGTH[spectrum] - lengths
    )


def exceedance_sigma(height: Array, probability: float) -> Array:
    """Return σ (...) m/s that is exceeded with a probability at heights (...); figure 7.

    Linear in height and in the logarithm of the probability; beyond the chart as at its edge.

    Args:
        height: above the ground, m.
        probability: of exceedance.

    Raises:
        InputError: the probability is not on the chart.
    """
    most, least = float(CHART_PROBABILITY[0]), float(CHART_PROBABILITY[-1])
    if not least <= probability <= most:
        raise InputError(
            f"probability {probability:g}: write one on the chart, from {least:g} to {most:g}"
        )
    rarity = -np.log(CHART_PROBABILITY)
    at = min(int(np.searchsorted(rarity, -np.log(probability), "right")), len(rarity) - 1)
    weight = (-np.log(probability) - rarity[at - 1]) / (rarity[at] - rarity[at - 1])
    curve = (1.0 - weight) * CHART[at - 1] + weight * CHART[at]
    sigma: Array = np.interp(height, CHART_HEIGHT, curve)
    return sigma


def intensities(height: Array, w20: float, probability: float) -> Array:
    """Return σ_u, σ_v, σ_w (..., 3) m/s at heights (...).

    From figure 11, section 3.7.3 and figure 7.

    Args:
        height: above the ground, m.
        w20: wind at 20 ft, m/s, for heights up to LOW.
        probability: of exceedance, for heights from HIGH on.

    Raises:
        InputError: the wind is negative, or the probability is not on the chart.
    """
    if not 0.0 <= w20 < np.inf:
        raise InputError(f"w20_mps {w20:g}: write the wind at 20 ft, 0 m/s or more")
    height = np.asarray(height, dtype=np.float64)
    vertical = np.full_like(height, 0.1 * w20)
    horizontal = vertical / _anisotropy(height) ** 0.4
    low = np.stack([horizontal, horizontal, vertical], axis=-1)
    high = exceedance_sigma(np.maximum(height, HIGH), probability)[..., None]
    return low + high_altitude_weight(height)[..., None] * (high - low)


@dataclass(frozen=True, slots=True)
class Scales:
    """Intensities and lengths as functions of height: the standard's, or constants instead.

    Raises:
        InputError: the spectrum is unknown, or a value is out of its range.
    """

    spectrum: str  # "dryden" or "von-karman"
    w20: float  # m/s
    probability: float
    sigma: tuple[float, float, float] | None = None  # m/s: longitudinal, lateral, vertical
    length: tuple[float, float, float] | None = None  # m

    def __post_init__(self) -> None:
        """See the class."""
        if self.spectrum not in ISOTROPIC_LENGTH:
            known = " or ".join(ISOTROPIC_LENGTH)
            raise InputError(f"turbulence {self.spectrum!r}: write {known}")
        intensities(np.zeros(1), self.w20, self.probability)
        if self.sigma is not None and not all(0.0 <= each < np.inf for each in self.sigma):
            raise InputError(f"sigma_mps {list(self.sigma)}: write three numbers of 0 m/s or more")
        if self.length is not None and not all(0.0 < each < np.inf for each in self.length):
            raise InputError(f"length_m {list(self.length)}: write three lengths above 0 m")

    def __call__(self, height: Array) -> tuple[Array, Array]:
        """Return σ (..., 3) m/s and L (..., 3) m at heights (...).

        Heights are m above the ground.
        """
        sigma = intensities(height, self.w20, self.probability)
        length = scale_lengths(height, self.spectrum)
        if self.sigma is not None:
            sigma = np.broadcast_to(np.array(self.sigma, dtype=np.float64), sigma.shape)
        if self.length is not None:
            length = np.broadcast_to(np.array(self.length, dtype=np.float64), length.shape)
        return sigma, length
