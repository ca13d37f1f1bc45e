"""Dryden turbulence: filters exact for the step, spectra and variances of the closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from air_samples import (
    COMPONENTS,
    SAMPLES,
    SPAN,
    Case,
    cases,
    closed_variance,
    discrete_variance,
    felt,
    flown,
    fly,
    freedom,
    inside,
    least,
    steps_of,
)
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.stats import chi2

from testbed.air import independent
from testbed.air.filters import blank_filters, make_filters, write_filters
from testbed.air.independent import Independent, add_turbulence, turbulence_axes
from testbed.air.mil import HIGH, INTENSITIES, LOW, Scales
from testbed.air.spectra import psd
from testbed.errors import InputError
from testbed.frames import rotation_ned_body

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
@pytest.mark.parametrize("step", [4e-5, 1e-3, 0.05, 1.0, 40.0])
def test_a_step_is_the_matrix_exponential_and_keeps_the_stationary_covariance(corner, step):
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
def test_the_continuous_filters_have_the_closed_spectra(case):
    """|c (jω − A)⁻¹ B|², one-sided and per hertz, against section 3.7.1.2 and 3.7.5."""
    frequency = np.geomspace(1e-4, 50.0, 60)
    filters, expected = case.filters(), case.density(frequency)
    for axis, (speed, rate, span) in enumerate(((1, 5, 3.0 * SPAN), (2, 4, 4.0 * SPAN))):
        length = case.scales[1][1 + axis]
        a, b = system(np.pi * length / span)
        omega = 2.0 * np.pi * frequency * length / case.airspeed
        states = np.linalg.solve(1j * omega[:, None, None] * np.eye(3) - a, b[:, None])[..., 0]
        level = 2.0 * length / case.airspeed  # of the noise, in (L/V) s, and one-sided
        given = level * np.abs(states[:, :2] @ filters.speed[0, axis, 0]) ** 2
        assert given == pytest.approx(expected[speed], rel=1e-10)
        given = level * np.abs(states @ filters.rate[0, axis, 0]) ** 2
        assert given == pytest.approx(expected[rate], rel=1e-10)


@pytest.mark.parametrize("case", cases("dryden"))
def test_discrete_variance_is_the_closed_forms(case):
    """Within 0.1 %; the integral itself is good to 1e-6."""
    assert discrete_variance(case.filters()) == pytest.approx(closed_variance(case), rel=1e-5)


def test_variance_does_not_depend_on_the_step():
    found = [
        discrete_variance(Case("dryden", 22.0, 120.0, dt, 0).filters()) for dt in (1e-3, 0.02, 5.0)
    ]
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[2] == pytest.approx(found[1], rel=1e-9)


def test_rates_are_slopes_of_the_same_turbulence():
    """q = −∂w/∂x and r = ∂v/∂x, lagged by the distances 4b/π and 3b/π.

    Over distances short against L, ∂w/∂x is white: with its mean over a step D, its lag by a
    distance τ has a correlation of (1 − e^(−D/τ)) √(2τ/D).
    """
    step, count = 0.01, 20000
    air = Independent(
        ["uav"],
        seed=4,
        dt=step,
        spans=[np.pi / 4.0 * step],
        spectrum="dryden",
        scales=Scales("dryden", *MODERATE, sigma=(1.0,) * 3, length=(50.0,) * 3),
    )
    seen = flown(air, np.array([100.0]), np.array([1.0]), count)[:, 0]
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


def test_the_band_tells_another_spectrum_apart(flights):
    case, flight = flights[0]
    stranger = Case("von-karman", case.airspeed, case.height, case.dt, case.seed)
    assert inside(case, flight, stranger)[:3].mean() < 0.8
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


def test_the_nominal_flight_lies_in_its_band():
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


def test_it_starts_as_it_goes_on():
    """First samples of 600 aircraft: mean squares within the χ² band of 1e-5."""
    found = (fly(NOMINAL, 1, 600)[0] ** 2).sum(axis=0) / closed_variance(NOMINAL)
    assert (found > chi2.ppf(1e-5, 600)).all()
    assert (found < chi2.isf(1e-5, 600)).all()


def test_heights_and_airspeeds_may_change_without_a_transient():
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
        air = Independent(
            ["uav"],
            seed=3,
            dt=0.1,
            spans=[SPAN],
            spectrum="dryden",
            scales=lambda height: (np.tile(height[:, None], 3), np.full((1, 3), 50.0)),
            hold_s=hold_s,
        )
        heights = (1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0)
        return np.array([felt(air, np.array([each]), np.array([20.0]))[0][0] for each in heights])

    ratio = aloft(0.5) / aloft(0.1)
    assert ratio == pytest.approx(np.array([[1, 1, 1, 0.5, 0.5, 1, 1]]).T * np.ones(3))


def test_air_that_is_not_flown_through_stays():
    air = Independent(
        ["uav"],
        seed=3,
        dt=0.02,
        spans=[SPAN],
        spectrum="dryden",
        scales=Scales("dryden", *MODERATE),
    )
    first, second = (felt(air, np.array([100.0]), np.zeros(1)) for _ in range(2))
    for one, two in zip(first, second, strict=True):
        assert (one == two).all()
        assert np.abs(one).min() > 0.0


def test_draws_are_keyed_by_name_and_differ():
    def seen(names, seed=1):
        air = Independent(
            names,
            seed=seed,
            dt=0.02,
            spans=[SPAN] * len(names),
            spectrum="dryden",
            scales=Scales("dryden", *MODERATE),
        )
        n = len(names)
        steps = flown(air, np.full(n, 100.0), np.full(n, 20.0), 600)
        return {name: steps[:, i] for i, name in enumerate(names)}

    alone, together = seen(["uav2"]), seen(["leader", "uav1", "uav2", "uav3"])
    np.testing.assert_array_equal(alone["uav2"], together["uav2"])
    np.testing.assert_array_equal(together["uav1"], seen(["uav1", "leader"])["uav1"])
    assert (together["uav1"] != together["uav2"]).all()
    assert (seen(["uav2"], seed=2)["uav2"] != alone["uav2"]).all()


def test_aircraft_are_uncorrelated_and_so_are_components():
    """Steps of 20 lengths make samples independent: correlations have errors of 1/√n.

    Only q goes with its w, and r with its v.
    """
    count, aircraft = 4000, 3
    length = NOMINAL.scales[1].max()
    case = replace(NOMINAL, dt=20.0 * length / NOMINAL.airspeed)
    seen = np.corrcoef(fly(case, count, aircraft).reshape(count, -1).T)
    own = np.eye(6)
    own[2, 4] = own[4, 2] = own[1, 5] = own[5, 1] = 1.0
    strangers = np.kron(np.eye(aircraft), own) == 0.0
    assert np.abs(seen[strangers]).max() < 4.5 / np.sqrt(count)


def attitudes(rng, n):
    return rng.uniform([-0.8, -0.3, -np.pi], [0.8, 0.3, np.pi], (n, 3))


def test_turning_the_flight_turns_the_turbulence_and_nothing_else():
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


def test_turbulence_axes_of_each_band():
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


def test_straight_down_the_axes_point_north():
    found = turbulence_axes(np.zeros(1), np.array([[0.0, 0.0, 9.0]]), np.zeros((1, 3)))
    assert (found == np.eye(3)).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"spans": [0.0]}, "uav has a wingspan of 0 m: write one above 0 m"),
        ({"spans": [np.nan]}, "write one above 0 m"),
        ({"dt": 0.0}, "turbulence every 0 s: write a step above 0 s"),
    ],
)
def test_what_cannot_fly_is_refused(changes, said):
    page = {
        "seed": 1,
        "dt": 0.02,
        "spans": [SPAN],
        "spectrum": "dryden",
        "scales": Scales("dryden", *MODERATE),
    }
    with pytest.raises(InputError, match=said):
        Independent(["uav"], **{**page, **changes})


def test_variances_of_rates_do_not_depend_on_airspeed_and_densities_add_up():
    """p by hand: σ_w² 0.8 (πL/4b)^(1/3) π²/(8 b L), for 1 m/s, 100 m and 2.8 m."""
    expected = 0.8 * (np.pi * 100.0 / 11.2) ** (1.0 / 3.0) * np.pi**2 / (22.4 * 100.0)
    grid = np.linspace(np.log(1e-9), np.log(1e12), 20001)
    for airspeed in (12.0, 30.0):
        ones, length = np.ones(3), np.full(3, 100.0)
        density = psd("dryden", np.exp(grid), airspeed, ones, length, 2.8)
        found = np.trapezoid(density * np.exp(grid), grid, axis=1)
        assert found[:4] == pytest.approx([1.0, 1.0, 1.0, expected], rel=1e-6)
    assert len(density) == len(COMPONENTS)


def test_the_compiled_filters_and_steps_do_what_the_readable_ones_say():
    """To rounding: sums of up to 48 terms of order one, in other orders."""
    pytest.importorskip("numba")
    from testbed.air import filters_twin, independent_twin

    rng = np.random.default_rng(61)
    heights = np.array([-5.0, 100.0, 400.0, 450.0, 600.0, 2000.0])
    for spectrum in ("dryden", "von-karman"):
        for n in (1, 2, 60):
            scales = rng.uniform(0.5, 3.0, (n, 3)), rng.uniform(3.0, 700.0, (n, 3))
            distance, spans = rng.uniform(0.0, 5.0, n), rng.uniform(1.0, 5.0, n)
            distance[0] = 0.0
            scales[1][-1, 1] = 3.0 * spans[-1] / np.pi  # a corner on a pole, of the first part
            filters, others = blank_filters(spectrum, n), blank_filters(spectrum, n)
            write_filters(spectrum, distance, *scales, spans, filters)
            filters_twin.write_filters(spectrum, distance, *scales, spans, others)
            # the last pivot of a short step is the root of a rounding; its square is none's
            for name, one, two in zip(filters._fields, filters, others, strict=True):
                if name == "root":
                    one, two = (each @ each.swapaxes(-1, -2) for each in (one, two))
                np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-12, err_msg=name)
            state, draw = rng.normal(0.0, 1.0, (2, n, 7 * (filters.keep.shape[1] - 1) + 1))
            position, velocity, mean, wind, rates = rng.normal(0.0, 15.0, (5, n, 3))
            position[:, 2] = -np.resize(heights, n)
            velocity[0] = mean[0]
            euler = attitudes(rng, n)
            ours, theirs = ([each.copy() for each in (state, wind, rates)] for _ in range(2))
            place = position, velocity, euler, mean
            add_turbulence(ours[0], filters, *place, *ours[1:], draw)
            independent_twin.ready_add_turbulence(theirs[0], filters, *place, *theirs[1:])(draw)
            for one, two in zip(ours, theirs, strict=True):
                assert two == pytest.approx(one, abs=1e-12)


def test_a_draw_does_not_depend_on_the_block(monkeypatch):
    expected = fly(NOMINAL, 40, 2)
    monkeypatch.setattr(independent, "BLOCK", 7)
    np.testing.assert_array_equal(fly(NOMINAL, 40, 2), expected)
