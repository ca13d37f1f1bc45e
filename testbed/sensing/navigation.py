"""The navigation filter of an autopilot, as its errors: a Kalman filter like ArduPilot's EKF3.

What a filter believes is the truth plus its errors, and those errors obey linear equations in
which only the sensors' errors and the specific force appear. So the filter itself is simulated,
with its covariance, gates and resets, without simulating raw measurements: 17 states, fed by GPS
position and velocity, barometer, heading, airspeed and the assumption that an aeroplane does not
slip. Left out of EKF3's 24: the earth's and the airframe's magnetic field (a heading error stands
for what they leave) and the quaternion's fourth number.

Sources: ArduPilot 4.5, libraries/AP_NavEKF3, for structure, noise settings and gates; P. D. Groves,
Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, 2nd ed., sec. 14.2, for
the error equations.

Axes are NED. The attitude error is the small rotation ε of R_est = (1 + [ε]×) R.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from testbed.state import Array, Truths

Rows = NDArray[np.intp]
Counts = NDArray[np.int64]

# Columns of the states. Biases are those the filter subtracts, the wind is the wind it believes in,
# all others are errors: belief − truth.
TILT, VELOCITY, POSITION = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, FORCE_BIAS, WIND = slice(9, 12), slice(12, 15), slice(15, 17)
STATES = 17
STEP_S = 0.012  # EKF3's own time step: its process noises are per square root of that
SLIP_VARIANCE = 0.03  # rad², EKF3's R_BETA: slip of some 10° is taken for granted
SMOOTHING_S = 0.25  # EKF3's EK3_TAU_OUTPUT
SLOWEST_AIR = 1.0  # m/s, below it airspeed and slip say nothing
# Standard deviations with which a filter is switched on: 3 of tilt, velocity, position, 2 biases.
_BEGUN = np.repeat([0.05, 0.5, 1.0, 0.01, 0.2, 2.0], [3, 3, 3, 3, 3, 2])


SETTINGS = np.dtype(
    [
        ("process", "f8", (STATES,)),  # variance that each state gains per second
        ("position_noise", "f8", (3,)),  # m; of height, that of where it comes from
        ("velocity_noise", "f8", (3,)),  # m/s, of the GPS
        ("airspeed_noise", "f8"),  # m/s, equivalent
        ("heading_noise", "f8"),  # rad
        ("gate", "f8"),  # standard deviations of an innovation that is refused
        ("airspeed_gate", "f8"),
        ("reset_after_s", "f8"),
        ("gps_hz", "i8"),
        ("barometer_hz", "i8"),
        ("compass_hz", "i8"),
        ("latency", "i8"),  # steps, that fixes have
        ("assumed", "i8"),  # steps, that the filter takes them to have
        ("gps_height", "?"),  # height comes from the GPS, and not from the barometer
    ]
)


class Settings(NamedTuple):
    """The settings of M filters, and the sensors behind them: a table, for the twin's sake.

    Its columns (M, ...) are attributes too.
    """

    each: Any  # (M,) of SETTINGS
    rate_hz: int  # of the steps

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401 - an array of a field's type
        """A column."""
        return self.each[name]


class Memory(NamedTuple):
    """M filters between two steps, written in place: who steps them owns them."""

    states: Array  # (M, STATES)
    covariance: Array  # (M, STATES, STATES)
    residual: Array  # (M, 9) of corrections to tilt, velocity, position: what is not yet flown on
    # Position and velocity, and their errors, of the last L steps: step k in row k mod L.
    motions: Array  # (L, M, 6)
    errors: Array  # (L, M, 6) velocity first, as in the states
    spread_at: Counts  # (M,) step of the covariance
    accepted: Counts  # (3, M) step of the last velocity, horizontal position and height taken in


class Sensed(NamedTuple):
    """What the sensors of M aircraft say at a step, as far as it is wrong."""

    errors: Array  # (M, errors.COLUMNS)
    heading: Array  # (M,) rad, constant error of the compass
    equivalent_airspeed: Array  # (M,) m/s as measured
    airspeed: Array  # (M,)
    airspeed_new: Truths  # (M,) measured at this step
    gps_lost: Truths  # (M,)
    gps_jump: Array  # (M, 3) m


def begin(settings: Settings, step: int, states: Array, position: Array, velocity: Array) -> Memory:
    """M filters before a step, switched on with these states (M, STATES).

    Who has been nowhere yet has come straight on; motions (M, 3).
    """
    n = len(states)
    covariance = np.zeros((n, STATES, STATES))
    covariance[:] = np.diag(_BEGUN**2)
    length = 1 + int(max(settings.latency.max(initial=0), settings.assumed.max(initial=0)))
    motions = np.empty((length, n, 6))
    for ago in range(length):
        there = motions[(step - ago) % length]
        there[:, :3] = position - ago / settings.rate_hz * velocity
        there[:, 3:] = velocity
    return Memory(
        states=states.copy(),
        covariance=covariance,
        residual=np.zeros((n, 9)),
        motions=motions,
        errors=np.zeros((length, n, 6)),
        spread_at=np.full(n, step),
        accepted=np.full((3, n), step),
    )


def drift(
    states: Array, rotation: Array, force: Array, gyro: Array, accel: Array, dt: float
) -> None:
    """Let the errors of N filters move on by `dt` s, in place.

    Args:
        states: (N, STATES)
        rotation: R_NB (N, 3, 3), the truth's.
        force: (N, 3) m/s² specific force, NED.
        gyro: (N, 3) rad/s errors of the gyros, body axes.
        accel: (N, 3) m/s² errors of the accelerometers, body axes.
        dt: s
    """
    sensed = np.stack([gyro - states[:, GYRO_BIAS], accel - states[:, FORCE_BIAS]], axis=2)
    turned = rotation @ sensed  # (N, 3, 2)
    states[:, POSITION] += dt * states[:, VELOCITY]
    states[:, VELOCITY] += dt * (cross(states[:, TILT], force) + turned[:, :, 1])
    states[:, TILT] += dt * turned[:, :, 0]


def spread(covariance: Array, rotation: Array, force: Array, process: Array, dt: Array) -> Array:
    """The covariance (N, STATES, STATES) after `dt` (N,) s without measurements."""
    n = len(covariance)
    flow = np.zeros((n, STATES, STATES))
    flow[:, TILT, GYRO_BIAS] = -rotation
    flow[:, VELOCITY, FORCE_BIAS] = -rotation
    flow[:, VELOCITY, TILT] = -_skew(force)
    flow[:, POSITION, VELOCITY] = np.eye(3)
    flow *= dt[:, np.newaxis, np.newaxis]
    transition = np.eye(STATES) + flow + 0.5 * (flow @ flow)
    out: Array = transition @ covariance @ transition.swapaxes(1, 2)
    each = np.arange(STATES)
    out[:, each, each] += process * dt[:, np.newaxis]
    return out


def fuse(memory: Memory, rows: Rows, slope: Array, innovation: Array, variance: Array) -> None:
    """Take in one number for each of the filters `rows` (m,).

    Args:
        memory: of all; states and covariance change.
        rows: (m,)
        slope: (m, STATES) of the number against the states.
        innovation: (m,) what the filter expected minus what was measured.
        variance: (m,) of the measurement, as the filter takes it to be.
    """
    covariance = memory.covariance[rows]
    along = (covariance @ slope[:, :, np.newaxis])[:, :, 0]
    total = (along * slope).sum(axis=1) + variance
    gain = along / total[:, np.newaxis]
    memory.states[rows] -= gain * innovation[:, np.newaxis]
    memory.covariance[rows] = covariance - gain[:, :, np.newaxis] * along[:, np.newaxis, :]


def restart(memory: Memory, rows: Rows, columns: slice, change: Array, variance: Array) -> None:
    """Forget what the filters `rows` (m,) believed of k states, and move these.

    Args:
        memory: of all; states and covariance change.
        rows: (m,)
        columns: of the states.
        change: (m, k)
        variance: (m, k) that they have now.
    """
    memory.states[rows, columns] += change
    covariance = memory.covariance[rows]
    covariance[:, columns, :] = 0.0
    covariance[:, :, columns] = 0.0
    each = np.arange(STATES)[columns]
    covariance[:, each, each] = variance
    memory.covariance[rows] = covariance


def cross(a: Array, b: Array) -> Array:
    """The product a × b of vectors (m, 3)."""
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def _skew(v: Array) -> Array:
    """[v]× (N, 3, 3)."""
    out = np.zeros((len(v), 3, 3))
    out[:, 0, 1], out[:, 0, 2], out[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    out[:, 1, 0], out[:, 2, 0], out[:, 2, 1] = v[:, 2], -v[:, 1], v[:, 0]
    return out
