"""Own state and command of a companion computer, as the MAVLink messages that carry them.

A companion computer reads GLOBAL_POSITION_INT, LOCAL_POSITION_NED, ATTITUDE, VFR_HUD and SCALED_IMU
of its autopilot, and commands it by SET_ATTITUDE_TARGET
(https://mavlink.io/en/messages/common.html). The functions here write the fields of these messages
to the digit, and read them. A flight whose states and commands pass through them, and a companion
in a process of its own, call the same functions, so that both compute the same numbers.

Of LOCAL_POSITION_NED only the velocity is used: its position counts from the origin of the
autopilot's own navigation filter, which differs among aircraft. Positions are those of
GLOBAL_POSITION_INT, converted to the origin of the scenario.
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.frames import GRAVITY, angles_from_quaternion, rotation_rows, specific_force
from testbed.core.geodetic import E7, LocalFrame, to_geodetic, to_ned, wrap_longitude
from testbed.core.records import Array, Indices, Record, Records, Values, Vector
from testbed.core.standard_atmosphere import density_ratio

# Sources of the own acceleration, which no MAVLink message has.
VELOCITY, IMU = 0, 1
MILLI_G = 1e-3 * GRAVITY  # m/s²
MAX_GAP_S = 0.5  # between samples, above which their difference gives no acceleration
_MAX = 1e18  # larger magnitudes are clamped, as in telemetry
_I16, _I32, _U32 = (1 << 15) - 1, (1 << 31) - 1, (1 << 32) - 1
_TAU = 2.0 * pi

# Fields of the five messages that a companion computer reads, all of one sample.
OWN_STATE = np.dtype(
    [
        ("time_boot_ms", "u4"),
        ("lat", "i4"),  # 1e-7 deg
        ("lon", "i4"),  # 1e-7 deg
        ("alt", "i4"),  # mm above sea level
        ("velocity_ned", "f4", (3,)),  # vx, vy, vz, m/s
        ("euler", "f4", (3,)),  # roll, pitch, yaw, rad
        ("rates_body", "f4", (3,)),  # rollspeed, pitchspeed, yawspeed, rad/s
        ("airspeed", "f4"),  # equivalent, m/s
        ("specific_force", "i2", (3,)),  # xacc, yacc, zacc, mG; body axes
        ("received", "?"),  # whether there is a sample
    ],
    align=True,
)
# Fields of SET_ATTITUDE_TARGET.
ATTITUDE_TARGET = np.dtype([("q", "f4", (4,)), ("thrust", "f4")], align=True)  # q is w, x, y, z


class AttitudeLimits(NamedTuple):
    """Limits (N,) of the angles that autopilots take from an attitude target, rad."""

    roll: Array
    pitch_max: Array
    pitch_min: Array


@entry
def encode_own_states(aircraft: Records, frame: LocalFrame, messages: Records, now: float) -> None:
    """Write the messages of all autopilots, of their estimates.

    Args:
        aircraft: (N,) of AIRCRAFT.
        frame: local frame of the scenario's origin, in degrees.
        messages: (N,) of OWN_STATE; written.
        now: s since the autopilots were switched on.
    """
    for i in range(len(aircraft)):
        encode_own_state(aircraft[i].estimate, frame, messages[i], now)


@entry
def decode_own_states(
    rows: Indices,
    messages: Records,
    before: Records,
    frame: LocalFrame,
    source: int,
    received: Records,
) -> None:
    """Write the own states that companions know, as `estimate` of `received`.

    Args:
        rows: (M,) of the aircraft.
        messages: (N,) of OWN_STATE, the newest.
        before: (N,) of OWN_STATE, of the call before; written.
        frame: local frame of the scenario's origin, in degrees.
        source: of the acceleration, VELOCITY or IMU.
        received: (N,) of AIRCRAFT; written.
    """
    for i in rows:
        decode_own_state(messages[i], before[i], frame, source, received[i].estimate)


@entry
def encode_attitude_targets(rows: Indices, aircraft: Records, targets: Records) -> None:
    """Write `control` of the aircraft in these rows (M,) as attitude targets (N,)."""
    for i in rows:
        encode_attitude_target(aircraft[i].control, targets[i])


@kernel
def encode_own_state(estimate: Record, frame: LocalFrame, message: Record, now: float) -> None:
    """Write the fields of one autopilot's messages; see `encode_own_states`."""
    message.time_boot_ms = np.int64(np.rint(now * 1e3)) & _U32
    north, east, down = estimate.position_ned
    latitude, longitude, height = to_geodetic(frame, north, east, down)
    message.lat = _whole(_finite(latitude) * 1e7, _I32)
    message.lon = _whole(wrap_longitude(np.rint(_finite(longitude) * 1e7), E7), _I32)
    message.alt = _whole(_finite(height) * 1e3, _I32)
    for axis in range(3):
        message.velocity_ned[axis] = _finite(estimate.velocity_ned[axis])
        message.euler[axis] = _finite(estimate.euler[axis])
        message.rates_body[axis] = _finite(estimate.rates_body[axis])
    message.euler[2] = _signed(_finite(estimate.euler[2]))
    message.airspeed = _finite(estimate.equivalent_airspeed)
    force = specific_force(_finite3(estimate.euler), _finite3(estimate.acceleration_ned))
    for axis in range(3):
        message.specific_force[axis] = _whole(force[axis] / MILLI_G, _I16)
    message.received = True


@kernel
def decode_own_state(
    message: Record, before: Record, frame: LocalFrame, source: int, own: Record
) -> None:
    """Write the own state of one aircraft; see `decode_own_states`.

    The true airspeed follows from the equivalent one in the standard atmosphere. A sample that is
    repeated changes nothing.

    Args:
        message: of OWN_STATE.
        before: of OWN_STATE, of the call before; written.
        frame: local frame of the scenario's origin, in degrees.
        source: of the acceleration: VELOCITY takes the difference of the velocities of two samples,
            0 for the first and after a gap of more than MAX_GAP_S; IMU the specific force, turned
            by the attitude, and gravity.
        own: of MOTION; written.
    """
    latitude, longitude = message.lat / 1e7, message.lon / 1e7
    height = message.alt / 1e3
    north, east, down = to_ned(frame, latitude, longitude, height)
    own.position_ned[0], own.position_ned[1], own.position_ned[2] = north, east, down
    for axis in range(3):
        own.velocity_ned[axis] = message.velocity_ned[axis]
        own.euler[axis] = message.euler[axis]
        own.rates_body[axis] = message.rates_body[axis]
    own.equivalent_airspeed = message.airspeed
    own.airspeed = own.equivalent_airspeed / sqrt(density_ratio(height))
    if source == IMU:
        rows = rotation_rows(own.euler)
        for axis in range(3):
            own.acceleration_ned[axis] = GRAVITY if axis == 2 else 0.0
            for k in range(3):
                own.acceleration_ned[axis] += rows[axis][k] * (MILLI_G * message.specific_force[k])
    else:
        _difference(message, before, own)
    _copy_sample(message, before)


@kernel
def _difference(message: Record, before: Record, own: Record) -> None:
    """Write the acceleration of two samples, m/s²; unchanged if both are of one time."""
    elapsed_ms = (np.int64(message.time_boot_ms) - np.int64(before.time_boot_ms)) & _U32
    if not before.received or elapsed_ms > 1e3 * MAX_GAP_S:
        for axis in range(3):
            own.acceleration_ned[axis] = 0.0
    elif elapsed_ms > 0:
        for axis in range(3):
            step = own.velocity_ned[axis] - np.float64(before.velocity_ned[axis])
            own.acceleration_ned[axis] = step / (elapsed_ms / 1e3)


@kernel
def _copy_sample(message: Record, out: Record) -> None:
    """Copy what the acceleration of the next sample needs."""
    out.time_boot_ms, out.received = message.time_boot_ms, message.received
    for axis in range(3):
        out.velocity_ned[axis] = message.velocity_ned[axis]


@kernel
def encode_attitude_target(control: Record, target: Record) -> None:
    """Write a command as an attitude target, whose yaw is 0.

    Args:
        control: of COMMAND.
        target: of ATTITUDE_TARGET; written.
    """
    roll, pitch = 0.5 * control.roll, 0.5 * control.pitch
    target.q[0], target.q[1] = cos(roll) * cos(pitch), sin(roll) * cos(pitch)
    target.q[2], target.q[3] = cos(roll) * sin(pitch), -sin(roll) * sin(pitch)
    target.thrust = control.throttle


@kernel
def decode_attitude_target(target: Record, limits: AttitudeLimits, row: int) -> Values:
    """Return pitch and roll, rad, and throttle that an autopilot takes from an attitude target.

    Args:
        target: of ATTITUDE_TARGET, with a unit quaternion.
        limits: (N,) of the autopilots.
        row: of the autopilot.
    """
    w, x, y, z = target.q
    roll, pitch, _ = angles_from_quaternion(
        np.float64(x), np.float64(y), np.float64(z), np.float64(w)
    )
    return (
        min(max(pitch, limits.pitch_min[row]), limits.pitch_max[row]),
        min(max(roll, -limits.roll[row]), limits.roll[row]),
        min(max(np.float64(target.thrust), 0.0), 1.0),
    )


@kernel
def _finite(value: float) -> float:
    """Return a finite number: NaN becomes 0, the magnitude is clamped."""
    return 0.0 if np.isnan(value) else min(max(value, -_MAX), _MAX)


@kernel
def _finite3(values: Vector) -> Values:
    return _finite(values[0]), _finite(values[1]), _finite(values[2])


@kernel
def _whole(value: float, largest: int) -> int:
    """Round to an integer of a field, half to even, and clamp to its range."""
    return int(np.rint(min(max(value, -largest - 1.0), largest)))


@kernel
def _signed(angle: float) -> float:
    """Return an angle, rad, as one from −π to π, as exactly as `math.remainder`."""
    rest: float = np.fmod(angle, _TAU)
    if rest > pi:
        rest -= _TAU
    elif rest < -pi:
        rest += _TAU
    return rest
