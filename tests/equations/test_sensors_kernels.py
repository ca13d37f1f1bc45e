"""Kernels of the sensors against the numpy reference, along flights that reach every branch."""

import numpy as np
from reference import adapters_sensors as kernels
from reference import sensors_ekf, sensors_step
from sensors_samples import (
    SPEED,
    THINNER,
    Filters,
    ReferenceFilters,
    make_flight,
    no_faults,
    suite,
)

from testbed.core.records import VehicleState, allocate
from testbed.sensors.airspeed import make_airspeed_sensors
from testbed.sensors.errors import (
    ERRORS,
    ConstantBiases,
    advance_errors,
    make_sensor_errors,
    view_errors,
)

# The two take the same sums in other orders and differ by roundings of 1e-16, of positions of
# 1e3 m, that a filter gathers for some seconds: by 1e-11 along this flight.
TOLERANCE = 1e-9
HZ = 50
SUITES = [
    suite("pixhawk"),
    suite("degraded"),
    suite(
        "degraded", estimator={"gate_sigma": 0.7, "airspeed_gate_sigma": 0.7, "reset_after_s": 2.0}
    ),
    suite("pixhawk", gps={"rate_hz": 7, "latency_s": 0.0}, barometer={"rate_hz": 3}),
    suite("pixhawk", magnetometer={"rate_hz": 1}, estimator={"gps_delay_s": 0.5}),
    suite("pixhawk", estimator={"height_source": "gps"}),
    suite(gps={"rate_hz": 50}),
]
EACH = 3  # aircraft with each of these suites


def assert_same(found, expected):
    assert found.keys() == expected.keys()
    for name, array in expected.items():
        np.testing.assert_allclose(found[name], array, rtol=TOLERANCE, atol=TOLERANCE, err_msg=name)


def count_updates(monkeypatch):
    """Count, from now on, what the reference fuses and resets."""
    seen = {"fused": 0, "velocity": 0, "position": 0}
    update, reset = sensors_ekf.scalar_update, sensors_ekf.reset_states

    def counted_update(memory, rows, *rest):
        seen["fused"] += len(rows)
        update(memory, rows, *rest)

    def counted_reset(memory, rows, columns, *rest):
        seen["velocity" if columns == sensors_ekf.VELOCITY else "position"] += len(rows)
        reset(memory, rows, columns, *rest)

    monkeypatch.setattr(sensors_ekf, "scalar_update", counted_update)
    monkeypatch.setattr(sensors_ekf, "reset_states", counted_reset)
    return seen


def test_ekf_step_matches_reference(monkeypatch):
    """With lost fixes, jumps, airspeeds that are rejected, and suites that differ in all keys."""
    seen = count_updates(monkeypatch)
    flight = make_flight(HZ, (8, 0, 0), (12, 1, 0.1), (10, -1, -0.05))
    suites = [each for each in SUITES for _ in range(EACH)]
    n = len(suites)
    ours, theirs = Filters(suites, flight), ReferenceFilters(suites, flight)
    names = [f"uav{i}" for i in range(n)]
    errors = make_sensor_errors(names, suites, seed=1, dt=1 / HZ)
    rng = np.random.default_rng(70)
    heading_bias = rng.normal(0.0, 0.1, n)
    measured = quiet = 0
    for k in range(len(flight)):
        tas = np.maximum(SPEED + rng.normal(0.0, 2.0, n), 0.02)
        tas[0] = 0.02 if 500 < k < 700 else tas[0]  # as of a drained tube: rejected
        lost, jump = np.zeros(n, dtype=bool), np.zeros((n, 3))
        lost[1::EACH] = 400 < k < 900
        jump[2::EACH] = np.array([60.0, -10.0, 5.0]) * (600 < k < 1200)
        advance_errors(errors.coefficients, errors.values, errors.numbers.draw())
        args = {
            "errors": view_errors(errors),
            "heading_bias": heading_bias,
            "airspeed": tas,
            "equivalent_airspeed": tas / THINNER,
            "airspeed_sampled": rng.random(n) < 0.2,
            "gps_lost": lost,
            "gps_jump": jump,
        }
        found, expected = ours.step(k, **args), theirs.step(k, **args)
        np.testing.assert_allclose(found, expected, rtol=TOLERANCE, atol=TOLERANCE)
        if k % 25 == 0:
            assert_same(ours.numbers(), theirs.numbers())
        fixes, heights, headings, airspeeds = sensors_ekf.measured(
            theirs.settings, k, HZ, theirs.sensed(k, **args)
        )
        measured += 5 * fixes.sum() + (fixes & theirs.settings["gps_height"]).sum()
        measured += heights.sum() + headings.sum() + 2 * airspeeds.sum()
        quiet += int((~(fixes | heights | headings | airspeeds)).sum())
    # measurements fused and rejected, resets, and steps without a measurement
    assert seen["fused"] > 10_000
    assert measured - seen["fused"] > 1000
    assert min(seen["velocity"], seen["position"]) >= EACH
    assert quiet > 1000


def test_ekf_step_at_low_airspeed_matches_reference():
    """Near the minimum airspeed: of these filters some fuse airspeed and sideslip, some do not."""
    rng = np.random.default_rng(71)
    flight = make_flight(HZ, (2, 0, 0))
    slow = {"airspeed": np.full(4, 0.5), "equivalent_airspeed": np.full(4, 0.5)}
    unchanged = 0
    for _ in range(40):
        ours = Filters([suite("pixhawk")] * 4, flight)
        theirs = ReferenceFilters([suite("pixhawk")] * 4, flight)
        wind = flight.velocity[0, :2] + rng.normal(0.0, 0.8, (4, 2))
        ours.states[:, 15:] = theirs.states[:, 15:] = wind
        np.testing.assert_allclose(ours.step(5, **slow), theirs.step(5, **slow), atol=TOLERANCE)
        assert_same(ours.numbers(), theirs.numbers())
        unchanged += int((theirs.states[:, 15:] == wind).all(axis=1).sum())
    assert 20 < unchanged < 140


def random_motion(rng, n):
    angles = rng.uniform([-1.0, -1.0, -np.pi], [1.0, 1.0, np.pi], (n, 3))
    a, b, c, d = rng.normal(0.0, 10.0, (4, n, 3))
    return VehicleState(a, b, c, angles, d, *rng.uniform(15.0, 25.0, (2, n)))


def test_apply_errors_matches_reference():
    rng = np.random.default_rng(72)
    for _ in range(100):
        n, rows = 7, np.sort(rng.permutation(7)[:4])
        truth = random_motion(rng, n)
        output, states = rng.normal(0.0, 0.05, (4, 9)), rng.normal(0.0, 0.1, (4, 17))
        errors = allocate(ERRORS, n)
        errors.view("f8")[...] = rng.normal(0.0, 0.1, errors.view("f8").shape)
        expected = VehicleState(*(each.copy() for each in truth))
        sensors_step.apply_errors(expected, rows, output, states, errors)
        found = kernels.apply_errors(truth, rows, output, states, errors)
        assert_same(found._asdict(), expected._asdict())


def test_airspeed_sensor_matches_reference():
    """Tubes that are blocked and open again, drained or not, at other heights and densities."""
    rng = np.random.default_rng(74)
    n = 8
    described = {"noise_pa": 3.0, "smoothing_s": 0.1, "rate_hz": 20}
    suites = [suite(airspeed=described) if i % 3 else suite() for i in range(n)]
    biases = ConstantBiases(*rng.normal(0.0, 0.1, (3, n)))
    sensors = make_airspeed_sensors(suites, biases, HZ)
    reference = sensors_step.AirspeedSensors(sensors.copy(), HZ)
    for k in range(-20, 300):
        truth = random_motion(rng, n)
        blocked = (np.arange(n) % 2 == 0) & (k % 100 > 40)
        faults = no_faults(n)._replace(pitot_blocked=blocked, pitot_drained=np.arange(n) % 4 == 0)
        noise = rng.normal(0.0, 3.0, n)
        reference.measure(k, truth, noise, faults)
        found = kernels.airspeeds(sensors, truth, faults, noise, k, HZ)
        np.testing.assert_allclose(found, reference.airspeeds(truth), rtol=1e-12)
        assert np.array_equal(sensors["sampled"], reference.sampled(k))


def test_add_jitter_matches_reference():
    rng = np.random.default_rng(73)
    for _ in range(100):
        truth, errors = random_motion(rng, 5), rng.normal(0.0, 0.1, (5, 9))
        expected = sensors_step.add_jitter(errors, truth)
        assert_same(kernels.add_jitter(errors, truth)._asdict(), expected._asdict())


def test_advance_errors_matches_reference():
    rng = np.random.default_rng(75)
    coefficients, (values, numbers) = rng.random((2, 5, 9)), rng.normal(size=(2, 5, 9))
    expected = coefficients[0] * values + coefficients[1] * numbers
    advance_errors(coefficients, values, numbers)
    np.testing.assert_allclose(values, expected, rtol=1e-15)
