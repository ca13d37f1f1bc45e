"""State estimates of autopilots: sensor errors, airspeed sensors and the navigation filter."""
