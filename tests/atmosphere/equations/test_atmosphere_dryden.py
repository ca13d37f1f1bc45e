"""Dryden turbulence: filters exact for the step, spectra and variances of the closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from atmosphere_samples import (
    COMPONENTS,
    SAMPLES,
    SPAN,
    Case,
    cases,
    closed_variance,
    discrete_variance,
    fly,
    freedom,
    inside,
    least,
    sample,
    simulate,
    steps_of,
)
from cases import some
from reference.adapters_atmosphere import make_filters, turbulence_axes
from reference.frames import rotation_ned_body
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.stats import chi2

from testbed.atmosphere.airframe_wind import LOCAL_WIND
from testbed.atmosphere.dryden import DrydenTurbulence
from testbed.atmosphere.mil_f_8785c import HIGH, INTENSITIES, LOW, Scales
from testbed.atmosphere.spectra import psd
from testbed.core import random
from testbed.core.call_list import run_steps
from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, allocate

MODERATE = INTENSITIES["moderate"]
NOMINAL = Case("dryden", 22.0, 120.0, 0.02, 100)


@pytest.fixture(scope="module")
def flights():
    return [(case, fly(case, steps_of(case), SAMPLES)) for case in cases("dryden")]


def system(corner):
    """A (3, 3) and B (3) of the poles 1, 1 and a, as the filters document them."""
    b = np.sqrt(2.0 * np.array([1.0, 1.0, corner]))
    return -np.tril(np.outer(b, b), -1) - np.diag([1.0, 1.0, corner]), b


def one_part(corner, step):
    """Filters of one aircraft with πL/4b and V dt/L as given, and L = 100 m."""
    length = np.full((1, 3), 100.0)
    return make_filters(
        "dryden", np.array([100.0 * step]), np.ones((1, 3)), length, 25.0 * np.pi / corner
    )


CORNERS = [0.05, 0.9999999, 1.0, 1.3, 30.0, 300.0]


@pytest.mark.parametrize("corner", CORNERS)
@pytest.mark.parametrize("step", some([4e-5, 1e-3, 0.05, 1.0, 40.0], 3))
def test_filter_step_is_the_matrix_exponential(corner, step):
    """Against scipy's matrix exponential and Lyapunov equation; coinciding poles are 1e-9 apart."""
    a, b = system(corner)
    assert solve_continuous_lyapunov(a, -np.outer(b, b)) == pytest.approx(np.eye(3), abs=1e-12)
    filters = one_part(np.array([corner]), step)
    phi, root = filters.transition[0, 1, 0], filters.root[0, 1, 0]
    assert phi == pytest.approx(expm(a * step), abs=2e-9 if corner == 1.0 else 1e-12)
    assert root @ root.T == pytest.approx(np.eye(3) - phi @ phi.T, abs=1e-14)
    assert (np.diag(root) >= 0.0).all()
    assert (np.triu(root, 1) == 0.0).all()


@pytest.mark.parametrize("case", cases("dryden"))
def test_filters_continuous_have_the_closed_spectra(case):
    """|c (jω − A)⁻¹ B|², one-sided and per hertz, against section 3.7.1.2 and 3.7.5."""
    frequency = np.geomspace(1e-4, 50.0, 60)
    filters, expected = case.filters(), case.density(frequency)
    for axis, (speed, rate, span) in enumerate(((1, 5, 3.0 * SPAN), (2, 4, 4.0 * SPAN))):
        length = case.scales[1][1 + axis]
        a, b = system(np.pi * length / span)
        omega = 2.0 * np.pi * frequency * length / case.airspeed
        states = np.linalg.solve(1j * omega[:, None, None] * np.eye(3) - a, b[:, None])[..., 0]
        level = 2.0 * length / case.airspeed  # of the noise, in (L/V) s, and one-sided
        args = level * np.abs(states[:, :2] @ filters.speed[0, axis, 0]) ** 2
        assert args == pytest.approx(expected[speed], rel=1e-10)
        args = level * np.abs(states @ filters.rate[0, axis, 0]) ** 2
        assert args == pytest.approx(expected[rate], rel=1e-10)


@pytest.mark.parametrize("case", cases("dryden"))
def test_filters_discrete_variance_is_the_closed_form(case):
    """Within 0.1 %; the integral itself is good to 1e-6."""
    assert discrete_variance(case.filters()) == pytest.approx(closed_variance(case), rel=1e-5)


def test_filters_variance_is_independent_of_the_step():
    found = [
        discrete_variance(Case("dryden", 22.0, 120.0, dt, 0).filters()) for dt in (1e-3, 0.02, 5.0)
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[2] == pytest.approx(found[1], rel=1e-9)


def test_rates_are_gradients_of_the_turbulence():
    """q = −∂w/∂x and r = ∂v/∂x, lagged by the distances 4b/π and 3b/π.

    Over distances short against L, ∂w/∂x is white: with its mean over a step D, its lag by a
    distance τ has a correlation of (1 − e^(−D/τ)) √(2τ/D).
    """
    step, count = 0.01, 20000
    air = DrydenTurbulence(
        ["uav"],
        seed=4,
        dt=step,
        spans=[np.pi / 4.0 * step],
        spectrum="dryden",
        scales=Scales("dryden", *MODERATE, sigma=(1.0,) * 3, length=(50.0,) * 3),
    )
    seen = simulate(air, np.array([100.0]), np.array([1.0]), count)[:, 0]
    turbulence, rates = seen[:, :3], seen[:, 3:]
    for component, rate, sign, tau in ((2, 1, -1.0, 1.0), (1, 2, 1.0, 0.75)):
        slope = sign * np.diff(turbulence[:, component]) / step
        expected = (1.0 - np.exp(-1.0 / tau)) * np.sqrt(2.0 * tau)
        # the standard error is (1 − ρ²)/√n, at most doubled by samples that remember each other
        error = 4.5 * 2.0 * (1.0 - expected**2) / np.sqrt(count)
        assert np.corrcoef(slope, rates[1:, rate])[0, 1] == pytest.approx(expected, abs=error)
        assert abs(np.corrcoef(slope, rates[1:, 3 - rate])[0, 1]) < 4.5 * 2.0 / np.sqrt(count)


def test_spectra_lie_in_the_chi_square_band(flights):
    """At least 93 % of the bins of all components over two decades inside the 95 % band.

    Of each case about 1400 of its bins are independent, since q goes with w and r with v: a share
    below 93 % has a chance of 3e-4. Expected densities are those of the sampled process, aliases
    and all.
    """
    shares = [inside(case, flight).mean() for case, flight in flights]
    assert min(shares) >= 0.93, shares
    assert np.mean(shares) < 0.97


def test_chi_square_band_rejects_another_spectrum(flights):
    case, flight = flights[0]
    other = Case("von-karman", case.airspeed, case.height, case.dt, case.seed)
    assert inside(case, flight, other)[:3].mean() < 0.8
    assert inside(case, 1.25 * flight).mean() < 0.93


def test_mean_squares_lie_in_their_bands(flights):
    """95 % bands of χ² with the degrees of freedom that the correlation leaves."""
    found = []
    for case, flight in flights:
        share = (flight**2).mean(axis=(0, 1)) / closed_variance(case)
        degrees = freedom(case, len(flight), SAMPLES)
        low, high = chi2.ppf([[0.025], [0.975]], degrees) / degrees
        found += list((share > low) & (share < high))
    assert sum(found) >= least(len(found))


def test_mean_squares_nominal_flight_in_their_bands():
    """22 m/s at 120 m with 50 Hz: every component's mean square in its own 95 % band."""
    flight = fly(NOMINAL, steps_of(NOMINAL), SAMPLES)
    share = (flight**2).mean(axis=(0, 1)) / closed_variance(NOMINAL)
    degrees = freedom(NOMINAL, len(flight), SAMPLES)
    assert (share > chi2.ppf(0.025, degrees) / degrees).all()
    assert (share < chi2.ppf(0.975, degrees) / degrees).all()


def test_rms_of_a_long_flight_is_within_2_percent():
    """8 h of 32 aircraft in steps of 5 s: the rms has a standard error below 0.5 %."""
    case, aircraft = Case("dryden", 22.0, 120.0, 5.0, 101), 32
    flight = fly(case, 6000, aircraft)
    degrees = freedom(case, len(flight), aircraft)
    assert (1.0 / np.sqrt(2.0 * degrees) < 0.005).all()
    rms = np.sqrt((flight**2).mean(axis=(0, 1)) / closed_variance(case))
    assert rms == pytest.approx(np.ones(6), abs=0.02)


def test_turbulence_is_stationary_from_the_start():
    """First samples of 600 aircraft: mean squares within the χ² band of 1e-5."""
    found = (fly(NOMINAL, 1, 600)[0] ** 2).sum(axis=0) / closed_variance(NOMINAL)
    assert (found > chi2.ppf(1e-5, 600)).all()
    assert (found < chi2.isf(1e-5, 600)).all()


def test_filters_changing_scales_cause_no_transient():
    """States stay orthonormal, so a step through other scales keeps the variance of those."""
    rng = np.random.default_rng(7)
    covariance = np.eye(3)
    for _ in range(50):
        filters = one_part(rng.uniform(0.5, 200.0, 1), 10.0 ** rng.uniform(-4.0, 0.5))
        phi, root = filters.transition[0, 0, 0], filters.root[0, 0, 0]
        covariance = phi @ covariance @ phi.T + root @ root.T
    assert covariance == pytest.approx(np.eye(3), abs=1e-13)


def test_filters_follow_the_height_after_the_hold():
    def aloft(hold_s):
        air = DrydenTurbulence(
            ["uav"],
            seed=3,
            dt=0.1,
            spans=[SPAN],
            spectrum="dryden",
            scales=lambda height: (np.tile(height[:, None], 3), np.full((1, 3), 50.0)),
            hold_s=hold_s,
        )
        heights = (1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0)
        return np.array([sample(air, np.array([each]), np.array([20.0]))[0][0] for each in heights])

    ratio = aloft(0.5) / aloft(0.1)
    assert ratio == pytest.approx(np.array([[1, 1, 1, 0.5, 0.5, 1, 1]]).T * np.ones(3))


def test_turbulence_at_zero_airspeed_stays_constant():
    air = DrydenTurbulence(
        ["uav"],
        seed=3,
        dt=0.02,
        spans=[SPAN],
        spectrum="dryden",
        scales=Scales("dryden", *MODERATE),
    )
    first, second = (sample(air, np.array([100.0]), np.zeros(1)) for _ in range(2))
    for one, two in zip(first, second, strict=True):
        assert (one == two).all()
        assert np.abs(one).min() > 0.0


def test_random_streams_are_keyed_by_name():
    def seen(names, seed=1):
        air = DrydenTurbulence(
            names,
            seed=seed,
            dt=0.02,
            spans=[SPAN] * len(names),
            spectrum="dryden",
            scales=Scales("dryden", *MODERATE),
        )
        n = len(names)
        steps = simulate(air, np.full(n, 100.0), np.full(n, 20.0), 600)
        return {name: steps[:, i] for i, name in enumerate(names)}

    single, four = seen(["uav2"]), seen(["leader", "uav1", "uav2", "uav3"])
    np.testing.assert_array_equal(single["uav2"], four["uav2"])
    np.testing.assert_array_equal(four["uav1"], seen(["uav1", "leader"])["uav1"])
    assert (four["uav1"] != four["uav2"]).all()
    assert (seen(["uav2"], seed=2)["uav2"] != single["uav2"]).all()


def test_turbulence_of_aircraft_is_uncorrelated():
    """Steps of 20 lengths make samples independent: correlations have errors of 1/√n.

    Only q goes with its w, and r with its v.
    """
    count, aircraft = 4000, 3
    length = NOMINAL.scales[1].max()
    case = replace(NOMINAL, dt=20.0 * length / NOMINAL.airspeed)
    seen = np.corrcoef(fly(case, count, aircraft).reshape(count, -1).T)
    own = np.eye(6)
    own[2, 4] = own[4, 2] = own[1, 5] = own[5, 1] = 1.0
    others = np.kron(np.eye(aircraft), own) == 0.0
    assert np.abs(seen[others]).max() < 4.5 / np.sqrt(count)


def attitudes(rng, n):
    return rng.uniform([-0.8, -0.3, -np.pi], [0.8, 0.3, np.pi], (n, 3))


def test_turbulence_axes_rotate_with_the_flight():
    rng = np.random.default_rng(60)
    heights = np.repeat([50.0, 450.0, 900.0], 20)
    euler, velocity = attitudes(rng, 60), rng.normal(0.0, 15.0, (60, 3))
    turbulence = rng.normal(0.0, 1.0, (60, 3, 1))
    reference = turbulence_axes(heights, velocity, euler) @ turbulence
    for angle in (0.4, np.pi / 2.0, 2.9, -np.pi / 2.0):
        turn = rotation_ned_body(np.array([0.0, 0.0, angle]))
        turned = euler + [0.0, 0.0, angle]
        axes = turbulence_axes(heights, velocity @ turn.T, turned)
        assert axes @ turbulence == pytest.approx(turn @ reference, abs=1e-12)


def test_turbulence_axes_of_each_altitude_band():
    """East at 20 m/s through the air, banked by 30° and pitched by 10°."""
    euler = np.radians([[30.0, 10.0, 90.0]])
    body = rotation_ned_body(euler)
    velocity = np.array([[0.0, 20.0, -3.0]])
    east = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for height, expected in (
        (0.0, east),
        (LOW, east),
        (0.25 * LOW + 0.75 * HIGH, 0.25 * east + 0.75 * body[0]),
        (HIGH, body[0]),
        (5.0 * HIGH, body[0]),
    ):
        found = turbulence_axes(np.array([height]), velocity, euler)
        assert found[0] == pytest.approx(expected, abs=1e-12)


def test_turbulence_axes_straight_down_point_north():
    found = turbulence_axes(np.zeros(1), np.array([[0.0, 0.0, 9.0]]), np.zeros((1, 3)))
    assert (found == np.eye(3)).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spans": [0.0]}, "uav has a wingspan of 0 m: write one above 0 m"),
        ({"spans": [np.nan]}, "write one above 0 m"),
        ({"dt": 0.0}, "turbulence every 0 s: write a step above 0 s"),
    ],
)
def test_dryden_invalid_span_or_step_is_rejected(changes, message):
    args = {
        "seed": 1,
        "dt": 0.02,
        "spans": [SPAN],
        "spectrum": "dryden",
        "scales": Scales("dryden", *MODERATE),
    }
    with pytest.raises(InputError, match=message):
        DrydenTurbulence(["uav"], **{**args, **changes})


def test_psd_integrates_to_the_variances():
    """p by hand: σ_w² 0.8 (πL/4b)^(1/3) π²/(8 b L), for 1 m/s, 100 m and 2.8 m."""
    expected = 0.8 * (np.pi * 100.0 / 11.2) ** (1.0 / 3.0) * np.pi**2 / (22.4 * 100.0)
    grid = np.linspace(np.log(1e-9), np.log(1e12), 20001)
    for airspeed in (12.0, 30.0):
        ones, length = np.ones(3), np.full(3, 100.0)
        density = psd("dryden", np.exp(grid), airspeed, ones, length, 2.8)
        found = np.trapezoid(density * np.exp(grid), grid, axis=1)
        assert found[:4] == pytest.approx([1.0, 1.0, 1.0, expected], rel=1e-6)
    assert len(density) == len(COMPONENTS)


def test_random_numbers_are_independent_of_the_block(monkeypatch):
    expected = fly(NOMINAL, 40, 2)
    monkeypatch.setattr(random, "BLOCK", 7)
    np.testing.assert_array_equal(fly(NOMINAL, 40, 2), expected)


def test_intensity_follows_the_height_within_a_second():
    """The vertical component of 1,000 aircraft that jump from 30 m to 900 m.

    Its standard deviation is known within 10 % by 1,000 samples; it doubles between the heights.
    """
    n, dt = 1000, 0.02
    scales = Scales("dryden", *MODERATE)
    turbulence = DrydenTurbulence(
        [f"uav{i}" for i in range(n)],
        seed=7, dt=dt, spans=[SPAN] * n, spectrum="dryden", scales=scales,
    )  # fmt: skip
    aircraft = allocate(AIRCRAFT, n)
    motion, wind = aircraft["truth"], aircraft["wind"]
    motion["velocity_ned"][:, 0] = 22.0
    step = turbulence.bind(aircraft, allocate(LOCAL_WIND, n))
    for height in (30.0, 900.0):
        motion["position_ned"][:, 2] = -height
        for _ in range(round(1.0 / dt)):
            wind["wind_ned"] = wind["wind_gradient_rates"] = 0.0
            run_steps([step], 0.0)
        expected = scales(np.array([height]))[0][0, 2]
        assert wind["wind_ned"][:, 2].std() == pytest.approx(expected, rel=0.1)
    low, high = scales(np.array([30.0, 900.0]))[0][:, 2]
    assert high > 1.5 * low
