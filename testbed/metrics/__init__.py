"""Numbers of a run: position errors, separations, guards and saturations counted."""

from testbed.metrics.observer import MetricsObserver
from testbed.metrics.summary import SCHEMA

__all__ = ["SCHEMA", "MetricsObserver"]
