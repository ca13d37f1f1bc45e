"""MAVLink, live: codec, links, the vehicles that ground stations see, and the telemetry log."""
