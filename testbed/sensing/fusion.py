"""One step of navigation filters: errors drift on, and what is measured is taken in.

One after the other: velocity and position of the GPS, height, heading, airspeed, slip. What lies
beyond its gate is refused; a velocity, position or height of which none was taken for too long is
believed after all.
"""

from __future__ import annotations

import math

import numpy as np

from testbed.frames import GRAVITY, rotation_ned_body
from testbed.sensing.errors import (
    BARO_NOISE,
    BARO_OWN,
    BARO_SHARED,
    FORCE_BIAS,
    FORCE_NOISE,
    GPS_NOISE,
    GPS_OWN,
    GPS_SHARED,
    GPS_VELOCITY,
    GYRO_BIAS,
    GYRO_NOISE,
    HEADING_NOISE,
)
from testbed.sensing.navigation import (
    POSITION,
    SLIP_VARIANCE,
    SLOWEST_AIR,
    SMOOTHING_S,
    STATES,
    TILT,
    VELOCITY,
    WIND,
    Counts,
    Memory,
    Rows,
    Sensed,
    Settings,
    cross,
    drift,
    fuse,
    restart,
    spread,
)
from testbed.state import Array, Truths, VehicleState

# First state and number of states of what is measured together: velocity, horizontal position,
# height.
_AXES = ((3, 3), (6, 2), (8, 1))
HEIGHTS = 2
_DOWN = np.array([0.0, 0.0, GRAVITY])


def navigate(
    memory: Memory, settings: Settings, step: int, truth: VehicleState, sensed: Sensed
) -> Array:
    """One step of M filters, in place.

    Args:
        memory: of the filters; changed.
        settings: theirs.
        step: number of the step.
        truth: of M aircraft.
        sensed: what is wrong in what they sense.

    Returns:
        Errors (M, 9) of attitude, velocity and position as they are flown on.
    """
    states, errors = memory.states, sensed.errors
    rotation = rotation_ned_body(truth.euler)
    force = truth.acceleration_ned - _DOWN
    dt = 1.0 / settings.rate_hz
    drift(
        states,
        rotation,
        force,
        errors[:, GYRO_BIAS] + errors[:, GYRO_NOISE],
        errors[:, FORCE_BIAS] + errors[:, FORCE_NOISE],
        dt,
    )
    # corrections reach what is flown on bit by bit
    residual = memory.residual
    residual *= math.exp(-dt / SMOOTHING_S)
    now = step % len(memory.motions)
    memory.motions[now, :, :3], memory.motions[now, :, 3:] = truth.position_ned, truth.velocity_ned
    memory.errors[now] = states[:, 3:9]

    gps = due(settings.gps_hz, step, settings.rate_hz) & ~sensed.gps_lost
    height = due(settings.barometer_hz, step, settings.rate_hz) & ~settings.gps_height
    heading = due(settings.compass_hz, step, settings.rate_hz)
    any_of_them = gps | height | heading | sensed.airspeed_new
    if any_of_them.any():
        before = states[:, :9].copy()
        rows = np.flatnonzero(any_of_them)
        since = dt * (step - memory.spread_at[rows]).astype(np.float64)
        memory.covariance[rows] = spread(
            memory.covariance[rows], rotation[rows], force[rows], settings.process[rows], since
        )
        memory.spread_at[rows] = step
        _take_fix(memory, settings, step, np.flatnonzero(gps), sensed)
        _take_height(memory, settings, step, np.flatnonzero(height), sensed)
        _take_heading(memory, settings, np.flatnonzero(heading), truth, sensed)
        rows = np.flatnonzero(sensed.airspeed_new)
        _take_airspeed(memory, settings, rows, truth, sensed)
        _take_slip(memory, rows, truth, rotation)
        change = states[:, :9] - before
        residual -= change
        memory.errors[:] += change[:, 3:]
    flown: Array = states[:, :9] + residual
    return flown


def aligned(settings: Settings, errors: Array, heading: Array, wind: Array) -> Array:
    """States (M, STATES) of filters that begin with what their sensors say, in a known wind (M, 2).

    Args:
        settings: of the filters.
        errors: (M, COLUMNS) of the sensors.
        heading: (M,) rad, constant error of the compass.
        wind: (M, 2) m/s
    """
    states = np.zeros((len(errors), STATES))
    states[:, TILT.stop - 1] = heading + errors[:, HEADING_NOISE]
    states[:, VELOCITY] = errors[:, GPS_VELOCITY]
    states[:, POSITION] = errors[:, GPS_SHARED] + errors[:, GPS_OWN] + errors[:, GPS_NOISE]
    barometer = errors[:, BARO_SHARED] + errors[:, BARO_OWN] + errors[:, BARO_NOISE]
    height = POSITION.stop - 1
    states[:, height] = np.where(settings.gps_height, states[:, height], barometer)
    states[:, WIND] = wind
    return states


def due(rate_hz: Counts, step: int, steps_hz: int) -> Truths:
    """Which sensors (M,) measure at this step, one of `steps_hz` in a second."""
    measuring: Truths = (step * rate_hz) % steps_hz < rate_hz
    return measuring


def _take_fix(memory: Memory, settings: Settings, step: int, rows: Rows, sensed: Sensed) -> None:
    """GPS velocity, horizontal position, and height where it is wanted, each if it passes."""
    length, errors = len(memory.motions), sensed.errors[rows]
    assumed = (step - settings.assumed[rows]) % length
    real = (step - settings.latency[rows]) % length
    # Of the moment that the filter takes the fix for: its error then, and how far the aircraft had
    # come since the moment of the fix.
    come = memory.motions[assumed, rows] - memory.motions[real, rows]
    expected = memory.errors[assumed, rows] + come[:, [3, 4, 5, 0, 1, 2]]
    expected[:, :3] -= errors[:, GPS_VELOCITY]
    expected[:, 3:] -= errors[:, GPS_SHARED] + errors[:, GPS_OWN] + errors[:, GPS_NOISE]
    expected[:, 3:] -= sensed.gps_jump[rows]
    expected -= memory.states[rows, 3:9]  # what is corrected meanwhile comes on top
    for kind, (first, axes) in enumerate(_AXES):
        wanted = settings.gps_height[rows] if kind == HEIGHTS else np.ones(len(rows), dtype=bool)
        off = expected[wanted, first - 3 : first - 3 + axes]
        _take_axes(memory, settings, step, rows[wanted], kind, off)


def _take_height(memory: Memory, settings: Settings, step: int, rows: Rows, sensed: Sensed) -> None:
    """The barometer's height."""
    errors = sensed.errors[rows]
    wrong = errors[:, BARO_SHARED] + errors[:, BARO_OWN] + errors[:, BARO_NOISE]
    _take_axes(memory, settings, step, rows, HEIGHTS, -wrong[:, np.newaxis])


def _take_axes(
    memory: Memory, settings: Settings, step: int, rows: Rows, kind: int, off: Array
) -> None:
    """States that are measured together, if they pass their gate, or in place of what was believed.

    Args:
        memory: of all.
        settings: of all.
        step: number of the step.
        rows: (m,)
        kind: of the measurement.
        off: (m, k) innovations, less the states as they are now.
    """
    first, axes = _AXES[kind]
    columns = slice(first, first + axes)
    noise = np.concatenate([settings.velocity_noise, settings.position_noise], axis=1)
    variance = noise[rows, first - 3 : first - 3 + axes] ** 2
    innovation = off + memory.states[rows, columns]
    each = np.arange(first, first + axes)
    total = memory.covariance[rows][:, each, each] + variance
    limit = settings.gate[rows] ** 2 * total.sum(axis=1)
    patience = settings.reset_after_s[rows] * settings.rate_hz
    again = step - memory.accepted[kind, rows] > patience
    good = ~again & ((innovation**2).sum(axis=1) <= limit)
    memory.accepted[kind, rows[good | again]] = step
    restart(memory, rows[again], columns, -innovation[again], variance[again])
    memory.residual[rows[again], columns] -= innovation[again]  # flown on at once
    taken = rows[good]
    for axis in range(axes):
        slope = np.zeros((len(taken), STATES))
        slope[:, first + axis] = 1.0
        now = off[good, axis] + memory.states[taken, first + axis]
        fuse(memory, taken, slope, now, variance[good, axis])


def _take_heading(
    memory: Memory, settings: Settings, rows: Rows, truth: VehicleState, sensed: Sensed
) -> None:
    """The compass's yaw, to which errors of tilt add where the nose is up."""
    _, pitch, yaw = truth.euler[rows].T
    slope = np.zeros((len(rows), STATES))
    slope[:, TILT] = np.stack(
        [np.tan(pitch) * np.cos(yaw), np.tan(pitch) * np.sin(yaw), np.ones(len(rows))], axis=1
    )
    wrong = sensed.heading[rows] + sensed.errors[rows, HEADING_NOISE]
    innovation = (slope * memory.states[rows]).sum(axis=1) - wrong
    variance = settings.heading_noise[rows] ** 2
    _take(memory, rows, slope, innovation, variance, settings.gate[rows])


def _take(
    memory: Memory, rows: Rows, slope: Array, innovation: Array, variance: Array, gate: Array
) -> None:
    """One number for each of the filters, unless it is beyond the gate; as `fuse`."""
    along = (memory.covariance[rows] @ slope[:, :, np.newaxis])[:, :, 0]
    good = innovation**2 <= gate**2 * ((along * slope).sum(axis=1) + variance)
    fuse(memory, rows[good], slope[good], innovation[good], variance[good])


def _take_airspeed(
    memory: Memory, settings: Settings, rows: Rows, truth: VehicleState, sensed: Sensed
) -> None:
    """True airspeed, which is the length of velocity less wind."""
    air = _through_air(memory, rows, truth)
    speed = np.sqrt((air * air).sum(axis=1))
    ahead = air / np.maximum(speed, SLOWEST_AIR)[:, np.newaxis]
    slope = np.zeros((len(rows), STATES))
    slope[:, VELOCITY], slope[:, WIND] = ahead, -ahead[:, :2]
    tas, eas = sensed.airspeed[rows], sensed.equivalent_airspeed[rows]
    variance = (settings.airspeed_noise[rows] * tas / eas) ** 2
    fast = speed > SLOWEST_AIR
    gate = settings.airspeed_gate[rows]
    _take(memory, rows[fast], slope[fast], (speed - tas)[fast], variance[fast], gate[fast])


def _take_slip(memory: Memory, rows: Rows, truth: VehicleState, rotation: Array) -> None:
    """That the air comes from ahead: its lateral share is taken to be measured, as zero."""
    air = _through_air(memory, rows, truth)
    tilt = memory.states[rows, TILT]
    nose, side = (axis + cross(tilt, axis) for axis in (rotation[rows, :, 0], rotation[rows, :, 1]))
    forward = (nose * air).sum(axis=1)
    fast = forward > SLOWEST_AIR
    scale = 1.0 / np.maximum(forward, SLOWEST_AIR)[:, np.newaxis]
    slope = np.zeros((len(rows), STATES))
    slope[:, VELOCITY], slope[:, WIND] = side * scale, -side[:, :2] * scale
    slope[:, TILT] = cross(side, air) * scale
    slip = (side * air).sum(axis=1) * scale[:, 0]
    variance = np.full(len(rows), SLIP_VARIANCE)
    fuse(memory, rows[fast], slope[fast], slip[fast], variance[fast])


def _through_air(memory: Memory, rows: Rows, truth: VehicleState) -> Array:
    """Velocities (m, 3) through the air as the filters believe them."""
    air: Array = truth.velocity_ned[rows] + memory.states[rows, VELOCITY]
    air[:, :2] -= memory.states[rows, WIND]
    return air
