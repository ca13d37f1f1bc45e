"""A bad link between two real programs: the channel of a run, at UDP ports and serial lines."""
