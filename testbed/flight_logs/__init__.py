"""Flights of real aircraft from their logs: DataFlash, tlog, ULog, recordings of positions."""
