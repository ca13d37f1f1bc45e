"""Flights in other processes, of this computer or of a Dask cluster."""
