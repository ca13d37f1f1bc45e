"""Fly an aircraft of a run around a square of 350 m, and leave it circling at the start.

    testbed run examples/square.yaml --mavlink udpout:127.0.0.1:14550
    python examples/square.py

Needs pymavlink, whose mavutil is under the LGPL and imports a module that is under the GPL.
"""

import math
import sys

from pymavlink import mavutil

SYSTEM = 4  # uav3; the leader is 1
SIDE, SPEED, NEAR = 350.0, 22.0, 25.0  # m, m/s, and m from a corner at which it is reached
MESSAGES = ["LOCAL_POSITION_NED", "VFR_HUD", "ATTITUDE"]
NO_RATES, CUSTOM_MODE, LOITER = 7, 1, 12


def clamp(value: float, limit: float) -> float:
    """Limit the magnitude of a value."""
    return max(-limit, min(limit, value))


link = mavutil.mavlink_connection((sys.argv + ["udpin:127.0.0.1:14550"])[1], source_system=245)
latest, corners, height = {}, [], 0.0
while True:
    message = link.recv_match(type=MESSAGES, blocking=True, timeout=60)
    if message is None:
        sys.exit("no telemetry received")
    if message.get_srcSystem() != SYSTEM:
        continue
    latest[message.get_type()] = message
    if message.get_type() != "ATTITUDE" or len(latest) < len(MESSAGES):
        continue  # ATTITUDE is the last message of a sample, and is answered
    position, speed = latest["LOCAL_POSITION_NED"], latest["VFR_HUD"].airspeed
    course = math.atan2(position.vy, position.vx)
    if not corners:  # ahead, to the right, back, and at the current position
        ahead, height = (SIDE * math.cos(course), SIDE * math.sin(course)), -position.z
        for forward, right in ((1, 0), (1, 1), (0, 1), (0, 0)):
            north, east = (
                forward * ahead[0] - right * ahead[1],
                forward * ahead[1] + right * ahead[0],
            )
            corners.append((position.x + north, position.y + east))
    north, east = corners[0][0] - position.x, corners[0][1] - position.y
    if math.hypot(north, east) < NEAR:
        print(f"corner at {corners[0][0]:.0f} m north, {corners[0][1]:.0f} m east", flush=True)
        if not corners[1:]:
            break
        corners.pop(0)
    turn = math.remainder(math.atan2(east, north) - course, math.tau)
    roll = clamp(1.5 * turn, math.radians(35.0))
    pitch = 0.03 + clamp(0.02 * (height + position.z) + 0.04 * position.vz, 0.2)
    throttle = 0.5 + clamp(0.08 * (SPEED - speed), 0.5)
    (cr, cp), (sr, sp) = map(math.cos, (roll / 2, pitch / 2)), map(math.sin, (roll / 2, pitch / 2))
    attitude = [cr * cp, sr * cp, cr * sp, -sr * sp]  # w, x, y, z of a heading north
    stamp = message.time_boot_ms
    link.mav.set_attitude_target_send(stamp, SYSTEM, 1, NO_RATES, attitude, 0, 0, 0, throttle)
link.mav.set_mode_send(SYSTEM, CUSTOM_MODE, LOITER)
