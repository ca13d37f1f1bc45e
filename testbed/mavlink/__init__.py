"""MAVLink: its frames, telemetry logs, and flights of real aircraft brought in from their logs."""
