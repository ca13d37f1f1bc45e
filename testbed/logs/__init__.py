"""Logs: write a run as MCAP, read it, and manage its directory.

`read.read_log` reads a log to arrays, and `flight_data` names them for notebooks; `recorder` writes
one; `run_directory` and `run_list` find the runs of a folder. Recordings of other programs are read
by `flight_logs`.
"""
