"""Lateral guidance along a line or a circle.

The nonlinear guidance law of S. Park, J. Deyst and J. P. How, "A new nonlinear guidance logic for
trajectory tracking", AIAA 2004-4900, in the form of ArduPlane's L1 controller (parameters
NAVL1_PERIOD and NAVL1_DAMPING; B. Hilton, P. Riseborough). With the look-ahead distance

    L1 = ζ T V / π

the lateral acceleration is 4 ζ² V²/L1 sin η, where η is the angle from the ground velocity to the
point on the path at that distance. For small errors from a line this is a second-order system with
period T and damping ζ.

Everything is horizontal and relative to the ground: (north, east) in m and m/s; further components
are ignored. Lateral acceleration and angles are positive to the right. The functions are for one
aircraft; the kernels of `mission_follower` call them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from testbed.core.compile import jitable
from testbed.core.frames import GRAVITY

CAPTURE_SINE = math.sqrt(0.5)  # of the largest angle to the line, 45°
MIN_SPEED = 0.1  # m/s, below which the ground course is undefined


@jitable
def look_ahead(speed: float, period: float, damping: float) -> float:
    """Return the look-ahead distance L1 = ζ T V / π, m."""
    return damping * period * max(speed, MIN_SPEED) / math.pi


@jitable
def track_coordinates(
    position: Sequence[float], start: Sequence[float], end: Sequence[float]
) -> tuple[float, float, float]:
    """Return distances along and right of the track start → end, and its length; m.

    A track of length zero points north.
    """
    north, east = end[0] - start[0], end[1] - start[1]
    length = math.hypot(north, east)
    north, east = (north / length, east / length) if length > 0.0 else (1.0, 0.0)
    dn, de = position[0] - start[0], position[1] - start[1]
    return dn * north + de * east, de * north - dn * east, length


@jitable
def line_acceleration(
    position: Sequence[float],
    velocity: Sequence[float],
    start: Sequence[float],
    end: Sequence[float],
    period: float,
    damping: float,
) -> float:
    """Return the lateral acceleration (m/s²) that captures and follows a line.

    Far behind `start` the aircraft heads for the start, and 3 s past `end` it heads back for the
    end; between, it approaches the line at 45° or less. ArduPlane also stores the direction of its
    last turn while it flies directly away from its target; here only the velocity determines it.
    """
    speed = max(math.hypot(velocity[0], velocity[1]), MIN_SPEED)
    ahead = look_ahead(speed, period=period, damping=damping)
    along, right, length = track_coordinates(position, start, end)
    if math.hypot(along, right) > ahead and along < -CAPTURE_SINE * math.hypot(along, right):
        eta = _angle_to(velocity, start[0] - position[0], start[1] - position[1])
    elif along > length + 3.0 * speed:
        eta = _angle_to(velocity, end[0] - position[0], end[1] - position[1])
    else:
        sine = min(max(-right / ahead, -CAPTURE_SINE), CAPTURE_SINE)
        eta = math.asin(sine) + _angle_to(velocity, end[0] - start[0], end[1] - start[1])
    return _acceleration(eta, speed, ahead, damping)


@jitable
def circle_acceleration(
    position: Sequence[float],
    velocity: Sequence[float],
    centre: Sequence[float],
    radius: float,
    clockwise: bool,
    period: float,
    damping: float,
) -> tuple[float, bool]:
    """Return the lateral acceleration (m/s²) that captures and follows a circle, and if captured.

    On the circle it is V_t²/r towards the centre plus (2π/T)² and 2ζ(2π/T) times the radial error
    and its rate, so that the radial error has period T and damping ζ as well. From outside the
    aircraft heads for the centre until following the circle needs the tighter turn.
    """
    side = 1.0 if clockwise else -1.0
    speed = max(math.hypot(velocity[0], velocity[1]), MIN_SPEED)
    ahead = look_ahead(speed, period=period, damping=damping)
    inward_n, inward_e = centre[0] - position[0], centre[1] - position[1]
    distance = math.hypot(inward_n, inward_e)
    eta = _angle_to(velocity, inward_n, inward_e)
    to_centre = _acceleration(eta, speed, ahead, damping)

    outward = -speed * math.cos(eta)  # radial speed
    around = side * speed * math.sin(eta)  # tangential speed, positive along the circle
    omega = 2.0 * math.pi / period
    correction = omega**2 * (distance - radius) + 2.0 * damping * omega * outward
    if outward > 0.0 and around < 0.0:  # leaving against its direction: do not turn outwards
        correction = max(correction, 0.0)
    on_circle = side * (correction + around**2 / max(0.5 * radius, distance))
    if distance > radius and side * to_centre < side * on_circle:
        return to_centre, False
    return on_circle, True


@jitable
def turn_distance(
    speed: float, turn: float, waypoint_radius: float, period: float, damping: float
) -> float:
    """Return the distance before a waypoint at which its turn begins, m.

    It is the look-ahead distance, at most `waypoint_radius`, scaled down for turns below 90°.
    """
    ahead = min(waypoint_radius, look_ahead(speed, period=period, damping=damping))
    return ahead * min(1.0, abs(turn) / (0.5 * math.pi))


@jitable
def roll_command(acceleration: float, bank_limit: float) -> float:
    """Return the roll (rad) of a coordinated turn with a lateral acceleration, limited."""
    return min(max(math.atan(acceleration / GRAVITY), -bank_limit), bank_limit)


@jitable
def _angle_to(velocity: Sequence[float], north: float, east: float) -> float:
    """Return the angle (rad) from the velocity to a direction, positive clockwise from above."""
    return math.atan2(
        velocity[0] * east - velocity[1] * north, velocity[0] * north + velocity[1] * east
    )


@jitable
def _acceleration(eta: float, speed: float, ahead: float, damping: float) -> float:
    eta = min(max(eta, -0.5 * math.pi), 0.5 * math.pi)
    return 4.0 * damping**2 * speed**2 / ahead * math.sin(eta)
