"""The computer aboard an aircraft of a formation: it reads its autopilot, and commands it."""
