"""Logs: writing a run as MCAP, reading it back, and the directory it lies in."""
