"""Flight-dynamics co-simulation of fixed-wing formations.

`testbed.run("simulation-3")` flies a scenario and returns its numbers, `testbed.load(run)` reads a
flown run back as arrays; `testbed --help` is the same from a shell.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.record.flight import Flight, load
    from testbed.sim.run import Run, run

__version__ = "0.1.0"
__all__ = ["Flight", "Run", "__version__", "load", "run"]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever the name stands for
    """Load a room when it is first asked for: `testbed --help` needs none of them."""
    if name in ("Run", "run"):
        from testbed.sim import run as room

        return getattr(room, name)
    if name in ("Flight", "load"):
        from testbed.record import flight

        return getattr(flight, name)
    raise AttributeError(f"module 'testbed' has no attribute {name!r}")
