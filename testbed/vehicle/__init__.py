"""An aircraft as a virtual autopilot: flight model, fly-by-wire law, trim and what it believes."""
