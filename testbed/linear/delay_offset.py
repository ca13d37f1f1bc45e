"""Where followers stay behind a steady leader when their messages are late or lost.

Behind a leader on a straight line, a circle or a helix the law has an equilibrium: all aircraft
turn at the leader's rate, and the integrals of the middle loop make the velocity of each follower
the desired one, but for the speed at which u of (14) is s. The slot errors solve these equations
with messages of known ages. Nothing here depends on the aircraft.

Horizontal vectors are complex numbers, forward + i right of the leader's course. What turns at the
rate Ω was a time A before at exp(-iΩA) times its direction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root

from testbed.core.records import Array, Records
from testbed.formation.control_function import sample_control_functions
from testbed.formation.leader_filter import BROADCAST, TURN

Complex = NDArray[np.complex128]
# of independent losses, that are predicted: 404 in a row are counted; with more hardly a message
# arrives, and a formation is lost before (docs/margins.md, maps)
MAX_LOSS = 0.95
_NEGLIGIBLE = 1e-9  # probability of as many losses in a row
_ROUNDING_S = 1e-9
_NEWTON_STEPS = 30


@dataclass(frozen=True, slots=True)
class SteadyMotion:
    """The motion of a leader.

    Attributes:
        speed: m/s over the ground.
        turn_rate: Ω, rad/s, clockwise if positive.
        climb: m/s.
    """

    speed: float
    turn_rate: float = 0.0
    climb: float = 0.0


@dataclass(frozen=True, slots=True)
class MessageAges:
    """Ages of the messages that n followers use, K of them with their probabilities.

    Attributes:
        age_s: (n, N, K) A, since the state was measured.
        step_s: (n, N, K) e, over which the law extrapolates it.
        share: (n, N, K), 1 in sum.
        interval_s: s, from one message to the next.
        loss: (n, N) probability p of a loss.
    """

    age_s: Array
    step_s: Array
    share: Array
    interval_s: float
    loss: Array


def ages_of_messages(
    delay_s: Array,
    loss: Array,
    after_s: Array,
    interval_s: float,
    *,
    from_timestamp: bool,
) -> MessageAges:
    """Return the ages of the messages that are used at control steps.

    A message is used from the first control step after its delay, until the next one arrives. With
    independent losses the newest message comes after m lost ones with the probability (1 - p) p^m.

    Args:
        delay_s: (n, N) d of the links.
        loss: (n, N) p of the links, at most MAX_LOSS.
        after_s: (n, N, C) from a transmission to each of the control steps after which the pattern
            of transmissions and control steps repeats.
        interval_s: from one transmission to the next.
        from_timestamp: the law extrapolates from the time of measurement, not of receipt.
    """
    most = float(loss.max(initial=0.0))
    count = 1 if most == 0.0 else math.ceil(math.log(_NEGLIGIBLE) / math.log(most))
    lost = np.arange(count)
    waited = np.mod(after_s - delay_s[..., np.newaxis] + _ROUNDING_S, interval_s) - _ROUNDING_S
    since_receipt = (waited[..., np.newaxis] + interval_s * lost).reshape(*delay_s.shape, -1)
    chance = loss[..., np.newaxis] ** lost
    chance /= chance.sum(axis=-1, keepdims=True)
    steps = after_s.shape[-1]
    share = np.tile(chance[..., np.newaxis, :] / steps, (1, 1, steps, 1))
    age = since_receipt + delay_s[..., np.newaxis]
    step = age if from_timestamp else since_receipt
    return MessageAges(age, step, share.reshape(age.shape), interval_s, loss)


class _Late(NamedTuple):
    """What messages show of the motion at their use, in the mean; (n, N) each.

    Attributes:
        behind: complex s, of the horizontal position: q - `behind` v is used for q.
        below: s, the same of the height.
        velocity: complex, factor of the horizontal velocity.
        frame: complex, direction of that velocity.
        acceleration: complex, factor of the horizontal acceleration, as measured.
        speed: factor of the horizontal speed.
    """

    behind: Complex
    below: Array
    velocity: Complex
    frame: Complex
    acceleration: Complex
    speed: Array


def _late(turn_rate: float, ages: MessageAges, parabola: Array) -> _Late:
    """Average what the messages show.

    Args:
        turn_rate: Ω, rad/s.
        ages: of the messages.
        parabola: (n,) 0 or 1: positions are extrapolated along a parabola.
    """
    age, step = ages.age_s, ages.step_s
    spin = 1j * turn_rate
    turned = np.exp(-spin * age)
    bend = spin * step * parabola[:, np.newaxis, np.newaxis]
    # what was flown since, ∫ exp(-iΩt) dt from 0 to A, as a product that is exact for small Ω
    flown = age * np.sinc(turn_rate * age / (2.0 * math.pi)) * np.exp(-0.5 * spin * age)
    velocity = turned * (1.0 + bend)
    parts = (
        flown - step * turned * (1.0 + 0.5 * bend),
        age - step,
        velocity,
        velocity / np.abs(velocity),
        turned,
        np.abs(velocity),
    )
    return _Late(*((ages.share * each).sum(axis=-1) for each in parts))


def _filtered(turn_rate: float, ages: MessageAges, blend: Array) -> Complex:
    """Return the factor (n,) by which the running average of the leader's acceleration lags.

    Args:
        turn_rate: Ω, rad/s.
        ages: of the messages.
        blend: (n,) share of a new message in the average.
    """
    p, turned = ages.loss[:, 0], np.exp(-1j * turn_rate * ages.interval_s)
    before = (1.0 - p) * turned / (1.0 - p * turned)  # of the message before, in the mean
    factor: Complex = blend / (1.0 - (1.0 - blend) * before)
    return factor


def steady_offsets(
    motion: SteadyMotion, law: Records, gains: Array, offsets: Array, ages: MessageAges
) -> Array:
    """Return the steady slot errors (n, 3), m, forward, right and down of the leader's course.

    NaN: there is none that the solver finds.

    Args:
        motion: of the leader.
        law: (n,) of LAW.
        gains: β (n, N, 3), forward, right, down; in a turn the first two are equal.
        offsets: υ (N, 3) m.
        ages: of the messages.
    """
    equations = _Equilibrium(motion, law, gains, offsets, ages)
    start = equations.slots.ravel()
    found = root(equations.residual, start, tol=1e-10)
    if not found.success and np.abs(found.fun).max() > 1e-6:
        return np.full((len(law), 3), np.nan)
    errors: Array = found.x.reshape(-1, 3) - equations.slots
    return errors


class _Equilibrium:
    """The equations of a steady flight.

    Attributes:
        slots: (n, 3) m, forward, right and down of the leader.
    """

    def __init__(
        self, motion: SteadyMotion, law: Records, gains: Array, offsets: Array, ages: MessageAges
    ) -> None:
        self._law, self._gains, self._offsets = law, gains, offsets
        self._turn, self._climb = 1j * motion.turn_rate, motion.climb
        self._speed = math.sqrt(motion.speed**2 - motion.climb**2)
        self._late = _late(motion.turn_rate, ages, law["with_acceleration"].astype(float))
        self._horizontal = law["horizontal"]
        source = law["acceleration_source"]
        lag = _filtered(motion.turn_rate, ages, law["acceleration_blend"][:, 0])
        measured = self._late.acceleration[:, 0] * lag
        turning = np.where(source == TURN, self._late.frame[:, 0], 0.0)
        # q̈_g of (10), as estimated
        acceleration = np.where(source == BROADCAST, measured, turning)
        self._acceleration: Complex = self._turn * self._speed * acceleration
        across, down = self._resolve(np.ones(len(law)))
        rows = law["row"]
        own = np.arange(len(law))
        self.slots = np.stack(
            (across[own, rows].real, across[own, rows].imag, down[own, rows]), axis=-1
        )

    def _resolve(self, speed: Array) -> tuple[Complex, Array]:
        """Return χ (n, N) of all offsets in velocity frames: across, without the turn, and down.

        Args:
            speed: (n,) factor of the leader's horizontal speed.
        """
        along = self._speed * speed
        climb = np.where(self._horizontal, 0.0, self._climb)
        cosine, sine = (each / np.hypot(along, climb) for each in (along, climb))
        x, y, z = self._offsets.T
        forward = np.outer(cosine, x) + np.outer(sine, z)
        return forward + 1j * y, np.outer(cosine, z) - np.outer(sine, x)

    def residual(self, places: Array) -> Array:
        """Return the velocities (3n,), m/s, that the law desires beyond those of the motion.

        Args:
            places: (3n,) m, forward, right and down of the leader.
        """
        law, late, turn, climb = self._law, self._late, self._turn, self._climb
        place = places.reshape(-1, 3)
        at = np.concatenate(([0.0], place[:, 0] + 1j * place[:, 1]))
        down = np.concatenate(([0.0], place[:, 2]))
        velocity = self._speed + turn * at
        own_at, own_down = at[1:, np.newaxis], down[1:, np.newaxis]
        own_velocity = velocity[1:]
        across, below = self._resolve(late.speed[:, 0])
        across = across * late.frame[:, :1]
        own = np.arange(len(law)), law["row"]
        slot, slot_down = across[own], below[own]

        # ξ and its derivative as the law has it, (6)
        apart = (at - late.behind * velocity - across) - (own_at - slot[:, np.newaxis])
        rising = (down + climb * late.below - below) - (own_down - slot_down[:, np.newaxis])
        change = (late.velocity * velocity - turn * across) - (own_velocity - turn * slot)[
            :, np.newaxis
        ]
        forward_gain, right_gain, down_gain = np.moveaxis(self._gains, -1, 0)
        vertical = ~self._horizontal
        xi = _weighted(forward_gain, right_gain, apart)
        xi_down = vertical * (down_gain * rising).sum(axis=1)
        xi_rate = _weighted(forward_gain, right_gain, change)

        # (7) to (12)
        value, slope = sample_control_functions(law["mu"], np.abs(xi) ** 2 + xi_down**2)
        along = 2.0 * slope * (np.conj(xi) * xi_rate).real
        k = law["k"]
        desired = late.velocity[:, 0] * self._speed + turn * slot + k * value * xi
        desired_down = k * value * xi_down - climb * vertical
        rate = self._acceleration + turn * turn * slot + k * (value * xi_rate + along * xi)
        rate_down = k * along * xi_down
        speed = np.sqrt(np.abs(desired) ** 2 + desired_down**2)
        speed_rate = ((np.conj(desired) * rate).real + desired_down * rate_down) / speed
        limited = np.clip(speed, law["speed_desired_min"], law["speed_desired_max"])
        excess = _speed_excess(law, np.where(limited == speed, speed_rate, 0.0))
        factor = (limited + excess) / speed
        ahead = factor * desired - own_velocity
        sinking = np.where(vertical, factor * desired_down + climb, self.slots[:, 2] - place[:, 2])
        return np.stack((ahead.real, ahead.imag, sinking), axis=-1).ravel()


def _weighted(forward: Array, right: Array, vectors: Complex) -> Complex:
    """Return the sums (n,) of vectors (n, N) with gains (n, N) forward and right."""
    total: Complex = (forward * vectors.real + 1j * right * vectors.imag).sum(axis=1)
    return total


def _speed_excess(law: Records, rate: Array) -> Array:
    """Return s - s_d (n,), m/s, at which u of (14) is s: a x + b x³ = ṡ_d, with h of 1."""
    a, b = law["a"], law["b"]
    excess: Array = rate / a
    for _ in range(_NEWTON_STEPS):
        excess = excess - (a * excess + b * excess**3 - rate) / (a + 3.0 * b * excess**2)
    return excess
