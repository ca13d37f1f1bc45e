"""FMI, the standard of co-simulation: formation laws that are FMUs, and aircraft as native FMUs."""
