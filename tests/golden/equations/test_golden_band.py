"""Student's quantile and the prediction band of golden tables."""

import math
import random
import statistics
from functools import cache

import pytest
from scipy import stats

from testbed.core.stats import student_quantile
from testbed.golden import golden_table


def test_student_quantile_agrees_with_printed_tables():
    """Two-sided, to the digits of a textbook, and through the distribution function."""
    printed = {(0.05, 1): 12.706, (0.05, 4): 2.776, (0.01, 5): 4.032, (0.001, 15): 4.073}
    for (tail, freedom), value in printed.items():
        assert student_quantile(tail, freedom) == pytest.approx(value, abs=6e-4)
    for freedom in (1, 2, 7, 15, 40):
        inside = 1.0 - 2.0 * stats.t.sf(student_quantile(1e-6, freedom), freedom)
        assert 1.0 - inside == pytest.approx(1e-6, rel=1e-8)
    # many degrees of freedom: the normal distribution
    normal = statistics.NormalDist().inv_cdf(1.0 - 0.5e-3)
    assert student_quantile(1e-3, 4001) == pytest.approx(normal, rel=1e-3)


@pytest.mark.parametrize("new_values", [1, 4])
def test_prediction_band_false_alarm_is_as_given(new_values, monkeypatch):
    """At 5 %: the mean over drawn bands of the probability that a new mean is outside."""
    monkeypatch.setattr(golden_table, "student_quantile", cache(student_quantile))
    draw = random.Random(20260101)
    new_mean = statistics.NormalDist(10.0, 0.5 / math.sqrt(new_values))
    outside = []
    for _ in range(2_000):
        low, high = golden_table.prediction_band(
            [draw.gauss(10.0, 0.5) for _ in range(6)],
            false_alarm=0.05,
            min_half_width=1e-9,
            new_values=new_values,
        )
        outside.append(1.0 - new_mean.cdf(high) + new_mean.cdf(low))
    bound = 4.0 * statistics.stdev(outside) / math.sqrt(len(outside))
    assert bound < 4.0 * math.sqrt(0.05 * 0.95 / 8_000)  # of as many new means that are counted
    assert statistics.fmean(outside) == pytest.approx(0.05, abs=bound)
