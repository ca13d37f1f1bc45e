"""Formations and starts for the tests of the theorem."""

import numpy as np
from closed_loop import Formations, Leader, State
from reference.formation_barrier import per_agent as one_barrier_each
from reference.formation_control_function import per_agent as one_function_each
from reference.formation_laws import SpeedSet

from testbed.formation.barrier import SpeedBarrier
from testbed.formation.control_function import EXAMPLE_2, EXAMPLE_3, example_1

LOW, HIGH = 16.0, 30.0
PAPERS_MU = example_1(50.0, 1.0, 0.5)
STEEPER_MU = example_1(4.0, 1.0, 0.5)  # μ(0) = 1/2 per metre
BARRIERS = {
    "example 4": SpeedBarrier(4, 0.02),
    "example 5": SpeedBarrier(5, 0.05),
    "example 6": SpeedBarrier(6, 1.0),
}
FUNCTIONS = {"example 1": PAPERS_MU, "example 2": EXAMPLE_2, "example 3": EXAMPLE_3}
PATHS = {  # γ (rad) and σ̇ (rad/s) of the leader
    "straight": (0.0, 0.0),
    "straight climb": (0.12, 0.0),
    "circle": (0.0, 0.18),
    "helix": (-0.1, -0.15),
}
VEE = [[-5.0, 5.0, 0.0], [-5.0, -5.0, -4.0], [-5.0, -5.0, 4.0]]


def each(value, n):
    """One number or n of them as an array (n,)."""
    return np.broadcast_to(np.asarray(value, dtype=float), (n,)).copy()


def leader(path="helix", *, speed=22.0, course=0.4, copies=1, origin=(0.0, 0.0, -300.0)):
    climb, course_rate = PATHS[path]
    return Leader(
        np.tile(np.asarray(origin, dtype=float), (copies, 1)),
        *(each(value, copies) for value in (speed, climb, course, course_rate)),
    )


def graph(beta, links=()):
    """Gains (n, n + 1, 3) of one formation from β_i (n,) or (n, 3) and links (i, j, β_ij)."""
    beta = np.asarray(beta, dtype=float)
    n = len(beta)
    gains = np.zeros((n, n + 1, 3))
    gains[:, 0] = beta if beta.ndim == 2 else beta[:, None]
    for i, j, value in links:
        gains[i, j + 1] = value
    return gains


# Graphs of the paper's simulations 1 to 3.
SIMULATION_1 = graph([1, 0, 0], [(0, 1, 1), (1, 0, 1), (1, 2, 1), (2, 1, 1)])
SIMULATION_2 = graph([1, 0, 0], [(1, 0, 1), (2, 1, 1)])
SIMULATION_3 = graph([1, 1, 1], [(1, 0, 1), (2, 1, 1)])


def one_formation(
    path="helix",
    *,
    gains=SIMULATION_1,
    offsets=VEE,
    k=3.0,
    a=1.0,
    b=0.1,
    c=1.0,
    mu=PAPERS_MU,
    barrier=BARRIERS["example 5"],
    margin=0.6,
    low=LOW,
    high=HIGH,
    copies=1,
    **of_the_leader,
):
    """`copies` of one formation; numbers may be arrays with one for every agent of them all."""
    n = len(gains)
    agents = copies * n
    low, high, margin = each(low, agents), each(high, agents), each(margin, agents)
    return Formations(
        leader(path, copies=copies, **of_the_leader),
        np.tile(np.asarray(offsets, dtype=float)[None, :n], (copies, 1, 1)),
        np.tile(gains, (copies, 1, 1)),
        *(each(value, agents) for value in (k, a, b, c)),
        each(0.64, agents),
        mu,
        barrier,
        SpeedSet(low, high, low + margin, high - margin),
    )


def every_case(mu=STEEPER_MU, **changes):
    """Every path, every graph of the paper's simulations and every barrier, at once.

    36 formations of three.
    """
    graphs = (SIMULATION_1, SIMULATION_2, SIMULATION_3)
    cases = [(p, g, b) for p in PATHS.values() for g in graphs for b in BARRIERS.values()]
    climb, course_rate = np.array([path for path, _, _ in cases]).T
    n = len(cases)
    formations = one_formation(copies=n, mu=mu, **changes)
    return formations.change(
        leader=formations.leader._replace(
            climb=climb, course_rate=course_rate, course=np.linspace(-3.0, 3.0, n)
        ),
        gains=np.concatenate([graph for _, graph, _ in cases]),
        barrier=one_barrier_each([barrier for _, _, barrier in cases for _ in range(3)]),
    )


def directions(rng, n):
    """Unit vectors, uniform on the sphere."""
    y = rng.normal(0.0, 1.0, (n, 3))
    return y / np.linalg.norm(y, axis=1, keepdims=True)


def at_slots(formations, error):
    """States (q = slot + error (N, 3)) flying exactly as desired there: s̃ = 0, ỹ = 0."""
    (q_g, *_), (chi, *_) = formations.targets(0.0)
    q = (q_g[:, None] + chi).reshape(-1, 3) + error
    n = len(q)
    # s_d and y_d depend on positions alone
    desired = formations.wanted(
        0.0, State(q, np.tile([1.0, 0.0, 0.0], (n, 1)), each(20.0, n))
    ).desired
    return State(q, desired.direction, desired.speed)


def scattered(rng, formations, *, spread=20.0, outside=0.0):
    """Random positions about the slots, any direction, speeds in S or up to `outside` beyond."""
    n = len(formations.k)
    start = at_slots(formations, rng.uniform(-spread, spread, (n, 3)))
    speeds = formations.speeds
    s = rng.uniform(speeds.min - outside, speeds.max + outside)
    return State(start.q, directions(rng, n), s)


def turned_away(direction, by, toward):
    """Unit vectors at the angles `by` (N,) rad from `direction` (N, 3), towards `toward`."""
    across = toward - (toward * direction).sum(axis=1, keepdims=True) * direction
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    by = np.asarray(by)[..., None]
    return np.cos(by) * direction + np.sin(by) * across


def random_graphs(rng, m, n):
    """Gains (m n, n + 1, 3), 1/m, of m directed graphs: 1 to n agents linked, the others alone.

    Each of the linked hears the leader or one before it, and perhaps some of the others.
    """
    gains = np.zeros((m, n, n + 1))
    for one in gains:
        linked = rng.integers(1, n + 1)
        for i in range(n):
            alone = i == 0 or i >= linked
            source = 0 if alone or rng.random() < 0.6 else rng.integers(i) + 1
            one[i, source] = rng.uniform(0.2, 0.3)
            for j in range(linked if i < linked else 0):
                if j != i and rng.random() < 0.2:
                    one[i, j + 1] += rng.uniform(0.02, 0.06)
        order = rng.permutation(n)
        one[:] = one[order][:, np.concatenate([[0], order + 1])]
    return np.repeat(gains.reshape(m * n, n + 1, 1), 3, axis=2)


def random_formations(rng, m, n):
    """M formations in which leaders, slots, graphs, bounds, functions and gains are all random.

    κ is measured: constant in the leader's frame, so Assumption 1 holds with it for ever.
    """
    agents = m * n
    lead = Leader(
        rng.uniform(-500.0, 500.0, (m, 3)),
        rng.uniform(21.0, 25.0, m),
        rng.uniform(-0.2, 0.2, m),
        rng.uniform(-np.pi, np.pi, m),
        rng.choice([0.0, 1.0], m) * rng.uniform(-0.2, 0.2, m),
    )
    low, high = rng.uniform(12.0, 14.0, agents), rng.uniform(32.0, 34.0, agents)
    mu = one_function_each(
        [
            example_1(rng.uniform(0.5, 3.0), rng.uniform(0.5, 2.0), rng.uniform(0.5, 0.6))
            if choice == 1
            else (EXAMPLE_2, EXAMPLE_3)[choice - 2]
            for choice in rng.integers(1, 4, agents)
        ]
    )
    barrier = one_barrier_each(
        [
            {
                4: SpeedBarrier(4, rng.uniform(0.01, 0.05)),
                5: SpeedBarrier(5, rng.uniform(0.01, 0.03)),
                6: SpeedBarrier(6, rng.uniform(0.5, 4.0)),
            }[choice]
            for choice in rng.integers(4, 7, agents)
        ]
    )
    formations = Formations(
        lead,
        rng.uniform(-10.0, 10.0, (m, n, 3)),
        random_graphs(rng, m, n),
        np.ones(agents),
        rng.uniform(0.6, 1.5, agents),
        rng.uniform(0.02, 0.1, agents),
        rng.uniform(2.0, 4.0, agents),
        rng.uniform(0.4, 0.7, agents),
        mu,
        barrier,
        SpeedSet(low, high, low, high),
    )
    (_, v_g, *_), (_, chi_rate, _) = formations.targets(0.0)
    cruise = np.linalg.norm((v_g[:, None] + chi_rate).reshape(-1, 3), axis=1)
    kappa = np.minimum(cruise - low, high - cruise)
    k = rng.uniform(0.6, 0.8, agents) * kappa / mu.bound
    margin = kappa - k * mu.bound
    return formations.change(k=k, speeds=SpeedSet(low, high, low + margin, high - margin))
