"""What the air and the network do alone: `testbed air`, `testbed network`."""
