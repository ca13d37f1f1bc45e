"""The world of a run, the clock, and the loop that flies it."""
