"""Properties of the laws of the library, each on the model for which it is published.

The kernels are those that fly, built from a scenario; vehicles and messages are the test's own.
In `make test` laws that tests/formation/contract/test_law_library.py does not compile run as
Python, as in a debugger: compiling one takes up to 7 s.
"""

import functools
import importlib.util
import math

import numpy as np
import pytest
import yaml
from cases import some
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import lsq_linear

from testbed.core.compile import is_compiled
from testbed.formation.compiled_law import (
    FollowerConfig,
    allocate_inputs,
    follower_config,
    python_function,
)
from testbed.formation.follower_hbh23 import FollowerHbh23
from testbed.plan.clock import build_clock
from testbed.plan.control import build_control
from testbed.plan.measured_fleet import resolve
from testbed.scenario import LAWS, list_laws, load_scenario

GRAVITY = 9.81
DT = 0.04  # s, between two control steps
SPEED = 22.0  # m/s, of the leader


def law_of(name, options="{}", *changes):
    """The law of a scenario's three followers, and their configuration."""
    compiled = name in some(list_laws(), 1)
    settings = [f"controller.law={name}", f"controller.options={options}"] if compiled else []
    built = control_of(*settings, *changes)
    if compiled:
        return built.groups[0].law, built.config
    return Interpreted(name, yaml.safe_load(options), built), built.config


@functools.cache
def control_of(*changes):
    """The control of a scenario; a law's `step` leaves it as it is."""
    scenario = load_scenario("simulation-3", changes)
    return build_control(resolve(scenario), scenario.controller, build_clock(scenario))


@functools.cache
def python_module(name):
    """The file of a law, imported; its functions are Python, but for those in COMPILED."""
    spec = importlib.util.spec_from_file_location(f"python_{name}", LAWS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    kernels = {key: each for key, each in vars(module).items() if is_compiled(each)}
    outputs = getattr(module, name).law_outputs
    for key in kernels.keys() - COMPILED:
        setattr(module, key, python_function(kernels[key]))
    return module, outputs


COMPILED = {"solve"}  # up to 200 steps of a method, and no other


class Interpreted:
    """A law of the library that runs as Python, with the methods of `CompiledLaw`."""

    def __init__(self, name, options, built):
        module, self.outputs = python_module(name.replace("-", "_"))
        self.function, self.options = getattr(module, name.replace("-", "_")), options
        config, gains = built.config, built.controllers["law"]
        values = {each: getattr(config, each, None) for each in FollowerConfig._fields}
        values |= {"speed_min": config.airspeed_min, "speed_max": config.airspeed_max}
        paper = FollowerHbh23(gains.view(np.recarray), config.offsets, config.gains)
        self.config = FollowerConfig(**{**values, "hbh23": paper})

    def start(self, own):
        return np.zeros(len(self.config.agents), self.outputs.memory).view(np.recarray)

    def step(self, now, own, inbox, memory):
        after, found = memory.copy(), []
        for row in range(len(after)):
            one = python_function(follower_config)(self.config, row)
            given = (type(each)(*(x[row] for x in each)) for each in (own, inbox))
            found.append(self.function(now, *given, after[row], one, **self.options))
        return type(found[0])(*map(np.array, zip(*found, strict=True))), after


class Formation:
    """A leader of constant speed and turn rate, and what three followers know at a time."""

    def __init__(self, law, config, *, turn=0.0, wind=(0.0, 0.0, 0.0)):
        self.law, self.config, self.turn, self.wind = law, config, turn, np.array(wind)
        self.position = np.zeros((3, 3))
        self.velocity = np.tile([SPEED, 0.0, 0.0], (3, 1))
        self.heading = np.zeros(3)
        self.memory = law.start(None)
        self.heard = True
        self.payload = None  # (3, K) of the followers, sent at `sent_s`
        self.command = None

    def leader(self, t):
        """Position, velocity and acceleration."""
        course = self.turn * t
        along = np.array([math.cos(course), math.sin(course), 0.0])
        side = np.array([-along[1], along[0], 0.0])
        way = [SPEED * t, 0.0, 0.0]
        if self.turn:
            radius = SPEED / self.turn
            way = [radius * math.sin(course), radius * (1.0 - math.cos(course)), 0.0]
        return np.array(way), SPEED * along, SPEED * self.turn * side

    def slots(self, t):
        """Positions (3, 3) and velocities of the slots."""
        position, velocity, _ = self.leader(t)
        along = velocity / SPEED
        axes = np.array([along, [-along[1], along[0], 0.0], [0.0, 0.0, 1.0]])
        arms = self.config.offsets[1:] @ axes
        return position + arms, velocity + np.cross([0.0, 0.0, self.turn], arms)

    def step(self, t, position=None, *, turn_known=True):
        """Return the commands of a step at which followers are at their positions, or others."""
        own, inbox = allocate_inputs(3, 4, self.law.outputs.sent_numbers)
        own.position_ned[:] = self.position if position is None else position
        own.velocity_ned[:], own.wind_ned[:] = self.velocity, self.wind
        own.euler[:, 2] = self.heading
        own.airspeed[:] = np.linalg.norm(self.velocity - self.wind, axis=1)
        own.equivalent_airspeed[:] = own.airspeed
        inbox.stamp_s[:] = inbox.received_s[:] = t
        motion = self.leader(t)
        for values, found in zip(inbox[2:5], motion, strict=True):
            values[:, 0] = found
        if not turn_known:
            inbox.acceleration_ned[:] = 0.0
        if not self.heard:
            inbox.received_s[:, 0] = np.nan
        if self.payload is not None:
            inbox.payload[:, 1:] = self.payload
        self.command, self.memory = self.law.step(t, own, inbox, self.memory)
        return self.command

    def errors(self, t):
        return np.linalg.norm(self.slots(t)[0] - self.position, axis=1)


# leader-follower

KAPPA, LIMIT = 0.5, 3.0


def closed_errors(starts, *, turn, turn_known=True, until=8.0, limit=LIMIT):
    """Errors (K, 3) of followers that track the desired velocity, by the midpoint rule."""
    options = f"{{closing_per_s: {KAPPA}, closing_limit_mps: {limit}}}"
    flight = Formation(*law_of("leader-follower", options), turn=turn)
    flight.position = flight.slots(0.0)[0] + starts

    def desired(t, position):
        command = flight.step(t, position, turn_known=turn_known)
        return command.speed_desired[:, np.newaxis] * command.direction

    found = []
    for t in np.arange(0.0, until, DT):
        found.append(flight.errors(t))
        half = flight.position + 0.5 * DT * desired(t, flight.position)
        flight.velocity = desired(t + 0.5 * DT, half)
        flight.position = flight.position + DT * flight.velocity
    return np.array(found)


def test_leader_follower_closes_as_its_equation():
    """ė = −f κ e, in a turn of the leader: small errors as exp(−κ t), large ones at v_c at most."""
    starts = np.array([[0.2, 0.1, 0.0], [-3.0, 2.0, 1.0], [-20.0, 5.0, 2.0]])
    found = closed_errors(starts, turn=0.3)
    times = DT * np.arange(len(found))
    small = np.linalg.norm(starts[0]) * np.exp(-KAPPA * times)
    assert abs(found[:, 0] - small).max() < 0.005
    expected = np.linalg.norm(starts, axis=1)
    for row in found:
        np.testing.assert_allclose(row, expected, rtol=0.01, atol=0.005)
        for _ in range(4):
            closing = KAPPA * expected / np.sqrt(1.0 + (KAPPA * expected / LIMIT) ** 2)
            expected = expected - 0.25 * DT * closing
    closed = -np.diff(found[:, 2])
    assert (closed > 0.0).all() and (closed <= LIMIT * DT).all()


def test_leader_follower_needs_the_lever_arm():
    """Planted: the lever arm ω × R υ is missing; what remains is |ω × R υ| / √(κ² + ω²)."""
    turn = 0.3
    found = closed_errors(np.zeros((3, 3)), turn=turn, turn_known=False, until=10.0, limit=100.0)
    arm = math.hypot(5.0, 5.0) * turn
    expected = arm / math.hypot(KAPPA, turn)
    np.testing.assert_allclose(found[-1], expected, rtol=0.03)


# virtual-structure

CONSENSUS = 0.8
# λ₂ is 2, and would be 3 were all of them 1
ALL = "{uav1: {uav2: 0.5, uav3: 1}, uav2: {uav1: 0.5, uav3: 1}, uav3: {uav1: 1, uav2: 1}}"


def laplacian(config):
    """L + B (3, 3) of the followers, and L alone."""
    gains = config.gains[:, :, 0]
    between = gains[:, 1:]
    alone = np.diag(between.sum(axis=1)) - between
    return alone + np.diag(gains[:, 0]), alone


def estimates(errors, changes=(), *, heard=True, until=8.0, inferred_from=None):
    """Errors (K, 3) of the followers' estimates of the leader's position along the path."""
    options = f"{{consensus_per_s: {CONSENSUS}}}"
    law, config = law_of("virtual-structure", options, *changes)
    flight = Formation(law, config)
    flight.position = flight.slots(0.0)[0]
    columns = law.outputs.columns(law.outputs.sent)
    flight.memory["velocity_ned"] = [SPEED, 0.0, 0.0]
    flight.memory["position_ned"][:, 0] = np.array(errors) - SPEED * DT
    flight.memory["time_s"] = -DT
    flight.heard = heard
    found = []
    for t in np.arange(0.0, until, DT):
        sent = law.outputs.read(flight.memory, 3)[:, columns]
        if inferred_from is not None:  # planted: q_j − R υ_j in place of the estimate
            sent[:, :3] = flight.slots(t - DT)[0] + inferred_from - config.offsets[1:]
        flight.payload = sent
        flight.position = flight.slots(t)[0]
        flight.step(t)
        found.append(flight.memory["position_ned"][:, 0] - flight.leader(t)[0][0])
    return np.array(found), config


def test_estimates_agree_at_the_laplacians_rate():
    """The error is (I − κ dt (L + B))^k of the first, and its slowest part decays with λ."""
    first = np.array([3.0, -2.0, 5.0])
    found, config = estimates(first)
    matrix, _ = laplacian(config)
    step, expected = np.eye(3) - CONSENSUS * DT * matrix, first
    for row in found:
        expected = step @ expected
        np.testing.assert_allclose(row, expected, atol=1e-8)
    least = np.linalg.eigvals(matrix).real.min()
    times = DT * np.arange(1, len(found) + 1)
    late = slice(100, None)
    rate = -np.polyfit(times[late], np.log(np.linalg.norm(found[late], axis=1)), 1)[0]
    assert rate == pytest.approx(CONSENSUS * least, rel=0.03)
    np.testing.assert_allclose(found[24], expm(-CONSENSUS * times[24] * matrix) @ first, atol=0.05)


def test_estimates_alone_agree_with_lambda_2():
    """Their mean stays, and the differences from it decay with λ₂ of the Laplacian."""
    first = np.array([4.0, -2.0, 1.0])
    found, config = estimates(first, [f"formation.neighbour_gains={ALL}"], heard=False)
    _, alone = laplacian(config)
    second = np.sort(np.linalg.eigvalsh(alone))[1]
    np.testing.assert_allclose(found.mean(axis=1), first.mean(), atol=1e-8)
    apart = np.linalg.norm(found - found.mean(axis=1, keepdims=True), axis=1)
    times = DT * np.arange(1, len(found) + 1)
    rate = -np.polyfit(times[100:], np.log(apart[100:]), 1)[0]
    assert second > 0.0
    assert rate == pytest.approx(CONSENSUS * second, rel=0.06)  # of dt κ λ₂ / 2, sampled


def test_inferred_estimates_do_not_agree():
    """Planted: where a neighbour that is 3 m off its place stands for its estimate, errors stay."""
    off = np.array([[3.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found, config = estimates(np.zeros(3), until=10.0, inferred_from=off)
    gains = config.gains[:, :, 0]
    expected = gains[:, 1:] @ off[:, 0] / gains.sum(axis=1)
    np.testing.assert_allclose(found[-1], expected, atol=0.01)
    assert expected[1] == 1.5


# track-pid

PID = {
    **{"along_p": 0.4, "along_i": 0.02, "speed_p": 0.12, "speed_i": 0.03},
    **{"cross_p": 0.03, "cross_i": 0.004, "cross_d": 0.12},
    **{"height_p": 0.03, "height_i": 0.004, "height_d": 0.04},
}
THRUST = 8.0  # m/s² of full throttle


def responses(starts, *, bank_bias=0.0, until=60.0, **changes):
    """Errors (K, 3) along, across, in height, each of one follower; ÿ = g φ, ḣ = V θ, V̇ = T δ."""
    options = ", ".join(f"{key}: {value}" for key, value in {**PID, **changes}.items())
    flight = Formation(*law_of("track-pid", f"{{{options}}}"))
    trim = flight.config.trim_throttle
    offsets = np.diag([-starts[0], -starts[1], starts[2]])  # height missing: below the slot
    flight.position = flight.slots(0.0)[0] + offsets
    found = []
    for t in np.arange(0.0, until, DT):
        error = flight.slots(t)[0] - flight.position
        found.append([error[0, 0], error[1, 1], -error[2, 2]])
        command = flight.step(t)
        for _ in range(4):  # finer, with held commands
            part = 0.25 * DT
            flight.velocity[:, 0] += part * THRUST * (command.throttle - trim)
            flight.velocity[:, 1] += part * GRAVITY * (command.roll + bank_bias)
            flight.velocity[:, 2] = -SPEED * command.pitch
            flight.position = flight.position + part * flight.velocity
    return np.array(found)


def free_response(*coefficients, first, times):
    """Response y(t) of y⁽ⁿ⁾ + … = 0 from first values, at times of equal steps from 0."""
    n = len(coefficients)
    a = np.diag(np.ones(n - 1), 1)
    a[-1] = -np.array(coefficients[::-1])
    step, found = expm(a * times[1]), [np.array(first)]
    while len(found) < len(times):
        found.append(step @ found[-1])
    return np.array(found)[:, 0]


def test_pid_responds_as_its_linear_loops():
    """Across: s³ + g D s² + g K s + g I. Height: (1 + V D) s² + V K s + V I. Along: of order 4."""
    found = responses([2.0, 1.5, 1.0], until=25.0)
    times = DT * np.arange(len(found))
    k, i, d = (GRAVITY * PID[f"cross_{each}"] for each in ("p", "i", "d"))
    # y(0) = 1.5 at rest; −g K y is its acceleration
    across = free_response(d, k, i, first=[1.5, 0.0, -k * 1.5], times=times)
    np.testing.assert_allclose(found[:, 1], across, atol=0.06)
    k, i, d = (SPEED * PID[f"height_{each}"] for each in ("p", "i", "d"))
    height = free_response(k / (1 + d), i / (1 + d), first=[1.0, -k / (1 + d)], times=times)
    np.testing.assert_allclose(found[:, 2], height, atol=0.06)
    p, q = THRUST * PID["speed_p"], THRUST * PID["speed_i"]
    ap, ai = PID["along_p"], PID["along_i"]
    first = [2.0, 0.0, -p * ap * 2.0, (p * p * ap - p * ai - q * ap) * 2.0]
    along = free_response(p, q + p * ap, p * ai + q * ap, q * ai, first=first, times=times)
    np.testing.assert_allclose(found[:, 0], along, atol=0.08)


def test_pid_integral_leaves_no_error_of_a_bank():
    """A constant error of the bank; planted: without the integral bias / K of it remains."""
    zero, bias = np.zeros(3), 0.12
    gains = {"cross_p": 0.2, "cross_d": 0.3}  # whose error settles within seconds
    with_integral = responses(zero, bank_bias=bias, cross_i=0.06, until=18.0, **gains)
    without = responses(zero, bank_bias=bias, cross_i=0.0, until=8.0, **gains)
    assert abs(with_integral[:, 1]).max() > 0.3
    assert abs(with_integral[-1, 1]) < 0.005
    assert without[-1, 1] == pytest.approx(-bias / gains["cross_p"], rel=0.01)


# plane-follow


CALM = (0.0, 0.0, 0.0)


def followed(*, turn=0.0, wind=CALM, known_wind=None, until=90.0, thrust_bias=0.0, **gains):
    """A flight of coordinated turns: V ψ̇ = g tan φ, V̇ = T (δ − δ_trim), through moving air."""
    options = ", ".join(f"{key}: {value}" for key, value in gains.items())
    law, config = law_of("plane-follow", f"{{{options}}}")
    flight = Formation(law, config, turn=turn, wind=wind if known_wind is None else known_wind)
    flight.position = flight.slots(0.0)[0]
    air = flight.velocity - np.array(wind)
    heading, speed = np.arctan2(air[:, 1], air[:, 0]), np.hypot(air[:, 0], air[:, 1])
    for t in np.arange(0.0, until, DT):
        air = speed * np.array([np.cos(heading), np.sin(heading), np.zeros(3)])
        flight.velocity, flight.heading = air.T + np.array(wind), heading
        command = flight.step(t)
        heading = heading + DT * GRAVITY * np.tan(command.roll) / speed
        change = THRUST * (command.throttle - config.trim_throttle) + thrust_bias
        speed = speed + DT * change
        flight.position = flight.position + DT * flight.velocity
    return flight, until


def test_plane_follow_lags_in_a_turn_by_its_bank():
    """The heading is behind the commanded one by arctan(χ̇ V / g) / P, as P alone makes the bank."""
    turn = 0.15
    for gain in (0.873, 1.746):
        flight, _ = followed(turn=turn, heading_p=gain, distance_i=0.0, until=30.0)
        bank = np.arctan(turn * np.linalg.norm(flight.velocity, axis=1) / GRAVITY)
        np.testing.assert_allclose(flight.memory["heading_error_rad"], bank / gain, rtol=0.02)
        assert (flight.memory["heading_error_rad"] > 0.1).all()


def test_plane_follow_integral_removes_the_distance():
    """Against a constant drag; planted: without both integrals the distance stays."""
    gains = {"distance_p": 0.3, "velocity_p": 0.3, "lookahead_s": 2.0, "throttle_p": 0.2}
    found = []
    for distance_i, throttle_i in ((0.03, 0.05), (0.0, 0.0)):
        flight, end = followed(
            thrust_bias=-0.5, distance_i=distance_i, throttle_i=throttle_i, **gains
        )
        found.append(flight.slots(end)[0][:, 0] - flight.position[:, 0])
    assert abs(found[0]).max() < 0.1
    lack = 0.5 / (THRUST * gains["throttle_p"])
    np.testing.assert_allclose(found[1], lack / gains["distance_p"], rtol=0.02)


def test_plane_follow_holds_its_track_in_wind():
    """Planted: in a wind of which nothing is known it flies beside the track."""
    wind = (0.0, 6.0, 0.0)
    drifts = []
    for known in (wind, CALM):
        flight, end = followed(wind=wind, known_wind=known)
        drifts.append(abs(flight.slots(end)[0] - flight.position)[:, 1].max())
    assert drifts[0] < 0.2
    assert drifts[1] > 5.0


def test_plane_follow_modes_are_those_documented():
    """Far: to the target. Close: with its heading. Overshot: slower, and around."""
    law, config = law_of("plane-follow", "{close_m: 50.0, heading_p: 0.873}")
    flight = Formation(law, config)
    slots = flight.slots(0.0)[0]
    far, close, past = [-300.0, 300.0, 0.0], [-10.0, 0.0, 0.0], [20.0, 0.0, 0.0]
    flight.position = slots + np.array([far, close, past])
    flight.velocity[2] = [0.0, -SPEED, 0.0]  # across: 90° from the leader's heading
    flight.heading[2] = -0.5 * np.pi
    command = flight.step(0.0)
    assert flight.memory["mode"].tolist() == [1, 2, 3]
    # from the first the target is 45° to the left; behind the third, which flies to the left
    np.testing.assert_allclose(
        flight.memory["heading_error_rad"], np.radians([-45.0, 0.0, -90.0]), atol=1e-9
    )
    assert command.throttle[2] == 0.0 < config.trim_throttle[1] < command.throttle[1]


# mpc

WEIGHTS = {"position_weight": 4.0, "velocity_weight": 0.5, "input_weight": 0.3, "lag_s": 0.3}


def mpc_of(iterations, step_s):
    options = ", ".join(f"{key}: {value}" for key, value in WEIGHTS.items())
    options += f", iterations: {iterations}, step_s: {step_s}, limits_mps2: [2.0, 8.0, 2.5]"
    return law_of("mpc", f"{{{options}, error_limit_m: {ERROR_LIMIT}}}")


def sampled_model(step):
    """A and B of x, v, a with the input held, by the exponential of a matrix."""
    lag = WEIGHTS["lag_s"]
    m = np.zeros((4, 4))
    m[:2, 1:3], m[2, 2], m[2, 3] = np.eye(2), -1.0 / lag, 1.0 / lag
    found = expm(step * m)
    return found[:3, :3], found[:3, 3:]


def costs(step):
    """Q, R and the solution of the Riccati equation."""
    a, b = sampled_model(step)
    q = np.diag([WEIGHTS["position_weight"], WEIGHTS["velocity_weight"], 0.0])
    r = np.array([[WEIGHTS["input_weight"]]])
    return q, r, solve_discrete_are(a, b, q, r)


def program(step, start, steps=20):
    """Rows F, g of min ‖F u − g‖² over a plan u (20,)."""
    a, b = sampled_model(step)
    q, r, p = costs(step)
    response, free = [], []
    powers = [np.linalg.matrix_power(a, k) for k in range(steps + 1)]
    for k in range(1, steps + 1):
        weight = np.linalg.cholesky(p).T if k == steps else np.sqrt(q)
        columns = [powers[k - 1 - j] @ b if j < k else np.zeros((3, 1)) for j in range(steps)]
        response.append(weight @ np.hstack(columns))
        free.append(weight @ powers[k] @ start)
    response.append(np.sqrt(r) * np.eye(steps))
    free.append(np.zeros(steps))
    return np.vstack(response), -np.concatenate(free)


def plans(law, config, offsets):
    """Plans (3, 3, 20) of followers at offsets from their slots, after one step."""
    flight = Formation(law, config)
    flight.position = flight.slots(0.0)[0] + offsets
    flight.step(0.0)
    return flight.memory["plan"]


OFFSETS = np.array([[0.3, -0.2, 0.1], [4.0, -6.0, 3.0], [-15.0, 25.0, -8.0]])
BOUNDS = (2.0, 8.0, 2.5)  # m/s²
ERROR_LIMIT = 4.0  # m


def test_mpc_plan_is_that_of_a_qp_solver():
    """Within the bounds; after 12 steps the cost is within the bound of the fast gradient."""
    step = 0.2
    many, few = (plans(*mpc_of(count, step), OFFSETS) for count in (200, 12))
    bounded = 0
    for i, axis in np.ndindex(3, 3):
        start = np.array([np.clip(OFFSETS[i, axis], -ERROR_LIMIT, ERROR_LIMIT), 0.0, 0.0])
        f, g = program(step, start)
        best = lsq_linear(f, g, (-BOUNDS[axis], BOUNDS[axis]), tol=1e-12)
        assert best.success
        np.testing.assert_allclose(many[i, axis], best.x, atol=0.03 * BOUNDS[axis])
        assert abs(few[i, axis]).max() <= BOUNDS[axis]
        bounded += np.isclose(abs(few[i, axis]), BOUNDS[axis]).any()
        for plan, count in ((many, 200), (few, 12)):
            assert -1e-6 <= excess(f, g, plan[i, axis], best.x, count) <= 1.0
    assert bounded >= 2


def excess(f, g, plan, best, iterations):
    """Excess of cost over that of the best plan, as a share of its bound, 4 L ‖u*‖² / (k + 1)²."""
    lipschitz = 2.0 * np.linalg.eigvalsh(f.T @ f).max()
    (cost, least) = (np.sum((f @ u - g) ** 2) for u in (plan, best))
    bound = 2.0 * hessian_ratio(f) * lipschitz * np.sum(best**2) / (iterations + 1) ** 2
    return (cost - least) / bound


def hessian_ratio(f):
    """L of the law over half the largest eigenvalue of the Hessian."""
    module = mpc_module()
    bound, _ = gradient_bound(module, 0.2)
    return bound / np.linalg.eigvalsh(f.T @ f).max()


def mpc_module():
    return python_module("mpc")[0]


def gradient_bound(module, step):
    """L of the law, and what it is made of."""
    a, b = sampled_model(step)
    _, r, p = costs(step)
    weights = np.array([WEIGHTS["position_weight"], WEIGHTS["velocity_weight"], 0.0])
    model = (a, b[:, 0].copy(), p)
    return module.hessian_bound(model, weights, r[0, 0]), (model, weights, r[0, 0])


def test_mpc_step_is_below_the_limit_of_the_gradient():
    """L bounds the Hessian, by less than a factor of 4; planted: with L / 8 the method diverges."""
    module = mpc_module()
    start = np.array([1.0, 0.0, 0.0])
    f, g = program(0.2, start)
    bound, (model, weights, weight) = gradient_bound(module, 0.2)
    assert 1.0 <= hessian_ratio(f) <= 4.0
    least = np.sum((f @ np.linalg.lstsq(f, g, rcond=None)[0] - g) ** 2)
    found = []
    for lipschitz in (bound, bound / 8.0):
        plan = np.zeros(20)
        free = (-1e12, 1e12)
        python_function(module.solve)(plan, start, free, model, weights, weight, lipschitz, 200)
        found.append(np.sum((f @ plan - g) ** 2) / least)
    assert found[0] < 1.01
    assert not found[1] < 1e3


def closed_loop(law, config, start, steps):
    """Errors (K, 3), inputs (K, 3) of followers on the model, one step of it per control step."""
    flight = Formation(law, config)
    a, b = sampled_model(DT)
    states = np.zeros((3, 3, 3))  # by follower and axis
    states[:, :, 0] = start
    errors, inputs = [], []
    for t in DT * np.arange(steps):
        slots, velocities = flight.slots(t)
        flight.position = slots + states[:, :, 0]
        flight.velocity = velocities + states[:, :, 1]
        flight.step(t)
        u = flight.memory["plan"][:, :, :1]
        errors.append(states[:, :, 0].copy())
        inputs.append(u[:, :, 0].copy())
        states = states @ a.T + u @ b.T
    return np.array(errors), np.array(inputs)


def test_mpc_is_the_lqr_where_no_bound_acts():
    """The closed loop on the model equals that of u = −K s; far off the bounds act, and hold."""
    starts = np.array([[0.2, -0.3, 0.1], [0.05, 0.4, -0.1], [-30.0, 40.0, -20.0]])
    errors, inputs = closed_loop(*mpc_of(200, DT), starts, 100)
    a, b = sampled_model(DT)
    _, r, p = costs(DT)
    gain = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)
    for i, axis in np.ndindex(2, 3):
        state = np.array([starts[i, axis], 0.0, 0.0])
        expected = []
        for _ in range(len(errors)):
            expected.append(state[0])
            state = a @ state - b @ (gain @ state)
        np.testing.assert_allclose(errors[:, i, axis], expected, atol=2e-3)
    limits = np.array(BOUNDS)
    assert (abs(inputs) <= limits + 1e-12).all()
    assert np.isclose(abs(inputs[0, 2]), limits).all()
    assert (gain[0, 0] * ERROR_LIMIT > limits).all()  # what no bound would have commanded
