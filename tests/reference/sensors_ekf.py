"""The navigation filters of M aircraft at once, with numpy: errors, covariance, gates and resets.

Settings are records of `testbed.sensors.ekf.SETTINGS`, errors those of `testbed.sensors.errors`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from reference.frames import rotation_ned_body
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, BoolArray, Records, VehicleState

Rows = NDArray[np.intp]
Steps = NDArray[np.int64]

TILT, VELOCITY, POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCELEROMETER_BIAS, WIND = slice(9, 12), slice(12, 15), slice(15, 17)
STATES = 17
OUTPUT_TIME_CONSTANT_S = 0.25
MIN_AIRSPEED = 1.0
INITIAL_SIGMA = np.repeat([0.05, 0.5, 1.0, 0.01, 0.2, 2.0], [3, 3, 3, 3, 3, 2])
# First and number of the states of velocity, horizontal position and height.
FUSED_TOGETHER = ((3, 3), (6, 2), (8, 1))
HEIGHT = 2
_DOWN = np.array([0.0, 0.0, GRAVITY])


class Memory(NamedTuple):
    """What M filters keep between two steps, changed in place."""

    states: Array  # (M, 17)
    covariance: Array  # (M, 17, 17)
    residual: Array  # (M, 9) of corrections, not yet in the output
    # Position and velocity, and their errors, of the last L steps: step k in row k mod L.
    motions: Array  # (L, M, 6)
    errors: Array  # (L, M, 6) velocity first, as in the states
    covariance_step: Steps  # (M,)
    accepted_step: Steps  # (M, 3) of the last velocity, horizontal position and height


class Sensed(NamedTuple):
    """What the sensors of M aircraft measure at a step, as far as it differs from the truth."""

    errors: Records  # (M,) of ERRORS
    heading_bias: Array  # (M,) rad
    equivalent_airspeed: Array  # (M,) m/s as measured
    airspeed: Array  # (M,)
    airspeed_sampled: BoolArray  # (M,)
    gps_lost: BoolArray  # (M,)
    gps_jump: Array  # (M, 3) m


def initial_memory(
    settings: Records, step: int, rate_hz: int, states: Array, position: Array, velocity: Array
) -> Memory:
    """M filters before a step, which have flown straight on: states (M, 17), motions (M, 3)."""
    n = len(states)
    covariance = np.zeros((n, STATES, STATES))
    covariance[:] = np.diag(INITIAL_SIGMA**2)
    length = 1 + int(max(settings["latency"].max(), settings["assumed_latency"].max()))
    motions = np.empty((length, n, 6))
    for ago in range(length):
        there = motions[(step - ago) % length]
        there[:, :3], there[:, 3:] = position - ago / rate_hz * velocity, velocity
    return Memory(
        states=states.copy(),
        covariance=covariance,
        residual=np.zeros((n, 9)),
        motions=motions,
        errors=np.zeros((length, n, 6)),
        covariance_step=np.full(n, step),
        accepted_step=np.full((n, 3), step),
    )


def ekf_step(
    memory: Memory,
    settings: Records,
    step: int,
    rate_hz: int,
    truth: VehicleState,
    sensed: Sensed,
) -> Array:
    """Step M filters and return the errors (M, 9) of attitude, velocity and position flown on."""
    states, errors = memory.states, sensed.errors
    rotation = rotation_ned_body(truth.euler)
    force = truth.acceleration_ned - _DOWN
    dt = 1.0 / rate_hz
    gyro = errors["gyro_bias"] + errors["gyro_noise"]
    accelerometer = errors["accelerometer_bias"] + errors["accelerometer_noise"]
    propagate_state(states, rotation, force, gyro, accelerometer, dt)
    residual = memory.residual
    residual *= math.exp(-dt / OUTPUT_TIME_CONSTANT_S)
    now = step % len(memory.motions)
    memory.motions[now, :, :3], memory.motions[now, :, 3:] = truth.position_ned, truth.velocity_ned
    memory.errors[now] = states[:, 3:9]
    gps, height, heading, sampled = measured(settings, step, rate_hz, sensed)
    rows = np.flatnonzero(gps | height | heading | sampled)
    if len(rows):
        before = states[:, :9].copy()
        since = dt * (step - memory.covariance_step[rows]).astype(np.float64)
        memory.covariance[rows] = propagate_covariance(
            memory.covariance[rows], rotation[rows], force[rows], settings["process"][rows], since
        )
        memory.covariance_step[rows] = step
        _fuse_fix(memory, settings, step, rate_hz, np.flatnonzero(gps), sensed)
        _fuse_height(memory, settings, step, rate_hz, np.flatnonzero(height), sensed)
        _fuse_heading(memory, settings, np.flatnonzero(heading), truth, sensed)
        _fuse_airspeed(memory, settings, np.flatnonzero(sampled), truth, sensed)
        _fuse_sideslip(memory, settings, np.flatnonzero(sampled), truth, rotation)
        change = states[:, :9] - before
        residual -= change
        memory.errors[:] += change[:, 3:]
    output: Array = states[:, :9] + residual
    return output


def measured(
    settings: Records, step: int, rate_hz: int, sensed: Sensed
) -> tuple[BoolArray, BoolArray, BoolArray, BoolArray]:
    """Which filters (M,) get a fix, a barometer's height, a heading and an airspeed at a step."""
    gps, barometer, compass = (
        (step * settings[name]) % rate_hz < settings[name]
        for name in ("gps_hz", "barometer_hz", "compass_hz")
    )
    height = barometer & ~settings["gps_height"]
    return gps & ~sensed.gps_lost, height, compass, sensed.airspeed_sampled


def propagate_state(
    states: Array, rotation: Array, force: Array, gyro: Array, accelerometer: Array, dt: float
) -> None:
    """Propagate the errors (M, 17) of M filters by `dt` s, in place.

    Args:
        states: (M, 17)
        rotation: R_NB (M, 3, 3), the truth's.
        force: (M, 3) m/s² specific force, NED.
        gyro: (M, 3) rad/s errors of the gyros, body axes.
        accelerometer: (M, 3) m/s² errors of the accelerometers, body axes.
        dt: s
    """
    rest = [gyro - states[:, GYRO_BIAS], accelerometer - states[:, ACCELEROMETER_BIAS]]
    turned = rotation @ np.stack(rest, axis=2)  # (M, 3, 2)
    states[:, POSITION] += dt * states[:, VELOCITY]
    states[:, VELOCITY] += dt * (np.cross(states[:, TILT], force) + turned[:, :, 1])
    states[:, TILT] += dt * turned[:, :, 0]


def propagate_covariance(
    covariance: Array, rotation: Array, force: Array, process: Array, dt: Array
) -> Array:
    """The covariance (M, 17, 17) after `dt` (M,) s without measurements."""
    n = len(covariance)
    flow = np.zeros((n, STATES, STATES))
    flow[:, TILT, GYRO_BIAS] = -rotation
    flow[:, VELOCITY, ACCELEROMETER_BIAS] = -rotation
    flow[:, VELOCITY, TILT] = -_skew(force)
    flow[:, POSITION, VELOCITY] = np.eye(3)
    flow *= dt[:, np.newaxis, np.newaxis]
    transition = np.eye(STATES) + flow + 0.5 * (flow @ flow)
    out: Array = transition @ covariance @ transition.swapaxes(1, 2)
    each = np.arange(STATES)
    out[:, each, each] += process * dt[:, np.newaxis]
    return out


def scalar_update(
    memory: Memory, rows: Rows, slope: Array, innovation: Array, variance: Array
) -> None:
    """Update the filters `rows` (m,) with one measurement each.

    Args:
        memory: of all; states and covariance change.
        rows: (m,)
        slope: (m, 17) of the measurement against the states.
        innovation: (m,) what the filter expects minus what is measured.
        variance: (m,) of the measurement, as the filter takes it to be.
    """
    covariance = memory.covariance[rows]
    along = (covariance @ slope[:, :, np.newaxis])[:, :, 0]
    total = (along * slope).sum(axis=1) + variance
    gain = along / total[:, np.newaxis]
    memory.states[rows] -= gain * innovation[:, np.newaxis]
    memory.covariance[rows] = covariance - gain[:, :, np.newaxis] * along[:, np.newaxis, :]


def reset_states(
    memory: Memory, rows: Rows, columns: slice, innovation: Array, variance: Array
) -> None:
    """Reset k states of the filters `rows` (m,) to what is measured: (m, k) each."""
    memory.states[rows, columns] -= innovation
    memory.residual[rows, columns] -= innovation  # in the output at once
    covariance = memory.covariance[rows]
    covariance[:, columns, :] = 0.0
    covariance[:, :, columns] = 0.0
    each = np.arange(STATES)[columns]
    covariance[:, each, each] = variance
    memory.covariance[rows] = covariance


def _fuse_fix(
    memory: Memory, settings: Records, step: int, rate_hz: int, rows: Rows, sensed: Sensed
) -> None:
    """GPS velocity, horizontal position, and height where it is the source."""
    length, errors = len(memory.motions), sensed.errors[rows]
    assumed = (step - settings["assumed_latency"][rows]) % length
    real = (step - settings["latency"][rows]) % length
    # the error of the assumed moment, and the way since the moment of the fix
    way = memory.motions[assumed, rows] - memory.motions[real, rows]
    expected = memory.errors[assumed, rows]
    expected[:, :3] += way[:, 3:] - errors["gps_velocity_noise"]
    fix = errors["gps_shared"] + errors["gps_own"] + errors["gps_noise"]
    expected[:, 3:] += way[:, :3] - fix - sensed.gps_jump[rows]
    expected -= memory.states[rows, 3:9]
    for kind, (first, count) in enumerate(FUSED_TOGETHER):
        used = settings["gps_height"][rows] | (kind != HEIGHT)
        off = expected[used, first - 3 : first - 3 + count]
        _fuse_together(memory, settings, step, rate_hz, rows[used], kind, off)


def _fuse_height(
    memory: Memory, settings: Records, step: int, rate_hz: int, rows: Rows, sensed: Sensed
) -> None:
    """The barometer's height."""
    errors = sensed.errors[rows]
    wrong = errors["barometer_shared"] + errors["barometer_own"] + errors["barometer_noise"]
    _fuse_together(memory, settings, step, rate_hz, rows, HEIGHT, -wrong[:, np.newaxis])


def _fuse_together(
    memory: Memory,
    settings: Records,
    step: int,
    rate_hz: int,
    rows: Rows,
    kind: int,
    off: Array,
) -> None:
    """States that are measured together: by their gate, or reset after too long a time.

    Args:
        memory: of all.
        settings: of all.
        step: number of the step.
        rate_hz: of the steps.
        rows: (m,)
        kind: of the measurement.
        off: (m, k) innovations, less the states as they are now.
    """
    first, count = FUSED_TOGETHER[kind]
    columns = slice(first, first + count)
    variance = settings["fix_noise"][rows, first - 3 : first - 3 + count] ** 2
    innovation = off + memory.states[rows, columns]
    each = np.arange(first, first + count)
    total = memory.covariance[rows][:, each, each] + variance
    limit = settings["gate"][rows] ** 2 * total.sum(axis=1)
    reset_after = settings["reset_after_s"][rows] * rate_hz
    reset = step - memory.accepted_step[rows, kind] > reset_after
    good = ~reset & ((innovation**2).sum(axis=1) <= limit)
    memory.accepted_step[rows[good | reset], kind] = step
    reset_states(memory, rows[reset], columns, innovation[reset], variance[reset])
    fused = rows[good]
    for axis in range(count):
        slope = np.zeros((len(fused), STATES))
        slope[:, first + axis] = 1.0
        now = off[good, axis] + memory.states[fused, first + axis]
        scalar_update(memory, fused, slope, now, variance[good, axis])


def _fuse_heading(
    memory: Memory, settings: Records, rows: Rows, truth: VehicleState, sensed: Sensed
) -> None:
    """The compass's yaw, to which errors of tilt add where the nose is up."""
    _, pitch, yaw = truth.euler[rows].T
    slope = np.zeros((len(rows), STATES))
    slope[:, TILT] = np.stack(
        [np.tan(pitch) * np.cos(yaw), np.tan(pitch) * np.sin(yaw), np.ones(len(rows))], axis=1
    )
    wrong = sensed.heading_bias[rows] + sensed.errors["heading_noise"][rows]
    innovation = (slope * memory.states[rows]).sum(axis=1) - wrong
    variance = settings["heading_noise"][rows] ** 2
    _gated_update(memory, rows, slope, innovation, variance, settings["gate"][rows])


def _gated_update(
    memory: Memory, rows: Rows, slope: Array, innovation: Array, variance: Array, gate: Array
) -> None:
    """As `scalar_update`, but for filters for which it is beyond the gate."""
    along = (memory.covariance[rows] @ slope[:, :, np.newaxis])[:, :, 0]
    good = innovation**2 <= gate**2 * ((along * slope).sum(axis=1) + variance)
    scalar_update(memory, rows[good], slope[good], innovation[good], variance[good])


def _fuse_airspeed(
    memory: Memory, settings: Records, rows: Rows, truth: VehicleState, sensed: Sensed
) -> None:
    """True airspeed, the length of velocity minus wind."""
    air = _velocity_through_air(memory, rows, truth)
    speed = np.sqrt((air * air).sum(axis=1))
    ahead = air / np.maximum(speed, MIN_AIRSPEED)[:, np.newaxis]
    slope = np.zeros((len(rows), STATES))
    slope[:, VELOCITY], slope[:, WIND] = ahead, -ahead[:, :2]
    tas, eas = sensed.airspeed[rows], sensed.equivalent_airspeed[rows]
    variance = (settings["airspeed_noise"][rows] * tas / eas) ** 2
    fast, gate = speed > MIN_AIRSPEED, settings["airspeed_gate"][rows]
    _gated_update(memory, rows[fast], slope[fast], (speed - tas)[fast], variance[fast], gate[fast])


def _fuse_sideslip(
    memory: Memory, settings: Records, rows: Rows, truth: VehicleState, rotation: Array
) -> None:
    """A sideslip of zero."""
    air = _velocity_through_air(memory, rows, truth)
    tilt = memory.states[rows, TILT]
    nose, side = (
        axis + np.cross(tilt, axis) for axis in rotation[rows][:, :, :2].transpose(2, 0, 1)
    )
    forward = (nose * air).sum(axis=1)
    fast = forward > MIN_AIRSPEED
    scale = 1.0 / np.maximum(forward, MIN_AIRSPEED)[:, np.newaxis]
    slope = np.zeros((len(rows), STATES))
    slope[:, VELOCITY], slope[:, WIND] = side * scale, -side[:, :2] * scale
    slope[:, TILT] = np.cross(side, air) * scale
    sideslip = (side * air).sum(axis=1) * scale[:, 0]
    variance = settings["sideslip_variance"][rows]
    scalar_update(memory, rows[fast], slope[fast], sideslip[fast], variance[fast])


def _velocity_through_air(memory: Memory, rows: Rows, truth: VehicleState) -> Array:
    """Estimated velocities (m, 3) through the air."""
    air: Array = truth.velocity_ned[rows] + memory.states[rows, VELOCITY]
    air[:, :2] -= memory.states[rows, WIND]
    return air


def _skew(v: Array) -> Array:
    """[v]× (M, 3, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return out
