"""Rates with which a formation is linearised at a fifth of the cost, for claims at any rate."""

from cases import ALL

# The state of a flight repeats after one control period at 10 Hz, and after five at 25 Hz.
SLOW = ("rates.control_hz=10", "rates.broadcast_hz=10")
RATES = () if ALL else SLOW
