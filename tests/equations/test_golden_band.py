"""The band of golden tables: Student's quantiles, and how often a correct value is outside."""

import math
import random
import statistics

import pytest

from testbed.study.golden_band import prediction_band, student_quantile, student_tail


def test_students_quantiles_are_the_printed_ones():
    """Two-sided, from the table every textbook has."""
    printed = {(0.05, 1): 12.706, (0.05, 4): 2.776, (0.01, 5): 4.032, (0.001, 15): 4.073}
    for (tail, freedom), value in printed.items():
        assert student_quantile(tail, freedom) == pytest.approx(value, abs=6e-4)
    for freedom in (1, 2, 7, 15, 40):
        assert student_tail(student_quantile(1e-6, freedom), freedom) == pytest.approx(
            1e-6, rel=1e-5
        )
    # many degrees of freedom: the normal distribution's
    normal = statistics.NormalDist().inv_cdf(1.0 - 0.5e-3)
    assert student_quantile(1e-3, 4001) == pytest.approx(normal, rel=1e-3)
    with pytest.raises(ValueError, match="1e-14"):
        student_quantile(1e-14, 5)


@pytest.mark.parametrize("of", [1, 4])
def test_the_band_is_left_as_often_as_it_says(of):
    """At one in twenty, where some thousand draws can tell."""
    draw = random.Random(20260101)
    outside, trials = 0, 8_000
    for _ in range(trials):
        low, high = prediction_band(
            [draw.gauss(10.0, 0.5) for _ in range(6)], false_alarm=0.05, least=1e-9, of=of
        )
        outside += not low <= statistics.fmean(draw.gauss(10.0, 0.5) for _ in range(of)) <= high
    assert outside / trials == pytest.approx(0.05, abs=4.0 * math.sqrt(0.05 * 0.95 / trials))
