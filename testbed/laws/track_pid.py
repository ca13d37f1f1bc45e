"""PID along and across the track, and on height.

What is flown by hobbyists, with the gains in three loops that share nothing: throttle closes the
error along the track, bank the error across it, pitch the error of height. With the slot's
position q_s and velocity v_s from the leader's message, t and n the unit vectors along the
leader's course and to its right, e = q_s − q and d = v_s − v:

    V_c = V_s + K_a e·t + I_a ∫ e·t dt                          commanded speed         (1)
    δ = δ_trim + K_v (V_c − V) + I_v ∫ (V_c − V) dt             throttle                (2)
    φ = F arctan(χ̇ V / g) + K_c e·n + I_c ∫ e·n dt + D_c d·n    bank                    (3)
    θ = F γ_s + K_h h + I_h ∫ h dt + D_h ḣ                      pitch                   (4)

V and V_s are horizontal speeds, V_c within the bounds of the speed over the ground; h = −e·down is
the height missing, γ_s = climb of the slot over V_s, χ̇ the leader's course rate. F is
`feed_forward`: 1 adds bank and climb of the leader, 0 leaves them to the errors. Errors across and
of height count up to `cross_limit_m` and `height_limit_m`, which bounds the angle of an intercept.
Integrals run within 15 m (throttle: inside its limits) and are bounded. Source: the PID of any
textbook, as K. J. Åström, T. Hägglund: Advanced PID Control, ISA 2006; the choice of errors is that
of trajectory tracking by fixed-wing autopilots.

Hypotheses: gains for the leader; no gain is negative, K_a, K_v, K_c, D_c, K_h > 0;
g K_c D_c > I_c, so that the lateral loop is stable by the criterion of Routh. Property, on the
linear model ÿ = g φ, ḣ = V θ, V̇ = T (δ − δ_trim): the error across the track follows
s³ + g D_c s² + g K_c s + g I_c = 0, and with I_c > 0 a constant disturbance of the bank leaves no
error; likewise for height and speed.
"""

import numpy as np

import testbed
from testbed.law import (
    FbwaCommand,
    FollowerConfig,
    FormationConfig,
    Inbox,
    OwnState,
    ground_speed_bounds,
)

GRAVITY = 9.81
WINDUP_M = 15.0  # errors beyond which integrals hold
DOWN = np.array([0.0, 0.0, 1.0])


def requires(config: FormationConfig, **options: float) -> None:
    """Check the hypotheses."""
    for name, gains in zip(config.names, config.gains, strict=True):
        if not (gains[0, :2] > 0.0).all():
            raise ValueError(
                f"{name} has no gain for the leader (write one in formation.leader_gains)"
            )
    for name, value in options.items():
        if value < 0.0:
            raise ValueError(f"{name} is {value:g} (write 0 or more)")
    limits = "cross_limit_m", "height_limit_m"
    for name in ("along_p", "speed_p", "cross_p", "cross_d", "height_p", *limits):
        if options[name] == 0.0:
            raise ValueError(f"{name} is 0 (write more)")
    largest = GRAVITY * options["cross_p"] * options["cross_d"]
    if not options["cross_i"] < largest:
        raise ValueError(
            f"cross_i is {options['cross_i']:g} (write less than g cross_p cross_d, {largest:.3g}: "
            "the lateral loop is unstable)"
        )


@testbed.kernel
def slot_motion(
    age: float, inbox: Inbox, offset: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return a slot's position and velocity, the leader's velocity and course rate."""
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
    arm = offset[0] * forward + offset[1] * right + offset[2] * down
    turning = np.cross(course_rate * DOWN + climb_rate * right, arm)
    return position + arm, velocity + turning, velocity, course_rate


@testbed.kernel
def clip(value: float, limit: float) -> float:
    """Limit a value to ±limit."""
    return min(max(value, -limit), limit)


@testbed.kernel(
    memory=[
        ("along_ms", float),
        ("speed_m", float),
        ("cross_ms", float),
        ("height_ms", float),
    ],
    requires=requires,
)
def track_pid(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: np.record,
    config: FollowerConfig,
    along_p: float = 0.86,
    along_i: float = 0.0026,
    speed_p: float = 0.31,
    speed_i: float = 0.021,
    cross_p: float = 0.132,
    cross_i: float = 0.0023,
    cross_d: float = 0.058,
    height_p: float = 0.126,
    height_i: float = 0.011,
    height_d: float = 0.0087,
    cross_limit_m: float = 6.0,
    height_limit_m: float = 2.0,
    feed_forward: float = 1.0,
) -> FbwaCommand[float]:
    """Return the command of one follower."""
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:  # also where nothing has come yet, and age is NaN
        return FbwaCommand(0.0, 0.0, config.trim_throttle)
    slot, slot_velocity, velocity, course_rate = slot_motion(
        age, inbox, config.offsets[config.agents]
    )
    level = np.hypot(velocity[0], velocity[1])
    north, east = velocity[0] / level, velocity[1] / level
    error = slot - own.position_ned
    rate = slot_velocity - own.velocity_ned
    along = north * error[0] + east * error[1]
    cross = north * error[1] - east * error[0]
    cross_rate = north * rate[1] - east * rate[0]
    height, climb = -error[2], -rate[2]

    ground = np.hypot(own.velocity_ned[0], own.velocity_ned[1])
    wanted = np.hypot(slot_velocity[0], slot_velocity[1])
    low, high = ground_speed_bounds(config, own)
    speed = wanted + along_p * along + along_i * memory.along_ms
    speed_error = min(max(speed, low), high) - ground
    throttle = config.trim_throttle + speed_p * speed_error + speed_i * memory.speed_m
    bank = feed_forward * np.arctan(course_rate * ground / GRAVITY)
    roll = (
        bank
        + cross_p * clip(cross, cross_limit_m)
        + cross_i * memory.cross_ms
        + cross_d * cross_rate
    )
    pitch = feed_forward * -slot_velocity[2] / wanted + height_p * clip(height, height_limit_m)
    pitch += height_d * climb
    pitch += height_i * memory.height_ms

    if abs(along) < WINDUP_M and low < speed < high:
        memory.along_ms = clip(memory.along_ms + config.dt * along, 100.0)
    if 0.0 < throttle < 1.0:
        memory.speed_m = clip(memory.speed_m + config.dt * speed_error, 20.0)
    if abs(cross) < WINDUP_M:
        memory.cross_ms = clip(memory.cross_ms + config.dt * cross, 100.0)
    if abs(height) < WINDUP_M:
        memory.height_ms = clip(memory.height_ms + config.dt * height, 100.0)
    return FbwaCommand(
        clip(pitch, config.pitch_limit),
        clip(roll, config.roll_limit),
        min(max(throttle, 0.0), 1.0),
    )
