"""Flight-dynamics co-simulation of fixed-wing formations.

`testbed.run("simulation-3")` flies a scenario and returns metrics; `testbed.load_scenario` reads
one, `testbed.load_run` reads the log of a run as arrays. `testbed.Simulation` steps a scenario,
`testbed.Aircraft` one aircraft; `testbed.law` has the types of a law of your own, which
`testbed.kernel` compiles. `testbed --help` lists the commands for a shell.
"""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

from testbed.core.version import __version__

if TYPE_CHECKING:
    from testbed.flight.stages import FlightRecords, UserStage
    from testbed.formation.compiled_law import kernel
    from testbed.linear.gain_scan import GainScan
    from testbed.linear.linear_system import LinearSystem
    from testbed.linear.linearise import linearise
    from testbed.logs.flight_data import FlightData, load_run
    from testbed.runs.batch import Batch
    from testbed.runs.run import Run, run
    from testbed.runs.simulation import Simulation
    from testbed.runs.single_aircraft import Aircraft
    from testbed.scenario.load import load_scenario
    from testbed.tuning.tuning import Tuning

__all__ = [
    "Aircraft",
    "Batch",
    "FlightData",
    "FlightRecords",
    "GainScan",
    "LinearSystem",
    "Run",
    "Simulation",
    "Tuning",
    "UserStage",
    "__version__",
    "kernel",
    "linearise",
    "load_run",
    "load_scenario",
    "run",
]

_MODULES = {
    "Aircraft": "testbed.runs.single_aircraft",
    "Batch": "testbed.runs.batch",
    "FlightData": "testbed.logs.flight_data",
    "FlightRecords": "testbed.flight.stages",
    "GainScan": "testbed.linear.gain_scan",
    "LinearSystem": "testbed.linear.linear_system",
    "Run": "testbed.runs.run",
    "Simulation": "testbed.runs.simulation",
    "Tuning": "testbed.tuning.tuning",
    "UserStage": "testbed.flight.stages",
    "kernel": "testbed.formation.compiled_law",
    "linearise": "testbed.linear.linearise",
    "load_run": "testbed.logs.flight_data",
    "load_scenario": "testbed.scenario",
    "run": "testbed.runs.run",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401 - a class or a function
    """Import a public name when it is first used, so that `testbed --help` imports none of them."""
    if name in _MODULES:
        return getattr(import_module(_MODULES[name]), name)
    if name == "law":
        return import_module("testbed.law")
    if name == "StateSpace":  # until 0.2
        text = "testbed.StateSpace is testbed.LinearSystem now (write that name)"
        warnings.warn(text, DeprecationWarning, stacklevel=2)
        return __getattr__("LinearSystem")
    raise AttributeError(f"module 'testbed' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, also those that are not imported yet, without those of this module."""
    return sorted({*__all__, "law"})
