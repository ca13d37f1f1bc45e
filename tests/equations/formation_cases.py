"""Formations of random agents for the tests of the control law, and ways to cut and turn them."""

import numpy as np

from testbed.formation import control_function
from testbed.formation.barrier import Barrier
from testbed.formation.law import PaperLaw, PaperMemory
from testbed.formation.laws import SpeedSet
from testbed.formation.middle_loop import MiddleLoopGains, MiddleLoopMemory
from testbed.state import Inbox, VehicleState

LOW, HIGH, KAPPA = 16.0, 30.0, 3.6
PAPERS_MU = control_function.example_1(50.0, 1.0, 0.5)
PAPERS_BARRIER = Barrier(5, 0.05)


def same(value, n):
    return np.full(n, float(value))


def middle_gains(n, **changes):
    values = {
        "climb_p": 1.5,
        "climb_i": 0.2,
        "climb_d": 0.1,
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
    return MiddleLoopGains(**{name: same(v, n) for name, v in {**values, **changes}.items()})


def make_law(n, rng, *, mu=PAPERS_MU, barrier=PAPERS_BARRIER, **changes):
    """A law whose agents all differ, with Section 9's bounds."""
    k = rng.uniform(2.0, 3.0, n)
    law = PaperLaw(
        offsets=np.vstack([np.zeros(3), rng.uniform(-10.0, 10.0, (n, 3))]),
        gains=rng.uniform(0.2, 1.5, (n, n + 1, 3)) * (rng.random((n, n + 1, 1)) < 0.8),
        k=k,
        a=rng.uniform(0.5, 1.5, n),
        b=rng.uniform(0.05, 0.2, n),
        c=rng.uniform(0.05, 0.2, n),
        pole=rng.uniform(0.4, 0.7, n),
        control_function=mu,
        barrier=barrier,
        speeds=SpeedSet(same(LOW, n), same(HIGH, n), KAPPA - k * min(mu.bound, 1.0)),
        middle=middle_gains(n),
        dt=0.04,
        from_timestamp=False,
        airspeed_error_as_printed=False,
        acceleration_blend=np.array([0.4, 0.4, 0.025]),
        rate_blend=rng.uniform(0.3, 1.0, n),
    )
    return law._replace(**changes)


def velocities(rng, shape, low, high):
    """Velocities of speeds between these (m/s), any course, at most 20° up or down."""
    speed, course = rng.uniform(low, high, shape), rng.uniform(-np.pi, np.pi, shape)
    climb = rng.uniform(-0.35, 0.35, shape)
    parts = (np.cos(climb) * np.cos(course), np.cos(climb) * np.sin(course), -np.sin(climb))
    return speed[..., None] * np.stack(parts, axis=-1)


def states(n, rng, *, low=LOW - 4.0, high=HIGH + 4.0, silence=0.0, now=100.0):
    """What n agents know at the time `now`: own state, inbox, memory; own speeds low to high."""
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
    stamp[rng.random(shape) < silence] = np.nan
    quiet = np.isnan(stamp)
    vectors = (
        rng.normal(0.0, 8.0, (*shape, 3)),
        velocities(rng, shape, 17.0, 29.0),
        rng.normal(0.0, 3.0, (*shape, 3)),
        rng.normal(0.0, 0.2, (*shape, 3)),
    )
    inbox = Inbox(
        stamp,
        stamp + rng.uniform(0.0, 0.1, shape),
        *(np.where(quiet[..., None], np.nan, each) for each in vectors),
    )
    memory = PaperMemory(
        MiddleLoopMemory(*rng.normal(0.0, 0.3, (3, n))),
        rng.normal(0.0, 1.0, (n, 3)),
        rng.normal(0.0, 0.2, n),
        rng.normal(0.0, 0.2, n),
    )
    return own, inbox, memory


def leaves(record):
    """Every array of nested named tuples by its dotted name."""
    for name, value in zip(record._fields, record, strict=True):
        if hasattr(value, "_fields"):
            yield from ((f"{name}.{inner}", array) for inner, array in leaves(value))
        else:
            yield name, value


def results(stepped):
    """Every array of a step's result by name."""
    kinds = ("command", "memory", "diagnosis")
    return {
        f"{kind}.{name}": array
        for kind, record in zip(kinds, stepped, strict=True)
        for name, array in leaves(record)
    }


def choose(record, rows, keep=()):
    """A record with only these rows of every array, in nested records too."""
    return record._replace(
        **{
            name: choose(value, rows, keep)
            if hasattr(value, "_fields")
            else np.ascontiguousarray(value[rows])
            if isinstance(value, np.ndarray) and name not in keep
            else value
            for name, value in zip(record._fields, record, strict=True)
        }
    )


def reorder(law, own, inbox, memory, order):
    """The same agents listed in another order; the leader stays first."""
    everyone = np.concatenate([[0], np.asarray(order) + 1])
    law = choose(law, order, keep=("offsets", "acceleration_blend"))
    law = law._replace(offsets=law.offsets[everyone], gains=_columns(law.gains, everyone))
    inbox = Inbox(*(_columns(each, everyone) for each in choose(inbox, order)))
    return law, choose(own, order), inbox, choose(memory, order)


def _columns(array, chosen):
    return np.ascontiguousarray(array[:, chosen])
