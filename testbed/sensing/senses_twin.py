"""The compiled twin of `senses.sense`: all that is sensed in a period behind one door.

A test holds it to the numpy function. numba compiles it when it is first bound.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from math import isnan, nan, sqrt

import numpy as np

from testbed.compiled import bound, twin
from testbed.frames import GRAVITY
from testbed.sensing.belief_twin import write_beliefs
from testbed.sensing.errors import PITOT_NOISE
from testbed.sensing.fusion_twin import due, step_filters
from testbed.sensing.pitot import LEAST_PRESSURE, PRESSURE, SEA_LEVEL_DENSITY, TRAPPED, TRAPPED_AT


def ready_sense(senses, truth, broken):
    errors, pitots = senses.errors, senses.pitots
    move = bound(
        _sense,
        errors.parts,
        errors.now,
        *senses.offsets,
        pitots.each,
        pitots.held,
        pitots.told,
        senses.rows,
        *senses.settings,
        *senses.memory,
        senses.flown,
        *truth,
        *broken,
        senses.vectors,
        senses.speeds,
        more=(errors.now, 0, True),
    )

    def sense(step, fresh):
        move(errors.draw() if fresh else errors.now, step, fresh)

    return sense


@twin
def _pressure(eas, tas, height, held, i, blocked, drained):
    """Dynamic pressure in a tube, Pa, that may be blocked."""
    pressure = 0.5 * SEA_LEVEL_DENSITY * eas * eas
    if not blocked:
        held[TRAPPED, i] = held[TRAPPED_AT, i] = nan
        return pressure
    if isnan(held[TRAPPED, i]):
        held[TRAPPED, i] = pressure
    if isnan(held[TRAPPED_AT, i]):
        held[TRAPPED_AT, i] = height
    ratio = eas / tas
    climbed = height - held[TRAPPED_AT, i]
    climbed = SEA_LEVEL_DENSITY * ratio * ratio * GRAVITY * climbed
    return 0.0 if drained else held[TRAPPED, i] + climbed


@twin
def _read(step, hz, errors, pressure, scale, each, held, told, new, truth, blocked, drained):
    """The tubes, once more."""
    position, airspeed, equivalent = truth
    for i in range(len(each)):
        inside = _pressure(
            equivalent[i], airspeed[i], -position[i, 2], held, i, blocked[i], drained[i]
        )
        measured = (1.0 + scale[i]) * inside + pressure[i] + errors[i, PITOT_NOISE]
        if isnan(held[PRESSURE, i]):
            held[PRESSURE, i] = measured
        new[i] = due(each[i].rate_hz, step, hz)
        if new[i]:
            held[PRESSURE, i] += each[i].share * (measured - held[PRESSURE, i])
        filtered = held[PRESSURE, i]
        if filtered < LEAST_PRESSURE:
            filtered = LEAST_PRESSURE
        told[0, i] = sqrt(filtered * (2.0 / SEA_LEVEL_DENSITY))
        told[1, i] = told[0, i] * (airspeed[i] / equivalent[i])


@twin
def _sense(
    parts,
    errors,
    pressure,
    scale,
    heading,
    pitots,
    held,
    told,
    rows,
    settings,
    hz,
    states,
    covariance,
    residual,
    motions,
    past,
    spread_at,
    accepted,
    flown,
    position,
    velocity,
    acceleration,
    euler,
    rates,
    airspeed,
    equivalent,
    lost,
    jump,
    blocked,
    drained,
    vectors,
    speeds,
    draw,
    step,
    fresh,
):
    n = len(airspeed)
    if fresh:
        for i in range(n):
            for k in range(errors.shape[1]):
                errors[i, k] = parts[0, i, k] * errors[i, k] + parts[1, i, k] * draw[i, k]
        new = np.empty(n, np.bool_)
        tubes = pressure, scale, pitots, held, told, new
        seen = position, airspeed, equivalent
        _read(step, hz, errors, *tubes, seen, blocked, drained)
        step_filters(
            rows,
            settings,
            hz,
            states,
            covariance,
            residual,
            motions,
            past,
            spread_at,
            accepted,
            flown,
            step,
            position,
            velocity,
            acceleration,
            euler,
            errors,
            heading,
            told,
            new,
            lost,
            jump,
        )
    for i in range(n):
        for axis in range(3):
            vectors[0, i, axis] = position[i, axis]
            vectors[1, i, axis] = velocity[i, axis]
            vectors[2, i, axis] = acceleration[i, axis]
            vectors[3, i, axis] = euler[i, axis]
            vectors[4, i, axis] = rates[i, axis]
        exact = not pitots[i].erring and isnan(held[TRAPPED, i])
        speeds[0, i] = airspeed[i] if exact else told[1, i]
        speeds[1, i] = equivalent[i] if exact else told[0, i]
    write_beliefs(vectors, rows, flown, states, errors)
