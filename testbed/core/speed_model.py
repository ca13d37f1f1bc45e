"""The speed model of an agent, ṡ = f + g u, [HBH23] eq. (2), with f and g of the speed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from testbed.core.compile import kernel
from testbed.core.records import Array, Record, Records, Values, allocate
from testbed.core.tabulated import TABLE, Function, Rough, interpolate, make_table

GRID = 4001  # speeds at which the sign of g is checked
SMALLEST = 1e-3  # of |g|, as a share of the largest
# f and g of a user, in place of f = −p s and g = p.
SPEED_MODEL = np.dtype([("own", "?"), ("f", TABLE), ("g", TABLE)], align=True)


class OwnSpeedModel(NamedTuple):
    """A user's own f and g."""

    f: Records  # (1,) of TABLE
    g: Records  # (1,) of TABLE


def make_own(f: Function, g: Function, s_min: float, s_max: float) -> OwnSpeedModel:
    """Tabulate a user's own f(s) and g(s).

    The table is from half the lowest to twice the highest speed.

    Beyond, both continue along straight lines.

    Args:
        f: m/s², of speeds (K,), m/s.
        g: of speeds (K,), m/s² per unit of u.
        s_min: s_lo, m/s.
        s_max: s_hi, m/s.

    Raises:
        ValueError: g is zero or changes its sign, or a derivative is not continuous.
    """
    start, end = 0.5 * s_min, 2.0 * s_max
    tables = []
    for name, function in (("f", f), ("g", g)):
        try:
            tables.append(make_table(function, start, end))
        except Rough as error:
            raise ValueError(
                f"{name} has no continuous derivative, or changes too fast, near {error.x:.4g} m/s "
                f"(write a smoother {name})"
            ) from None
    speeds: Array = np.linspace(start, end, GRID)
    values = g(speeds)
    small = np.flatnonzero(np.abs(values) <= SMALLEST * np.abs(values).max())
    changed = np.flatnonzero(np.diff(np.sign(values)))
    if small.size or changed.size:
        at = speeds[int((small if small.size else changed)[0])]
        raise ValueError(
            f"g is zero or changes its sign near {at:.4g} m/s: u has no effect there (write a g "
            f"that is not zero from {start:g} to {end:g} m/s)"
        )
    return OwnSpeedModel(*tables)


def speed_model_records(*models: OwnSpeedModel | None) -> Records:
    """Pack speed models into records (n,) of SPEED_MODEL.

    None stands for f = −p s and g = p.
    """
    records = allocate(SPEED_MODEL, len(models))
    for k, model in enumerate(models):
        if model is not None:
            records["own"][k] = True
            records["f"][k], records["g"][k] = model.f[0], model.g[0]
    return records


@kernel
def speed_terms(model: Record, s: float) -> Values:
    """Return f, m/s², and g of a user's model at a speed, m/s."""
    f, _ = interpolate(model.f, s)
    g, _ = interpolate(model.g, s)
    return f, g


@kernel
def later_speed(model: Record, u: float, s: float, dt: float) -> float:
    """Return the speed dt s later under a held u: one classical Runge-Kutta step, m/s."""
    one = _rate(model, u, s)
    two = _rate(model, u, s + 0.5 * dt * one)
    three = _rate(model, u, s + 0.5 * dt * two)
    four = _rate(model, u, s + dt * three)
    return s + dt * (one + 2.0 * two + 2.0 * three + four) / 6.0


@kernel
def _rate(model: Record, u: float, s: float) -> float:
    f, g = speed_terms(model, s)
    rate: float = f + g * u
    return rate
