"""Fit latency, mass, drag and control power of an aircraft to a recording of its flight.

The output-error method (Jategaonkar, Flight Vehicle System Identification, 2nd ed., AIAA 2015,
ch. 4): the model flies the commands of the recording, with its virtual autopilot in the loop. The
squared differences of its outputs from the recorded ones, each divided by a variance of its column,
have the least sum: first by the variance of what was recorded, then by that of the differences that
were left.

Sensors and mountings have offsets. Those of pitch and airspeed, which the autopilot flies with, and
the airspeed at the start are fitted too; the constant differences of the other columns but the
climb rate are not counted.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from testbed.commissioning.airframe_variant import FACTORS, copy_with_factors
from testbed.commissioning.command_files import RESPONSES, Commands
from testbed.commissioning.replay_commands import ReplayedAircraft, ReplaySetup, replay
from testbed.core.errors import InputError
from testbed.core.records import Array
from testbed.core.stats import LEVEL, student_quantile
from testbed.vehicle.trim import TrimError

LATENCY = "latency"
PARAMETERS = (*FACTORS, LATENCY)
NUISANCE = ("start_airspeed", "pitch_offset", "airspeed_offset")
FITTED = (
    *("phi_rad", "theta_rad", "p_radps", "q_radps", "r_radps", "airspeed_mps", "v_down_mps"),
    *("alpha_rad", "pwm_ail", "pwm_ele"),
)
_NEEDED = ("phi_rad", "theta_rad", "airspeed_mps")
_WITHOUT_OFFSET = ("theta_rad", "airspeed_mps", "v_down_mps")
MIN_FITTED_S = 20.0  # of a recording, after what is left out at its start
_FACTOR = (0.2, 5.0, 0.01)  # bounds and the step of finite differences
_RANGES = {
    **dict.fromkeys(FACTORS, _FACTOR),
    LATENCY: (0.0, 1.0, 0.002),
    "start_airspeed": (1.0, 400.0, 0.05),
    "pitch_offset": (-0.2, 0.2, 0.001),
    "airspeed_offset": (-20.0, 20.0, 0.05),
}
_MAX_STEPS = 10  # of each of the two minimisations
MOST_STEPS = 2 * _MAX_STEPS + 1
_TOLERANCE = 1e-3  # relative, of the sum of squares and of the parameters
_LOST = 1e3  # standard deviations, of rows that a candidate does not fly
_BLOCKS = 8  # of the recording, for intervals
_LEAST_SIGMA = 1e-9  # of a column without any difference


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """A parameter with its confidence interval at 95 %."""

    name: str
    value: float  # a factor; of the latency s
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True, slots=True)
class AirframeFit:
    """The result of a fit.

    Attributes:
        parameters: those that were asked for.
        nuisance: the others, by name: m/s, rad.
        correlation: (P, P) of the parameters asked for.
        columns: that were fitted.
        rms: before and after the fit, by column, of differences without their offset.
        flights: how many times the model flew the recording.
    """

    parameters: tuple[FittedParameter, ...]
    nuisance: dict[str, float]
    correlation: Array
    columns: tuple[str, ...]
    rms: dict[str, tuple[float, float]]
    flights: int

    def factors(self) -> dict[str, float]:
        """Return the fitted factors of the airframe, by the names of `FACTORS`."""
        return {each.name: each.value for each in self.parameters if each.name in FACTORS}


def fit_airframe(
    folder: Path,
    commands: Commands,
    setup: ReplaySetup,
    names: Sequence[str],
    *,
    skip_s: float = 2.0,
    progress: Callable[[int], None] = lambda step: None,
) -> AirframeFit:
    """Fit parameters of an aircraft to a recording.

    Args:
        folder: of the aircraft.
        commands: with recorded columns.
        setup: of the replay; its latency and airspeed are where the fit begins.
        names: of PARAMETERS.
        skip_s: of the recording that is left out at its start, s.
        progress: called after each step with the number of steps up to now, at most MOST_STEPS.

    Raises:
        InputError: the recording is too short or has no column to fit to; or a name is unknown.
        AircraftError: a parameter has no place in the aircraft's files.
        TrimError: the aircraft has no steady flight at the start.
    """
    from scipy.optimize import least_squares

    _check(commands, names, skip_s)
    with tempfile.TemporaryDirectory() as scratch:
        flights = _Flights(folder, commands, setup, names, skip_s, Path(scratch))
        x, scale = flights.first, np.array([_RANGES[name][2] for name in flights.names])
        bounds = np.array([_RANGES[name][:2] for name in flights.names]).T
        before = _deviations(flights.differences(x)[0])

        # two steps: the first needs no variances of differences, which depend on where it begins
        for sigma in (flights.variation, None):
            weights = 1.0 / (_deviations(flights.differences(x)[0]) if sigma is None else sigma)

            def residuals(x: Array, weights: Array = weights) -> Array:
                each = flights.differences(x)[0] * weights
                progress(flights.steps)
                return each.ravel()

            def jacobian(x: Array, weights: Array = weights) -> Array:
                return (flights.differences(x)[1] * weights[:, None]).reshape(-1, len(x))

            x = least_squares(
                residuals,
                x,
                jacobian,
                bounds=tuple(bounds),
                x_scale=scale,
                ftol=_TOLERANCE,
                xtol=_TOLERANCE,
                max_nfev=_MAX_STEPS,
            ).x
        difference, slope = flights.differences(x)
        after = _deviations(difference)
        covariance = block_covariance(difference * weights, slope * weights[:, None])
    return _result(flights, x, covariance, np.stack((before, after)), len(names))


def block_covariance(residual: Array, slope: Array, blocks: int = _BLOCKS) -> Array:
    """Estimate the covariance of least-squares parameters whose residuals are correlated.

    The jackknife that leaves out one block of time after the other: correlations within a block and
    between columns may be any, and blocks may tell different amounts (MacKinnon, Nielsen and Webb,
    Fast and reliable jackknife and bootstrap methods for cluster-robust inference, Journal of
    Applied Econometrics 38, 2023). Intervals take Student's t with `blocks` − 1 degrees of freedom.

    Args:
        residual: (K, C) at the minimum, in standard deviations.
        slope: (K, C, P) its derivatives.
        blocks: of equal length.

    Returns:
        (P, P)

    Raises:
        InputError: without one of the blocks the parameters cannot be told apart.
    """
    parts = [
        (np.einsum("kcp,kcq->pq", j, j), np.einsum("kcp,kc->p", j, r))
        for j, r in zip(
            np.array_split(slope, blocks), np.array_split(residual, blocks), strict=True
        )
    ]
    whole = np.sum([square for square, _ in parts], axis=0)
    try:
        changes = np.array([np.linalg.solve(whole - square, score) for square, score in parts])
    except np.linalg.LinAlgError:
        raise InputError(
            "--fit: the recording does not tell these parameters apart (fit fewer, or a recording "
            "with more manoeuvres)"
        ) from None
    result: Array = changes.T @ changes * (blocks - 1) / blocks
    return result


def _check(commands: Commands, names: Sequence[str], skip_s: float) -> None:
    for name in names:
        if name not in PARAMETERS:
            raise InputError(f"--fit {name}: write some of {', '.join(PARAMETERS)}")
    left = commands.time_s[-1] - commands.time_s[0] - skip_s
    if left < MIN_FITTED_S:
        raise InputError(
            f"{commands.path}: {max(left, 0.0):.1f} s are left to fit to; at least "
            f"{MIN_FITTED_S:g} s are needed"
        )
    missing = [name for name in _NEEDED if name not in commands.recorded]
    if missing:
        raise InputError(f"{commands.path}:1: no column {', '.join(missing)}, which a fit needs")


def _deviations(difference: Array) -> Array:
    """Return the RMS of each column (C,), above 0."""
    result: Array = np.sqrt(np.mean(difference * difference, axis=0))
    return np.maximum(result, _LEAST_SIGMA)


class _Flights:
    """Flights of candidates, and their differences from the recording.

    Attributes:
        names: P, the parameters that were asked for, then NUISANCE.
        first: (P,) their values before the fit.
        steps: sets of flights up to now, each with all derivatives.
        variation: (C,) standard deviations of the recorded columns.
    """

    def __init__(
        self,
        folder: Path,
        commands: Commands,
        setup: ReplaySetup,
        names: Sequence[str],
        skip_s: float,
        scratch: Path,
    ) -> None:
        self.names, self.steps = (*names, *NUISANCE), 0
        self._folder, self._commands, self._setup = folder, commands, setup
        self._scratch = scratch
        self._folders: dict[tuple[float, ...], Path] = {}  # by factors
        self.columns = tuple(name for name in FITTED if name in commands.recorded)
        self._at = [RESPONSES.index(name) for name in self.columns]
        self._has_offset = np.array([name not in _WITHOUT_OFFSET for name in self.columns])
        self._kept = commands.time_s >= commands.time_s[0] + skip_s
        recorded = [commands.recorded[name] for name in self.columns]
        self._recorded = np.stack(recorded, axis=-1)[self._kept]
        self.variation = np.maximum(self._recorded.std(axis=0), _LEAST_SIGMA)
        self._latency = setup.timing.command_latency
        begin = {LATENCY: self._latency, "start_airspeed": setup.start(commands).airspeed}
        begin |= {"pitch_offset": 0.0, "airspeed_offset": 0.0}
        self.first = np.array([begin.get(name, 1.0) for name in self.names])
        self._last: tuple[bytes, tuple[Array, Array]] | None = None

    def differences(self, x: Array) -> tuple[Array, Array]:
        """Return differences (K, C) at parameters (P,), and their derivatives (K, C, P).

        All are flown at the same time, because the derivatives are nearly always needed.

        Raises:
            TrimError: there is no steady flight to start from before the fit.
        """
        key = x.tobytes()
        if self._last is None or self._last[0] != key:
            self._last = key, self._fly(x)
        return self._last[1]

    def _fly(self, x: Array) -> tuple[Array, Array]:
        steps = np.array([_RANGES[name][2] for name in self.names])
        points = x + np.vstack((np.zeros(len(x)), np.diag(steps)))
        try:
            rows = replay(
                [self._candidate(each) for each in points],
                self._commands,
                self._setup,
                engine="auto",
            )
        except TrimError:
            if self._last is None:
                raise
            shape = *self._recorded.shape, len(x)
            return np.full(shape[:2], _LOST * self._last[1][0].std()), np.zeros(shape)
        finally:
            self.steps += 1
        flown = rows[:, self._kept][:, :, self._at]
        difference = flown[0] - self._recorded
        slope = np.moveaxis(flown[1:] - flown[0], 0, -1) / steps
        lost = ~np.isfinite(difference)
        if lost.any():
            difference = np.where(lost, _LOST * np.nanstd(difference, axis=0), difference)
        slope = np.nan_to_num(slope)
        difference -= self._has_offset * difference.mean(axis=0)
        slope -= self._has_offset[:, None] * slope.mean(axis=0)
        return difference, slope

    def _candidate(self, point: Array) -> ReplayedAircraft:
        values = dict(zip(self.names, point.tolist(), strict=True))
        factors = {name: values[name] for name in FACTORS if name in values}
        key = tuple(factors.values())
        if key not in self._folders:
            folder = self._scratch / f"candidate-{len(self._folders)}"
            copy_with_factors(self._folder, folder, factors)
            self._folders[key] = folder
        nuisance = (values[name] for name in NUISANCE)
        return ReplayedAircraft(self._folders[key], values.get(LATENCY, self._latency), *nuisance)


def _result(flights: _Flights, x: Array, covariance: Array, rms: Array, count: int) -> AirframeFit:
    """Return the result; the first `count` parameters were asked for."""
    sigma = np.sqrt(np.diag(covariance))
    half = student_quantile(1.0 - LEVEL, _BLOCKS - 1) * sigma
    correlation = covariance / np.outer(sigma, sigma)
    parameters = [
        FittedParameter(name, value, value - each, value + each)
        for name, value, each in zip(flights.names, x.tolist(), half.tolist(), strict=True)
    ]
    return AirframeFit(
        parameters=tuple(parameters[:count]),
        nuisance={each.name: each.value for each in parameters[count:]},
        correlation=correlation[:count, :count],
        columns=flights.columns,
        rms={
            name: (float(old), float(new))
            for name, old, new in zip(flights.columns, *rms, strict=True)
        },
        flights=flights.steps * (len(x) + 1),
    )
