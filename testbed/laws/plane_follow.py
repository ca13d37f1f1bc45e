"""Following as ArduPilot's Plane Follow documents.

ArduPlane flies in GUIDED; the applet commands a heading, an airspeed and an altitude. Written from
the applet's documentation alone, libraries/AP_Scripting/applets/plane_follow.md of ArduPilot at
commit 09b33ef0, some time after 4.7, with which the applet came, and from the documentation of
parameters; no line of the applet is used.
It states what the parameters mean, not the formulas; those below are this law's.

- The target is the leader's position with FOLL_OFS_X, _Y and _Z along its heading, at its altitude:
  q_s, the scenario's slot, level and along the leader's course.
- "Close" (ZPF_DIST_CLOSE, `close_m`) is where heading and speed of the target are matched: (2).
- Overshot, by the difference of the headings (ZPF_OVRSHT_DEG, 75°, `overshoot_deg`), the vehicle
  slows down and turns around: (3).
- The target turns, by the difference of the headings (ZPF_TURN_DEG, 15°, `turn_deg`): the effect is
  not documented; here integrals of the speed hold.
- Two PIDs command the speed, one of the distance, one of the velocity (ZPF2_D_P, _I, _D, ZPF2_V_P,
  _I, _D; `distance_p` to `velocity_d`), with a time to look ahead for distance errors (ZPF2_LKAHD,
  `lookahead_s`): (4).
- A factor on the distance (ZPF2_DIST_FUDGE), of which the documentation says that it may be a bad
  idea, is left out, as are the largest distance, FOLL_DIST_MAX, and a fixed altitude, ZPF_ALT_OVR.
- Without the target (ZPF_TIMEOUT, ZPF_FAIL_MODE): level flight after controller.leader_timeout_s.

    far:       heading to q_s                                                             (1)
    close:     heading to q_s + t_L v₀, which is the leader's where q = q_s               (2)
    overshot:  close, q_s behind by more than the angle: heading to q_s, least airspeed    (3)
    V_c = V₀ + PID_D(d + t_L ḋ) + PID_V(ḋ)                                                (4)

d is the distance to the slot along the leader's course, ḋ the leader's speed minus the own one
along it, V₀ the leader's airspeed by the own estimate of the wind. Each heading is that at which
the velocity over the ground has the wanted course in that wind, without sideslip.

What stands in for ArduPlane's own loops, which are not the applet's:

    bank      φ = `heading_p` × heading error: GUIDED_P, 5000 cdeg/rad = 0.873 in 4.7     (5)
    pitch     θ = (ḣ_c + `climb_i` ∫ (ḣ_c − ḣ) dt) / V, ḣ_c = height error / `height_s`     (6)
    throttle  δ = δ_trim + `throttle_p` (V_c − V) + `throttle_i` ∫ (V_c − V) dt           (7)

(6) and (7) are in place of TECS; `height_s` is its TECS_TIME_CONST, ḣ_c within ±5 m/s as by
TECS_CLMB_MAX and TECS_SINK_MAX.

Hypotheses: gains for the leader; no gain is negative, and `heading_p`, `distance_p`,
`throttle_p`, `height_s`, `lookahead_s`, `close_m` > 0. Property: (5) has no integral, so in a
steady turn at χ̇ the heading is behind the commanded one by arctan(χ̇ V / g) / `heading_p`, 52° at
45° of bank with the default of 4.7; on a straight path with a constant error of the speed the
distance error goes to zero with `distance_i` > 0.
"""

import numpy as np

import testbed
from testbed.law import FbwaCommand, FollowerConfig, FormationConfig, Inbox, OwnState

CLIMB_MPS = 5.0  # TECS_CLMB_MAX, TECS_SINK_MAX


def requires(config: FormationConfig, **options: float) -> None:
    """Check the hypotheses."""
    for name, gains in zip(config.names, config.gains, strict=True):
        if not (gains[0, :2] > 0.0).all():
            raise ValueError(
                f"{name} has no gain for the leader (write one in formation.leader_gains)"
            )
    positive = "heading_p distance_p throttle_p height_s lookahead_s close_m"
    for name, value in options.items():
        if value < 0.0 or (value == 0.0 and name in positive.split()):
            raise ValueError(f"{name} is {value:g} (write more)")


@testbed.kernel
def clip(value: float, limit: float) -> float:
    """Limit a value to ±limit."""
    return min(max(value, -limit), limit)


@testbed.kernel
def wrap(angle: float) -> float:
    """Return the angle in ±π."""
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@testbed.kernel(
    memory=[
        ("distance_ms", float),
        ("velocity_m", float),
        ("climb_m", float),
        ("airspeed_m", float),
        ("relative_mps", float),  # ḋ of the step before, for the D of the velocity
        ("heading_error_rad", float),
        ("mode", int),
    ],
    log=["heading_error_rad"],
    events={"mode": ["without the target", "flies to the target", "is close", "has overshot"]},
    requires=requires,
)
def plane_follow(
    now: float,
    own: OwnState,
    inbox: Inbox,
    memory: np.record,
    config: FollowerConfig,
    close_m: float = 50.0,
    lookahead_s: float = 1.02,
    overshoot_deg: float = 75.0,
    turn_deg: float = 15.0,
    distance_p: float = 1.99,
    distance_i: float = 0.082,
    distance_d: float = 0.0,
    velocity_p: float = 0.64,
    velocity_i: float = 0.0,
    velocity_d: float = 0.0,
    heading_p: float = 2.48,
    height_s: float = 2.75,
    climb_i: float = 0.216,
    throttle_p: float = 0.227,
    throttle_i: float = 0.0286,
) -> FbwaCommand[float]:
    """Return the command of one follower."""
    age = now - inbox.received_s[0]
    if not age <= config.leader_timeout_s:  # also where nothing has come yet, and age is NaN
        memory.mode = 0
        return FbwaCommand(0.0, 0.0, config.trim_throttle)
    acceleration = inbox.acceleration_ned[0]
    velocity = inbox.velocity_ned[0] + age * acceleration
    position = inbox.position_ned[0] + age * (inbox.velocity_ned[0] + 0.5 * age * acceleration)
    speed = np.hypot(velocity[0], velocity[1])
    north, east = velocity[0] / speed, velocity[1] / speed
    ahead, aside, below = config.offsets[config.agents]
    to_north = position[0] + ahead * north - aside * east - own.position_ned[0]
    to_east = position[1] + ahead * east + aside * north - own.position_ned[1]
    distance = to_north * north + to_east * east
    relative = speed - (own.velocity_ned[0] * north + own.velocity_ned[1] * east)

    wind = own.wind_ned
    heading = own.euler[2]
    leader_heading = np.arctan2(velocity[1] - wind[1], velocity[0] - wind[0])
    difference = abs(wrap(leader_heading - heading))
    bearing_error = abs(wrap(np.arctan2(to_east, to_north) - heading))
    turns = difference > np.radians(turn_deg)
    airspeed = float(own.airspeed)
    target_airspeed = np.hypot(velocity[0] - wind[0], velocity[1] - wind[1])
    is_close = np.hypot(to_north, to_east) < close_m
    overshot = is_close and distance < 0.0 and difference > np.radians(overshoot_deg)
    memory.mode = 3 if overshot and bearing_error > np.radians(overshoot_deg) else 1 + is_close
    if memory.mode == 2:
        to_north += lookahead_s * velocity[0]
        to_east += lookahead_s * velocity[1]

    # the velocity through the air, of the own airspeed, whose ground velocity has this course
    course = np.arctan2(to_east, to_north)
    across = (wind[1] * np.cos(course) - wind[0] * np.sin(course)) / max(airspeed, 1.0)
    wanted = course - np.arcsin(clip(across, 0.99))
    memory.heading_error_rad = wrap(wanted - heading)
    roll = heading_p * memory.heading_error_rad

    looked = distance + lookahead_s * relative
    change = (relative - memory.relative_mps) / config.dt if memory.relative_mps != 0.0 else 0.0
    memory.relative_mps = relative
    command = target_airspeed
    command += distance_p * looked + distance_i * memory.distance_ms
    command += distance_d * (relative + lookahead_s * change)
    command += velocity_p * relative + velocity_i * memory.velocity_m + velocity_d * change
    if memory.mode == 3:
        command = config.airspeed_min
    bounded = min(max(command, config.airspeed_min), config.airspeed_max)
    if memory.mode == 2 and not turns and bounded == command:
        memory.distance_ms = clip(memory.distance_ms + config.dt * looked, 100.0)
        memory.velocity_m = clip(memory.velocity_m + config.dt * relative, 100.0)

    height = own.position_ned[2] - (position[2] + below)
    climb = clip(height / height_s, CLIMB_MPS)
    memory.climb_m = clip(memory.climb_m + config.dt * (climb + own.velocity_ned[2]), 20.0)
    pitch = (climb + climb_i * memory.climb_m) / max(airspeed, 1.0)
    speed_error = bounded - airspeed
    throttle = config.trim_throttle + throttle_p * speed_error + throttle_i * memory.airspeed_m
    if 0.0 < throttle < 1.0:
        memory.airspeed_m = clip(memory.airspeed_m + config.dt * speed_error, 20.0)
    return FbwaCommand(
        clip(pitch, config.pitch_limit),
        clip(roll, config.roll_limit),
        min(max(throttle, 0.0), 1.0),
    )
