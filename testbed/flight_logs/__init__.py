"""Flights of real aircraft from their logs: DataFlash, tlog, and recordings of positions."""
