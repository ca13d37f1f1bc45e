"""Confidence intervals that hold at every number of values: by quadrature, and by simulation."""

import math

import numpy as np
import pytest
from scipy import stats

from testbed.studies.sequential_interval import (
    MIN_VALUES,
    MIXTURE_VARIANCE,
    RunningMean,
    relative_half_width,
)

SAMPLES, MOST = 4_000, 300


def test_running_mean_is_that_of_numpy():
    values = np.random.default_rng(1).normal(1e6, 0.1, 50)
    running = RunningMean(0.95)
    for value in values:
        running.add(float(value))
    assert running.count == 50
    assert running.mean == pytest.approx(values.mean(), rel=1e-15)
    expected = relative_half_width(50, 0.95) * values.std(ddof=1)
    assert running.half_width == pytest.approx(expected, rel=1e-9)


def test_few_values_have_no_interval():
    assert math.isinf(relative_half_width(MIN_VALUES - 1, 0.5))
    assert math.isinf(relative_half_width(MIN_VALUES, 0.9999))
    assert math.isfinite(relative_half_width(MIN_VALUES, 0.95))
    running = RunningMean(0.95)
    assert math.isnan(running.mean) and math.isinf(running.half_width)


@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_mixture_at_the_ends_is_one_over_alpha(confidence):
    """The mixture of likelihood ratios, by quadrature over mean and standard deviation."""
    values = np.random.default_rng(2).normal(0.3, 1.7, 12)
    half = relative_half_width(values.size, confidence) * values.std(ddof=1)
    end = values.mean() + half

    # of normal values with mean = end + shift sd, by the measure d sd / sd; trapezoidal sums
    shift, log_sd = np.linspace(-6.0, 6.0, 1201), np.linspace(-3.0, 6.0, 601)[:, None]
    powers = sum((((each - end) / np.exp(log_sd)) - shift) ** 2 for each in values)
    likelihoods = np.exp(-0.5 * powers - values.size * log_sd).sum(axis=0)
    prior = stats.norm.pdf(shift, 0.0, math.sqrt(MIXTURE_VARIANCE)) * (shift[1] - shift[0])
    mixed = float(prior @ likelihoods) / likelihoods[600]
    assert shift[600] == 0.0 and mixed == pytest.approx(1.0 / (1.0 - confidence), rel=1e-6)


DISTRIBUTIONS = {
    "normal": (lambda random, size: random.normal(0.0, 1.0, size), 0.0, 1.0),
    "gamma 4": (lambda random, size: random.gamma(4.0, 0.5, size), 2.0, 1.0),
    "exponential": (lambda random, size: random.exponential(1.0, size), 1.0, 1.0),
}
"""Draws, mean and standard deviation; their skewness is 0, 1 and 2."""


def coverage(name, half_of, expected, fewest):
    """Return how often the mean is within the first interval that is narrow enough."""
    draw, mean, sd = DISTRIBUTIONS[name]
    values = draw(np.random.default_rng(3), (SAMPLES, MOST))
    count = np.arange(1, MOST + 1)
    means = np.cumsum(values, axis=1) / count
    squares = np.cumsum((values - mean) ** 2, axis=1) - count * (means - mean) ** 2
    scatter = np.sqrt(squares / np.maximum(count - 1, 1))
    relative = np.array([half_of(n) if n >= fewest else math.inf for n in count])
    with np.errstate(invalid="ignore"):
        half = np.where(np.isfinite(relative), relative * scatter, math.inf)
    enough = half <= sd * half_of(expected)  # reached at about this number of values
    assert enough.any(axis=1).all()
    at = (np.arange(SAMPLES), enough.argmax(axis=1))
    return float((np.abs(means[at] - mean) <= half[at]).mean())


# How often the mean is held when a point stops after about 10, 25 and 80 flights: by the interval
# here, and by Student's. docs/studies.md has these numbers.
COVERAGE = {
    "normal": ((1.000, 0.999, 0.997), (0.90, 0.91, 0.93)),
    "gamma 4": ((0.999, 0.993, 0.992), (0.90, 0.88, 0.91)),
    "exponential": ((0.995, 0.985, 0.966), (0.85, 0.79, 0.84)),
}
EXPECTED = (10, 25, 80)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_interval_covers_the_mean_when_it_stops(name):
    """As often as nominal, or more; the numbers are those of the docs."""
    covered = [coverage(name, lambda n: relative_half_width(n, 0.95), k, 8) for k in EXPECTED]
    assert min(covered) >= 0.95
    assert covered == pytest.approx(COVERAGE[name][0], abs=6e-4)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_students_interval_looked_at_covers_less(name):
    """The negative control: Student's interval after each flight, as if its number were fixed."""
    covered = [
        coverage(name, lambda n: stats.t.ppf(0.975, n - 1) / math.sqrt(n), k, fewest=3)
        for k in EXPECTED
    ]
    assert max(covered) < 0.94
    assert covered == pytest.approx(COVERAGE[name][1], abs=6e-3)


def test_interval_holds_at_all_numbers_at_once():
    """The share of normal samples whose mean is outside at any number of values up to 300."""
    values = np.random.default_rng(4).normal(0.0, 1.0, (SAMPLES, MOST))
    sums, squares = np.cumsum(values, axis=1), np.cumsum(values**2, axis=1)
    outside = np.zeros(SAMPLES, dtype=bool)
    for n in range(MIN_VALUES, MOST + 1):
        mean = sums[:, n - 1] / n
        scatter = np.sqrt((squares[:, n - 1] - n * mean**2) / (n - 1))
        outside |= np.abs(mean) > relative_half_width(n, 0.9) * scatter
    assert 0.02 < outside.mean() < 0.1
