"""Metrics of a run: formation errors, separations, limits, winds and estimates."""
