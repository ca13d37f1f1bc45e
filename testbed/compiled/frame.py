"""The part of JSBSim's frame that all aircraft share, as scalar equations.

A frame runs Propagate, Inertial, Atmosphere, Winds, Systems, MassBalance, Auxiliary, Propulsion,
Aerodynamics, Aircraft and Accelerations, in this order. Systems, Propulsion and Aerodynamics come
from the aircraft's files (`translate`); the others are here.

Results equal JSBSim's to the bit, so the order of operations matters: sums and products are
evaluated as they are written, from left to right.

Frames: I, inertial, with its origin in the centre of the Earth; E, earth-centred and earth-fixed;
L, local north-east-down on the ellipsoid; B, body forward-right-down. T_IB takes a vector resolved
in B to I. Units are JSBSim's: ft, s, rad, slug, lb, degrees Rankine.
"""

from __future__ import annotations

from math import asin, atan, atan2, copysign, cos, exp, pi, pow, sin, sqrt

from testbed.core.compile import jitable, kernel
from testbed.core.records import Values, Vector

# WGS 84, as in vehicle/earth.xml
SEMI_MAJOR, SEMI_MINOR = 20925646.32546, 20855486.5951  # ft
EARTH_RATE = 0.00007292115  # rad/s
GM, J2 = 14.0764417572e15, 1.08262982e-03  # ft³/s², -
_AXES_RATIO = SEMI_MINOR / SEMI_MAJOR
_AXES_RATIO_2 = _AXES_RATIO * _AXES_RATIO
_ECCENTRICITY_2 = 1.0 - _AXES_RATIO_2
_FOCUS = SEMI_MAJOR * _ECCENTRICITY_2
_SEA_LEVEL = SEMI_MAJOR * _AXES_RATIO  # the semi-minor axis, as rounded by JSBSim
_GRAVITY_J2 = 1.5 * J2

# US standard atmosphere 1976
_FOOT, _SLUG, _RANKINE = 0.3048, 0.06852168, 1.8  # m; slug per kg; degrees Rankine per kelvin
_R_STAR = 8.31432 * _SLUG / (_RANKINE * (_FOOT * _FOOT))  # of a mole
_MOLAR_MASS = 28.9645 * _SLUG / 1000.0
GAS_CONSTANT = _R_STAR / _MOLAR_MASS  # ft lb / (slug degree Rankine), of dry air
_HEAT_RATIO = 1.4
_EARTH_RADIUS = 6356766.0 / _FOOT  # of geopotential altitudes
_TROPOPAUSE = 36089.2388  # ft, geopotential, as all heights here
CEILING = 65616.7979  # 20 km, the end of the layer of constant temperature
T_SEA, _T_TROPOPAUSE = 518.67, 389.97
P_SEA = 2116.228  # lb/ft²
RHO_SEA = P_SEA / (GAS_CONSTANT * T_SEA)
_LAPSE = (_T_TROPOPAUSE - T_SEA) / (_TROPOPAUSE - 0.0)  # degrees Rankine per ft
_GRAVITY = 9.80665 / _FOOT  # ft/s²
_EXPONENT = _GRAVITY / (GAS_CONSTANT * _LAPSE)

DEGREES = 180.0 / pi
KNOTS = 3600.0 * _FOOT / 1852.0  # of a ft/s
_NO_FLOW = 0.001  # ft/s, of the airspeed below which flow angles are zero
_UNIT_TOLERANCE = 1e-10  # of the length of a quaternion


# Vectors (3,) and matrices (3 rows of 3) are tuples.


@kernel
def add(a: Vector, b: Vector) -> Values:
    """Return a + b."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel
def scale(factor: float, v: Vector) -> Values:
    """Return a vector times a number."""
    return factor * v[0], factor * v[1], factor * v[2]


@kernel
def cross(a: Vector, b: Vector) -> Values:
    """Return a × b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@kernel
def dot(a: Vector, b: Vector) -> float:
    """Return a · b."""
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product


@kernel
def rotate(m: Values, v: Vector) -> Values:
    """Return M v."""
    return dot(m[0], v), dot(m[1], v), dot(m[2], v)


@kernel
def rotate_back(m: Values, v: Vector) -> Values:
    """Return Mᵀ v."""
    return (
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    )


@kernel
def multiply_transposed(a: Values, b: Values) -> Values:
    """Return A Bᵀ."""
    return rotate(b, a[0]), rotate(b, a[1]), rotate(b, a[2])


# Integrators: the increment of a component over dt, from its newest derivatives.


@kernel
def euler(dt: float, now: float) -> float:
    """Return the increment of Euler's method."""
    return dt * now


@kernel
def adams_bashforth_2(dt: float, now: float, before: float) -> float:
    """Return the increment of the Adams-Bashforth method of second order."""
    return dt * (1.5 * now - 0.5 * before)


@kernel
def adams_bashforth_3(dt: float, now: float, before: float, earlier: float) -> float:
    """Return the increment of the Adams-Bashforth method of third order."""
    return 1.0 / 12.0 * dt * (23.0 * now - 16.0 * before + 5.0 * earlier)


# Propagate


@jitable  # also of placements, from Python
def attitude_rate(q: Values, rates: Vector) -> Values:
    """Return the derivative of the quaternion of the attitude, I to B.

    Args:
        q: quaternion, the scalar first.
        rates: p, q, r of the body in I, rad/s.
    """
    x, y, z = rates
    return (
        -0.5 * (q[1] * x + q[2] * y + q[3] * z),
        0.5 * (q[0] * x - q[3] * y + q[2] * z),
        0.5 * (q[3] * x + q[0] * y - q[1] * z),
        0.5 * (-q[2] * x + q[1] * y + q[0] * z),
    )


@kernel
def unit(q: Values) -> Values:
    """Scale a quaternion to length 1, unless it is so already."""
    length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    by = 1.0 if abs(length - 1.0) < _UNIT_TOLERANCE else 1.0 / length
    return q[0] * by, q[1] * by, q[2] * by, q[3] * by


@kernel
def matrix_of(q: Values) -> Values:
    """Return T_BI of a quaternion, I to B."""
    q00, q11, q22, q33 = q[0] * q[0], q[1] * q[1], q[2] * q[2], q[3] * q[3]
    q01, q02, q03 = q[0] * q[1], q[0] * q[2], q[0] * q[3]
    q12, q13, q23 = q[1] * q[2], q[1] * q[3], q[2] * q[3]
    return (
        (q00 + q11 - q22 - q33, 2.0 * (q12 + q03), 2.0 * (q13 - q02)),
        (2.0 * (q12 - q03), q00 - q11 + q22 - q33, 2.0 * (q23 + q01)),
        (2.0 * (q13 + q02), 2.0 * (q23 - q01), q00 - q11 - q22 + q33),
    )


@kernel
def quaternion_of(m: Values) -> Values:
    """Return the quaternion of a rotation matrix, from its largest component."""
    xx, yy, zz = m[0][0], m[1][1], m[2][2]
    t0, t1, t2, t3 = 1.0 + xx + yy + zz, 1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz
    x_minus, y_minus, z_minus = m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0]
    xy, xz, yz = m[0][1] + m[1][0], m[2][0] + m[0][2], m[1][2] + m[2][1]
    if t0 >= t1 and t0 >= t2 and t0 >= t3:
        q = 0.5 * sqrt(t0)
        return q, 0.25 * x_minus / q, 0.25 * y_minus / q, 0.25 * z_minus / q
    if t1 >= t2 and t1 >= t3:
        q = 0.5 * sqrt(t1)
        return 0.25 * x_minus / q, q, 0.25 * xy / q, 0.25 * xz / q
    if t2 >= t3:
        q = 0.5 * sqrt(t2)
        return 0.25 * y_minus / q, 0.25 * xy / q, q, 0.25 * yz / q
    q = 0.5 * sqrt(t3)
    return 0.25 * z_minus / q, 0.25 * xz / q, 0.25 * yz / q, q


@kernel
def earth_fixed(earth_angle: float, position: Vector) -> Values:
    """Return a position of I in E."""
    c, s = cos(earth_angle), sin(earth_angle)
    return position[0] * c + position[1] * s, position[0] * -s + position[1] * c, position[2]


@kernel
def reduced_latitude(position: Vector, horizontal: float) -> Values:
    """Return numbers proportional to sine and cosine of the geodetic latitude, and their length.

    One step of Fukushima's iteration (J. Geodesy 79, 2006), which is exact to rounding near the
    ground.

    Args:
        position: in E, ft.
        horizontal: its distance from the axis of the Earth, ft.
    """
    s0 = abs(position[2])
    zc, c0 = _AXES_RATIO * s0, _AXES_RATIO * horizontal
    a02 = c0 * c0 + s0 * s0
    a0 = sqrt(a02)
    a03 = a02 * a0
    s1 = zc * a03 + _FOCUS * (s0 * s0) * s0
    c1 = horizontal * a03 - _FOCUS * (c0 * c0) * c0
    cs0 = _FOCUS * c0 * s0
    b0 = 1.5 * cs0 * ((horizontal * s0 - zc * c0) * a0 - cs0)
    s1 = s1 * a03 - b0 * s0
    cc = _AXES_RATIO * (c1 * a03 - b0 * c0)
    return s1, cc, sqrt(s1 * s1 + cc * cc)


@kernel
def local_axes(earth_angle: float, position: Vector) -> Values:
    """Return T_LI at a position in E."""
    horizontal = sqrt(position[0] * position[0] + position[1] * position[1])
    sin_lon, cos_lon = position[1] / horizontal, position[0] / horizontal
    s1, cc, length = reduced_latitude(position, horizontal)
    cos_lat = cc / length
    sin_lat = (s1 if position[2] >= 0.0 else -s1) / length
    c, s = cos(earth_angle), sin(earth_angle)
    return (
        _turn_axis((-cos_lon * sin_lat, -sin_lon * sin_lat, cos_lat), c, s),
        _turn_axis((-sin_lon, cos_lon, 0.0), c, s),
        _turn_axis((-cos_lon * cos_lat, -sin_lon * cos_lat, -sin_lat), c, s),
    )


@kernel
def _turn_axis(v: Vector, c: float, s: float) -> Values:
    """Return a row vector of E in I."""
    return v[0] * c + v[1] * -s, v[0] * s + v[1] * c, v[2]


@kernel
def earth_velocity(position: Vector, velocity: Vector) -> Values:
    """Return the velocity over the rotating Earth, in I, ft/s."""
    x, y, z = velocity
    return x - -(EARTH_RATE * position[1]), y - EARTH_RATE * position[0], z


@kernel
def earth_rates(t_bi: Values) -> Values:
    """Return the angular velocity of the Earth in B, rad/s."""
    return EARTH_RATE * t_bi[0][2], EARTH_RATE * t_bi[1][2], EARTH_RATE * t_bi[2][2]


@kernel
def difference(a: Vector, b: Vector) -> Values:
    """Return a − b."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


# Inertial


@kernel
def radius_of(position: Vector) -> float:
    """Return the distance from the centre of the Earth, ft."""
    return sqrt(position[0] * position[0] + position[1] * position[1] + position[2] * position[2])


@kernel
def geocentric_latitude(position: Vector) -> float:
    """Return the geocentric latitude of a position in E, rad."""
    return atan2(position[2], sqrt(position[0] * position[0] + position[1] * position[1]))


@kernel
def gravity(position: Vector, radius: float, latitude: float) -> Values:
    """Return the gravitation of the ellipsoid with J2 at a position in E, ft/s²."""
    s = sin(latitude)
    ratio = SEMI_MAJOR / radius
    oblateness = _GRAVITY_J2 * ratio * ratio
    g = GM / (radius * radius)
    across = 1.0 + oblateness * (1.0 - 5.0 * (s * s))
    along = 1.0 + oblateness * (3.0 - 5.0 * (s * s))
    return (
        -g * (across * position[0] / radius),
        -g * (across * position[1] / radius),
        -g * (along * position[2] / radius),
    )


@kernel
def altitude_of(radius: float, latitude: float) -> float:
    """Return the height above the radius of the ellipsoid at this geocentric latitude, ft."""
    c = cos(latitude)
    return radius - _SEA_LEVEL / sqrt(1.0 - _ECCENTRICITY_2 * c * c)


# Atmosphere


@kernel
def geopotential(altitude: float) -> float:
    """Return the geopotential altitude, ft."""
    return altitude * _EARTH_RADIUS / (_EARTH_RADIUS + altitude)


@kernel
def temperature(height: float, offset: float) -> float:
    """Return the temperature at a geopotential altitude below CEILING, degrees Rankine."""
    if height > _TROPOPAUSE:
        return _T_TROPOPAUSE + offset
    if height > 0.0:
        return height / _TROPOPAUSE * (_T_TROPOPAUSE - T_SEA) + T_SEA + offset
    return T_SEA + height * _LAPSE + offset


@kernel
def pressure(height: float, offset: float) -> float:
    """Return the pressure at a geopotential altitude below CEILING, lb/ft²."""
    base = T_SEA + offset
    below = min(height, _TROPOPAUSE)
    p: float = P_SEA * pow(base / (base + _LAPSE * below), _EXPONENT)
    if height > _TROPOPAUSE:
        p *= exp(-_GRAVITY * (height - _TROPOPAUSE) / (GAS_CONSTANT * (_T_TROPOPAUSE + offset)))
    return p


@kernel
def sound_speed(t: float) -> float:
    """Return the speed of sound at a temperature, ft/s."""
    return sqrt(_HEAT_RATIO * GAS_CONSTANT * t)


# Auxiliary


@kernel
def square_of(v: Vector) -> float:
    """Return the square of the airspeed of a velocity through the air in B, ft²/s²."""
    square: float = v[0] * v[0] + v[2] * v[2] + v[1] * v[1]
    return square


@kernel
def flow(v: Vector, vt: float, acceleration: Vector) -> Values:
    """Return angle of attack and sideslip, rad, and their rates, rad/s.

    Args:
        v: velocity through the air in B, ft/s.
        vt: airspeed, ft/s.
        acceleration: derivatives of u, v, w of the frame before, ft/s².
    """
    alpha, beta, alpha_dot, beta_dot = 0.0, 0.0, 0.0, 0.0
    if vt > _NO_FLOW:
        ahead_2 = v[0] * v[0] + v[2] * v[2]
        ahead = sqrt(ahead_2)
        beta = atan2(v[1], ahead)
        if ahead_2 >= 1e-6:
            alpha = atan2(v[2], v[0])
            vt_dot = dot(v, acceleration) / vt
            alpha_dot = (v[0] * acceleration[2] - v[2] * acceleration[0]) / ahead_2
            beta_dot = (acceleration[1] * vt - v[1] * vt_dot) / (vt * ahead)
    return alpha, beta, alpha_dot, beta_dot


@kernel
def hypot_of(v: Vector) -> float:
    """Return the horizontal part of a velocity in L, ft/s."""
    return sqrt(v[0] * v[0] + v[1] * v[1])


@kernel
def path_angle(v: Vector) -> float:
    """Return the flight-path angle of a velocity in L, rad."""
    return atan2(-v[2], hypot_of(v))


@kernel
def wind_axes(alpha: float, beta: float) -> Values:
    """Return T_BW, of the wind axes."""
    ca, sa, cb, sb = cos(alpha), sin(alpha), cos(beta), sin(beta)
    return (ca * cb, -ca * sb, -sa), (sb, cb, 0.0), (sa * cb, -sa * sb, ca)


# Propulsion


@kernel
def induced_velocity(inflow: float, thrust: float, rho: float, area: float) -> float:
    """Return the velocity that a propeller adds to the flow in its disk, ft/s, by momentum theory.

    Args:
        inflow: along the shaft, ft/s.
        thrust: lb.
        rho: density, slug/ft³.
        area: of the disk, ft².
    """
    square = inflow * abs(inflow) + 2.0 * thrust / (rho * area)
    if square > 0.0:
        return 0.5 * (-inflow + sqrt(square))
    return 0.5 * (-inflow - sqrt(-square))


@kernel
def shift_thrust(point: Vector, flow_at: Vector, through: float, factor: float) -> Values:
    """Return where the thrust acts of a propeller in oblique flow, inches, structural frame.

    It moves across the flow, by a factor times the angle between shaft and flow.

    Args:
        point: of the propeller.
        flow_at: velocity of the propeller through the air, in B, ft/s.
        through: velocity of the flow along the shaft in the disk, ft/s.
        factor: inches per rad, with the sign of the turn.
    """
    across = sqrt(flow_at[1] * flow_at[1] + flow_at[2] * flow_at[2])
    if not across > 0.0001:
        return point[0], point[1], point[2]
    by = factor * atan2(across, through) / across
    return point[0], point[1] + by * flow_at[2], point[2] + by * flow_at[1]


# MassBalance


@kernel
def arm(cg: Vector, point: Vector) -> Values:
    """Return the vector from the centre of gravity to a point of the structural frame, in B, ft.

    Args:
        cg: x aft, y right, z up, inches.
        point: the same.
    """
    inch = 1.0 / 12.0
    return inch * (cg[0] - point[0]), inch * (point[1] - cg[1]), inch * (cg[2] - point[2])


@kernel
def inverse_inertia(j: Values) -> Values:
    """Return the inverse of a symmetric inertia tensor, 1/(slug ft²)."""
    xx, yy, zz = j[0][0], j[1][1], j[2][2]
    xy, xz, yz = -j[0][1], -j[0][2], -j[1][2]
    k1, k2, k3 = yy * zz - yz * yz, yz * xz + xy * zz, xy * yz + yy * xz
    by = 1.0 / (xx * k1 - xy * k2 - xz * k3)
    k1, k2, k3 = k1 * by, k2 * by, k3 * by
    k4, k5, k6 = (zz * xx - xz * xz) * by, (xy * xz + yz * xx) * by, (xx * yy - xy * xy) * by
    return (k1, k2, k3), (k2, k4, k5), (k3, k5, k6)


# Accelerations


@kernel
def rate_derivatives(j: Values, moment: Vector, rates: Vector) -> Values:
    """Return the derivatives of the rates of B in I: J⁻¹ (M − ω × J ω), rad/s²."""
    return rotate(inverse_inertia(j), difference(moment, cross(rates, rotate(j, rates))))


@kernel
def body_derivatives(
    specific: Vector,
    rates: Vector,
    earth: Vector,
    velocity: Vector,
    position: Vector,
    attraction: Vector,
    t_bi: Values,
    earth_angle: float,
) -> Values:
    """Return the derivatives of u, v, w over the rotating Earth, ft/s².

    Args:
        specific: force by mass in B, ft/s².
        rates: p, q, r relative to the Earth, rad/s.
        earth: angular velocity of the Earth in B, rad/s.
        velocity: u, v, w, ft/s.
        position: in I, ft.
        attraction: gravitation in E, ft/s².
        t_bi: T_BI.
        earth_angle: from I to E, rad.
    """
    turn = (
        rates[0] + 2.0 * earth[0],
        rates[1] + 2.0 * earth[1],
        rates[2] + 2.0 * earth[2],
    )
    inertial = difference(specific, cross(turn, velocity))
    centripetal = (
        -(EARTH_RATE * (EARTH_RATE * position[0])),
        EARTH_RATE * -(EARTH_RATE * position[1]),
        0.0,
    )
    c, s = cos(earth_angle), sin(earth_angle)
    t_be = _earth_row(t_bi[0], c, s), _earth_row(t_bi[1], c, s), _earth_row(t_bi[2], c, s)
    return add(difference(inertial, rotate(t_bi, centripetal)), rotate(t_be, attraction))


@kernel
def _earth_row(v: Vector, c: float, s: float) -> Values:
    """Return a row vector of I in E."""
    return v[0] * c + v[1] * s, v[0] * -s + v[1] * c, v[2]


@kernel
def inertial_derivatives(
    specific: Vector, attraction: Vector, t_bi: Values, earth_angle: float
) -> Values:
    """Return the acceleration in I, ft/s²; arguments as in `body_derivatives`."""
    c, s = cos(earth_angle), sin(earth_angle)
    x, y, z = attraction
    return add(rotate_back(t_bi, specific), (x * c + y * -s, x * s + y * c, z))


# What JSBSim's properties show of a state


@kernel
def geodetic(position: Vector) -> Values:
    """Return geodetic latitude and longitude, rad, and height above the ellipsoid, ft, in E."""
    horizontal = sqrt(position[0] * position[0] + position[1] * position[1])
    s1, cc, length = reduced_latitude(position, horizontal)
    latitude = atan(s1 / cc)
    across = sqrt(_AXES_RATIO_2 * (s1 * s1) + cc * cc)
    height = (horizontal * cc + abs(position[2]) * s1 - SEMI_MAJOR * across) / length
    return (
        latitude if position[2] >= 0.0 else -latitude,
        atan2(position[1], position[0]),
        height,
    )


@kernel
def euler_angles(t_bl: Values) -> Values:
    """Return roll, pitch and yaw (0 to 2π), rad; JSBSim finds them by way of a quaternion."""
    m = matrix_of(quaternion_of(t_bl))
    if not abs(m[0][2]) < 1.0:  # vertical: the heading is in the roll
        return atan2(-m[2][1], m[1][1]), copysign(0.5 * pi, -m[0][2]), 0.0
    pitch = asin(-m[0][2])
    yaw = atan2(m[0][1], m[0][0])
    return atan2(m[1][2], m[2][2]), pitch, yaw + 2.0 * pi if yaw < 0.0 else yaw


@kernel
def equivalent_airspeed(qbar: float) -> float:
    """Return the equivalent airspeed of a dynamic pressure, ft/s."""
    return sqrt(2.0 * qbar / RHO_SEA)
