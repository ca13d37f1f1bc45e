"""The bounded gradient ρ that turns a formation error into a velocity, [HBH23] eqs. (5), (13)."""

from __future__ import annotations

from math import exp, log
from typing import NamedTuple

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.records import Array, Record, Records, Values, record_of
from testbed.core.tabulated import (
    TABLE,
    Function,
    Rough,
    interpolate,
    make_table,
    pack_functions,
    sample_table,
)

Z0 = 0.01  # m²: a table resolves errors from a decimetre on
Z_MAX = 1e10  # m², end of a table, beyond which μ is a power of z
EXPONENT_TOLERANCE = 0.01  # of the power of z at the end of a table, which (C1) and (C2) bound


class ControlFunction(NamedTuple):
    """The scalar function μ of [HBH23] eq. (5): `example_1`, `EXAMPLE_2` or `EXAMPLE_3`.

    Examples 2 and 3 are the spline μ(z) = 1 up to `flat`, a cubic up to `far`, then z^(−1/2).
    """

    spline: bool
    nu1: float  # example 1, m²; spline: coefficient of (z − flat)²
    nu2: float  # example 1; spline: coefficient of (z − flat)³
    m: float  # example 1, exponent
    flat: float  # spline, m²
    far: float  # spline, m²
    bound: float  # ρ̄ = sup √z μ(z), (C2)


# The table is of an own function: ln μ over ln(1 + z/Z0).
MU = record_of(ControlFunction, ("own", "?"), ("table", TABLE))


class UserControlFunction(NamedTuple):
    """A user's own μ."""

    bound: float  # ρ̄
    table: Records  # (1,) of TABLE


def control_function_records(*functions: ControlFunction | UserControlFunction) -> Records:
    """Pack control functions into records (n,) of MU."""
    records = pack_functions(MU, functions)
    records["own"] = [isinstance(function, UserControlFunction) for function in functions]
    return records


def control_function_curve(
    function: ControlFunction | UserControlFunction, z: Array
) -> tuple[Array, Array]:
    """Sample μ and μ' at z (K,), m², for figures and checks."""
    records = np.repeat(control_function_records(function), len(z))
    return sample_control_functions(records, z)


def sample_control_functions(functions: Records, z: Array) -> tuple[Array, Array]:
    """Return μ and μ' (K,) of records (K,) of MU at z (K,), m²."""
    out = np.empty((2, len(z)))
    _write_values(functions, np.ascontiguousarray(z, dtype=np.float64), out)
    return out[0], out[1]


@entry
def _write_values(functions: Records, z: Array, out: Array) -> None:
    for k in range(len(z)):
        out[0, k], out[1, k] = mu(functions[k], z[k])


def make_own(function: Function) -> UserControlFunction:
    """Tabulate a user's own μ(z), z in m², and check (C1) and (C2) numerically.

    No finite number of values can prove either. At the end of the table μ must fall as a power of z
    between z^(−1/2), (C2), and z^(−1), (C1), as it continues from there.

    Raises:
        ValueError: μ is not positive, its derivative not continuous, or (C1) or (C2) fails.
    """

    def log_mu(w: Array) -> Array:
        value = function(Z0 * np.expm1(w))
        bad = np.flatnonzero(~(value > 0.0))
        if bad.size:
            z = Z0 * np.expm1(w[bad[0]])
            raise ValueError(f"mu({z:.4g}) is {value[bad[0]]:g} (write a mu above 0 everywhere)")
        return np.log(value)

    try:
        table = make_table(log_mu, 0.0, log(1.0 + Z_MAX / Z0))
    except Rough as error:
        raise ValueError(
            f"mu has no continuous derivative, or changes too fast, near z = "
            f"{Z0 * np.expm1(error.x):.4g} m² (write a smoother mu)"
        ) from None
    exponent = float(table["slopes"][0, -1])
    falls = f"for large z, mu falls as z^({exponent:.3g})"
    if exponent < -1.0 - EXPONENT_TOLERANCE:
        raise ValueError(
            f"(C1) fails: {falls}, and its integral is bounded: large errors are not closed (write "
            "a mu that falls no faster than 1/z)"
        )
    if exponent > -0.5 + EXPONENT_TOLERANCE:
        raise ValueError(
            f"(C2) fails: {falls}, and the closing speed k ‖rho‖ has no bound (write a mu that "
            "falls at least as fast as 1/sqrt(z))"
        )
    table["slopes"][0, -1] = min(max(exponent, -1.0), -0.5)
    w = np.linspace(0.0, log(1.0 + Z_MAX / Z0), 100_001)
    bound = np.sqrt(Z0 * np.expm1(w)) * np.exp(sample_table(table, w)[0])
    return UserControlFunction(float(bound.max()), table)


def example_1(nu1: float, nu2: float, m: float) -> ControlFunction:
    """Make μ(z) = (ν1 + ν2 z)^(−m), [HBH23] example 1.

    Args:
        nu1: ν1 > 0, m²; near zero error the gain is ν1^(−m).
        nu2: ν2 > 0.
        m: exponent in [0.5, 1].

    Raises:
        ValueError: (C1) or (C2) does not hold.
    """
    if not (nu1 > 0.0 and nu2 > 0.0 and 0.5 <= m <= 1.0):
        raise ValueError(
            "control function example 1 needs nu1 > 0, nu2 > 0 and m in [0.5, 1], "
            f"not nu1 = {nu1}, nu2 = {nu2}, m = {m}"
        )
    if m == 0.5:
        bound = nu2**-0.5
    else:
        # the maximum of √z (ν1 + ν2 z)^(−m) lies where z ν2 (2m − 1) = ν1
        z = nu1 / (nu2 * (2.0 * m - 1.0))
        bound = z**0.5 * (nu1 + nu2 * z) ** -m
    return ControlFunction(False, float(nu1), float(nu2), float(m), 0.0, 1.0, float(bound))


def _spline(flat: float, far: float) -> ControlFunction:
    """Make examples 2 and 3; the cubic equals z^(−1/2) at `far` in value and slope."""
    width = far - flat
    value, slope = far**-0.5 - 1.0, -0.5 * far**-1.5
    nu1 = (3.0 * value / width - slope) / width
    nu2 = (slope - 2.0 * value / width) / width**2
    return ControlFunction(True, nu1, nu2, 0.5, flat, far, 1.0)


EXAMPLE_2 = _spline(flat=0.5, far=1.5)
EXAMPLE_3 = _spline(flat=0.1, far=0.4)


@kernel
def mu(function: Record, z: float) -> Values:
    """Return μ(z) and μ'(z) for z = ‖x‖² >= 0, m².

    `function` is a record of MU.
    """
    if function.own:
        value, slope = interpolate(function.table, log(1.0 + z / Z0))
        value = exp(value)
        return value, value * slope / (Z0 + z)
    if not function.spline:
        base = function.nu1 + function.nu2 * z
        value = base**-function.m
        return value, (-function.m * function.nu2) * value / base
    if z > function.far:
        value = z**-0.5
        return value, -0.5 * value**3
    past = max(z - function.flat, 0.0)
    return (
        1.0 + past * past * (function.nu1 + function.nu2 * past),
        past * (2.0 * function.nu1 + 3.0 * function.nu2 * past),
    )
