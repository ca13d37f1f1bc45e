"""Formations of random agents for the tests of the control law, and ways to cut and turn them."""

from dataclasses import fields, is_dataclass, replace

import numpy as np
from reference import formation_barrier as barriers
from reference import formation_control_function as functions_of
from reference.adapters import hbh23_step as step  # noqa: F401 - for the tests
from reference.adapters import middle_step as middle  # noqa: F401
from reference.formation_hbh23 import Hbh23Law
from reference.formation_laws import SpeedSet
from reference.formation_leader_filter import Memory
from reference.formation_middle_loop import (
    MiddleLoop,
    MiddleLoopGains,
    MiddleLoopMemory,
)

from testbed.core.records import Messages, UnicycleCommand, VehicleState
from testbed.formation import control_function
from testbed.formation import leader_filter as leader
from testbed.formation.barrier import SpeedBarrier

LOW, HIGH, KAPPA = 16.0, 30.0, 3.6
NOW, DT = 100.0, 0.04
PAPERS_MU = control_function.example_1(50.0, 1.0, 0.5)
PAPERS_BARRIER = SpeedBarrier(5, 0.05)


def same(value, n):
    return np.full(n, float(value))


def flags(value, n):
    return np.full(n, value, dtype=bool)


def make_law(n, rng, *, mu=PAPERS_MU, barrier=PAPERS_BARRIER, **changes):
    """A law whose agents all differ, with Section 9's bounds and, for each, its own options.

    `mu` and `barrier` are one for all agents, or a list with one for each.
    """
    functions = mu if isinstance(mu, list) else [mu] * n
    k = rng.uniform(2.0, 3.0, n)
    margin = KAPPA - k * np.array([min(each.bound, 1.0) for each in functions])
    law = Hbh23Law(
        agents=np.arange(1, n + 1, dtype=np.intp),
        offsets=np.vstack([np.zeros(3), rng.uniform(-10.0, 10.0, (n, 3))]),
        gains=rng.uniform(0.2, 1.5, (n, n + 1, 3)) * (rng.random((n, n + 1, 1)) < 0.8),
        k=k,
        a=rng.uniform(0.5, 1.5, n),
        b=rng.uniform(0.05, 0.2, n),
        c=rng.uniform(0.05, 0.2, n),
        c_speed=np.zeros(n),
        speed_pole=rng.uniform(0.4, 0.7, n),
        control_function=functions_of.per_agent(functions),
        barrier=barriers.per_agent(barrier if isinstance(barrier, list) else [barrier] * n),
        speeds=SpeedSet(same(LOW, n), same(HIGH, n), LOW + margin, HIGH - margin),
        horizontal=flags(False, n),
        bounds_of_airspeed=False,
        from_timestamp=False,
        with_acceleration=flags(False, n),
        acceleration_source=np.full(n, leader.BROADCAST),
        acceleration_blend=np.tile([0.4, 0.4, 0.025], (n, 1)),
        difference_blend=np.tile([0.4, 0.2], (n, 1)),
        angular_acceleration_source=np.full(n, leader.NOTHING),
        turn_rate_blend=np.full(n, 0.3),
        leader_timeout_s=5.0,
        neighbour_timeout_s=5.0,
        hold_stale_neighbours=False,
        lost_leader_airspeed=rng.uniform(20.0, 24.0, n),
        lost_leader_turn_rate=np.zeros(n),
    )
    return replace(law, **changes)


def mixed_options(n, rng):
    """For each agent a random choice of everything that an agent may choose."""
    return {
        "c_speed": rng.choice([0.0, 3e-4], n),
        "horizontal": rng.random(n) < 0.3,
        "with_acceleration": rng.random(n) < 0.5,
        "acceleration_source": rng.integers(0, 3, n),
        "acceleration_blend": rng.uniform(0.02, 1.0, (n, 3)),
        "difference_blend": rng.uniform(0.02, 1.0, (n, 2)),
        "angular_acceleration_source": rng.integers(0, 3, n),
        "turn_rate_blend": rng.uniform(0.02, 1.0, n),
        "lost_leader_turn_rate": rng.choice([0.0, -0.2, 0.15], n),
        "hold_stale_neighbours": bool(rng.random() < 0.5),
    }


def middle_gains(n, **changes):
    """The paper's gains; what the paper has not is zero."""
    values = {
        **dict.fromkeys(MiddleLoopGains._fields, 0.0),
        "gamma_p": 1.5,
        "gamma_i": 0.2,
        "gamma_d": 0.1,
        "course_p": 4.0,
        "course_i": 0.02,
        "course_d": 0.5,
        "speed_p": 0.15,
        "speed_i": 0.02,
        "eta_speed": 0.1,
        "eta_bank": 0.12,
        "trim_throttle": 0.22,
        "trim_airspeed": 22.0,
        "pitch_limit": np.pi / 9.0,
        "roll_limit": 5.0 * np.pi / 18.0,
    }
    assert not set(changes) - set(values)
    return MiddleLoopGains(
        **{name: np.ones(n) * value for name, value in {**values, **changes}.items()}
    )


def make_middle(n, *, altitude=np.nan, as_printed=False, dt=DT, **gains):
    """The middle loops of n agents with the paper's gains."""
    return MiddleLoop(
        gains=middle_gains(n, **gains),
        speed_min=same(LOW, n),
        speed_max=same(HIGH, n),
        altitude=np.ones(n) * altitude,
        airspeed_error_as_printed=as_printed,
        dt=dt,
    )


def velocities(rng, shape, low, high):
    """Velocities of speeds between these (m/s), any course, at most 20° up or down."""
    speed, course = rng.uniform(low, high, shape), rng.uniform(-np.pi, np.pi, shape)
    gamma = rng.uniform(-0.35, 0.35, shape)
    parts = (np.cos(gamma) * np.cos(course), np.cos(gamma) * np.sin(course), -np.sin(gamma))
    return speed[..., None] * np.stack(parts, axis=-1)


def states(n, rng, *, low=LOW - 4.0, high=HIGH + 4.0, never=0.0, old=0.0, now=NOW):
    """State, inbox and memory of n agents at the time `now`; own speeds low to high.

    A share `never` of the links has no message, a share `old` none for 30 s.
    """
    own_velocity = velocities(rng, (n,), low, high)
    own = VehicleState(
        position_ned=rng.normal(0.0, 8.0, (n, 3)),
        velocity_ned=own_velocity,
        acceleration_ned=rng.normal(0.0, 3.0, (n, 3)),
        euler=rng.uniform(-0.8, 0.8, (n, 3)),
        rates_body=rng.normal(0.0, 0.3, (n, 3)),
        airspeed=np.sqrt((own_velocity**2).sum(axis=1)) + rng.normal(0.0, 3.0, n),
        equivalent_airspeed=rng.uniform(14.0, 30.0, n),
    )
    shape = (n, n + 1)
    stamp = now - rng.uniform(0.0, 0.5, shape)
    stamp[rng.random(shape) < old] -= 30.0
    stamp[rng.random(shape) < never] = np.nan
    quiet = np.isnan(stamp)
    vectors = (
        rng.normal(0.0, 8.0, (*shape, 3)),
        velocities(rng, shape, 17.0, 29.0),
        rng.normal(0.0, 3.0, (*shape, 3)),
        rng.uniform(-0.8, 0.8, (*shape, 3)),
        rng.normal(0.0, 0.2, (*shape, 3)),
    )
    inbox = Messages(
        stamp,
        stamp + rng.uniform(0.0, 0.1, shape),
        *(np.where(quiet[..., None], np.nan, each) for each in vectors),
    )
    return own, inbox, some_memory(rng, stamp)


def some_memory(rng, stamp):
    """Memories of a message of the leader just before, of the same one, or of none.

    Half of the neighbours were never reckoned to be anywhere; of the others the newest message is
    new, or was known before.
    """
    n = len(stamp)
    since = rng.choice([0.04, 0.2, 0.0, np.nan], n)
    begun = np.where(np.isnan(since), np.nan, 1.0)
    place = np.where(
        rng.random((*stamp.shape, 1)) < 0.5, rng.normal(0.0, 9.0, (*stamp.shape, 3)), np.nan
    )
    place[:, 0] = np.nan
    before = np.where(np.isnan(stamp), 99.0, stamp) - rng.choice([0.04, 0.2, 0.0], stamp.shape)
    return Memory(
        acceleration=rng.normal(0.0, 1.0, (n, 3)),
        time_s=stamp[:, 0] - since,
        speed=rng.uniform(20.0, 24.0, n) * begun,
        gamma=rng.uniform(-0.2, 0.2, n) * begun,
        speed_rate=rng.normal(0.0, 1.0, n),
        gamma_dot=rng.normal(0.0, 0.1, n),
        omega=rng.normal(0.0, 0.3, (n, 3)) * begun[:, None],
        omega_dot=rng.normal(0.0, 0.3, (n, 3)),
        timeout_since=np.full(n, np.nan),
        timeout_course=np.full(n, np.nan),
        held_position=place,
        held_time_s=np.where(np.isnan(place[:, :, 0]), np.nan, before),
    )


def middle_states(n, rng):
    """Own states, commands and memories of middle loops, some of which have not begun."""
    own, _, _ = states(n, rng)
    inputs = UnicycleCommand(
        speed=rng.normal(23.0, 5.0, n),
        omega=np.column_stack([np.zeros(n), rng.normal(0.0, 0.3, (n, 2))]),
        speed_desired=rng.uniform(LOW, HIGH, n),
        direction=velocities(rng, (n,), 1.0, 1.0),
        limiter_flags=rng.integers(0, 16, n).astype(np.uint8) & np.uint8(0b1011),
    )
    begun = np.where(rng.random(n) < 0.8, 1.0, np.nan)
    integrals = rng.normal(0.0, 0.3, (4, n))
    filtered = rng.normal(0.0, 0.2, (3, n)) * begun
    return own, inputs, MiddleLoopMemory(*integrals, *filtered, rng.normal(0.0, 0.2, n))


def leaves(record):
    """Every array of nested records by its dotted name."""
    names = [f.name for f in fields(record)] if is_dataclass(record) else record._fields
    for name in names:
        value = getattr(record, name)
        if hasattr(value, "_fields") or is_dataclass(value):
            yield from ((f"{name}.{inner}", array) for inner, array in leaves(value))
        elif isinstance(value, np.ndarray):
            yield name, value


def results(stepped):
    """Every array of a step's result by name: of the law two records, of the middle loop three."""
    kinds = ("inputs", "memory") if len(stepped) == 2 else ("command", "memory", "diagnosis")
    return {
        f"{kind}.{name}": array
        for kind, record in zip(kinds, stepped, strict=True)
        for name, array in leaves(record)
    }


def assert_same(ours, theirs, **tolerance):
    assert ours.keys() == theirs.keys()
    for name, array in ours.items():
        np.testing.assert_allclose(array, theirs[name], err_msg=name, **tolerance)


def choose(record, rows, keep=()):
    """A record with only these rows of every array, in nested records too."""
    names = [f.name for f in fields(record)] if is_dataclass(record) else record._fields
    changed = {}
    for name in names:
        value = getattr(record, name)
        if hasattr(value, "_fields") or is_dataclass(value):
            changed[name] = choose(value, rows, keep)
        elif isinstance(value, np.ndarray) and name not in keep:
            changed[name] = np.ascontiguousarray(value[rows])
    return replace(record, **changed) if is_dataclass(record) else record._replace(**changed)


def some_of(law, rows):
    """The law of some of its agents; the number of aircraft stays."""
    return choose(law, rows, keep=("offsets",))


def reorder(law, own, inbox, memory, order):
    """The same agents listed in another order; the leader stays first."""
    all_rows = np.concatenate([[0], np.asarray(order) + 1])
    law = choose(law, order, keep=("offsets", "agents"))
    law = replace(law, offsets=law.offsets[all_rows], gains=_columns(law.gains, all_rows))
    inbox = Messages(*(_columns(each, all_rows) for each in choose(inbox, order)))
    memory = choose(memory, order)
    memory = memory._replace(
        held_position=_columns(memory.held_position, all_rows),
        held_time_s=_columns(memory.held_time_s, all_rows),
    )
    return law, choose(own, order), inbox, memory


def _columns(array, chosen):
    return np.ascontiguousarray(array[:, chosen])
