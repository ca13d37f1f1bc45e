"""Turbulence intensities and scale lengths: MIL-F-8785C worked by hand, and its errors."""

import numpy as np
import pytest

from testbed.atmosphere.mil_f_8785c import (
    CHART,
    CHART_HEIGHT,
    CHART_PROBABILITY,
    HIGH,
    INTENSITIES,
    LOW,
    LOWEST,
    Scales,
    exceedance_sigma,
    intensities,
    scale_lengths,
)
from testbed.core.errors import InputError
from testbed.core.frames import FOOT

SPECTRA = ("dryden", "von-karman")
MODERATE = INTENSITIES["moderate"]


def feet(*heights):
    return FOOT * np.array(heights, dtype=float)


def test_intensities_by_name():
    """15, 30 and 45 knots of 1852 m an hour."""
    assert INTENSITIES["light"] == pytest.approx((7.71667, 1e-2), rel=1e-6)
    assert INTENSITIES["moderate"] == pytest.approx((15.43333, 1e-3), rel=1e-6)
    assert INTENSITIES["severe"] == pytest.approx((23.15, 1e-5), rel=1e-6)


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_scale_lengths_low_worked_by_hand(spectrum):
    """100 ft: 0.2593^1.2 = 0.1979534, 505.169 ft; 400 ft: 0.5062^1.2 = 0.4417602, 905.469 ft."""
    assert scale_lengths(feet(100.0), spectrum)[0] / FOOT == pytest.approx(
        [505.1693, 505.1693, 100.0], rel=1e-5
    )
    assert scale_lengths(feet(400.0), spectrum)[0] / FOOT == pytest.approx(
        [905.4687, 905.4687, 400.0], rel=1e-5
    )


def test_intensities_low_worked_by_hand():
    """σ_w = 3 kt; at 100 ft 0.2593^0.4 = 0.582802, at 400 ft 0.5062^0.4 = 0.761603."""
    knot = 1852.0 / 3600.0
    for height, ratio in ((100.0, 0.582802), (400.0, 0.761603)):
        found = intensities(feet(height), 30.0 * knot, 1e-3)[0] / knot
        assert found == pytest.approx([3.0 / ratio, 3.0 / ratio, 3.0], rel=1e-5)


def test_scale_lengths_high_are_isotropic():
    for spectrum, length in zip(SPECTRA, (1750.0, 2500.0), strict=True):
        found = scale_lengths(feet(2000.0, 30000.0), spectrum) / FOOT
        assert found == pytest.approx(np.full((2, 3), length), rel=1e-12)


def test_exceedance_sigma_at_nodes_and_between():
    """Between 1e-3 and 1e-4 at 3750 ft: 10.6 and 16.0 ft/s; at 10^−3.5 their mean."""
    for row, probability in enumerate(CHART_PROBABILITY):
        assert exceedance_sigma(CHART_HEIGHT, probability) == pytest.approx(CHART[row], abs=1e-12)
    assert exceedance_sigma(feet(3750.0), 10.0**-3.5) == pytest.approx(FOOT * 13.3)
    # 2000 ft is an eighth of the way from 9.6 at 1750 ft to 10.6 at 3750 ft
    assert exceedance_sigma(feet(2000.0), 1e-3) == pytest.approx(FOOT * 9.725)
    assert exceedance_sigma(feet(20000.0), 1e-5) == pytest.approx(FOOT * 21.05)
    assert exceedance_sigma(feet(90000.0), 1e-6) == pytest.approx(FOOT * 7.2)


def test_exceedance_chart_is_monotonic():
    """Rarer turbulence is never weaker."""
    assert (np.diff(CHART, axis=0) >= 0.0).all()
    assert CHART.shape == (len(CHART_PROBABILITY), len(CHART_HEIGHT))


def test_intensities_high_are_the_charts_alone():
    heights = feet(2000.0, 7500.0, 35000.0)
    found = intensities(heights, 7.0, 1e-3)
    assert found == pytest.approx(np.repeat(exceedance_sigma(heights, 1e-3)[:, None], 3, axis=1))
    assert (intensities(heights, 20.0, 1e-3) == found).all()


@pytest.mark.parametrize("spectrum", SPECTRA)
@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
def test_scales_are_linear_from_1000_to_2000_ft(spectrum, share):
    height = np.array([LOW + share * (HIGH - LOW)])
    scales = Scales(spectrum, *MODERATE)
    for middle, low, high in zip(
        scales(height), scales(np.array([LOW])), scales(np.array([HIGH])), strict=True
    ):
        assert middle == pytest.approx((1.0 - share) * low + share * high, rel=1e-12)


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_scales_are_continuous_between_bands(spectrum):
    scales = Scales(spectrum, *MODERATE)
    for edge in (LOWEST, LOW, HIGH):
        below, above = scales(np.array([edge - 1e-7])), scales(np.array([edge + 1e-7]))
        for one, two in zip(below, above, strict=True):
            assert one == pytest.approx(two, rel=1e-6)


def test_scales_at_1000_ft_are_isotropic():
    scales = Scales("dryden", *MODERATE)
    sigma, length = scales(np.array([LOW]))
    assert length == pytest.approx(np.full((1, 3), LOW))
    assert sigma == pytest.approx(np.full((1, 3), 0.1 * MODERATE.w20))


def test_scales_below_10_ft_are_those_at_10_ft():
    scales = Scales("von-karman", *MODERATE)
    for one, two in zip(scales(feet(-30.0, 0.0, 9.0)), scales(feet(10.0, 10.0, 10.0)), strict=True):
        assert (one == two).all()


def test_scales_constants_replace_the_standard():
    """At all heights."""
    scales = Scales("dryden", *MODERATE, sigma=(1.0, 2.0, 3.0), length=(10.0, 20.0, 30.0))
    sigma, length = scales(feet(50.0, 5000.0))
    assert (sigma == [1.0, 2.0, 3.0]).all()
    assert (length == [10.0, 20.0, 30.0]).all()
    sigma, length = Scales("dryden", *MODERATE, sigma=(1.0, 2.0, 3.0))(feet(50.0))
    assert sigma.shape == length.shape == (1, 3)
    assert (length == scale_lengths(feet(50.0), "dryden")).all()


def test_intensities_low_without_wind_are_zero():
    assert (intensities(feet(0.0, 500.0, 1000.0), 0.0, 1e-3) == 0.0).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spectrum": "kaimal"}, "write dryden or von-karman"),
        ({"w20": -1.0}, "w20_mps -1: write the wind at 20 ft"),
        ({"w20": np.nan}, "w20_mps nan"),
        ({"probability": 0.3}, "write one on the chart, from 1e-06 to 0.2"),
        ({"probability": 1e-7}, "write one on the chart, from 1e-06 to 0.2"),
        ({"probability": np.nan}, "write one on the chart"),
        ({"sigma": (1.0, 1.0, -0.1)}, "sigma_mps .* write three numbers of 0 m/s or more"),
        ({"length": (100.0, 0.0, 50.0)}, "length_m .* write three lengths above 0 m"),
    ],
)
def test_scales_invalid_values_are_rejected(changes, message):
    scales = {"spectrum": "dryden", "w20": 15.0, "probability": 1e-3, **changes}
    with pytest.raises(InputError, match=message):
        Scales(**scales)
