"""Turbulence as time series: the samples of the filters, and refusals."""

import atmosphere_samples as samples
import numpy as np
import pytest

from testbed.atmosphere.dryden import DrydenTurbulence
from testbed.atmosphere.turbulence_series import turbulence_series
from testbed.core.errors import InputError

CASE = samples.Case("von-karman", airspeed=22.0, height=100.0, dt=0.02, seed=3)


def series(**changes):
    given = {
        "spectrum": CASE.spectrum,
        "height": CASE.height,
        "airspeed": CASE.airspeed,
        "dt": CASE.dt,
        "steps": 100,
        "span": samples.SPAN,
        "flights": 2,
        "seed": CASE.seed,
    }
    return turbulence_series(CASE.model, **{**given, **changes})


def test_samples_are_those_of_the_filters():
    turbulence = DrydenTurbulence(
        ["flight0", "flight1"],
        seed=CASE.seed,
        dt=CASE.dt,
        spans=[samples.SPAN] * 2,
        spectrum=CASE.spectrum,
        scales=CASE.model,
    )
    expected = samples.simulate(turbulence, np.full(2, CASE.height), np.full(2, CASE.airspeed), 100)
    np.testing.assert_array_equal(series(), expected)


def test_one_flight_does_not_depend_on_others():
    np.testing.assert_array_equal(series(flights=1)[:, 0], series()[:, 0])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"airspeed": 0.0}, "write an airspeed above 0"),
        ({"steps": 0}, "write 1 or more"),
        ({"flights": 0}, "write 1 or more"),
        ({"span": 0.0}, "write one above 0 m"),
        ({"dt": 0.0}, "write a step above 0 s"),
    ],
)
def test_impossible_series_are_refused(changes, said):
    with pytest.raises(InputError, match=said):
        series(**changes)
