"""Fly probes through the air of a scenario, and estimate the spectra they measure."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.atmosphere.airframe_wind import MEAN, WING
from testbed.atmosphere.spectra import cross_spectra
from testbed.atmosphere.spectra import psd as model_psd
from testbed.atmosphere.turbulence_field import BAND_END, BAND_WHOLE, FINEST
from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, Array, BoolArray, allocate
from testbed.plan.air import build_air, build_mean_wind, turbulence_scales
from testbed.scenario import Scenario, dump, find_aircraft
from testbed.vehicle.jsbsim_adapter import airframe

SCHEMA = """testbed air 2: probes p of P at times k of T; SI units, angles in rad
names (P,), t (T,) s
wind_ned (P, T, 3) velocity of the air averaged over the wing: north, east, down
wind_gradient_rates (P, T, 3) rotation of the air about forward, right, down: dw/dy, -dw/dx, dv/dx
position_ned (P, T, 3) over the ground, from the origin of the scenario
mean_wind_ned (P, T, 3) the mean wind there, which is part of wind_ned
airspeed, course_rad (through the air, clockwise from north), height (above the ground)
span of the airframe; model of turbulence, its sigma (3,) and length (3,) at that height, or
those of the field: longitudinal, lateral, vertical; NaN where there is none
scenario: resolved, YAML"""


class ProbePath(NamedTuple):
    """Straight and level flight of the probes."""

    rate_hz: float
    duration_s: float
    airspeed: float  # m/s
    course: float  # rad, through the air, clockwise from north; also the heading
    height: float  # m above the ground of the origin
    separation: float | None  # m, of a second probe to the right of the first


class ProbeRecord(NamedTuple):
    """Wind at P probes and T times."""

    names: tuple[str, ...]  # P
    time: Array  # (T,) s
    wind_ned: Array  # (P, T, 3) m/s, velocity of the air, averaged over the wing
    wind_gradient_rates: Array  # (P, T, 3) rad/s, rotation of the air about forward, right, down
    position_ned: Array  # (P, T, 3) m, over the ground
    mean_wind_ned: Array  # (P, T, 3) m/s, the scenario's mean wind there
    span: float  # m, of the airframe
    sigma: Array  # (3,) m/s of the turbulence model: longitudinal, lateral, vertical
    length: Array  # (3,) m; both are NaN where there is none

    def about_mean(self, course: float) -> Array:
        """Return the wind minus its mean (P, T, 3) m/s: along a course (rad), right, down."""
        north, east, down = np.moveaxis(self.wind_ned - self.mean_wind_ned, -1, 0)
        cosine, sine = math.cos(course), math.sin(course)
        return np.stack([cosine * north + sine * east, cosine * east - sine * north, down], axis=-1)


def fly_probes(scenario: Scenario, path: ProbePath) -> ProbeRecord:
    """Fly one probe from the leader's start, or two side by side.

    Probes have the leader's airframe, and the turbulence of the leader and of the first follower.
    They drift with the mean wind, but not with gusts and turbulence.

    Raises:
        InputError: a recorded wind is shorter than the flight.
    """
    probes = 1 if path.separation is None else 2
    names = scenario.aircraft_names[:probes]
    frame = airframe(find_aircraft(scenario.leader.aircraft))
    dt = 1.0 / path.rate_hz
    start, origin = scenario.leader.start, scenario.scenario.origin
    mean_wind = build_mean_wind(  # its duration is checked below
        scenario.air.wind, height_m=start.altitude_m, duration_s=0.0
    )
    if not mean_wind.steady and mean_wind.end_s < path.duration_s:
        raise InputError(
            f"--duration {path.duration_s:g}: the recorded wind ends after "
            f"{mean_wind.end_s:g} s; write no more than that"
        )
    frames, no_wakes = [frame] * probes, [False] * probes
    air = build_air(
        scenario.air,
        mean_wind,
        names,
        frames,
        seed=scenario.scenario.seed,
        height_m=start.altitude_m,
        elevation_m=origin.elevation_m,
        dt=dt,
        sheds=no_wakes,
    )
    aircraft = allocate(AIRCRAFT, probes)
    truth, sample = aircraft["truth"], aircraft["wind"]
    air.bind(aircraft)
    count = round(path.duration_s * path.rate_hz)
    time = np.arange(count) / path.rate_hz
    wind, rates, positions, mean = np.empty((4, count, probes, 3))
    forward = np.array([math.cos(path.course), math.sin(path.course), 0.0])
    right = np.array([-forward[1], forward[0], 0.0])
    position = np.array([start.north_m, start.east_m, -path.height]) + np.outer(
        [0.0, path.separation or 0.0][:probes], right
    )
    truth["euler"] = [0.0, 0.0, path.course]
    truth["airspeed"] = truth["equivalent_airspeed"] = path.airspeed
    mean_before = mean_wind.velocity_ned(0.0, path.height)
    for k, now in enumerate(time.tolist()):
        mean_now = mean_wind.velocity_ned(now, path.height)
        if k:  # exact for a steady wind, and for one that is linear between its rows
            drift = 0.5 * (mean_before + mean_now) * [1.0, 1.0, 0.0]
            position = position + (path.airspeed * forward + drift) * dt
        truth["position_ned"] = position
        truth["velocity_ned"] = path.airspeed * forward + mean_now * [1.0, 1.0, 0.0]
        air.sample_wind(now)
        wind[k], rates[k] = sample["wind_ned"], sample["wind_gradient_rates"]
        positions[k], mean[k] = position, mean_now
        mean_before = mean_now
    sigma, length = np.full(3, np.nan), np.full(3, np.nan)
    scales_at = turbulence_scales(scenario.air.turbulence)
    if air.field is not None:
        sigma, length = air.field.sigma, air.field.length
    elif scales_at is not None:
        sigma, length = scales_at(np.array(path.height))
    wind, rates, positions, mean = (
        np.ascontiguousarray(each.swapaxes(0, 1)) for each in (wind, rates, positions, mean)
    )
    return ProbeRecord(names, time, wind, rates, positions, mean, frame.span, sigma, length)


def to_arrays(scenario: Scenario, path: ProbePath, record: ProbeRecord) -> dict[str, Any]:
    """Return the arrays of an .npz file; `schema` describes them."""
    return {
        "schema": np.array(SCHEMA),
        "names": np.array(record.names),
        "t": record.time,
        "wind_ned": record.wind_ned,
        "wind_gradient_rates": record.wind_gradient_rates,
        "position_ned": record.position_ned,
        "mean_wind_ned": record.mean_wind_ned,
        "airspeed": np.array(path.airspeed),
        "course_rad": np.array(path.course),
        "height": np.array(path.height),
        "span": np.array(record.span),
        "model": np.array(scenario.air.turbulence.model),
        "sigma": record.sigma,
        "length": record.length,
        "scenario": np.array(dump(scenario)),
    }


Indices = NDArray[np.intp]

BANDS_PER_OCTAVE = 6
CONFIDENCE = 0.95
MIN_FREEDOM = 4.0  # degrees of freedom below which a coherence is not given
# Squared correlations of periodogram ordinates one and two apart with a Hann taper: (2/3)², (1/6)².
NEXT, NEXT_BUT_ONE = 4.0 / 9.0, 1.0 / 36.0
MIN_SLOPE = 5.0 / 3.0  # exponent with which a spectrum decreases at high frequencies, at least
IMAGES = 12  # number of aliases that are added one by one
GRID = 1500  # frequencies at which a closed form is computed; interpolated between


class SpectrumEstimate(NamedTuple):
    """Spectra of P probes in B frequency bands."""

    frequency_hz: Array  # (B,) mean of each band
    psd: Array  # (P, 3, B) one-sided, (m/s)²/Hz
    coherence: Array  # (3, B) co-spectrum of the first two probes over the root of their spectra
    freedom: Array  # (B,) degrees of freedom of each number
    ordinates_hz: Array  # (k,) frequencies that are averaged
    first: Indices  # (B,) index of the first of each band among them


class ClosedForm(NamedTuple):
    """Spectra and coherence of u, v and w in B frequency bands, sampled at the probes' rate."""

    psd: Array  # (3, B) (m/s)²/Hz
    coherence: Array  # (3, B)


def estimate(velocity: Array, rate_hz: float) -> SpectrumEstimate:
    """Estimate spectra of velocities (P, T, 3) sampled at a rate.

    The mean is removed, and with it the first two ordinates, into which the taper leaks it. The
    coherence is NaN for one probe, and in bands with too few ordinates.
    """
    count = velocity.shape[1]
    taper = np.hanning(count + 1)[:-1]  # periodic
    deviation = velocity - velocity.mean(axis=1, keepdims=True)
    lines = np.fft.rfft(deviation * taper[:, np.newaxis], axis=1)[:, 2 : (count + 1) // 2]
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
        co_spectrum = band_mean((lines[0] * lines[1].conj()).real, first)
        with np.errstate(invalid="ignore"):  # 0 / 0 without turbulence
            coherence = co_spectrum / np.sqrt(psd[0] * psd[1])
        coherence[:, ~_enough_freedom(freedom)] = np.nan
    frequency = ordinates * (rate_hz / count)
    return SpectrumEstimate(
        frequency_hz=band_mean(frequency, first),
        psd=psd,
        coherence=coherence,
        freedom=freedom,
        ordinates_hz=frequency,
        first=first,
    )


def band_mean(values: Array, first: Indices) -> Array:
    """Average values (..., k) over the bands that begin at `first` (B,): (..., B)."""
    width = np.diff(np.append(first, values.shape[-1]))
    means: Array = np.add.reduceat(values, first, axis=-1) / width
    return means


def psd_band(psd: Array, freedom: Array) -> tuple[Array, Array]:
    """Return the band of 95 % of the estimates of a spectrum (..., B): χ², `freedom` (B,)."""
    from scipy.special import gammaincinv  # needed for figures only

    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (2.0 * gammaincinv(0.5 * freedom, p) / freedom for p in (tail, 1.0 - tail))
    return psd * low, psd * high


def coherence_band(coherence: Array, freedom: Array) -> tuple[Array, Array]:
    """Return the band of 95 % of the estimates of a real coherence (..., B).

    With a real cross-spectrum the estimate is the correlation of as many pairs of normal numbers
    as there are degrees of freedom; its inverse hyperbolic tangent is nearly normal (Fisher). NaN
    where there are too few.
    """
    from scipy.special import ndtri

    enough = np.where(_enough_freedom(freedom), freedom - 2.0, np.nan)
    half = ndtri(0.5 * (1.0 + CONFIDENCE)) / np.sqrt(enough)
    centre = np.arctanh(np.clip(coherence, -1.0 + 1e-12, 1.0 - 1e-12))
    centre = centre + coherence / (2.0 * enough)
    return np.tanh(centre - half), np.tanh(centre + half)


def _enough_freedom(freedom: Array) -> BoolArray:
    """Return for each band (B,) whether it and all higher ones have enough degrees of freedom."""
    return np.logical_and.accumulate((freedom > MIN_FREEDOM)[::-1])[::-1]


def unresolved_waves(scenario: Scenario, path: ProbePath) -> tuple[float, float] | None:
    """Return from which frequency a field lacks waves, Hz, and the length of its shortest one, m.

    Waves of all directions contribute at a frequency f, from the length V/f down. At twice the
    lengths over which the field's finest band fades, a quarter of the closed form is missing on
    average of the components, and ever more above. None for turbulence that is no field.
    """
    if scenario.air.turbulence.model != "coherent":
        return None
    whole, shortest = 2.0 * FINEST / BAND_WHOLE, 2.0 * FINEST / BAND_END
    return path.airspeed / (whole + shortest), shortest


# closed forms


def closed_form(
    scenario: Scenario, path: ProbePath, record: ProbeRecord, found: SpectrumEstimate
) -> ClosedForm | None:
    """Return the spectra of the scenario's turbulence model in the bands of an estimate.

    None without turbulence.
    """
    model = scenario.air.turbulence.model
    if model == "none":
        return None
    top = 2.0 * (IMAGES + 1) * path.rate_hz
    grid = np.geomspace(found.ordinates_hz[0], top, GRID)

    def in_bands(spectra: Array) -> Array:
        """Average aliased spectra (3, GRID) over the bands."""

        def interpolate(frequency_hz: Array) -> Array:
            logs = np.log(frequency_hz)
            return np.stack([np.interp(logs, np.log(grid), row) for row in spectra])

        return band_mean(aliased(interpolate, found.ordinates_hz, path.rate_hz), found.first)

    if model != "coherent":
        own = model_psd(model, grid, path.airspeed, record.sigma, record.length, record.span)[:3]
        return ClosedForm(in_bands(own), np.zeros((3, len(found.first))))
    own = in_bands(wing_cross_spectra(grid, path.airspeed, record, 0.0))
    cross = in_bands(wing_cross_spectra(grid, path.airspeed, record, path.separation or 0.0))
    with np.errstate(invalid="ignore"):  # 0 / 0 for a component without turbulence
        return ClosedForm(own, cross / own)


def wing_cross_spectra(
    frequency_hz: Array, airspeed: float, record: ProbeRecord, separation: float
) -> Array:
    """Return cross-spectra (3, F) of a field averaged over two wings side by side.

    The average over sample points of each wing is a sum of the cross-spectra of all pairs.

    Args:
        frequency_hz: (F,).
        airspeed: m/s.
        record: with the field's sigma and length, and the wing span.
        separation: m, between the wings' centres.
    """
    points = 0.5 * record.span * WING
    total = np.zeros((3, len(frequency_hz)))
    for weight, point in zip(MEAN, points, strict=True):
        for other_weight, other in zip(MEAN, separation + points, strict=True):
            total += (weight * other_weight) * cross_spectra(
                frequency_hz, airspeed, record.sigma, record.length, float(other - point)
            )
    return total


def aliased(psd: Callable[[Array], Array], frequency_hz: Array, rate_hz: float) -> Array:
    """Return a one-sided spectrum (..., k) with the aliases of sampling at a rate.

    Beyond `IMAGES` aliases the spectrum is taken as a power of the frequency.
    """
    total = psd(frequency_hz)
    for image in range(1, IMAGES + 1):
        total = total + psd(image * rate_hz - frequency_hz) + psd(image * rate_hz + frequency_hz)
    images = IMAGES + 0.5
    ends = psd(np.array([images, 2.0 * images]) * rate_hz)
    with np.errstate(divide="ignore", invalid="ignore"):  # without turbulence
        slope = np.log2(ends[..., :1] / ends[..., 1:])
    rest: Array = 2.0 * ends[..., :1] * images / (np.fmax(slope, MIN_SLOPE) - 1.0)
    return total + rest
