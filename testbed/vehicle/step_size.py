"""Which steps are too long for the modes of an aircraft.

A step dt is compared with the eigenvalues λ of the aircraft in trim. Adams and Bashforth's second
order is stable on the real axis for |λ| dt < 1, and Euler's method, by which JSBSim integrates the
propeller's speed, for |λ| dt < 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from testbed.core.errors import InputError
from testbed.vehicle.linearize import NaturalMode

STABLE = 1.0  # |λ| dt
PROPELLER_STABLE = 2.0  # |λ| dt
# |λ| dt. A Skywalker X8's responses to commands of 1 Hz are up to 3 % off at 0.59, and up to 0.7 %
# at 0.3; at 1.05 it diverges (docs/speed.md).
ACCURATE = 0.5


class CoarseStep(NamedTuple):
    """A step that is too long for a mode."""

    mode: NaturalMode
    product: float  # |λ| dt
    limit: float  # which the product exceeds: of accuracy or of stability
    stable: bool
    rate_hz: int  # that suits


def describe_coarse_step(coarse: CoarseStep, aircraft: str, airspeed: float, rate_hz: int) -> str:
    """Describe a step that is too long, without what to write instead.

    Args:
        coarse: the step.
        aircraft: name of the airframe.
        airspeed: of its trim, m/s.
        rate_hz: steps per second.
    """
    value = coarse.mode.eigenvalue
    shown = f"{value.real:.3g}"
    if coarse.mode.oscillates:
        shown += f" ± {value.imag:.3g}i"
    what = (
        f"above {coarse.limit:g} flights are inaccurate"
        if coarse.stable
        else f"from {coarse.limit:g} on its integration diverges"
    )
    return (
        f"the {coarse.mode.name} mode of {aircraft} at {airspeed:g} m/s has the eigenvalue {shown} "
        f"1/s; its magnitude times the step of 1/{rate_hz} s is {coarse.product:.3g}, and {what}"
    )


def check_fixed_step(
    aircraft: str,
    airspeed: float,
    modes: Sequence[NaturalMode],
    rate_hz: int,
    warn: Callable[[str], None],
) -> None:
    """Check the step of a flight whose rate cannot be chosen.

    Args:
        aircraft: name of the airframe.
        airspeed: of its trim, m/s.
        modes: of the aircraft in this trim.
        rate_hz: steps per second.
        warn: receives a line if the flight is inaccurate.

    Raises:
        InputError: the flight would diverge.
    """
    coarse = find_coarse_step(modes, rate_hz, rate_hz)
    if coarse is None:
        return
    text = describe_coarse_step(coarse, aircraft, airspeed, rate_hz)
    text += f" (fly it in a scenario with rates.physics_hz: {coarse.rate_hz}, or slower)"
    if not coarse.stable:
        raise InputError(text)
    warn(text)


def find_coarse_step(
    modes: Sequence[NaturalMode], rate_hz: int, multiple_hz: int
) -> CoarseStep | None:
    """Return the mode for which steps are too long, an unstable one first; None: there is none.

    Args:
        modes: of the aircraft at its start.
        rate_hz: steps per second.
        multiple_hz: of which the suggested rate is a multiple.
    """
    if not modes:
        return None
    fastest = max(modes, key=lambda mode: mode.frequency)
    suits = multiple_hz * math.ceil(fastest.frequency / ACCURATE / multiple_hz)
    for mode in modes:
        limit = PROPELLER_STABLE if mode.name == "propeller" else STABLE
        if (product := mode.frequency / rate_hz) >= limit:
            return CoarseStep(mode, product, limit, stable=False, rate_hz=suits)
    if (product := fastest.frequency / rate_hz) > ACCURATE:
        return CoarseStep(fastest, product, ACCURATE, stable=True, rate_hz=suits)
    return None
