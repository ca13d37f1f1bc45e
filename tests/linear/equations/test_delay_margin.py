"""The message delay that followers bear which receive from each other, beside flights."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cases import ALL, in_full
from cheap_steady_flights import cheap_steady_flights  # noqa: F401 - for all tests
from scipy.signal import dlsim

import testbed
from testbed.core.errors import InputError
from testbed.linear import delay_margin
from testbed.linear.delay_margin import delay_margins
from testbed.linear.held_flight import HeldFlight
from testbed.linear.linear_formation import join
from testbed.linear.predicted_margins import _LaterMessages, linearise
from testbed.linear.steady_flight import steady_scenario
from testbed.plan.world import build
from testbed.scenario import load_scenario

BEGIN_S = 24.0  # later, an unstable formation has left its steady flight
COMPENSATED = "controller.extrapolate_from=timestamp"


def begin(delay_s):
    """Return a straight flight, some time after its start."""
    scenario = load_scenario("simulation-1", [COMPENSATED, f"network.delay_s={delay_s}"])
    flight = HeldFlight(build(steady_scenario(scenario, 0.0, "compiled")))
    flight.fly_to(BEGIN_S)
    return flight


@pytest.fixture(scope="module")
def maps():
    """Return the linearised control periods of a line of followers that all receive both ways."""
    return linearise(begin(0.0))


@pytest.fixture(scope="module")
def frequencies():
    """As many as users have; else fewer, with which counts are sure, too: see below."""
    with pytest.MonkeyPatch.context() as patch:
        if not ALL:
            patch.setattr(delay_margin, "_FREQUENCIES", 60)
        yield


@pytest.fixture(scope="module")
def margin(maps, frequencies):
    [found] = delay_margins(maps)
    return found


def rate_of(delay_s):
    """Return at which rate a small disturbance grows in flight, 1/s."""
    flight = begin(delay_s)
    start, kick = flight.save(), np.zeros((3, 3))
    still = flight.respond(start, 700)
    kick[0] = math.radians(0.02), math.radians(0.02), 3e-4
    errors = np.abs(flight.respond(start, 700, kick) - still)[..., 2:].max(axis=(1, 2))
    early, late = errors[175:350].max(), errors[525:].max()
    return math.log(late / early) / 14.0


def test_delay_margin_is_that_of_flights(maps, margin):
    """Disturbances decay at 0.95 times the margin and grow at 1.05 times it."""
    loop, periods = delay_margin._MessageLoop(maps, [0, 1, 2]), round(margin.delay_s / maps.dt)
    assert loop.count_unstable(periods) == 0 < loop.count_unstable(periods + 1)
    assert margin.followers == ("uav1", "uav2", "uav3") and 0.8 < margin.delay_s < 1.4
    assert rate_of(0.95 * margin.delay_s) < -0.02
    assert rate_of(1.05 * margin.delay_s) > 0.005


@pytest.mark.usefixtures("frequencies")
def test_delay_margin_needs_the_extrapolation(maps, margin, monkeypatch):
    """From the time of receipt the loop bears every delay that is tried."""
    monkeypatch.setattr(delay_margin, "MAX_DELAY_S", 1.2 * margin.delay_s)
    [found] = delay_margins(replace(maps, from_timestamp=np.zeros(3, dtype=bool)))
    assert math.isinf(found.delay_s)


def delayed(maps, delay_s):
    """Return maps with later messages, extrapolated by that time along the velocity."""
    late = np.eye(9) + delay_s * np.eye(9, k=3)
    late[3:6, 6:9] = 0.0  # the acceleration is not used
    followers = [
        each._replace(
            b_message={j: b @ late if j else b for j, b in each.b_message.items()},
            d_message={j: d @ late if j else d for j, d in each.d_message.items()},
        )
        for each in maps.followers
    ]
    ages = np.where(np.isnan(maps.age_s), np.nan, delay_s)
    return replace(maps, followers=tuple(followers), age_s=ages)


@in_full  # as flights decide, and counts the period
def test_delay_margin_has_the_poles_of_the_map(maps, margin):
    """Those of the system that has all messages under way in its state."""
    assert join(delayed(maps, margin.delay_s)).is_stable()
    assert not join(delayed(maps, margin.delay_s + maps.dt)).is_stable()


@pytest.mark.parametrize("last", [0, 17, 49])
def test_delays_that_need_flights_are_searched(maps, monkeypatch, last):
    """As for a law of a user, of which each delay is flown; one that is not steady is unstable."""

    class Loop:
        def __init__(self, periods, _):
            self.count_unstable = lambda _: int(periods > last)

    monkeypatch.setattr(delay_margin, "_MessageLoop", Loop)
    for later in (lambda periods: periods, lambda periods: None if periods > last else 0):
        assert delay_margin._search(later, maps, []) == pytest.approx(last * maps.dt)
    assert math.isinf(delay_margin._search(lambda _: 0, maps, []))


@pytest.mark.usefixtures("frequencies")
def test_maps_with_later_messages_are_of_flights(maps):
    """Those of the built-in law are known without a flight."""
    later = _LaterMessages(load_scenario("simulation-1", [COMPENSATED]), 0.0, maps)(10)
    rows = [0, 1, 2]
    flown = delay_margin._MessageLoop(later, rows)._determinant(0)
    found = delay_margin._MessageLoop(maps, rows)._determinant(10)
    assert np.abs(found / flown - 1.0).max() < 0.01
    wrong = replace(maps, from_timestamp=np.zeros(3, dtype=bool))
    assert np.abs(delay_margin._MessageLoop(wrong, rows)._determinant(10) / flown - 1).max() > 0.1


def test_counts_are_sure_with_few_frequencies(maps, monkeypatch):
    """Where the determinant turns far between two frequencies, others are added between them."""

    def counts(frequencies, largest_turn):
        monkeypatch.setattr(delay_margin, "_FREQUENCIES", frequencies)
        monkeypatch.setattr(delay_margin, "_LARGEST_TURN", largest_turn)
        loop = delay_margin._MessageLoop(maps, [0, 1, 2])
        tried = range(0, 50, 4) if ALL else (0, 18, 36)
        return [loop.count_unstable(periods) for periods in tried]

    sure = counts(3000 if ALL else 400, 0.5)
    assert sure[0] == 0 and sure[-1] >= 2
    assert counts(12, 0.5) == sure
    assert counts(12, math.inf) != sure


def test_state_space_steps_as_the_flight(maps):
    """Matrices with names, as control libraries take them."""
    model = join(maps)
    flight = begin(0.0)
    start, kick = flight.save(), np.zeros((3, 3))
    kick[0, 1] = math.radians(0.01)
    flown = flight.respond(start, 100, kick) - flight.respond(start, 100)
    inputs = np.zeros((100, len(model.inputs)))
    inputs[:5, model.inputs.index("uav1.roll")] = math.radians(0.01)
    _, found, _ = dlsim(model.to_scipy(), inputs)
    for name, column in (("attitude.roll", 0), ("error.right", 3)):
        roll = found[:, model.outputs.index(f"uav1.{name}")]
        assert np.linalg.norm(roll - flown[:, 0, column]) < 0.02 * np.linalg.norm(roll)


def test_followers_shift_with_the_leader(maps):
    """At frequency 0 the slot error, with the leader's slot held, is the leader's displacement."""
    model = join(maps)
    [response] = model.response_at(np.exp([1e-4j * model.dt]))
    for axis in ("forward", "right"):
        column = model.inputs.index(f"leader.position_ned.{axis}")
        for name in ("uav1", "uav2", "uav3"):
            row = model.outputs.index(f"{name}.error.{axis}")
            assert abs(response[row, column]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"bank_deg": True}, "bank_deg: is True"),
        ({"bank_deg": 61.0}, "from -60 to 60"),
        ({"climb_mps": math.nan}, "climb_mps: is nan"),
        ({"bank_deg": 49.0}, "too near the limit of uav1"),
    ],
)
def test_linearise_refuses(arguments, message):
    """Each error has what to write."""
    with pytest.raises(InputError, match=message):
        testbed.linearise("simulation-3", **arguments)
    with pytest.raises(InputError, match=message):
        testbed.GainScan("simulation-3", **arguments)
