"""Velocity of the slot, and bounded closing.

Each follower knows the leader alone. Its slot is fixed in the leader's velocity frame, as
separation and bearing are in [DOK01], where a feedback linearisation of the velocity makes both
converge exponentially. Here this is done in Cartesian coordinates, for a velocity in three
dimensions that the vehicle tracks:

    q_s = q₀ + R υ                                   slot                                 (1)
    v_s = v₀ + ω × R υ                               its velocity, with the lever arm     (2)
    a_s = a₀ + ω × (ω × R υ)                         its acceleration, with constant ω    (3)
    e = q_s − q,  f = (1 + (κ ‖e‖ / v_c)²)^(−1/2)    error, and the bound of its closing  (4)
    p = v_s + f κ e                                  desired velocity                     (5)
    ṗ = a_s + f κ (ė − (f κ / v_c)² (e · ė) e)       its derivative, with ė = v_s − v     (6)

q₀, v₀ and a₀ are the leader's position, velocity and acceleration, extrapolated to the present by
the age of the message; υ is the slot's offset; the columns of R are the axes forward, right and
down of the leader's velocity frame, and ω is its angular velocity, without roll. κ is
`closing_per_s`, v_c `closing_limit_mps`.

Hypotheses: gains for the leader; κ > 0, v_c > 0, κ dt < 1. Property: where the velocity
is tracked, ė = −f κ e. The error decays monotonically, a small one as exp(−κ t), a large one at
v_c at most.

[DOK01] J. P. Desai, J. P. Ostrowski, V. Kumar: Modeling and control of formations of nonholonomic
mobile robots. IEEE Transactions on Robotics and Automation 17 (2001), 905–908.
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


def requires(config: FormationConfig, closing_per_s: float, closing_limit_mps: float) -> None:
    """Check the hypotheses."""
    for name, gains in zip(config.names, config.gains, strict=True):
        if not (gains[0, :2] > 0.0).all():
            raise ValueError(
                f"{name} has no gain for the leader (write one in formation.leader_gains)"
            )
    if not 0.0 < closing_per_s < 1.0 / config.dt:
        raise ValueError(
            f"closing_per_s is {closing_per_s:g} (write above 0, below the rate of control)"
        )
    if not closing_limit_mps > 0.0:
        raise ValueError(f"closing_limit_mps is {closing_limit_mps:g} (write a speed above 0)")


@testbed.kernel
def slot_motion(
    age: float, inbox: Inbox, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return position, velocity and acceleration of a slot, (1) to (3)."""
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


@testbed.kernel(requires=requires)
def leader_follower(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: None,
    config: FollowerConfig,
    closing_per_s: float = 0.8,
    closing_limit_mps: float = 10.0,
) -> UnicycleCommand:
    """Return the command of one follower."""
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:  # also where nothing has come yet, and age is NaN
        level = np.array([own.velocity_ned[0], own.velocity_ned[1], 0.0])
        return command_from_velocity(config, own, level)
    position, velocity, acceleration = slot_motion(age, inbox, config.offsets[config.agents])
    error = position - own.position_ned
    rate = velocity - own.velocity_ned
    share = closing_per_s / closing_limit_mps
    bound = 1.0 / np.sqrt(1.0 + share**2 * np.sum(error**2))
    desired = velocity + bound * closing_per_s * error
    closing = rate - (bound * share) ** 2 * np.sum(error * rate) * error
    return command_from_velocity(
        config, own, desired, acceleration + bound * closing_per_s * closing
    )
