"""The search for gains by flights."""
