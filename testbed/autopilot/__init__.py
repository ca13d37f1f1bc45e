"""Fly-by-wire A of ArduPlane as a compiled law, and its parameters."""
