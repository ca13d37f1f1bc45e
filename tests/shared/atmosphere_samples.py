"""Flights through turbulence of each aircraft's own, and its expected statistics."""

import os
from dataclasses import dataclass

import numpy as np
from cases import ALL
from reference.adapters_atmosphere import make_filters
from scipy.fft import irfft, next_fast_len
from scipy.linalg import solve_discrete_lyapunov
from scipy.signal import periodogram
from scipy.stats import binom, chi2

from testbed.atmosphere.airframe_wind import LOCAL_WIND
from testbed.atmosphere.dryden import DrydenTurbulence
from testbed.atmosphere.mil_f_8785c import HIGH, INTENSITIES, LOW, Scales
from testbed.atmosphere.spectra import psd
from testbed.core.call_list import run_steps
from testbed.core.records import AIRCRAFT, allocate

SAMPLES = int(os.environ.get("TESTBED_AIR_SAMPLES", "16"))  # aircraft per case
IN_FULL = "TESTBED_AIR_SAMPLES" in os.environ
SPAN = 2.8
LONGEST = 1000.0  # L ω/V up to which the sum of Dryden fields is von Kármán's
COMPONENTS = ("u", "v", "w", "p", "q", "r")


@dataclass(frozen=True)
class Case:
    spectrum: str
    airspeed: float
    height: float
    dt: float
    seed: int

    @property
    def model(self):
        return Scales(self.spectrum, *INTENSITIES["moderate"])

    @property
    def scales(self):
        sigma, length = self.model(np.array([self.height]))
        return sigma[0], length[0]

    def density(self, frequency):
        return psd(self.spectrum, frequency, self.airspeed, *self.scales, SPAN)

    def filters(self):
        scales = self.model(np.array([self.height]))
        distance = np.array([self.airspeed * self.dt])
        return make_filters(self.spectrum, distance, *scales, np.array([SPAN]))


def cases(spectrum):
    """Two airspeeds, one height in each altitude band, two steps; every case its own draws.

    Unless they are flown in full, each airspeed at each height has one of the two steps, or each
    height one airspeed and the larger step, as the smaller one needs four times as many.
    """
    heights = (100.0, 450.0, 900.0)
    assert heights[0] < LOW < heights[1] < HIGH < heights[2]
    every = [(v, h, dt) for v in (15.0, 30.0) for h in heights for dt in (0.02, 0.005)]
    simulate = [Case(spectrum, *each, seed) for seed, each in enumerate(every)]
    few = (0, 3, 4, 7, 8, 11) if ALL else (0, 8, 10)
    return simulate if IN_FULL else [simulate[seed] for seed in few]


def simulate(turbulence, height, airspeed, steps):
    """Turbulence and rates (steps, N, 6) of aircraft that fly north and level through still air."""
    aircraft = allocate(AIRCRAFT, len(height))
    motion, wind = aircraft["truth"], aircraft["wind"]
    motion["position_ned"][:, 2], motion["velocity_ned"][:, 0] = -height, airspeed
    step = turbulence.bind(aircraft, allocate(LOCAL_WIND, len(height)))
    out = np.empty((steps, len(height), 6))
    for each in out:
        wind["wind_ned"] = wind["wind_gradient_rates"] = 0.0
        run_steps([step], 0.0)
        each[:, :3], each[:, 3:] = wind["wind_ned"], wind["wind_gradient_rates"]
    return out


def sample(turbulence, height, airspeed):
    """The next sample alone: turbulence and rates (N, 3)."""
    (found,) = simulate(turbulence, height, airspeed, 1)
    return found[:, :3], found[:, 3:]


def fly(case, steps, aircraft):
    """Turbulence and rates (steps, aircraft, 6)."""
    turbulence = DrydenTurbulence(
        [f"uav{i}" for i in range(aircraft)],
        seed=case.seed,
        dt=case.dt,
        spans=[SPAN] * aircraft,
        spectrum=case.spectrum,
        scales=case.model,
        hold_s=1e9,  # heights and airspeeds stay
    )
    height, airspeed = np.full(aircraft, case.height), np.full(aircraft, case.airspeed)
    return simulate(turbulence, height, airspeed, steps)


def closed_variance(case):
    """The integral of the closed forms over all frequencies, by trapezia in log f."""
    grid = np.linspace(np.log(1e-9), np.log(1e12), 20001)
    return np.trapezoid(case.density(np.exp(grid)) * np.exp(grid), grid, axis=1)


def discrete_variance(filters):
    """Variance (6) of what one aircraft's filters give, by their Lyapunov equations."""
    decay, noise, gain = (each[0] for each in (filters.decay, filters.noise, filters.gain))
    plain = gain**2 * noise**2 / (1.0 - decay**2)
    transverse = np.zeros((2, 2))  # lateral and vertical; speed and rate
    for axis in range(2):
        for part in range(len(gain) - 1):
            root = filters.root[0, axis, part]
            p = solve_discrete_lyapunov(filters.transition[0, axis, part], root @ root.T)
            speed, rate = np.append(filters.speed[0, axis, part], 0.0), filters.rate[0, axis, part]
            transverse[axis] += speed @ p @ speed, rate @ p @ rate
    (v, r), (w, q) = transverse
    return np.array([plain[:-1].sum(), v, w, plain[-1], q, r])


def sampled_density(case, frequency, aliases=300):
    """The closed forms as a process sampled every dt has them: aliases summed."""
    alias = np.arange(-aliases, aliases + 1)[:, None] / case.dt
    folded = np.abs(frequency + alias)
    return case.density(folded.ravel()).reshape(6, *folded.shape).sum(axis=1)


def band(case):
    """Two decades of frequency, Hz, where filters and closed forms should agree."""
    low, long = 0.2 / case.dt, LONGEST * case.airspeed / (2.0 * np.pi * case.scales[1].max())
    return min(low, long) / 100.0, min(low, long)


def steps_of(case):
    """Eight periods of the lowest frequency: below, a Hann window biases a f^(−5/3) by over 1 %."""
    return int(np.ceil(8.0 / (band(case)[0] * case.dt)))


def inside(case, flight, against=None):
    """Which bins (6, F) of the mean periodogram lie in the 95 % band of χ².

    Every other bin: those of a Hann window that are two apart are all but independent.
    """
    frequency, seen = periodogram(flight, 1.0 / case.dt, "hann", detrend=False, axis=0)
    low, high = band(case)
    chosen = np.flatnonzero((frequency >= low) & (frequency <= high))[::2]
    freedom = 2 * flight.shape[1]
    expected = sampled_density(against or case, frequency[chosen])
    ratio = freedom * seen[chosen].mean(axis=1).T / expected
    return (ratio > chi2.ppf(0.025, freedom)) & (ratio < chi2.ppf(0.975, freedom))


def freedom(case, steps, aircraft):
    """Effective degrees of freedom (6) of a mean square: 2 σ⁴ over its variance.

    The variance of the mean of x² is 2 Σ (n − |k|) R_k²/n²; R_k from the closed forms.
    """
    fine = next_fast_len(4 * steps, real=True)  # so that R does not wrap into the lags used
    frequency = np.arange(fine // 2 + 1) / (fine * case.dt)
    correlation = irfft(sampled_density(case, frequency, 2), fine, axis=1)[:, :steps]
    correlation /= correlation[:, :1]
    weight = (steps - np.arange(steps)) * np.where(np.arange(steps) > 0, 2.0, 1.0)
    return aircraft * steps**2 / (weight * correlation**2).sum(axis=1)


def least(count, share=0.95, chance=1e-4):
    """So many of count independent draws fall inside, but for a chance."""
    return binom.ppf(chance, count, share)
