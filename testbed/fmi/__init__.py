"""FMI, the standard of co-simulation: a compiled aircraft with its autopilot as a native FMU."""
