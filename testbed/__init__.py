"""Flight-dynamics co-simulation of fixed-wing formations.

`testbed.run("simulation-3")` flies a scenario and returns its metrics, `testbed.load(run)` reads
the log of a run as arrays; `testbed --help` lists the commands for a shell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.logs.flight_data import FlightData, load
    from testbed.sim.run import Run, run

__version__ = "0.1.0"
__all__ = ["FlightData", "Run", "__version__", "load", "run"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - a class or a function
    """Import a public name when it is first used, so that `testbed --help` imports none of them."""
    if name in ("Run", "run"):
        from testbed.sim import run as module

        return getattr(module, name)
    if name in ("FlightData", "load"):
        from testbed.logs import flight_data

        return getattr(flight_data, name)
    raise AttributeError(f"module 'testbed' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the public names, also those that are not imported yet."""
    return sorted({*globals(), *__all__})
