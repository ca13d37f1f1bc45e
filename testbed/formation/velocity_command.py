"""The command of a user's law that reaches a desired velocity."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numba.core import types
from numba.extending import overload

from testbed.core.compile import kernel
from testbed.core.frames import norm
from testbed.core.records import Array, OwnState, UnicycleCommand, Values, Vector
from testbed.formation.compiled_law import FollowerConfig, require_vector
from testbed.formation.control_step import Hbh23Law
from testbed.formation.hbh23 import reach_velocity
from testbed.formation.law import FormationConfig


def command_from_velocity(
    config: FormationConfig | FollowerConfig,
    own: OwnState,
    velocity_ned: Array,
    acceleration_ned: Array | float = 0.0,
) -> UnicycleCommand:
    """Compute the command that turns and accelerates followers to desired velocities.

    This is the second half of the built-in law, [HBH23] (8)-(15), with the scenario's gains a, b
    and c, barrier and speed bounds: s_d and y_d are length and direction of the desired velocity,
    s_d is clamped to its bounds, and u and ω reach them. With `formation.altitudes_m` the vertical
    components are not used. In a law under `testbed.kernel` the arguments are those of one
    follower, the vectors (3,) or triples.

    Args:
        config: the first argument of the law's class.
        own: the followers' estimates, as `step` receives them.
        velocity_ned: p_d (n, 3) m/s over the ground, north, east, down; finite, not zero.
        acceleration_ned: its time derivative (n, 3) m/s²; without it followers lag behind a
            desired velocity that turns.

    Raises:
        ValueError: a velocity is zero or not finite, or an array has another shape.
    """
    if isinstance(config, FollowerConfig):  # a kernel that runs as Python
        return _follower_command(config, own, velocity_ned, _triple(acceleration_ned))
    law = config.hbh23
    if not isinstance(law, Hbh23Law):
        raise ValueError("config.hbh23 is missing: pass the config that the law's class received")
    shape = (len(config.names), 3)
    arrays = []
    for name, value in (("velocity_ned", velocity_ned), ("acceleration_ned", acceleration_ned)):
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(f"{name} has no numbers (write shape {shape})") from None
        if array.shape not in (shape, ()):
            raise ValueError(f"{name} has shape {array.shape}, not {shape}")
        array = np.ascontiguousarray(np.broadcast_to(array, shape))
        if not np.isfinite(array).all():
            row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
            raise ValueError(f"{name} of {config.names[row]} is not finite")
        arrays.append(array)
    weights = np.where(law.law["horizontal"][:, np.newaxis], [1.0, 1.0, 0.0], 1.0)
    still = np.flatnonzero(~(arrays[0] * weights).any(axis=1))
    if len(still):
        raise ValueError(f"velocity_ned of {config.names[still[0]]} is zero: it has no direction")
    return law.command_from_velocity(own, *arrays)


def ground_speed_bounds(config: FormationConfig | FollowerConfig, own: OwnState) -> tuple[Any, Any]:
    """Compute the bounds of the speeds over the ground that followers can fly now.

    They are those with which the built-in law flies: the bounds of the airspeed, shifted by ground
    speed minus airspeed, in wind; those of the ground speed where the scenario has them, as in
    flights without wind. In a law under `testbed.kernel` they are two numbers.

    Args:
        config: the first argument of the law's class.
        own: the followers' estimates, as `step` receives them.

    Returns:
        Lower and upper bounds (n,) m/s.
    """
    if isinstance(config, FollowerConfig):  # a kernel that runs as Python
        return _follower_bounds(config, own)
    if config.bounds_ground_speed:
        return config.ground_speed_min, config.ground_speed_max
    shift = np.linalg.norm(own.velocity_ned, axis=1) - own.airspeed
    return config.airspeed_min + shift, config.airspeed_max + shift


@kernel
def _follower_bounds(config: FollowerConfig, own: Values) -> tuple[float, float]:
    if isfinite(config.ground_speed_max):
        return config.ground_speed_min, config.ground_speed_max
    shift = norm(own.velocity_ned) - own.airspeed
    return config.airspeed_min + shift, config.airspeed_max + shift


overload(ground_speed_bounds)(lambda config, own: lambda config, own: _follower_bounds(config, own))


@kernel
def _follower_command(
    config: FollowerConfig,
    own: Values,
    velocity: Vector,
    acceleration: Vector,
) -> UnicycleCommand:
    """Compute the command of one follower.

    Raises:
        ValueError: the velocity is zero or not finite, or a vector has not three numbers.
    """
    if len(velocity) != 3 or len(acceleration) != 3:
        raise ValueError("velocity_ned or acceleration_ned has not 3 numbers")
    p = (float(velocity[0]), float(velocity[1]), float(velocity[2]))
    p_rate = (float(acceleration[0]), float(acceleration[1]), float(acceleration[2]))
    for each in (*p, *p_rate):
        if not isfinite(each):
            raise ValueError("velocity_ned or acceleration_ned is not finite")
    law, airspeed = config.hbh23.gains[0], own.airspeed
    if p[0] == 0.0 and p[1] == 0.0 and (law.horizontal or p[2] == 0.0):
        raise ValueError("velocity_ned is zero: it has no direction")
    u, omega, s_d, y_d, flags = reach_velocity(law, own.velocity_ned, airspeed, p, p_rate)
    return UnicycleCommand(u, omega, s_d, y_d, flags)


def _triple(value: Any) -> Any:  # noqa: ANN401 - three numbers, or one for all
    return (value,) * 3 if isinstance(value, int | float) else value


def _command_in_kernels(velocity_ned: object, acceleration_ned: object) -> Any:  # noqa: ANN401
    """Return what kernels compile in place of `command_from_velocity`, for types of numba."""
    require_vector("velocity_ned", velocity_ned)
    if isinstance(acceleration_ned, float | types.Number | types.Omitted):
        return lambda config, own, velocity_ned, acceleration_ned=0.0: _follower_command(
            config, own, velocity_ned, (acceleration_ned, acceleration_ned, acceleration_ned)
        )
    require_vector("acceleration_ned", acceleration_ned)
    return lambda config, own, velocity_ned, acceleration_ned=0.0: _follower_command(
        config, own, velocity_ned, acceleration_ned
    )


# numba compares the parameters, also their annotations
overload(command_from_velocity)(
    lambda config, own, velocity_ned, acceleration_ned=0.0: _command_in_kernels(
        velocity_ned, acceleration_ned
    )
)
