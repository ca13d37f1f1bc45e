"""Logs: write a run as MCAP, read it, and manage its directory."""
