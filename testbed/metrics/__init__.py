"""Metrics of a run: formation errors, separations, limits, winds and estimates."""

from testbed.metrics.observer import MetricsObserver
from testbed.metrics.summary import SCHEMA

__all__ = ["SCHEMA", "MetricsObserver"]
