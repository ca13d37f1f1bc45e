"""Whole flights for users: run, step, recover, expectations."""
