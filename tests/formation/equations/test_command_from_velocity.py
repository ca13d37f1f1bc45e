"""The command of `testbed.law.command_from_velocity` against [HBH23] (8)-(15)."""

import pydoc
from dataclasses import replace

import numpy as np
import pytest
from formation_cases import NOW, flags, make_law, same, states, velocities
from reference import adapters
from reference import formation_laws as laws
from reference.formation_laws import Desired

from testbed import law as public
from testbed.core.flags import LimiterFlag
from testbed.formation.control_step import Hbh23Law
from testbed.formation.law import FormationConfig
from testbed.law import command_from_velocity

N = 200


def config_of(law, memory):
    """The configuration of the followers of a reference law."""
    n = len(law.k)
    records = adapters.law_records(law)
    values = dict.fromkeys(("pitch_limit", "roll_limit", "trim_throttle"), same(0.5, n))
    return FormationConfig(
        names=tuple(f"uav{i + 1}" for i in range(n)),
        agents=law.agents,
        offsets=law.offsets,
        gains=law.gains,
        airspeed_min=law.speeds.min,
        airspeed_max=law.speeds.max,
        ground_speed_min=law.speeds.min,
        ground_speed_max=law.speeds.max,
        speed_pole=law.speed_pole,
        trim_airspeed=same(22.0, n),
        dt=0.04,
        leader_timeout_s=5.0,
        neighbour_timeout_s=5.0,
        hbh23=Hbh23Law(records, adapters.neighbour_records(law, memory)),
        **values,
    )


def case(**changes):
    rng = np.random.default_rng(5)
    law = make_law(N, rng, **changes)
    own, inbox, memory = states(N, rng)
    velocity, acceleration = velocities(rng, (N,), 12.0, 34.0), rng.normal(0.0, 1.5, (N, 3))
    return law, own, inbox, memory, velocity, acceleration


@pytest.mark.parametrize("with_rate", [False, True])
@pytest.mark.parametrize("bounds_of_airspeed", [False, True])
def test_command_is_that_of_8_to_15(with_rate, bounds_of_airspeed):
    law, own, _, memory, velocity, acceleration = case(bounds_of_airspeed=bounds_of_airspeed)
    args = (velocity, acceleration) if with_rate else (velocity,)
    command = command_from_velocity(config_of(law, memory), own, *args)
    rate = acceleration if with_rate else np.zeros((N, 3))

    s_d = np.linalg.norm(velocity, axis=1)  # (8)
    y_d = velocity / s_d[:, None]  # (9)
    s_d_rate = (y_d * rate).sum(axis=1)  # (11)
    y_d_rate = (rate - s_d_rate[:, None] * y_d) / s_d[:, None]  # (12)
    speed = np.linalg.norm(own.velocity_ned, axis=1)
    wind = speed - own.airspeed if bounds_of_airspeed else np.zeros(N)
    speeds = laws.SpeedSet(*(bound + wind for bound in law.speeds))
    inside = np.clip(s_d, speeds.desired_min, speeds.desired_max)
    clamped = inside != s_d
    desired = Desired(inside, np.where(clamped, 0.0, s_d_rate), y_d, y_d_rate, clamped)
    u, within = laws.speed_control(
        speed, desired, law.a, law.b, law.speed_pole, law.barrier, speeds
    )
    pitching, yawing = laws.turn_control(own.velocity_ned, desired, law.c)

    assert clamped.any() and not clamped.all() and within.any() and not within.all()
    # far outside the speed set (14) divides by a slope of h near zero, which magnifies rounding
    usual = abs(u) < 1e3
    assert usual.sum() > N / 2
    assert command.speed[usual] == pytest.approx(u[usual], rel=1e-9)
    assert command.speed[~usual] == pytest.approx(u[~usual], rel=1e-3)
    assert command.omega == pytest.approx(np.stack((0 * u, pitching, yawing), 1), abs=1e-13)
    assert command.speed_desired == pytest.approx(inside, rel=1e-15)
    assert command.direction == pytest.approx(y_d, abs=1e-15)
    assert ((command.limiter_flags & LimiterFlag.SPEED_DESIRED_CLAMPED > 0) == clamped).all()
    assert ((command.limiter_flags & LimiterFlag.OUTSIDE_SPEED_SET > 0) == ~within).all()


def test_desired_velocity_gives_the_builtin_command():
    """The built-in law's s_d y_d, where it is not clamped, leads back to its u and ω.

    At the moment at which ṡ_d and ẏ_d vanish: all fly straight, in their slots, without
    acceleration.
    """
    law, own, inbox, memory, *_ = case()
    law = replace(law, acceleration_source=np.zeros(N, dtype=int), gains=law.gains * 0.0)
    inbox = inbox._replace(euler_rates=np.zeros_like(inbox.euler_rates))
    config = config_of(law, memory)
    built, _ = config.hbh23.step(NOW, own, inbox, config.hbh23.start(own))
    velocity = built.speed_desired[:, None] * built.direction
    command = command_from_velocity(config, own, velocity)
    free = built.limiter_flags == 0
    assert free.sum() > 20
    for ours, theirs in zip(command, built, strict=True):
        assert ours[free] == pytest.approx(theirs[free], rel=1e-9, abs=1e-12)


def test_horizontal_law_uses_no_vertical_component():
    law, own, _, memory, velocity, _ = case(horizontal=flags(True, N))
    command = command_from_velocity(config_of(law, memory), own, velocity)
    level = velocity * [1.0, 1.0, 0.0]
    same_command = command_from_velocity(config_of(law, memory), own, level)
    assert (command.direction[:, 2] == 0.0).all() and (command.omega[:, 1] == 0.0).all()
    assert all(map(np.array_equal, command, same_command))


def test_velocity_without_a_command_is_an_error():
    law, own, _, memory, velocity, _ = case()
    config = config_of(law, memory)
    with pytest.raises(ValueError, match=r"velocity_ned has shape \(200,\), not \(200, 3\)"):
        command_from_velocity(config, own, velocity[:, 0])
    for value, message in ((np.nan, "velocity_ned of uav2 is not finite"), (0.0, "uav2 is zero")):
        wrong = velocity.copy()
        wrong[1] = value
        with pytest.raises(ValueError, match=message):
            command_from_velocity(config, own, wrong)
    with pytest.raises(ValueError, match="acceleration_ned of uav1 is not finite"):
        command_from_velocity(config, own, velocity, np.inf)
    with pytest.raises(ValueError, match=r"config\.hbh23 is missing"):
        command_from_velocity(replace(config, hbh23=None), own, velocity)


@pytest.mark.parametrize(
    "name", sorted(set(public.__all__) - {"HBH23_MEMORY", "Law", "LimiterFlag", "Saturation"})
)
def test_help_of_a_law_type_has_fields_and_units(name):
    text = pydoc.render_doc(getattr(public, name), renderer=pydoc.plaintext)
    assert "Alias for field" not in text
    fields = getattr(getattr(public, name), "__annotations__", {})
    for field in set(fields) - {"return"}:  # of functions the arguments
        assert f"    {field}: " in text, field
    expected = {
        "FollowerHbh23": "(1,) of LAW",
        "Inbox": "(n, N, 3) m/s over the ground",
        "Outputs": "fields that each message has",
        "OwnState": "(n, 3) m/s, velocity of the air, north, east, down",
        "VehicleState": "(N, 3) roll, pitch, yaw, rad",
        "UnicycleCommand": "(0, pitch rate, yaw rate)",
        "FbwaCommand": "rad, nose up positive",
        "FollowerConfig": "rad, of the fly-by-wire-A command",
        "FormationConfig": "forward, right, down in the leader's velocity frame",
        "command_from_velocity": "m/s over the ground, north, east, down",
        "ground_speed_bounds": "upper bounds (n,) m/s",
    }
    assert expected[name] in text
