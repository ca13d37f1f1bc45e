"""Many flights: golden tables, comparisons of runs, studies and the tuning of gains.

Scenarios fly in worker processes; only their metrics come back. No other package but the command
line imports this one.
"""
