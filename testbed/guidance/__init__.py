"""What the leader flies: a mission of waypoints and circles, or a recorded flight."""
