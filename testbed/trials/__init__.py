"""Measurements with parts of a flight: probes, steps, margins."""
