"""Linear model-predictive control of the slot error.

Each control step solves, for each axis forward, right, down of the slot's velocity frame, which is
held over the horizon of N = 20 steps of T, the quadratic program

    min Σ_{k=1}^{N−1} (w_x x_k² + w_v v_k²) + s_Nᵀ P s_N + w_u Σ_{k=0}^{N−1} u_k²        (1)
    s_{k+1} = A s_k + B u_k,  s = (x, v, a)                                             (2)
    l ≤ u_k ≤ h                                                                         (3)

x and v are the own position and velocity minus the slot's, a the own acceleration minus the slot's,
which follows the command u with the lag τ: (2) is ẋ = v, v̇ = a, τ ȧ = u − a, sampled with u held.
Larger errors of position count as ±`error_limit_m`, as (1) knows no bounds of the speed.
(3) bounds the acceleration of slot and correction together, per axis. P is the solution of the
algebraic Riccati equation of (1) and (2), by structured doubling, so without active bounds the plan
is that of the infinite horizon [RMD17]. The program is solved by Nesterov's fast gradient method
with projection on (3) [N83, RJM12]:

    z = Π(y − ∇J(y) / (2 L)),  y ← z + (t − 1)/t₊ (z − z₋),  t₊ = (1 + √(1 + 4 t²)) / 2  (4)
    L = w_u + w_x ‖h_x‖₁² + w_v ‖h_v‖₁² + Σ_k g_kᵀ P g_k,  g_k = A^(N−1−k) B             (5)

in `iterations` steps from the plan of the control step before, moved on by dt. h_x and h_v are the
impulse responses of x and v over the horizon: L bounds half the largest eigenvalue of the Hessian.
The first acceleration of the plan becomes a desired velocity, t_l = `lead_s` ahead, of which a
share μ = `slot_share` is the slot's, so that it does not drift with a disturbed own velocity v_o:

    p = v_o + μ (v_s − v_o) + t_l u₀,  ṗ = a_s + u₀                                     (6)

The acceleration a is that of the model, driven by the own commands: that of the sensors is noisy.

Hypotheses: gains for the leader; weights, lag, limits and lead positive; dt ≤ T ≤ 1 s;
1 to 200 iterations. Property, on (2): converged and without active bounds, u₀ = −K s, the linear
quadratic regulator; u is within (3) always. The plans of neighbours are in no message, so this is a
decentralised MPC.

[N83] Y. Nesterov: A method for solving a convex programming problem with convergence rate O(1/k²).
Soviet Mathematics Doklady 27 (1983), 372–376.
[RJM12] S. Richter, C. N. Jones, M. Morari: Computational complexity certification for real-time
MPC with input constraints based on the fast gradient method. IEEE Transactions on Automatic Control
57 (2012), 1391–1403.
[RMD17] J. B. Rawlings, D. Q. Mayne, M. M. Diehl: Model Predictive Control, 2nd edition, 2017.
"""

import numpy as np

import testbed
from testbed.law import (
    FollowerConfig,
    FormationConfig,
    Inbox,
    OwnState,
    UnicycleCommand,
    command_from_velocity,
)

DOWN = np.array([0.0, 0.0, 1.0])
STEPS = 20
DOUBLINGS = 7  # 2⁷ steps of the Riccati recursion


def requires(
    config: FormationConfig, limits_mps2: tuple[float, ...], iterations: int, **options: float
) -> None:
    """Check the hypotheses."""
    for name, gains in zip(config.names, config.gains, strict=True):
        if not (gains[0, :2] > 0.0).all():
            raise ValueError(
                f"{name} has no gain for the leader (write one in formation.leader_gains)"
            )
    if len(limits_mps2) != 3 or min(limits_mps2) <= 0.0:
        raise ValueError(f"limits_mps2 is {limits_mps2} (write three above 0)")
    if not 1 <= iterations <= 200 or iterations != int(iterations):
        raise ValueError(f"iterations is {iterations} (write 1 to 200)")
    for name, value in options.items():
        if not value > 0.0 and name != "slot_share":
            raise ValueError(f"{name} is {value:g} (write more than 0)")
    if not 0.0 <= options["slot_share"] <= 1.0:
        raise ValueError(f"slot_share is {options['slot_share']:g} (write 0 to 1)")
    if not config.dt <= options["step_s"] <= 1.0:
        raise ValueError(f"step_s is {options['step_s']:g} (write dt, {config.dt:g}, to 1 s)")


@testbed.kernel
def product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the product of two matrices (3, 3)."""
    c = np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            c[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]
    return c


@testbed.kernel
def inverse(a: np.ndarray) -> np.ndarray:
    """Return the inverse of a matrix (3, 3), by its cofactors."""
    c = np.zeros((3, 3))
    for i in range(3):
        p, q = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            r, s = (j + 1) % 3, (j + 2) % 3
            c[j, i] = a[p, r] * a[q, s] - a[p, s] * a[q, r]
    determinant = a[0, 0] * c[0, 0] + a[0, 1] * c[1, 0] + a[0, 2] * c[2, 0]
    for i in range(3):
        for j in range(3):
            c[i, j] /= determinant
    return c


@testbed.kernel
def sampled_model(step: float, lag: float) -> tuple[np.ndarray, np.ndarray]:
    """Return A (3, 3) and B (3,) of (2)."""
    f = np.exp(-step / lag)
    of_v = lag * (1.0 - f)
    of_x = lag * (step - of_v)
    a = np.array([[1.0, step, of_x], [0.0, 1.0, of_v], [0.0, 0.0, f]])
    return a, np.array([0.5 * step * step - of_x, step - of_v, 1.0 - f])


@testbed.kernel
def terminal_weight(a: np.ndarray, b: np.ndarray, weights: np.ndarray, input: float) -> np.ndarray:
    """Return P (3, 3) of (1), by structured doubling."""
    g, h = np.zeros((3, 3)), np.zeros((3, 3))
    for i in range(3):
        h[i, i] = weights[i]
        for j in range(3):
            g[i, j] = b[i] * b[j] / input
    for _ in range(DOUBLINGS):
        w = product(g, h)
        for i in range(3):
            w[i, i] += 1.0
        w = inverse(w)
        aw = product(a, w)
        h = h + product(np.ascontiguousarray(a.T), product(product(h, w), a))
        g = g + product(product(aw, g), np.ascontiguousarray(a.T))
        a = product(aw, a)
    return h


@testbed.kernel
def hessian_bound(
    model: tuple[np.ndarray, np.ndarray, np.ndarray], weights: np.ndarray, input: float
) -> float:
    """Return L of (5)."""
    a, b, p = model
    bound, g, sums = input, b.copy(), np.zeros(3)
    for k in range(STEPS):
        for i in range(3):
            for j in range(3):
                bound += g[i] * p[i, j] * g[j]
            if k < STEPS - 1:
                sums[i] += abs(g[i])
        g[0] += a[0, 1] * g[1] + a[0, 2] * g[2]
        g[1] += a[1, 2] * g[2]
        g[2] *= a[2, 2]
    for i in range(3):
        bound += weights[i] * sums[i] ** 2
    return bound


@testbed.kernel
def solve(
    plan: np.ndarray,
    start: np.ndarray,
    bounds: tuple[float, float],
    model: tuple[np.ndarray, np.ndarray, np.ndarray],
    weights: np.ndarray,
    input: float,
    lipschitz: float,
    iterations: int,
) -> None:
    """Improve a plan (N,) in place, (4), from the state `start` (3,)."""
    a, b, p = model
    for k in range(STEPS):
        plan[k] = min(max(plan[k], bounds[0]), bounds[1])
    ahead, before = plan.copy(), plan.copy()
    states = np.zeros((STEPS + 1, 3))
    states[0] = start
    t = 1.0
    for _ in range(iterations):
        for k in range(STEPS):
            x, v, c = states[k]
            u = ahead[k]
            states[k + 1, 0] = x + a[0, 1] * v + a[0, 2] * c + b[0] * u
            states[k + 1, 1] = v + a[1, 2] * c + b[1] * u
            states[k + 1, 2] = a[2, 2] * c + b[2] * u
        x, v, c = states[STEPS]
        l0 = p[0, 0] * x + p[0, 1] * v + p[0, 2] * c
        l1 = p[1, 0] * x + p[1, 1] * v + p[1, 2] * c
        l2 = p[2, 0] * x + p[2, 1] * v + p[2, 2] * c
        for k in range(STEPS - 1, -1, -1):
            gradient = input * ahead[k] + b[0] * l0 + b[1] * l1 + b[2] * l2
            plan[k] = min(max(ahead[k] - gradient / lipschitz, bounds[0]), bounds[1])
            l2 = a[0, 2] * l0 + a[1, 2] * l1 + a[2, 2] * l2 + weights[2] * states[k, 2]
            l1 = a[0, 1] * l0 + l1 + weights[1] * states[k, 1]
            l0 = l0 + weights[0] * states[k, 0]
        after = 0.5 * (1.0 + np.sqrt(1.0 + 4.0 * t * t))
        for k in range(STEPS):
            ahead[k] = plan[k] + (t - 1.0) / after * (plan[k] - before[k])
            before[k] = plan[k]
        t = after


@testbed.kernel
def slot_motion(
    age: float, inbox: Inbox, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration of a slot."""
    acceleration = inbox.acceleration_ned[0]
    velocity = inbox.velocity_ned[0] + age * acceleration
    position = inbox.position_ned[0] + age * (inbox.velocity_ned[0] + 0.5 * age * acceleration)
    speed = np.sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    level = np.hypot(velocity[0], velocity[1])
    forward = velocity / speed
    right = np.array([-velocity[1] / level, velocity[0] / level, 0.0])
    down = np.cross(forward, right)
    course_rate = (velocity[0] * acceleration[1] - velocity[1] * acceleration[0]) / level**2
    climb_rate = -np.sum(down * acceleration) / speed
    omega = course_rate * DOWN + climb_rate * right
    arm = offset[0] * forward + offset[1] * right + offset[2] * down
    turning = np.cross(omega, arm)
    return position + arm, velocity + turning, acceleration + np.cross(omega, turning)


@testbed.kernel(
    memory=[("plan", float, (3, STEPS)), ("relative_ned", float, 3)],
    requires=requires,
)
def mpc(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: np.record,
    config: FollowerConfig,
    step_s: float = 0.2,
    iterations: int = 12,
    position_weight: float = 43.0,
    velocity_weight: float = 0.055,
    input_weight: float = 0.3,
    lag_s: float = 0.05,
    limits_mps2: tuple[float, float, float] = (4.0, 12.0, 4.0),
    error_limit_m: float = 4.0,
    slot_share: float = 0.3,
    lead_s: float = 0.316,
) -> UnicycleCommand:
    """Return the command of one follower."""
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:  # also where nothing has come yet, and age is NaN
        memory.plan[:] = 0.0
        memory.relative_ned[:] = 0.0
        level = np.array([own.velocity_ned[0], own.velocity_ned[1], 0.0])
        return command_from_velocity(config, own, level)
    position, velocity, acceleration = slot_motion(age, inbox, config.offsets[config.agents])
    axes = np.zeros((3, 3))
    axes[0] = velocity / np.sqrt(np.sum(velocity**2))
    axes[1] = np.cross(DOWN, axes[0])
    axes[1] /= np.sqrt(np.sum(axes[1] ** 2))
    axes[2] = np.cross(axes[0], axes[1])
    a, b = sampled_model(step_s, lag_s)
    weights = np.array([position_weight, velocity_weight, 0.0])
    model = (a, b, terminal_weight(a, b, weights, input_weight))
    lipschitz = hessian_bound(model, weights, input_weight)
    moved = config.dt / step_s
    correction = np.zeros(3)
    for i in range(3):
        along = np.sum(axes[i] * acceleration)
        error = np.sum(axes[i] * (own.position_ned - position))
        start = np.array(
            [
                min(max(error, -error_limit_m), error_limit_m),
                np.sum(axes[i] * (own.velocity_ned - velocity)),
                np.sum(axes[i] * memory.relative_ned),
            ]
        )
        plan = np.zeros(STEPS)
        for k in range(STEPS):
            plan[k] = memory.plan[i, k]
            if k + 1 < STEPS:
                plan[k] += moved * (memory.plan[i, k + 1] - plan[k])
        bounds = (-limits_mps2[i] - along, limits_mps2[i] - along)
        solve(plan, start, bounds, model, weights, input_weight, lipschitz, iterations)
        memory.plan[i, :] = plan
        correction += plan[0] * axes[i]
    decay = np.exp(-config.dt / lag_s)
    memory.relative_ned[:] = decay * memory.relative_ned + (1.0 - decay) * correction
    desired = own.velocity_ned + slot_share * (velocity - own.velocity_ned) + lead_s * correction
    return command_from_velocity(config, own, desired, acceleration + correction)
