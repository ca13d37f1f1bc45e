"""Turbulence as time series: what aircraft meet in straight and level flight."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from testbed.atmosphere.airframe_wind import LOCAL_WIND
from testbed.atmosphere.dryden import DrydenTurbulence
from testbed.core.call_list import run_steps
from testbed.core.errors import InputError
from testbed.core.records import AIRCRAFT, Array, allocate


def turbulence_series(
    scales: Callable[[Array], tuple[Array, Array]],
    *,
    spectrum: str,
    height: float,
    airspeed: float,
    dt: float,
    steps: int,
    span: float,
    flights: int = 1,
    seed: int = 0,
) -> Array:
    """Sample the turbulence of MIL-F-8785C along straight and level flights.

    Args:
        scales: σ (N, 3) m/s and L (N, 3) m at heights (N), such as `mil_f_8785c.Scales`.
        spectrum: "dryden" or "von-karman".
        height: above the ground, m.
        airspeed: true, m/s.
        dt: between samples, s.
        steps: K, number of samples.
        span: wingspan, m, over which rates are averaged.
        flights: M, each in turbulence of its own.
        seed: of the random numbers.

    Returns:
        (K, M, 6): u, v, w, m/s, along the flight, to the right and down, and the angular rates
        p, q, r of the air, rad/s, about these axes.

    Raises:
        InputError: a span, a step or the airspeed is not positive, or there are no samples.
    """
    if not 0.0 < airspeed < np.inf:
        raise InputError(f"turbulence at {airspeed:g} m/s: write an airspeed above 0 m/s")
    if steps < 1 or flights < 1:
        raise InputError(f"{steps} steps of {flights} flights: write 1 or more of both")
    names = [f"flight{i}" for i in range(flights)]
    turbulence = DrydenTurbulence(
        names, seed=seed, dt=dt, spans=[span] * flights, spectrum=spectrum, scales=scales
    )
    aircraft = allocate(AIRCRAFT, flights)
    truth, wind = aircraft["truth"], aircraft["wind"]
    truth["position_ned"][:, 2], truth["velocity_ned"][:, 0] = -height, airspeed
    step = turbulence.bind(aircraft, allocate(LOCAL_WIND, flights))
    samples = np.empty((steps, flights, 6))
    for each in samples:
        wind["wind_ned"] = wind["wind_gradient_rates"] = 0.0
        run_steps([step], 0.0)
        each[:, :3], each[:, 3:] = wind["wind_ned"], wind["wind_gradient_rates"]
    return samples
