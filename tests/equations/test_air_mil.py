"""How strong and how long turbulence is: MIL-F-8785C worked by hand, and what it refuses."""

import numpy as np
import pytest

from testbed.air.mil import (
    CHART,
    CHART_HEIGHT,
    CHART_PROBABILITY,
    HIGH,
    INTENSITIES,
    LOW,
    LOWEST,
    Scales,
    chart,
    intensities,
    scale_lengths,
)
from testbed.errors import InputError
from testbed.frames import FOOT

SPECTRA = ("dryden", "von-karman")
MODERATE = INTENSITIES["moderate"]


def feet(*heights):
    return FOOT * np.array(heights, dtype=float)


def test_words_stand_for_winds_and_probabilities():
    """15, 30 and 45 knots of 1852 m an hour."""
    assert INTENSITIES["light"] == pytest.approx((7.71667, 1e-2), rel=1e-6)
    assert INTENSITIES["moderate"] == pytest.approx((15.43333, 1e-3), rel=1e-6)
    assert INTENSITIES["severe"] == pytest.approx((23.15, 1e-5), rel=1e-6)


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_low_lengths_worked_by_hand(spectrum):
    """100 ft: 0.2593^1.2 = 0.1979534, 505.169 ft; 400 ft: 0.5062^1.2 = 0.4417602, 905.469 ft."""
    assert scale_lengths(feet(100.0), spectrum)[0] / FOOT == pytest.approx(
        [505.1693, 505.1693, 100.0], rel=1e-5
    )
    assert scale_lengths(feet(400.0), spectrum)[0] / FOOT == pytest.approx(
        [905.4687, 905.4687, 400.0], rel=1e-5
    )


def test_low_intensities_worked_by_hand():
    """σ_w = 3 kt; at 100 ft 0.2593^0.4 = 0.582802, at 400 ft 0.5062^0.4 = 0.761603."""
    knot = 1852.0 / 3600.0
    for height, ratio in ((100.0, 0.582802), (400.0, 0.761603)):
        found = intensities(feet(height), 30.0 * knot, 1e-3)[0] / knot
        assert found == pytest.approx([3.0 / ratio, 3.0 / ratio, 3.0], rel=1e-5)


def test_high_lengths_are_isotropic():
    for spectrum, length in zip(SPECTRA, (1750.0, 2500.0), strict=True):
        found = scale_lengths(feet(2000.0, 30000.0), spectrum) / FOOT
        assert found == pytest.approx(np.full((2, 3), length), rel=1e-12)


def test_the_chart_at_its_nodes_and_between():
    """Between 1e-3 and 1e-4 at 3750 ft: 10.6 and 16.0 ft/s; at 10^−3.5 their mean."""
    for row, probability in enumerate(CHART_PROBABILITY):
        assert chart(CHART_HEIGHT, probability) == pytest.approx(CHART[row], abs=1e-12)
    assert chart(feet(3750.0), 10.0**-3.5) == pytest.approx(FOOT * 13.3)
    # 2000 ft is an eighth of the way from 9.6 at 1750 ft to 10.6 at 3750 ft
    assert chart(feet(2000.0), 1e-3) == pytest.approx(FOOT * 9.725)
    assert chart(feet(20000.0), 1e-5) == pytest.approx(FOOT * 21.05)
    assert chart(feet(90000.0), 1e-6) == pytest.approx(FOOT * 7.2)


def test_rarer_turbulence_is_never_weaker():
    assert (np.diff(CHART, axis=0) >= 0.0).all()
    assert CHART.shape == (len(CHART_PROBABILITY), len(CHART_HEIGHT))


def test_high_intensities_are_the_charts_alone():
    heights = feet(2000.0, 7500.0, 35000.0)
    found = intensities(heights, 7.0, 1e-3)
    assert found == pytest.approx(np.repeat(chart(heights, 1e-3)[:, None], 3, axis=1))
    assert (intensities(heights, 20.0, 1e-3) == found).all()


@pytest.mark.parametrize("spectrum", SPECTRA)
@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
def test_between_1000_and_2000_ft_all_is_linear(spectrum, share):
    height = np.array([LOW + share * (HIGH - LOW)])
    given = Scales(spectrum, *MODERATE)
    for middle, low, high in zip(
        given(height), given(np.array([LOW])), given(np.array([HIGH])), strict=True
    ):
        assert middle == pytest.approx((1.0 - share) * low + share * high, rel=1e-12)


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_bands_meet_without_a_jump(spectrum):
    given = Scales(spectrum, *MODERATE)
    for edge in (LOWEST, LOW, HIGH):
        below, above = given(np.array([edge - 1e-7])), given(np.array([edge + 1e-7]))
        for one, two in zip(below, above, strict=True):
            assert one == pytest.approx(two, rel=1e-6)


def test_at_1000_ft_turbulence_is_isotropic():
    given = Scales("dryden", *MODERATE)
    sigma, length = given(np.array([LOW]))
    assert length == pytest.approx(np.full((1, 3), LOW))
    assert sigma == pytest.approx(np.full((1, 3), 0.1 * MODERATE.w20))


def test_below_10_ft_everything_is_as_at_10_ft():
    given = Scales("von-karman", *MODERATE)
    for one, two in zip(given(feet(-30.0, 0.0, 9.0)), given(feet(10.0, 10.0, 10.0)), strict=True):
        assert (one == two).all()


def test_what_is_given_replaces_the_standard_at_all_heights():
    given = Scales("dryden", *MODERATE, sigma=(1.0, 2.0, 3.0), length=(10.0, 20.0, 30.0))
    sigma, length = given(feet(50.0, 5000.0))
    assert (sigma == [1.0, 2.0, 3.0]).all()
    assert (length == [10.0, 20.0, 30.0]).all()
    sigma, length = Scales("dryden", *MODERATE, sigma=(1.0, 2.0, 3.0))(feet(50.0))
    assert sigma.shape == length.shape == (1, 3)
    assert (length == scale_lengths(feet(50.0), "dryden")).all()


def test_no_wind_is_no_turbulence_down_low():
    assert (intensities(feet(0.0, 500.0, 1000.0), 0.0, 1e-3) == 0.0).all()


@pytest.mark.parametrize(
    ("changes", "said"),
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
def test_what_no_turbulence_has_is_refused_with_what_to_write(changes, said):
    page = {"spectrum": "dryden", "w20": 15.0, "probability": 1e-3, **changes}
    with pytest.raises(InputError, match=said):
        Scales(**page)
