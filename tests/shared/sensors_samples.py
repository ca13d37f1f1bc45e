"""Flights along which sensors and filters are tested, and tests of samples against chance."""

from typing import NamedTuple

import numpy as np
from reference import adapters_sensors as kernels
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, ttest_1samp

from testbed.core.frames import GRAVITY, wrap_pi
from testbed.core.records import FaultState, VehicleState, allocate
from testbed.scenario.sensors import Sensors
from testbed.sensors.ekf import WIND, make_filters, start_filters
from testbed.sensors.estimators import make_settings
from testbed.sensors.sensor_errors import ERRORS

SEED = 1
# The tests of the sensors ask some 400 times whether chance explains a deviation. Bonferroni: at
# this level, sensors that are right fail one or more of them for one seed in a hundred.
LEVEL = 0.01 / 400
BATCHES = 50
INCIDENCE = 0.05  # rad, angle of attack of every flight
THINNER = 1.05  # TAS over EAS of every flight
RADIUS = 120.0  # m, of the turns
SPEED = 20.0  # m/s through the air


def suite(*presets, **keys):
    """Sensors by keys of a scenario, or by presets with keys on top."""
    (like,) = presets or ("truth",)
    return Sensors.model_validate({"preset": like, **keys})


def assert_chance(p_value):
    assert p_value > LEVEL


def assert_means(samples, expected):
    """Independent samples (n, ...) have these means (...): Student's test of each."""
    assert_chance(ttest_1samp(samples, expected, axis=0).pvalue.min())


def assert_mean_in_time(values, expected):
    """Values that depend on near ones only have this mean: Student's test of means of batches."""
    batches = np.array([each.mean(axis=0) for each in np.array_split(values, BATCHES)])
    assert_means(batches, expected)


def assert_variances(samples, expected):
    """Independent normal samples (n, ...) of mean zero have these variances (...)."""
    n = len(samples)
    ratio = (np.asarray(samples) ** 2).sum(axis=0) / expected
    assert_chance(2.0 * np.minimum(chi2.cdf(ratio, n), chi2.sf(ratio, n)).min())


class Flight(NamedTuple):
    """A flight as one aircraft makes it, K steps.

    Velocity is the sum of accelerations, position of velocities, and attitude the product of
    turns, step by step: integration by the same rule gives them to rounding.
    """

    position: np.ndarray  # (K, 3)
    velocity: np.ndarray  # (K, 3)
    acceleration: np.ndarray  # (K, 3)
    rotation: np.ndarray  # (K, 3, 3) R_NB
    euler: np.ndarray  # (K, 3)
    rates: np.ndarray  # (K, 3)
    airspeed: np.ndarray  # (K,)
    wind: np.ndarray  # (3,)
    rate_hz: int

    @property
    def motion(self):
        """The motion, step by step: (K, ...) each."""
        vectors = (self.position, self.velocity, self.acceleration, self.euler, self.rates)
        return VehicleState(*vectors, self.airspeed, self.airspeed / THINNER)

    def at(self, k, aircraft=1):
        """The motion at a step of so many aircraft that fly it side by side."""
        return VehicleState(*(np.repeat(each[k][None], aircraft, axis=0) for each in self.motion))

    def write(self, k, truth):
        """Write the motion at a step over one made by `at`."""
        for array, each in zip(truth, self.motion, strict=True):
            array[...] = each[k]

    def __len__(self):
        return len(self.airspeed)


def make_flight(rate_hz, *legs, wind=(3.0, -2.0, 0.0), heading=0.3, speed=SPEED):
    """Coordinated flight: straight, in turns and climbs that take 2 s to begin and to end.

    Args:
        rate_hz: of its steps.
        legs: of (duration s, turn -1, 0 or 1 to the right, flight-path angle in still air rad).
        wind: m/s
        heading: of the air's velocity at first, rad.
        speed: m/s, true airspeed.
    """
    dt = 1.0 / rate_hz
    ramp = np.ones(2 * rate_hz) / (2 * rate_hz)
    turn, climb = (
        np.concatenate([np.full(round(leg[0] * rate_hz), float(leg[which])) for leg in legs])
        for which in (1, 2)
    )
    turn, climb = (
        np.convolve(np.concatenate([np.full(len(ramp) - 1, each[0]), each]), ramp, "valid")
        for each in (turn * speed / RADIUS, climb)
    )
    course = heading + dt * (np.cumsum(turn) - turn[0])
    bank = np.arctan(turn * speed / GRAVITY)
    # the air comes from ahead and from below the nose: no slip
    along = Rotation.from_euler("ZYX", np.stack([course, climb, bank], axis=1))
    body = along * Rotation.from_euler("Y", INCIDENCE)
    velocity = speed * along.as_matrix()[:, :, 0] + wind
    steps = np.diff(velocity, axis=0, prepend=velocity[:1])
    position = np.cumsum(dt * velocity, axis=0) - dt * velocity
    turned = (body[:-1].inv() * body[1:]).as_rotvec() / dt
    return Flight(
        position=position + np.array([40.0, -70.0, -100.0]),
        velocity=velocity,
        acceleration=steps / dt,
        rotation=body.as_matrix(),
        euler=body.as_euler("ZYX")[:, ::-1],
        rates=np.concatenate([np.zeros((1, 3)), turned]),
        airspeed=np.full(len(velocity), speed),
        wind=np.array(wind),
        rate_hz=rate_hz,
    )


def no_faults(n):
    """FaultState of n aircraft in which nothing fails."""
    none = np.zeros(n, dtype=bool)
    return FaultState(
        power=np.ones(n),
        stuck=np.zeros((n, 5), dtype=bool),
        stuck_at=np.full((n, 5), np.nan),
        floating=np.zeros((n, 5), dtype=bool),
        floats=np.zeros((n, 5)),
        frozen=none,
        charge=np.full(n, np.nan),
        pitot_blocked=none,
        pitot_drained=none,
        gps_lost=none,
        gps_jump=np.zeros((n, 3)),
        transmitter_off=none,
    )


class Filters:
    """The kernels of navigation filters along a flight, with sensor errors that the test gives.

    Args:
        pages: the sensors of each filter.
        flight: of all of them.
    """

    def __init__(self, suites, flight):
        """Switched on before the first step."""
        self.flight, self.n = flight, len(suites)
        self.settings = make_settings(suites, flight.rate_hz)
        states = np.zeros((self.n, 17))
        states[:, WIND:] = flight.wind[:2]
        before = flight.position[0] - flight.velocity[0] / flight.rate_hz
        motion = np.tile(before, (self.n, 1)), np.tile(flight.velocity[0], (self.n, 1))
        self.filters, self.past = make_filters(self.settings)
        start_filters(self.filters, self.past, -1, flight.rate_hz, states, *motion)

    @property
    def states(self):
        return self.filters["states"]

    @property
    def covariance(self):
        return self.filters["covariance"]

    def sensed(self, k, **wrong):
        """What is measured at a step, airspeed ten times in a second; exact but for `wrong`."""
        truth = self.flight.at(k, self.n)
        right = {
            "errors": allocate(ERRORS, self.n),
            "heading_bias": np.zeros(self.n),
            "equivalent_airspeed": truth.equivalent_airspeed,
            "airspeed": truth.airspeed,
            "airspeed_sampled": np.full(self.n, (10 * k) % self.flight.rate_hz < 10),
            "gps_lost": np.zeros(self.n, dtype=bool),
            "gps_jump": np.zeros((self.n, 3)),
        }
        return {**right, **wrong}

    def step(self, k, truth=None, **wrong):
        """Errors (N, 9) that are flown on after a step."""
        truth = self.flight.at(k, self.n) if truth is None else truth
        own = self.settings, self.filters, self.past
        sensed = self.sensed(k, **wrong)
        return kernels.ekf_step(*own, k, self.flight.rate_hz, truth, **sensed)

    def run(self, first, end, **wrong):
        """Errors (K, N, 9) that are flown on, from the first step to before the end."""
        return np.array([self.step(k, **wrong) for k in range(first, end)])


class Ins:
    """A strapdown INS with a Kalman filter, on what sensors measure: the second route.

    It knows no errors: it turns an attitude matrix by measured rates, integrates measured forces,
    and corrects with measurements by the slopes at its estimate. Its covariance steps with it.

    Args:
        flight: whose first motion, and wind, it knows.
        settings: what it takes its sensors to be.
        sigma: standard deviations (17,) at first.
    """

    def __init__(self, flight, settings, sigma):
        """Switched on before the first step."""
        n = len(settings["gate"])
        self.settings, self.dt = settings, 1.0 / flight.rate_hz
        self.rotation = np.tile(flight.rotation[0], (n, 1, 1))
        start = np.concatenate(
            [flight.velocity[0], flight.position[0] - self.dt * flight.velocity[0]]
        )
        self.x = np.zeros((n, 17))  # but for the attitude, in the order of the filter's states
        self.x[:, 3:9], self.x[:, 15:] = start, flight.wind[:2]
        self.covariance = np.tile(np.diag(sigma**2), (n, 1, 1))
        # velocity and position that it has estimated, the newest last; straight on before
        ago = np.arange(int(settings["assumed_latency"].max()), -1, -1) * self.dt
        self.history = [
            np.tile(np.concatenate([start[:3], start[3:] - each * start[:3]]), (n, 1))
            for each in ago
        ]

    def predict(self, gyro, force):
        """One step with measured rates and specific force (N, 3)."""
        x, dt = self.x, self.dt
        self.rotation = self.rotation @ Rotation.from_rotvec((gyro - x[:, 9:12]) * dt).as_matrix()
        specific_force = np.einsum("nij,nj->ni", self.rotation, force - x[:, 12:15])
        x[:, 6:9] += dt * x[:, 3:6]
        x[:, 3:6] += dt * (specific_force + [0.0, 0.0, GRAVITY])
        flow = np.zeros_like(self.covariance)
        flow[:, :3, 9:12] = flow[:, 3:6, 12:15] = -self.rotation
        flow[:, 3:6, :3] = -np.cross(specific_force[:, None, :], np.eye(3)).swapaxes(1, 2)
        flow[:, 6:9, 3:6] = np.eye(3)
        step = np.eye(17) + dt * flow
        self.covariance = step @ self.covariance @ step.swapaxes(1, 2)
        self.covariance[:, range(17), range(17)] += self.settings["process"] * dt
        self.history = [*self.history[1:], x[:, 3:9].copy()]

    def correct(self, slope, innovation, sigma, mask=True):
        """Take in one number: belief minus measurement (N,), by its slope (N, 17)."""
        along = np.einsum("nij,nj->ni", self.covariance, slope)
        gain = along / ((along * slope).sum(axis=1) + sigma**2)[:, None]
        gain = np.where(np.broadcast_to(mask, len(gain))[:, None], gain, 0.0)
        self.covariance = self.covariance - gain[:, :, None] * along[:, None, :]
        change = -gain * innovation[:, None]
        self.rotation = Rotation.from_rotvec(change[:, :3]).as_matrix() @ self.rotation
        self.x[:, 3:] += change[:, 3:]
        for each in self.history:
            each += change[:, 3:9]

    def fix(self, velocity, position, mask):
        """A GPS's velocity and position (N, 3), of the moment that it is taken for."""
        rows, ago = np.arange(len(self.x)), -1 - self.settings["assumed_latency"]
        for measured, noise, first, axes in (
            (velocity, self.settings["fix_noise"][:, :3], 0, 3),
            (position, self.settings["fix_noise"][:, 3:], 3, 2),
        ):
            for axis in range(axes):
                estimated = np.array(self.history)[ago, rows, first + axis]
                slope = np.zeros_like(self.x)
                slope[:, 3 + first + axis] = 1.0
                self.correct(slope, estimated - measured[:, axis], noise[:, axis], mask)

    def height(self, down):
        """A barometer's height, as the third axis of a position (N,)."""
        slope = np.zeros_like(self.x)
        slope[:, 8] = 1.0
        self.correct(slope, self.x[:, 8] - down, self.settings["fix_noise"][:, 5])

    def compass(self, yaw):
        """The third Euler angle (N,)."""
        euler = Rotation.from_matrix(self.rotation).as_euler("ZYX")
        slope = np.zeros_like(self.x)
        rise = np.tan(euler[:, 1])
        slope[:, 0], slope[:, 1] = np.cos(euler[:, 0]) * rise, np.sin(euler[:, 0]) * rise
        slope[:, 2] = 1.0
        self.correct(slope, wrap_pi(euler[:, 0] - yaw), self.settings["heading_noise"])

    def air(self, tas, eas):
        """The true airspeed (N,), then that the air has no lateral share in body axes."""
        through = self._through()
        speed = np.linalg.norm(through, axis=1)
        slope = np.zeros_like(self.x)
        slope[:, 3:6] = through / speed[:, None]
        slope[:, 15:] = -slope[:, 3:5]
        self.correct(slope, speed - tas, self.settings["airspeed_noise"] * tas / eas)
        through = self._through()
        ahead, aside, _ = np.einsum("nji,nj->in", self.rotation, through)
        # the whole slope of the quotient, by the velocity in body axes and then by the states
        by_body = np.stack([-aside / ahead**2, 1.0 / ahead, 0.0 * ahead], axis=1)
        by_ned = np.einsum("nij,nj->ni", self.rotation, by_body)
        slope = np.zeros_like(self.x)
        slope[:, 3:6], slope[:, 15:] = by_ned, -by_ned[:, :2]
        slope[:, :3] = np.cross(by_ned, through)
        self.correct(slope, aside / ahead, np.full(len(ahead), np.sqrt(0.03)))

    def _through(self):
        through = self.x[:, 3:6].copy()
        through[:, :2] -= self.x[:, 15:]
        return through
