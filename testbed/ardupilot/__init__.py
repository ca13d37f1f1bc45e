"""The real ArduPlane as an aircraft's autopilot, with our flight model as its JSON physics.

`sitl_process` starts the program, `json_physics` and `sitl_mavlink` exchange packets with it, and
`ardupilot_sitl` flies one aircraft with them in lockstep. The virtual autopilot, ArduPlane's
fly-by-wire A as compiled code, is `autopilot`.
"""
