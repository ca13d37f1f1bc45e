"""The navigation filter of an autopilot, as its errors: a Kalman filter like ArduPilot's EKF3.

An estimate is the truth plus its error, and the errors obey linear equations in which only the
sensors' errors and the specific force appear. So the errors themselves are simulated, with the
filter's covariance, gates and resets, but without raw measurements: 17 states, updated with GPS
velocity and position, barometer, heading, airspeed and the assumption of zero sideslip. Left out of
EKF3's 24 are the magnetic fields of earth and airframe (a heading error stands for what they leave)
and the quaternion's fourth number.

Sources: ArduPilot 4.5, libraries/AP_NavEKF3, for structure, noise settings and gates; P. D. Groves,
Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., sec. 14.2, for
the error equations.

Axes are NED. The attitude error is the small rotation ε of R_est = (1 + [ε]×) R.
"""

from __future__ import annotations

from math import cos, exp, pi, sin, sqrt, tan

import numpy as np

from testbed.core.compile import kernel
from testbed.core.frames import GRAVITY, rotation_rows
from testbed.core.records import Array, Record, Records, Values, Vector, allocate
from testbed.sensors.sensor_errors import is_sampled

# First of the states of each kind. Biases are those that the filter subtracts, the wind is its
# estimate; all others are errors: estimate − truth.
TILT, VELOCITY, POSITION = 0, 3, 6  # rad, m/s, m; NED, three each
GYRO_BIAS, ACCELEROMETER_BIAS = 9, 12  # rad/s, m/s²; body axes, three each
WIND = 15  # m/s, north and east
STATES = 17
DYNAMIC = WIND  # states whose errors grow into others; the wind is constant but for its noise
OUTPUTS = GYRO_BIAS  # states that the autopilot flies on: attitude, velocity, position
# States that are measured together, the first and how many.
VELOCITY_FIX, POSITION_FIX, HEIGHT = 0, 1, 2
FUSED_TOGETHER = ((VELOCITY, 3), (POSITION, 2), (POSITION + 2, 1))
MAX_SLOPES = 8  # states on which one measurement depends

SIDESLIP_VARIANCE = 0.03  # rad², EKF3's R_BETA: a standard deviation of 10°
OUTPUT_TIME_CONSTANT_S = 0.25  # EKF3's EK3_TAU_OUTPUT
MIN_AIRSPEED = 1.0  # m/s, below it airspeed and sideslip are not fused
# Standard deviations at first: of tilt, velocity, position, the two biases and the wind.
INITIAL_SIGMA = np.repeat([0.05, 0.5, 1.0, 0.01, 0.2, 2.0], [3, 3, 3, 3, 3, 2])

# The settings of one filter, and the rates and latency of its sensors.
SETTINGS = np.dtype(
    [
        ("row", "i8"),  # its aircraft, among all
        ("process", "f8", STATES),  # variance that each state gains per second
        # of velocity, m/s, and position, m; the last is that of the height's source
        ("fix_noise", "f8", 6),
        ("airspeed_noise", "f8"),  # m/s, equivalent
        ("heading_noise", "f8"),  # rad
        ("sideslip_variance", "f8"),  # rad²
        ("gate", "f8"),  # standard deviations of an innovation, beyond which it is rejected
        ("airspeed_gate", "f8"),
        ("reset_after_s", "f8"),
        ("gps_hz", "i8"),
        ("barometer_hz", "i8"),
        ("compass_hz", "i8"),
        ("latency", "i8"),  # steps, of the GPS
        ("assumed_latency", "i8"),  # steps, that the filter takes the GPS to have
        ("gps_height", "?"),  # the height comes from the GPS, not from the barometer
        ("heading_bias", "f8"),  # rad, of the compass
    ],
    align=True,
)
# What one filter keeps from one step to the next.
FILTER = np.dtype(
    [
        ("states", "f8", STATES),
        ("covariance", "f8", (STATES, STATES)),
        ("residual", "f8", OUTPUTS),  # of past corrections, not yet in the output
        ("output", "f8", OUTPUTS),  # errors of attitude, velocity and position that are flown on
        ("covariance_step", "i8"),  # number of the step of the covariance
        # numbers of the steps of the last velocity, horizontal position and height accepted
        ("accepted_step", "i8", 3),
    ],
    align=True,
)
# One of the last L steps, in row step mod L: a fix that is late is compared with these.
PAST_MOTION = np.dtype(
    [
        ("velocity", "f8", 3),  # m/s, the truth
        ("position", "f8", 3),  # m
        ("velocity_error", "f8", 3),  # m/s, corrected with the states
        ("position_error", "f8", 3),  # m
    ],
    align=True,
)


def aligned_states(settings: Records, errors: Records, wind: Array) -> Array:
    """Return the states (M, 17) of filters that start from what their sensors measure.

    Args:
        settings: (M,) of SETTINGS.
        errors: (M,) of ERRORS.
        wind: (M, 2) m/s, north and east, known to the filters.
    """
    states = np.zeros((len(settings), STATES))
    states[:, TILT + 2] = settings["heading_bias"] + errors["heading_noise"]
    states[:, VELOCITY : VELOCITY + 3] = errors["gps_velocity_noise"]
    fix = errors["gps_shared"] + errors["gps_own"] + errors["gps_noise"]
    height = errors["barometer_shared"] + errors["barometer_own"] + errors["barometer_noise"]
    states[:, POSITION : POSITION + 2] = fix[:, :2]
    states[:, POSITION + 2] = np.where(settings["gps_height"], fix[:, 2], height)
    states[:, WIND:] = wind
    return states


def make_filters(settings: Records) -> tuple[Records, Records]:
    """Allocate M filters (M,) of FILTER and their past (M, L) of PAST_MOTION; see `start_filters`.

    Args:
        settings: (M,) of SETTINGS.
    """
    latest = [int(settings[name].max(initial=0)) for name in ("latency", "assumed_latency")]
    return allocate(FILTER, len(settings)), allocate(PAST_MOTION, len(settings), 1 + max(latest))


def start_filters(
    filters: Records,
    past: Records,
    step: int,
    rate_hz: int,
    states: Array,
    position: Array,
    velocity: Array,
) -> None:
    """Switch on M filters before a step, in straight flight.

    Args:
        filters: (M,) of FILTER; written.
        past: (M, L) of PAST_MOTION; written.
        step: number of the step.
        rate_hz: of the steps.
        states: (M, 17)
        position: (M, 3) m NED, at that step.
        velocity: (M, 3) m/s NED.
    """
    filters["states"], filters["covariance"] = states, np.diag(INITIAL_SIGMA**2)
    filters["residual"] = filters["output"] = 0.0
    filters["covariance_step"] = filters["accepted_step"] = step
    past["velocity"] = velocity[:, np.newaxis]
    past["velocity_error"] = past["position_error"] = 0.0
    length = past.shape[1]
    for ago in range(length):
        past["position"][:, (step - ago) % length] = position - ago / rate_hz * velocity


@kernel
def ekf_step(
    g: Record,
    f: Record,
    past: Records,
    errors: Record,
    airspeed: Record,
    truth: Record,
    faults: Record,
    step: int,
    steps_per_s: int,
) -> None:
    """Step one filter: propagate its errors, and update them with new measurements.

    These are, in this order: velocity and position of the GPS, height, heading, airspeed, sideslip.

    Args:
        g: record of SETTINGS.
        f: record of FILTER; written.
        past: (L,) of PAST_MOTION; written.
        errors: record of ERRORS.
        airspeed: record of AIRSPEED_SENSOR.
        truth: record of MOTION.
        faults: record of FAULTS.
        step: number of the step.
        steps_per_s: Hz.
    """
    dt = 1.0 / steps_per_s
    x, p, residual = f.states, f.covariance, f.residual
    rotation = rotation_rows(truth.euler)
    acceleration = truth.acceleration_ned
    force = acceleration[0], acceleration[1], acceleration[2] - GRAVITY
    propagate_state(x, errors, rotation, force, dt)
    now = past[step % len(past)]
    for axis in range(3):
        now.velocity[axis] = truth.velocity_ned[axis]
        now.position[axis] = truth.position_ned[axis]
        now.velocity_error[axis] = x[VELOCITY + axis]
        now.position_error[axis] = x[POSITION + axis]
    # corrections reach the output with a time constant
    decay = exp(-dt / OUTPUT_TIME_CONSTANT_S)
    for k in range(OUTPUTS):
        residual[k] *= decay
    fixed = is_sampled(g.gps_hz, step, steps_per_s) and not faults.gps_lost
    height = is_sampled(g.barometer_hz, step, steps_per_s) and not g.gps_height
    heading = is_sampled(g.compass_hz, step, steps_per_s)
    if fixed or height or heading or airspeed.sampled:
        propagate_covariance(p, rotation, force, g.process, dt * (step - f.covariance_step))
        f.covariance_step = step
        before, innovation = np.empty(OUTPUTS), np.empty(OUTPUTS)
        work = np.empty(MAX_SLOPES, np.int64), np.empty(MAX_SLOPES), np.empty(STATES)
        for k in range(OUTPUTS):
            before[k] = x[k]
        if fixed:
            predict_fix(g, x, past, errors, faults, step, innovation)
            fuse_together(g, f, VELOCITY_FIX, innovation, step, steps_per_s, work)
            fuse_together(g, f, POSITION_FIX, innovation, step, steps_per_s, work)
            if g.gps_height:
                fuse_together(g, f, HEIGHT, innovation, step, steps_per_s, work)
        if height:
            innovation[POSITION + 2] = -(
                errors.barometer_shared + errors.barometer_own + errors.barometer_noise
            )
            fuse_together(g, f, HEIGHT, innovation, step, steps_per_s, work)
        if heading:
            fuse_heading(g, x, p, truth.euler, g.heading_bias + errors.heading_noise, work)
        if airspeed.sampled:
            fuse_airspeed(g, x, p, truth.velocity_ned, airspeed, work)
            fuse_sideslip(g, x, p, truth.velocity_ned, rotation, work)
        for k in range(OUTPUTS):
            change = x[k] - before[k]
            residual[k] -= change
            before[k] = change
        # the errors of the past are corrected with the states
        for late in range(len(past)):
            motion = past[late]
            for axis in range(3):
                motion.velocity_error[axis] += before[VELOCITY + axis]
                motion.position_error[axis] += before[POSITION + axis]
    for k in range(OUTPUTS):
        f.output[k] = x[k] + residual[k]


@kernel
def propagate_state(x: Array, errors: Record, rotation: Values, force: Vector, dt: float) -> None:
    """Propagate the errors of one filter by `dt` s.

    Args:
        x: (17,) states; written.
        errors: record of ERRORS.
        rotation: R_NB, the truth's.
        force: specific force, m/s² NED.
        dt: s
    """
    a, b, c = x[TILT], x[TILT + 1], x[TILT + 2]
    tilted = b * force[2] - c * force[1], c * force[0] - a * force[2], a * force[1] - b * force[0]
    for axis in range(3):
        rate = specific_force = 0.0
        for k in range(3):
            gyro = errors.gyro_bias[k] + errors.gyro_noise[k] - x[GYRO_BIAS + k]
            accelerometer = (
                errors.accelerometer_bias[k]
                + errors.accelerometer_noise[k]
                - x[ACCELEROMETER_BIAS + k]
            )
            rate += rotation[axis][k] * gyro
            specific_force += rotation[axis][k] * accelerometer
        x[POSITION + axis] += dt * x[VELOCITY + axis]
        x[VELOCITY + axis] += dt * (tilted[axis] + specific_force)
        x[TILT + axis] += dt * rate


@kernel
def propagate_covariance(
    p: Array, rotation: Values, force: Vector, process: Array, dt: float
) -> None:
    """Propagate the covariance by `dt` s: P ← Φ P Φᵀ + Q dt.

    Args:
        p: (17, 17); written.
        rotation: R_NB.
        force: specific force, m/s² NED.
        process: (17,) variance that each state gains per second.
        dt: s
    """
    flow = np.empty((ACCELEROMETER_BIAS - 3, DYNAMIC))
    product, transposed = np.empty((STATES, STATES)), np.empty((STATES, STATES))
    write_flow(rotation, force, dt, flow)
    multiply_by_transition(flow, p, product)
    for i in range(STATES):
        for j in range(STATES):
            transposed[i, j] = product[j, i]
    multiply_by_transition(flow, transposed, product)
    for i in range(STATES):
        for j in range(STATES):
            p[i, j] = product[j, i]
        p[i, i] += process[i] * dt


@kernel
def write_flow(rotation: Values, force: Vector, dt: float, flow: Array) -> None:
    """Write Φ − 1 for tilt, velocity and position, to second order.

    Other rows are zero.

    Args:
        rotation: R_NB.
        force: specific force, m/s² NED.
        dt: s
        flow: (9, 15); written.
    """
    flow[:] = 0.0
    # ε × f = −[f]× ε
    skew = (0.0, force[2], -force[1]), (-force[2], 0.0, force[0]), (force[1], -force[0], 0.0)
    for i in range(3):
        for j in range(3):
            r = rotation
            turned = skew[i][0] * r[0][j] + skew[i][1] * r[1][j] + skew[i][2] * r[2][j]
            flow[TILT + i, GYRO_BIAS + j] = -dt * r[i][j]
            flow[VELOCITY + i, TILT + j] = dt * skew[i][j]
            flow[VELOCITY + i, GYRO_BIAS + j] = -0.5 * dt * dt * turned
            flow[VELOCITY + i, ACCELEROMETER_BIAS + j] = -dt * r[i][j]
            flow[POSITION + i, TILT + j] = 0.5 * dt * dt * skew[i][j]
            flow[POSITION + i, ACCELEROMETER_BIAS + j] = -0.5 * dt * dt * r[i][j]
        flow[POSITION + i, VELOCITY + i] = dt


@kernel
def multiply_by_transition(flow: Array, p: Array, out: Array) -> None:
    """Write Φ P, without the products that are zero.

    Args:
        flow: (9, 15) of `write_flow`.
        p: (17, 17)
        out: (17, 17); written.
    """
    width = p.shape[1]
    for i in range(3):
        t, v, x = flow[TILT + i], flow[VELOCITY + i], flow[POSITION + i]
        for j in range(width):
            out[TILT + i, j] = p[TILT + i, j] + t[9] * p[9, j] + t[10] * p[10, j] + t[11] * p[11, j]
        for j in range(width):
            tilted = v[0] * p[0, j] + v[1] * p[1, j] + v[2] * p[2, j] + p[VELOCITY + i, j]
            turned = tilted + v[9] * p[9, j] + v[10] * p[10, j] + v[11] * p[11, j]
            out[VELOCITY + i, j] = turned + v[12] * p[12, j] + v[13] * p[13, j] + v[14] * p[14, j]
        for j in range(width):
            tilted = x[0] * p[0, j] + x[1] * p[1, j] + x[2] * p[2, j]
            moved = tilted + x[VELOCITY + i] * p[VELOCITY + i, j] + p[POSITION + i, j]
            out[POSITION + i, j] = moved + x[12] * p[12, j] + x[13] * p[13, j] + x[14] * p[14, j]
    for i in range(GYRO_BIAS, STATES):
        for j in range(width):
            out[i, j] = p[i, j]


@kernel
def scalar_update(
    x: Array, p: Array, count: int, innovation: float, variance: float, work: Values
) -> None:
    """Update states and covariance with one measurement.

    Args:
        x: (17,) states; written.
        p: (17, 17) covariance; written.
        count: of the states on which it depends.
        innovation: what the filter expects minus what is measured.
        variance: of the measurement, as the filter takes it to be.
        work: those states, and its slopes against them (8,), and (17,) to work in.
    """
    states, slopes, gains = work
    width = len(gains)
    total = variance
    for i in range(width):
        along = 0.0
        for c in range(count):
            along += p[i, states[c]] * slopes[c]
        gains[i] = along
    for c in range(count):
        total += gains[states[c]] * slopes[c]
    for i in range(width):
        gain = gains[i] / total
        x[i] -= gain * innovation
        for j in range(width):
            p[i, j] -= gain * gains[j]


@kernel
def gated_update(
    x: Array, p: Array, count: int, innovation: float, variance: float, gate: float, work: Values
) -> None:
    """Update with one measurement as `scalar_update`, unless it is beyond the gate.

    Args:
        x: (17,) states; written.
        p: (17, 17) covariance; written.
        count: of the states on which it depends.
        innovation: what the filter expects minus what is measured.
        variance: of the measurement, as the filter takes it to be.
        gate: standard deviations of the innovation.
        work: as for `scalar_update`.
    """
    states, slopes, _ = work
    total = variance
    for k in range(count):
        for j in range(count):
            total += slopes[k] * p[states[k], states[j]] * slopes[j]
    if innovation * innovation <= gate * gate * total:
        scalar_update(x, p, count, innovation, variance, work)


@kernel
def predict_fix(
    g: Record, x: Array, past: Records, errors: Record, faults: Record, step: int, innovation: Array
) -> None:
    """Write the innovations of a fix's velocity and position.

    Each is written minus the present state. A fix is as old as its latency, and compared with the
    estimate of the assumed latency ago.

    Args:
        g: record of SETTINGS.
        x: (17,) states.
        past: (L,) of PAST_MOTION.
        errors: record of ERRORS.
        faults: record of FAULTS.
        step: number of the step.
        innovation: (9,), as the states; of velocity and position are written.
    """
    length = len(past)
    assumed, measured = past[(step - g.assumed_latency) % length], past[(step - g.latency) % length]
    for axis in range(3):
        off = assumed.velocity_error[axis] + assumed.velocity[axis]
        off -= measured.velocity[axis]
        off -= errors.gps_velocity_noise[axis] + x[VELOCITY + axis]
        innovation[VELOCITY + axis] = off
        fix = errors.gps_shared[axis] + errors.gps_own[axis] + errors.gps_noise[axis]
        off = assumed.position_error[axis] + assumed.position[axis]
        off -= measured.position[axis]
        off -= fix + faults.gps_jump[axis] + x[POSITION + axis]
        innovation[POSITION + axis] = off


@kernel
def fuse_together(
    g: Record, f: Record, kind: int, off: Array, step: int, steps_per_s: int, work: Values
) -> None:
    """Update states that are measured together, or reset them to the measurement.

    The sum of their squared innovations is held to the gate. They are reset if none was accepted
    for too long.

    Args:
        g: record of SETTINGS.
        f: record of FILTER; written.
        kind: VELOCITY_FIX, POSITION_FIX or HEIGHT.
        off: (9,) innovations minus the present states.
        step: number of the step.
        steps_per_s: Hz.
        work: as for `scalar_update`.
    """
    x, p = f.states, f.covariance
    states, slopes, _ = work
    first, count = FUSED_TOGETHER[kind]
    reset = step - f.accepted_step[kind] > g.reset_after_s * steps_per_s
    square = total = 0.0
    for k in range(first, first + count):
        square += (off[k] + x[k]) ** 2
        total += p[k, k] + g.fix_noise[k - VELOCITY] ** 2
    if not reset and square > g.gate**2 * total:
        return
    f.accepted_step[kind] = step
    for k in range(first, first + count):
        innovation, variance = off[k] + x[k], g.fix_noise[k - VELOCITY] ** 2
        if reset:
            reset_state(f, k, innovation, variance)
        else:
            states[0], slopes[0] = k, 1.0
            scalar_update(x, p, 1, innovation, variance, work)


@kernel
def reset_state(f: Record, state: int, innovation: float, variance: float) -> None:
    """Reset a state to its measurement; the output follows at once.

    Args:
        f: record of FILTER; written.
        state: its number.
        innovation: what the filter expects minus what is measured.
        variance: of the measurement.
    """
    f.states[state] -= innovation
    f.residual[state] -= innovation
    for k in range(STATES):
        f.covariance[state, k] = 0.0
        f.covariance[k, state] = 0.0
    f.covariance[state, state] = variance


@kernel
def fuse_heading(g: Record, x: Array, p: Array, euler: Vector, error: float, work: Values) -> None:
    """Update with the compass's yaw.

    Errors of tilt add to it where the nose is up.

    Args:
        g: record of SETTINGS.
        x: (17,) states; written.
        p: (17, 17) covariance; written.
        euler: the truth's roll, pitch, yaw, rad.
        error: of the compass, rad.
        work: as for `scalar_update`.
    """
    states, slopes, _ = work
    pitch, yaw = euler[1], euler[2]
    states[0], states[1], states[2] = TILT, TILT + 1, TILT + 2
    slopes[0], slopes[1], slopes[2] = tan(pitch) * cos(yaw), tan(pitch) * sin(yaw), 1.0
    innovation = slopes[0] * x[0] + slopes[1] * x[1] + x[2] - error
    gated_update(x, p, 3, innovation, g.heading_noise**2, g.gate, work)


@kernel
def fuse_airspeed(
    g: Record, x: Array, p: Array, velocity: Vector, airspeed: Record, work: Values
) -> None:
    """Update with the true airspeed, the length of velocity minus wind.

    Args:
        g: record of SETTINGS.
        x: (17,) states; written.
        p: (17, 17) covariance; written.
        velocity: the truth's, m/s NED.
        airspeed: record of AIRSPEED_SENSOR.
        work: as for `scalar_update`.
    """
    states, slopes, _ = work
    a, b, c = velocity_through_air(x, velocity)
    speed = sqrt(a * a + b * b + c * c)
    if speed > MIN_AIRSPEED:
        for k in range(3):
            states[k] = VELOCITY + k
        states[3], states[4] = WIND, WIND + 1
        slopes[0], slopes[1], slopes[2] = a / speed, b / speed, c / speed
        slopes[3], slopes[4] = -a / speed, -b / speed
        measured = airspeed.airspeed
        variance = (g.airspeed_noise * measured / airspeed.equivalent_airspeed) ** 2
        gated_update(x, p, 5, speed - measured, variance, g.airspeed_gate, work)


@kernel
def fuse_sideslip(
    g: Record, x: Array, p: Array, velocity: Vector, rotation: Values, work: Values
) -> None:
    """Update with a sideslip of zero: the air is taken to come from ahead.

    Args:
        g: record of SETTINGS.
        x: (17,) states; written.
        p: (17, 17) covariance; written.
        velocity: the truth's, m/s NED.
        rotation: R_NB, the truth's.
        work: as for `scalar_update`.
    """
    states, slopes, _ = work
    a, b, c = velocity_through_air(x, velocity)
    n0, n1, n2 = estimated_axis(x, rotation, 0)
    s0, s1, s2 = estimated_axis(x, rotation, 1)
    forward = n0 * a + n1 * b + n2 * c
    if forward > MIN_AIRSPEED:
        for k in range(VELOCITY + 3):
            states[k] = TILT + k
        states[6], states[7] = WIND, WIND + 1
        slopes[0] = (s1 * c - s2 * b) / forward
        slopes[1] = (s2 * a - s0 * c) / forward
        slopes[2] = (s0 * b - s1 * a) / forward
        slopes[3], slopes[4], slopes[5] = s0 / forward, s1 / forward, s2 / forward
        slopes[6], slopes[7] = -s0 / forward, -s1 / forward
        sideslip = (s0 * a + s1 * b + s2 * c) / forward
        scalar_update(x, p, MAX_SLOPES, sideslip, g.sideslip_variance, work)


@kernel
def velocity_through_air(x: Array, velocity: Vector) -> Values:
    """Return the estimated velocity through the air, m/s NED."""
    return (
        velocity[0] + x[VELOCITY] - x[WIND],
        velocity[1] + x[VELOCITY + 1] - x[WIND + 1],
        velocity[2] + x[VELOCITY + 2],
    )


@kernel
def estimated_axis(x: Array, rotation: Values, axis: int) -> Values:
    """Return a body axis in NED by the estimated attitude."""
    a, b, c = rotation[0][axis], rotation[1][axis], rotation[2][axis]
    return a + x[1] * c - x[2] * b, b + x[2] * a - x[0] * c, c + x[0] * b - x[1] * a


@kernel
def apply_errors(f: Record, errors: Record, estimate: Record) -> None:
    """Turn the motion of one aircraft into the estimate of its filter.

    Rates are those of the gyros, accelerations those of the accelerometers resolved with the
    estimated attitude, both minus the biases that the filter has estimated.

    Args:
        f: record of FILTER.
        errors: record of ERRORS.
        estimate: record of MOTION, the truth at first; all but the airspeeds are written.
    """
    x, output = f.states, f.output
    euler, acceleration = estimate.euler, estimate.acceleration_ned
    phi, theta, psi = euler[0], euler[1], euler[2]
    r0, r1, r2 = rotation_rows(euler)
    north, east, down = acceleration[0], acceleration[1], acceleration[2] - GRAVITY
    bias, noise = errors.accelerometer_bias, errors.accelerometer_noise
    a = bias[0] + noise[0] - x[ACCELEROMETER_BIAS]
    b = bias[1] + noise[1] - x[ACCELEROMETER_BIAS + 1]
    c = bias[2] + noise[2] - x[ACCELEROMETER_BIAS + 2]
    a += r0[0] * north + r1[0] * east
    a += r2[0] * down
    b += r0[1] * north + r1[1] * east
    b += r2[1] * down
    c += r0[2] * north + r1[2] * east
    c += r2[2] * down
    # the Euler angles of the attitude turned by a small rotation about NED axes
    sine, cosine = sin(psi), cos(psi)
    along = cosine * output[TILT] + sine * output[TILT + 1]
    euler[0] = phi + along / cos(theta)
    euler[1] = theta + (cosine * output[TILT + 1] - sine * output[TILT])
    euler[2] = pi - (pi - psi - (output[TILT + 2] + along * tan(theta))) % (2.0 * pi)
    r0, r1, r2 = rotation_rows(euler)
    acceleration[0] = r0[0] * a + r0[1] * b + r0[2] * c
    acceleration[1] = r1[0] * a + r1[1] * b + r1[2] * c
    acceleration[2] = r2[0] * a + r2[1] * b + r2[2] * c + GRAVITY
    for axis in range(3):
        gyro = errors.gyro_bias[axis] + errors.gyro_noise[axis]
        estimate.rates_body[axis] += gyro - x[GYRO_BIAS + axis]
        estimate.velocity_ned[axis] += output[VELOCITY + axis]
        estimate.position_ned[axis] += output[POSITION + axis]
