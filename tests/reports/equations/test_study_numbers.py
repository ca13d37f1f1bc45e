"""Statistics of a study report, compared with scipy and with values computed by hand."""

import math

import numpy as np
import pytest
from scipy import stats

from testbed.core.stats import student_quantile
from testbed.metrics.side_effects import change_of
from testbed.reports.study.study_data import (
    LEVEL,
    bootstrap,
    estimate_of,
    rank_correlation,
    running_quantiles,
    variance_share,
    wilson,
)


def samples(count, seed=1):
    return np.random.default_rng(seed).gamma(3.0, 1.0, count)


@pytest.mark.parametrize("statistic", ["median", "mean"])
def test_bootstrap_agrees_with_scipy(statistic):
    """Up to the random numbers."""
    values = samples(40)
    ours = bootstrap(values, statistic, "a name")
    theirs = stats.bootstrap(
        (values,), getattr(np, statistic), confidence_level=LEVEL, method="percentile",
        n_resamples=8000, rng=np.random.default_rng(2),
    ).confidence_interval  # fmt: skip
    width = theirs.high - theirs.low
    assert ours.value == getattr(np, statistic)(values)
    assert (ours.low, ours.high) == pytest.approx((theirs.low, theirs.high), abs=0.08 * width)


def test_bootstrap_of_many_values_is_normal_interval():
    values = samples(2000)
    found = bootstrap(values, "mean", "many")
    half = stats.norm.ppf(0.5 + LEVEL / 2) * values.std(ddof=1) / math.sqrt(values.size)
    assert (found.high - found.low) / 2.0 == pytest.approx(half, rel=0.06)
    assert (found.high + found.low) / 2.0 == pytest.approx(values.mean(), abs=0.1 * half)


def test_bootstrap_of_five_values_is_too_narrow():
    """As its docstring says: about 85 % instead of 95 %."""
    random = np.random.default_rng(5)
    inside = 0
    for k in range(300):
        found = bootstrap(random.normal(size=5), "mean", f"{k}")
        inside += found.low <= 0.0 <= found.high
    assert 0.76 < inside / 300 < 0.92


def test_bootstrap_depends_on_its_name():
    values = samples(20)
    assert bootstrap(values, "median", "a") == bootstrap(values, "median", "a")
    assert bootstrap(values, "mean", "a") != bootstrap(values, "mean", "b")


def mean_estimate(values):
    return estimate_of(change_of(0.0, 0.0, values, one_flight=False))


@pytest.mark.parametrize(
    "interval", [mean_estimate, lambda values: bootstrap(values, "mean", "few")]
)
def test_interval_of_few_values_is_nan(interval):
    two = interval(np.array([1.0, 3.0]))
    assert (two.value, two.count) == (2.0, 2) and math.isnan(two.low) and math.isnan(two.high)
    none = interval(np.empty(0))
    assert math.isnan(none.value) and none.count == 0


def test_mean_estimate_is_students_interval():
    values = samples(9) - 2.0
    found = mean_estimate(values)
    theirs = stats.ttest_1samp(values, 0.0).confidence_interval(LEVEL)
    assert (found.low, found.high) == pytest.approx((theirs.low, theirs.high), rel=1e-12)
    half = student_quantile(1.0 - LEVEL, 8) * values.std(ddof=1) / 3.0
    assert found.high - found.value == pytest.approx(half, rel=1e-12)


def wilson_by_hand(hits, of):
    """Wilson (1927): the shares p with |hits/of - p| <= z sqrt(p (1 - p) / of)."""
    z, share = stats.norm.ppf(0.5 + LEVEL / 2), hits / of
    roots = np.roots([1.0 + z * z / of, -2.0 * share - z * z / of, share * share])
    return sorted(roots.real)


@pytest.mark.parametrize(("hits", "of"), [(0, 12), (1, 7), (30, 60), (9, 9)])
def test_wilson_solves_its_quadratic_equation(hits, of):
    found = wilson(hits, of)
    assert found.value == hits / of
    assert (found.low, found.high) == pytest.approx(wilson_by_hand(hits, of), abs=1e-12)
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0


def test_rank_correlation_agrees_with_spearman():
    """With and without equal values."""
    x, y = samples(50, 1), samples(50, 2)
    for a, b in ((x, y), (x.round(), y.round()), (x, -(x**3))):
        assert rank_correlation(a, b) == pytest.approx(stats.spearmanr(a, b).statistic, rel=1e-12)
    assert math.isnan(rank_correlation(x, np.ones(50)))


def test_variance_share_agrees_with_f_test():
    values, group = samples(60), np.repeat([0, 1, 2], 20)
    values[group == 2] += 1.5
    share = variance_share(values, group)
    f = stats.f_oneway(*(values[group == k] for k in range(3))).statistic
    assert share / 2.0 / ((1.0 - share) / 57.0) == pytest.approx(f, rel=1e-10)
    # by hand: means 1 and 3 about 2, values 0 2 2 4 about 2
    assert variance_share(np.array([0.0, 2.0, 2.0, 4.0]), np.array([0, 0, 1, 1])) == 0.5
    assert math.isnan(variance_share(np.ones(4), np.array([0, 0, 1, 1])))


def test_running_quantiles_are_those_of_neighbours():
    x, y = samples(80, 3), samples(80, 4)
    middle, found = running_quantiles(x, y, (0.1, 0.5), window=11)
    order = np.argsort(x)
    for k in (0, 30, 69):
        near = order[k : k + 11]
        assert middle[k] == np.median(x[near])
        assert found[:, k] == pytest.approx(np.quantile(y[near], [0.1, 0.5]))
    assert found.shape == (2, 70)
