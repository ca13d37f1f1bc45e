"""The law of [HBH23] from plain numbers, with the parameters of its Section 9 as defaults."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from testbed.core.errors import InputError
from testbed.core.records import allocate
from testbed.core.speed_model import speed_model_records
from testbed.formation.assumptions import margin
from testbed.formation.barrier import SpeedBarrier, barrier_records
from testbed.formation.control_function import (
    ControlFunction,
    control_function_records,
    example_1,
)
from testbed.formation.control_step import Hbh23Law, make_neighbours
from testbed.formation.hbh23 import LAW
from testbed.formation.leader_filter import BROADCAST

SECTION_9_FUNCTION = example_1(50.0, 1.0, 0.5)
SECTION_9_BARRIER = SpeedBarrier(5, 0.05)


def make_paper_law(
    offsets: ArrayLike,
    gains: ArrayLike,
    *,
    k: float = 3.0,
    a: float = 1.0,
    b: float = 0.1,
    c: float = 0.1,
    kappa: float = 3.6,
    speed_min: float = 16.0,
    speed_max: float = 30.0,
    speed_pole: float = 0.64,
    control_function: ControlFunction = SECTION_9_FUNCTION,
    barrier: SpeedBarrier = SECTION_9_BARRIER,
    timeout_s: float = 5.0,
    lost_leader_airspeed: float = 22.0,
) -> Hbh23Law:
    """Make the law of [HBH23] for n followers with equal parameters.

    Messages are extrapolated with constant velocity from their receipt; q̈_g is the leader's
    broadcast, and ω̇_g is neglected.

    Args:
        offsets: υ (n, 3) m of the followers: forward, right, down in the leader's velocity frame.
        gains: (n, n + 1): β_i of the leader in column 0, β_ij of follower j in column j + 1.
        k: of (7), m/s.
        a: of (14), 1/s.
        b: of (14), s/m².
        c: of (15), 1/s.
        kappa: κ, m/s, distance of the slots' speed from the bounds.
        speed_min: s_lo, m/s over the ground.
        speed_max: s_hi, m/s.
        speed_pole: p of the speed model f = −p s, g = p, 1/s.
        control_function: μ of (5).
        barrier: h of (14).
        timeout_s: age since receipt from which a message is not used, s.
        lost_leader_airspeed: m/s, flown straight while the leader has timed out.

    Raises:
        InputError: shapes do not agree, or k is not below κ/ρ̄, as (7) requires.
    """
    slots, beta = np.asarray(offsets, dtype=np.float64), np.asarray(gains, dtype=np.float64)
    n = len(slots)
    if slots.shape != (n, 3) or beta.shape != (n, n + 1):
        raise InputError(
            f"offsets {slots.shape} and gains {beta.shape}: write (n, 3) and (n, n + 1)"
        )
    epsilon = float(margin(np.array(k), np.array(kappa), control_function.bound))
    if epsilon <= 0.0:
        raise InputError(
            f"k {k:g} m/s is not below κ/ρ̄, {kappa / control_function.bound:g} m/s (write a lower "
            "k or a higher kappa)"
        )
    law = allocate(LAW, n)
    law["row"] = np.arange(1, n + 1)
    law["k"], law["a"], law["b"], law["c"] = k, a, b, c
    law["speed_pole"], law["speed_model"] = speed_pole, speed_model_records(None)
    law["mu"] = control_function_records(control_function)
    law["barrier"] = barrier_records(barrier)
    law["speed_min"], law["speed_max"] = speed_min, speed_max
    law["speed_desired_min"], law["speed_desired_max"] = speed_min + epsilon, speed_max - epsilon
    law["acceleration_source"] = BROADCAST
    for each in ("acceleration_blend", "difference_blend", "turn_rate_blend"):
        law[each] = 1.0
    law["leader_timeout_s"] = law["neighbour_timeout_s"] = timeout_s
    law["lost_leader_airspeed"] = lost_leader_airspeed
    weights = np.repeat(beta[:, :, np.newaxis], 3, axis=2)
    everyone = np.vstack([np.zeros(3), slots])
    return Hbh23Law(law, make_neighbours(everyone, weights, timeout_s, timeout_s))
