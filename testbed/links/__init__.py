"""Links to programs outside: every aircraft as a MAVLink vehicle."""
