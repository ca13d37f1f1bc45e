"""Compute the density of the standard atmosphere, ISO 2533, in the troposphere."""

from __future__ import annotations

from typing import TypeVar

from testbed.core.compile import jitable
from testbed.core.records import Array

_ScalarsT = TypeVar("_ScalarsT", float, Array)

SEA_LEVEL_DENSITY = 1.225  # kg/m³
SEA_LEVEL_K = 288.15  # temperature
LAPSE_RATE = 0.0065  # K/m


@jitable
def density_ratio(altitude: _ScalarsT, temperature_offset: float = 0.0) -> _ScalarsT:
    """Return the ratio of air density to the standard one at sea level.

    Args:
        altitude: m above sea level.
        temperature_offset: K, of the air, to the standard atmosphere; the pressure at sea level is
            the standard one.
    """
    colder = SEA_LEVEL_K / (SEA_LEVEL_K + temperature_offset)
    ratio: _ScalarsT = colder * (1.0 - 2.25577e-5 * colder * altitude) ** 4.25588
    return ratio
