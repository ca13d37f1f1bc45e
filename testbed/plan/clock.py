"""The clock of a scenario: at which ticks each part of a flight is due; and the versions of all."""

from __future__ import annotations

import platform

import numpy as np

from testbed.core.random import named_stream
from testbed.core.version import __version__
from testbed.flight.schedule import Clock, make_clock
from testbed.plan.radio import transmit_times
from testbed.scenario import SCHEMA_VERSION, Scenario, SingleAircraft
from testbed.scenario.sections import Rates


def build_clock(scenario: Scenario | SingleAircraft) -> Clock:
    """Build the clock of a scenario, with random phases of unsynchronised aircraft."""
    rates = {name: getattr(scenario.rates, name) for name in Rates.model_fields}
    synchronous = rates.pop("synchronous")
    names, seed = [each.name for each in scenario.aircraft], scenario.scenario.seed
    phases = None
    if not synchronous:
        phases = [float(named_stream(seed, f"phase/{name}").random()) for name in names]
    times = transmit_times(names, scenario.network) if isinstance(scenario, Scenario) else {}
    return make_clock(**rates, aircraft=len(names), phases=phases, transmit_times=times)


def versions_without_jsbsim() -> dict[str, str]:
    """Return the versions that determine the numbers of a flight, other than that of JSBSim."""
    return {
        "testbed": __version__,
        "schema": str(SCHEMA_VERSION),
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
