"""Consensus on a virtual structure, and tracking.

Each follower has an estimate of its own of the structure, a frame that moves with the leader, and
sends it with its messages [RB04]. Estimates follow those of the leader and of the neighbours that
the scenario's gains name, by first-order consensus with the velocity fed forward [RBA07]:

    w_i = Σ_j g_ij ŵ_j / Σ_j g_ij                       velocity of the structure         (1)
    α_i = Σ_j g_ij α_j / Σ_j g_ij                       its acceleration                  (2)
    ċ_i = w_i + κ_c Σ_j g_ij (ĉ_j − c_i)                its position                      (3)

over the leader j = 0, whose position, velocity and acceleration are those of its message, and the
neighbours j, whose c_j, w_j and α_j are in their messages; ^ is extrapolated to the present by the
age of the content. Then the own place υ in the structure is tracked:

    q_s = c + R υ,  v_s = ċ + ω × R υ                   place and its velocity            (4)
    e = q_s − q,  f = (1 + (κ ‖e‖ / v_c)²)^(−1/2)       error, and bound of its closing   (5)
    p = v_s + f κ e                                     desired velocity                  (6)
    ṗ = α + ω × (ω × R υ) + f κ (ė − (f κ / v_c)² (e · ė) e),  ė = v_s − v                (7)

The columns of R are the axes forward, right and down of the velocity frame of w, ω its angular
velocity without roll; all of the follower's own estimate. κ_c is `consensus_per_s`, κ is
`closing_per_s`, v_c `closing_limit_mps`, g_ij are the scenario's gains.

Hypotheses: there is a path from the leader to each follower; κ_c Σ_j g_ij dt < 1; κ > 0, κ dt < 1,
v_c > 0. Property: with messages at hand, estimates converge to the leader's motion as
exp(−κ_c λ t), where λ is the smallest eigenvalue of the Laplacian of the gains with the leader's
row and column left out; without the leader, to a common one with the second smallest eigenvalue
λ₂ of the Laplacian.

[RB04] W. Ren, R. W. Beard: Decentralized scheme for spacecraft formation flying via the virtual
structure approach. Journal of Guidance, Control, and Dynamics 27 (2004), 73–82.
[RBA07] W. Ren, R. W. Beard, E. M. Atkins: Information consensus in multivehicle cooperative
control. IEEE Control Systems Magazine 27 (2007), 71–82.
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


def requires(
    config: FormationConfig,
    consensus_per_s: float,
    closing_per_s: float,
    closing_limit_mps: float,
) -> None:
    """Check the hypotheses."""
    weights = config.gains[:, :, :2].min(axis=2)
    reached = {0}
    for _ in config.names:
        for row, agent in enumerate(config.agents):
            if any(weights[row, j] > 0.0 for j in reached):
                reached.add(int(agent))
    for name, agent in zip(config.names, config.agents, strict=True):
        if int(agent) not in reached:
            raise ValueError(
                f"there is no path from the leader to {name} (write gains of it or of a neighbour "
                "that has one in formation.leader_gains or neighbour_gains)"
            )
    if not 0.0 < closing_per_s < 1.0 / config.dt:
        raise ValueError(f"closing_per_s is {closing_per_s:g} (write above 0, below 1/dt)")
    if not closing_limit_mps > 0.0:
        raise ValueError(f"closing_limit_mps is {closing_limit_mps:g} (write a speed above 0)")
    limit = 1.0 / (config.dt * config.gains.sum(axis=1).max())
    if not 0.0 < consensus_per_s < limit:
        raise ValueError(
            f"consensus_per_s is {consensus_per_s:g} (write above 0 and below {limit:.3g}: 1/dt "
            "over the largest sum of a follower's gains)"
        )


@testbed.kernel(
    memory=[
        ("position_ned", float, 3),  # m, c
        ("velocity_ned", float, 3),  # m/s, w; 0: there is no estimate
        ("acceleration_ned", float, 3),  # m/s², α
        ("time_s", float),  # of the estimate, on the own clock
    ],
    send=["position_ned", "velocity_ned", "acceleration_ned", "time_s"],
    log=["position_ned"],
    requires=requires,
)
def virtual_structure(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: np.record,
    config: FollowerConfig,
    consensus_per_s: float = 4.0,
    closing_per_s: float = 0.8,
    closing_limit_mps: float = 10.0,
) -> UnicycleCommand:
    """Return the command of one follower."""
    aircraft = len(inbox.received_s)
    total = 0.0
    positions = np.zeros((aircraft, 3))
    velocity, acceleration, centre = np.zeros(3), np.zeros(3), np.zeros(3)
    used = np.zeros(aircraft)
    for j in range(aircraft):
        gain = config.gains[j, 0]
        age = now - inbox.received_s[j]
        timeout = config.leader_timeout_s if j == 0 else config.neighbour_timeout_s
        if not (gain > 0.0 and age <= timeout):  # also where nothing has come yet
            continue
        at, towards = inbox.position_ned[j], inbox.velocity_ned[j]
        change = inbox.acceleration_ned[j]
        if j > 0:
            content = inbox.payload[j]
            at, towards, change = content[0:3], content[3:6], content[6:9]
            age += inbox.stamp_s[j] - content[9]
            if not np.sum(towards**2) > 0.0:  # it has no estimate
                continue
        positions[j] = at + age * (towards + 0.5 * age * change)
        velocity += gain * (towards + age * change)
        acceleration += gain * change
        centre += gain * positions[j]
        total += gain
        used[j] = 1.0
    if total == 0.0:
        memory.velocity_ned[:] = 0.0
        level = np.array([own.velocity_ned[0], own.velocity_ned[1], 0.0])
        return command_from_velocity(config, own, level)
    velocity /= total
    acceleration /= total
    centre /= total
    if np.sum(memory.velocity_ned**2) > 0.0:
        centre = memory.position_ned + config.dt * (velocity - 0.5 * config.dt * acceleration)
    pull = np.zeros(3)
    for j in range(aircraft):
        pull += used[j] * config.gains[j] * (positions[j] - centre)
    pull *= consensus_per_s
    centre = centre + config.dt * pull
    memory.position_ned[:] = centre
    memory.velocity_ned[:] = velocity
    memory.acceleration_ned[:] = acceleration
    memory.time_s = now

    speed = np.sqrt(np.sum(velocity**2))
    level_speed = np.hypot(velocity[0], velocity[1])
    forward = velocity / speed
    right = np.array([-velocity[1] / level_speed, velocity[0] / level_speed, 0.0])
    down = np.cross(forward, right)
    turn = velocity[0] * acceleration[1] - velocity[1] * acceleration[0]
    omega = turn / level_speed**2 * DOWN - np.sum(down * acceleration) / speed * right
    offset = config.offsets[config.agents]
    arm = offset[0] * forward + offset[1] * right + offset[2] * down
    turning = np.cross(omega, arm)

    place_velocity = velocity + pull + turning
    error = centre + arm - own.position_ned
    rate = place_velocity - own.velocity_ned
    share = closing_per_s / closing_limit_mps
    bound = 1.0 / np.sqrt(1.0 + share**2 * np.sum(error**2))
    desired = place_velocity + bound * closing_per_s * error
    closing = rate - (bound * share) ** 2 * np.sum(error * rate) * error
    change = acceleration + np.cross(omega, turning) + bound * closing_per_s * closing
    return command_from_velocity(config, own, desired, change)
