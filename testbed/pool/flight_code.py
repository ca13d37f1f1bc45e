"""The code of the testbed that decides the numbers of a flight, as a digest."""

from __future__ import annotations

from pathlib import Path

from testbed.core.compile import source_digest
from testbed.core.version import __version__

# packages that a flight of a study imports: a change in any of their files can change its numbers
FLIGHT_PACKAGES = (
    *("core", "airframes", "ardupilot", "atmosphere", "autopilot", "commands", "compiled"),
    *("fmi", "flight", "formation", "guidance", "logs", "mavlink", "metrics", "network", "plan"),
    *("pool", "runs", "scenario", "sensors", "studies", "vehicle"),
)
PREDICTION_PACKAGES = ("linear",)  # and a prediction
_PACKAGE = Path(__file__).parents[1]


def flight_code(*, predictions: bool = False) -> str:
    """Return a short digest of the code of flights, and of predictions."""
    packages = FLIGHT_PACKAGES + (PREDICTION_PACKAGES if predictions else ())
    return source_digest(_PACKAGE, packages)[:12]


def describe_code() -> str:
    """Return version and code as text: `testbed 0.1.0, code 1a2b3c4d5e6f`."""
    return f"testbed {__version__}, code {flight_code()}"
