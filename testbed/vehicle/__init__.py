"""Flight models: JSBSim and ideal vehicles, trim, linearisation and control surfaces."""
