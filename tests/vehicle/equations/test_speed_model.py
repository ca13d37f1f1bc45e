"""A user's own f and g in (2): closed forms of the ideal vehicle, and of the law's (14)."""

import math

import numpy as np
import pytest

import testbed
from testbed.core.errors import InputError
from testbed.core.speed_model import make_own, speed_model_records
from testbed.plan.world import build
from testbed.scenario import load_scenario, set_duration
from testbed.vehicle.unicycle import advance, make_unicycles

LOW, HIGH = 16.0, 30.0
POLE = 0.64
BY_TABLE = make_own(lambda s: -POLE * s, lambda s: np.full_like(s, POLE), LOW, HIGH)
DRAG = 0.02  # 1/m
THRUST = 3.0


def unicycles(models, speed):
    n = len(models)
    velocity = np.tile([speed, 0.0, 0.0], (n, 1))
    return make_unicycles(
        np.zeros((n, 3)), velocity, np.full(n, POLE), speed_model_records(*models)
    )


def test_drag_against_thrust_is_the_closed_form():
    """ṡ = −c s² + g u has the solution s∞ tanh(c s∞ t + atanh(s0/s∞)); x = ln(cosh) / c."""
    model = make_own(lambda s: -DRAG * s * s, lambda s: np.full_like(s, THRUST), LOW, HIGH)
    vehicle, u, start, seconds = unicycles([model], 18.0), 5.0, 18.0, 3.0
    vehicle["speed_command"] = u
    advance(vehicle, 0.005, round(seconds / 0.005))
    final = math.sqrt(THRUST * u / DRAG)
    before = math.atanh(start / final)
    after = DRAG * final * seconds + before
    assert vehicle["speed"][0] == pytest.approx(final * math.tanh(after), rel=1e-8)
    distance = math.log(math.cosh(after) / math.cosh(before)) / DRAG
    assert vehicle["position"][0, 0] == pytest.approx(distance, rel=1e-8)


def test_pole_as_functions_is_the_pole():
    vehicles = unicycles([None, BY_TABLE], 18.0)
    vehicles["speed_command"] = 27.0
    vehicles["omega"] = [0.0, 0.02, 0.3]
    advance(vehicles, 0.005, 400)
    for name in ("speed", "position", "rotation"):
        assert vehicles[name][1] == pytest.approx(vehicles[name][0], rel=1e-9, abs=1e-8)


def figure_eight(*overrides, seconds=40.0):
    scenario = set_duration(load_scenario("ideal-own-speed-model", overrides), seconds)
    frames = []

    class Watcher:
        def begin(self, info):
            pass

        def observe(self, sample):
            ground_velocity = sample.truth.velocity_ned[1:]
            frames.append(
                (np.linalg.norm(ground_velocity, axis=1), sample.formation.error_ned.copy())
            )

        def end(self, summary, events):
            pass

    testbed.run(scenario, write=False, observers=[Watcher()])
    speeds, errors = map(np.array, zip(*frames, strict=True))
    return speeds, errors


def test_theorem_holds_with_general_f_and_g():
    """(O1) and (O3): errors fall, speeds stay in S, and in the limit the loop is that of the pole.

    (14) removes f and g. While a command is held they act, so that the speeds of the two models
    differ by the period, of first order.
    """
    differences = []
    for rate_hz in (200, 400):
        rates = [f"rates.{name}_hz={rate_hz}" for name in ("physics", "autopilot", "control")]
        rates.append(f"rates.broadcast_hz={rate_hz}")
        speeds, errors = figure_eight(*rates, seconds=20.0)
        by_pole, _ = figure_eight(*rates, "formation.speed_model=null", seconds=20.0)
        assert ((speeds > LOW) & (speeds < HIGH)).all()
        lengths = np.linalg.norm(errors, axis=2)
        assert (lengths[-1] < 0.5 * lengths[0]).all()
        differences.append(np.abs(speeds - by_pole).max())
    assert differences[0] < 0.05
    assert differences[0] / differences[1] == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize(
    ("f", "g", "message"),
    [
        (lambda s: -s, lambda s: s - 20.0, r"g is zero or changes its sign near (20|19\.96) m/s"),
        (lambda s: -s, lambda s: 0.0 * s, "g is zero or changes its sign near 8 m/s"),
        (lambda s: np.abs(s - 23.0), lambda s: 1.0 + 0.0 * s, "f has no continuous derivative"),
    ],
    ids=["sign", "zero", "kink"],
)
def test_unusable_speed_model_is_an_error(f, g, message):
    with pytest.raises(ValueError, match=message):
        make_own(f, g, LOW, HIGH)


def test_flight_model_with_a_speed_model_is_an_error():
    with pytest.raises(InputError, match="uav2 has a flight model, and the throttle loop"):
        build(load_scenario("ideal-own-speed-model", ["fleet.uav2.vehicle=jsbsim"]))
    with pytest.raises(InputError, match="a law of your own commands speeds"):
        build(
            load_scenario(
                "ideal-own-speed-model", ["controller.law=leader_follower:LeaderFollower"]
            )
        )
