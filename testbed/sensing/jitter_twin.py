"""The compiled twin of `jitter.jitter`, aircraft by aircraft."""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from testbed.compiled import bound, twin
from testbed.frames import GRAVITY
from testbed.sensing.belief_twin import rotation_of


def ready_jitter(errors, parts, estimate, out):
    move = bound(_jitter, errors, parts, *estimate, *out, more=(errors, True))

    def jitter(draw):
        moves = draw is not None
        move(draw if moves else errors, moves)

    return jitter


@twin
def _jitter(
    errors,
    parts,
    position,
    velocity,
    acceleration,
    euler,
    rates,
    airspeed,
    equivalent,
    position_out,
    velocity_out,
    acceleration_out,
    euler_out,
    rates_out,
    airspeed_out,
    equivalent_out,
    draw,
    moves,
):
    for i in range(errors.shape[0]):
        if moves:
            for k in range(errors.shape[1]):
                errors[i, k] = parts[0, i, k] * errors[i, k] + parts[1, i, k] * draw[i, k]
        x, y, z = rotation_of(euler[i, 0], euler[i, 1], euler[i, 2])
        north, east = acceleration[i, 0], acceleration[i, 1]
        down = acceleration[i, 2] - GRAVITY
        a = north * x[0] + east * y[0] + down * z[0]
        b = north * x[1] + east * y[1] + down * z[1]
        c = north * x[2] + east * y[2] + down * z[2]
        for axis in range(3):
            position_out[i, axis] = position[i, axis] + errors[i, axis]
            velocity_out[i, axis] = velocity[i, axis] + errors[i, 3 + axis]
            euler_out[i, axis] = euler[i, axis] + errors[i, 6 + axis]
            rates_out[i, axis] = rates[i, axis]
        x, y, z = rotation_of(euler_out[i, 0], euler_out[i, 1], euler_out[i, 2])
        acceleration_out[i, 0] = x[0] * a + x[1] * b + x[2] * c
        acceleration_out[i, 1] = y[0] * a + y[1] * b + y[2] * c
        acceleration_out[i, 2] = z[0] * a + z[1] * b + z[2] * c + GRAVITY
        airspeed_out[i], equivalent_out[i] = airspeed[i], equivalent[i]
