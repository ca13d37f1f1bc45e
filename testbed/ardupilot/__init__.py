"""The real ArduPlane as an aircraft's autopilot, with our flight model as its JSON physics."""
