"""Studies: many flights of one question, from a plan to a table of their numbers.

Scenarios fly in worker processes; only their metrics come back.
"""
