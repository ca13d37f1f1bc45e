"""The compiled filter does what the readable one says, along flights that reach every branch."""

import copy
from functools import partial

import numpy as np
import pytest
from sensing_samples import SPEED, THINNER, Filters, make_flight, nothing_fails, page

from testbed.sensing import belief, estimators, fusion, jitter, senses
from testbed.sensing import errors as columns
from testbed.sensing.errors import SensorErrors, make_levels
from testbed.sensing.estimators import Estimators
from testbed.sensing.navigation import VELOCITY
from testbed.state import VehicleState

pytest.importorskip("numba")

from testbed.sensing import belief_twin, fusion_twin, jitter_twin, senses_twin  # noqa: E402

# The two take the same sums in other orders and differ by roundings of 1e-16, of positions of
# 1e3 m, that a filter gathers for some seconds: by 1e-11 along this flight.
TOLERANCE = 1e-9
HZ = 50
PAGES = [
    page("pixhawk"),
    page("degraded"),
    page(
        "degraded", estimator={"gate_sigma": 0.7, "airspeed_gate_sigma": 0.7, "reset_after_s": 2.0}
    ),
    page("pixhawk", gps={"rate_hz": 7, "latency_s": 0.0}, barometer={"rate_hz": 3}),
    page("pixhawk", magnetometer={"rate_hz": 1}, estimator={"gps_delay_s": 0.5}),
    page(gps={"rate_hz": 50}),
]
EACH = 3  # aircraft with each of these pages


def navigate(memory, settings, step, truth, sensed):
    """The compiled filters, called as the readable ones are."""
    flown = np.empty((len(memory.states), 9))
    told = np.array([sensed.equivalent_airspeed, sensed.airspeed])
    seen = sensed.errors, sensed.heading, told, sensed.airspeed_new
    fusion_twin.step_filters(
        np.arange(len(flown)),
        *settings,
        *memory,
        flown,
        step,
        *truth[:4],
        *seen,
        sensed.gps_lost,
        sensed.gps_jump,
    )
    return flown


def numbers(memory):
    return {name: array.copy() for name, array in memory._asdict().items()}


def compare(ours, theirs):
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        assert theirs[name].dtype == array.dtype, name
        np.testing.assert_allclose(
            theirs[name], array, rtol=TOLERANCE, atol=TOLERANCE, err_msg=name
        )


class Spy:
    """Counts what the readable filter does."""

    def __init__(self, monkeypatch):
        """From now on."""
        self.seen = {"velocity": 0, "position": 0, "taken": 0, "quiet": 0}
        fuse, restart = fusion.fuse, fusion.restart

        def fusing(memory, rows, *rest):
            self.seen["taken"] += len(rows)
            fuse(memory, rows, *rest)

        def restarting(memory, rows, which, *rest):
            self.seen["velocity" if which == VELOCITY else "position"] += len(rows)
            restart(memory, rows, which, *rest)

        monkeypatch.setattr(fusion, "fuse", fusing)
        monkeypatch.setattr(fusion, "restart", restarting)


def test_the_filter_along_a_flight(monkeypatch):
    """A lost GPS, jumps, tubes that stop, and pages that differ in all that they can say."""
    spy = Spy(monkeypatch).seen
    flight = make_flight(HZ, (8, 0, 0), (12, 1, 0.1), (10, -1, -0.05))
    pages = [each for each in PAGES for _ in range(EACH)]
    n = len(pages)
    readable, compiled = Filters(pages, flight), Filters(pages, flight, navigate)
    names = [f"uav{i}" for i in range(n)]
    sensors = SensorErrors(names, make_levels(pages, 1 / HZ), seed=1, dt=1 / HZ)
    rng = np.random.default_rng(70)
    heading = rng.normal(0.0, 0.1, n)
    expected = 0
    for k in range(len(flight)):
        tas = np.maximum(SPEED + rng.normal(0.0, 2.0, n), 0.02)
        tas[0] = 0.02 if 500 < k < 700 else tas[0]  # as if drained: refused
        lost = np.zeros(n, dtype=bool)
        lost[1::EACH] = 400 < k < 900
        jump = np.zeros((n, 3))
        jump[2::EACH] = np.array([60.0, -10.0, 5.0]) * (600 < k < 1200)
        given = {
            "errors": sensors.advance(),
            "heading": heading,
            "airspeed": tas,
            "equivalent_airspeed": tas / THINNER,
            "airspeed_new": rng.random(n) < 0.2,
            "gps_lost": lost,
            "gps_jump": jump,
        }
        sensed = readable.sensed(k, **given)
        ours, theirs = readable.step(k, **given), compiled.step(k, **given)
        settings = readable.settings
        fixes = fusion.due(settings.gps_hz, k, HZ) & ~lost
        height, compass = (
            fusion.due(each, k, HZ) for each in (settings.barometer_hz, settings.compass_hz)
        )
        expected += 5 * fixes.sum() + height.sum() + compass.sum() + 2 * sensed.airspeed_new.sum()
        spy["quiet"] += int((~(fixes | height | compass | sensed.airspeed_new)).sum())
        np.testing.assert_allclose(theirs, ours, rtol=TOLERANCE, atol=TOLERANCE)
        if k % 25 == 0:
            compare(numbers(readable.memory), numbers(compiled.memory))
    # numbers taken in, numbers refused, resets, and steps without a measurement
    assert spy["taken"] > 10_000
    assert expected - spy["taken"] > 1000
    assert min(spy["velocity"], spy["position"]) >= EACH
    assert spy["quiet"] > 1000


def test_slow_air_says_nothing_to_either():
    """Who flies with the wind through air at rest about it: no airspeed and no slip is taken in."""
    rng = np.random.default_rng(71)
    flight = make_flight(HZ, (2, 0, 0))
    reached = 0
    for _ in range(40):
        readable = Filters([page("pixhawk")] * 4, flight)
        readable.memory.states[:, 15:] = flight.velocity[0, :2] + rng.normal(0.0, 0.8, (4, 2))
        compiled = Filters([page("pixhawk")] * 4, flight, navigate)
        compiled.memory.states[:] = readable.memory.states
        slow = {"airspeed": np.full(4, 0.5), "equivalent_airspeed": np.full(4, 0.5)}
        before = readable.memory.states.copy()
        ours, theirs = readable.step(5, **slow), compiled.step(5, **slow)
        np.testing.assert_allclose(theirs, ours, rtol=TOLERANCE, atol=TOLERANCE)
        compare(numbers(readable.memory), numbers(compiled.memory))
        reached += int((readable.memory.states[:, 15:] == before[:, 15:]).all(axis=1).sum())
    assert 20 < reached < 140


def test_what_is_believed():
    rng = np.random.default_rng(72)
    for _ in range(100):
        n = 7
        rows = np.sort(rng.permutation(n)[:4])
        angles = rng.uniform([-1.0, -1.0, -np.pi], [1.0, 1.0, np.pi], (n, 3))
        vectors = rng.normal(0.0, 10.0, (4, n, 3))
        truth = VehicleState(
            vectors[0], vectors[1], vectors[2], angles, vectors[3], *rng.uniform(15.0, 25.0, (2, n))
        )
        flown, states = rng.normal(0.0, 0.05, (4, 9)), rng.normal(0.0, 0.1, (4, 17))
        errors = rng.normal(0.0, 0.1, (n, columns.COLUMNS))
        ours, theirs = copy.deepcopy(truth), copy.deepcopy(truth)
        belief.believe(ours, rows, flown, states, errors)
        vectors = np.array(theirs[:5])
        belief_twin.write_beliefs(vectors, rows, flown, states, errors)
        theirs = VehicleState(*vectors, *theirs[5:])
        compare(ours._asdict(), theirs._asdict())
        others = np.setdiff1d(np.arange(n), rows)
        for name, array in ours._asdict().items():
            assert np.array_equal(array[others], getattr(truth, name)[others])
            changed = name not in ("airspeed", "equivalent_airspeed")
            assert (array[rows] != getattr(truth, name)[rows]).all() == changed


def test_all_that_is_sensed_along_a_flight(monkeypatch):
    """Tubes that are blocked and open again, drained or not; a lost GPS; and asked in between."""
    monkeypatch.setattr(estimators, "WARM_UP_S", 2.0)
    flight = make_flight(HZ, (4, 0, 0), (8, 1, 0.1))
    tube = page(airspeed={"noise_pa": 3.0, "offset_pa": 10.0, "smoothing_s": 0.1, "rate_hz": 20})
    pages = [page(), tube, *PAGES, tube, page("pixhawk")]
    n = len(pages)
    names = [f"uav{i}" for i in range(n)]

    def failing(k):
        blocked = (np.arange(n) % 2 == 0) & (100 < k < 300)
        return nothing_fails(n)._replace(
            pitot_blocked=blocked,
            pitot_drained=blocked & (np.arange(n) % 4 == 0),
            gps_lost=(np.arange(n) % 3 == 0) & (200 < k < 400),
        )

    def believed(engine):
        monkeypatch.setattr(estimators, "READY_SENSE", engine)
        start = flight.at(0, n)
        each = Estimators(names, pages, seed=3, rate_hz=HZ, start=start, breakable=True)
        out = []
        for k in range(len(flight)):
            truth = flight.at(k, n)
            for fresh in (True, False)[: 1 + k % 2]:
                estimate = each.estimate(truth, fresh=fresh, failing=failing(k))
                out.append(np.concatenate([np.reshape(array, (n, -1)) for array in estimate], 1))
        return np.array(out)

    ours, theirs = believed(partial(partial, senses.sense)), believed(senses_twin.ready_sense)
    np.testing.assert_allclose(theirs, ours, rtol=TOLERANCE, atol=TOLERANCE)
    assert abs(ours[:, 0, -2:] - SPEED).max() > 1.0  # blocked in a climb


def test_errors_on_top_of_an_estimate():
    rng = np.random.default_rng(73)
    n = 5
    errors, draw = rng.normal(0.0, 0.1, (2, n, 9))
    parts = rng.uniform(0.0, 1.0, (2, n, 9))
    vectors = rng.normal(0.0, 1.0, (5, n, 3))
    estimate = VehicleState(*vectors, *rng.uniform(15.0, 25.0, (2, n)))
    mine, other = errors.copy(), errors.copy()
    ours, theirs = (VehicleState(*np.empty((5, n, 3)), *np.empty((2, n))) for _ in range(2))
    compiled = jitter_twin.ready_jitter(other, parts, estimate, theirs)
    for each in (draw, None, 2.0 * draw, None):
        jitter.jitter(mine, parts, estimate, ours, each)
        compiled(each)
        np.testing.assert_allclose(other, mine, rtol=1e-15, atol=0.0)
        compare(ours._asdict(), theirs._asdict())
