"""Linearise about trim, ẋ = A x + B u, and find natural modes.

Derivatives are central differences. The states are the body velocities u, w, v, the rates q, p, r,
the pitch θ, the bank φ and the propeller's speed n. Heading and position are left out, so the air
density is that at the trim. The controls are those of the trim, and the surfaces are at their
commanded positions: servo lag is not a state. Terms in α̇ are in A, because JSBSim evaluates them
with the accelerations of the same time.

The propeller's speed cannot be set in JSBSim. It is changed by letting the propeller settle at a
slightly different throttle, and its acceleration is measured over one step of 10 µs. The throttle
of an engine that burns fuel moves pressures and temperatures too, which lag: there the propeller
settles at a slightly different airspeed. The power of such an engine is that of its throttle; its
lag is not a state. A propeller that a governor keeps at its speed, and an aircraft without
propeller, have no state n.

A mode is an eigenvalue, named by the states that take part in it. The participation of state k in
mode i, |W_ik V_ki| with the right eigenvectors in V and W = V⁻¹, summing to 1 over the states, does
not depend on the units of the states.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from testbed.core.frames import euler_rates
from testbed.core.records import Array
from testbed.vehicle.trim import Controls, Placement, TrimModel, TrimResult, Vector

# Longitudinal first; the heading is not a state.
STATES = ("u", "w", "q", "theta", "n", "v", "p", "r", "phi")
UNITS = ("m/s", "m/s", "rad/s", "rad", "rev/s", "m/s", "rad/s", "rad/s", "rad")
CONTROLS = ("aileron", "elevator", "rudder", "throttle")
_STEPS = {
    "u": 0.01,
    "w": 0.01,
    "v": 0.01,
    "p": 1e-3,
    "q": 1e-3,
    "r": 1e-3,
    "theta": 1e-4,
    "phi": 1e-4,
}
_CONTROL_STEP = 1e-3
_THROTTLE_STEP = 0.01  # changes the propeller's speed
_AIRSPEED_STEP = 0.01  # of the airspeed; the same of an engine that burns fuel
_GOVERNED = 1e-4  # relative change of the speed, below which a governor keeps it


class LinearModel(TrimModel, Protocol):
    """A flight model with the acceleration of its propeller."""

    has_propeller: bool
    throttle_lags: bool  # the power follows the throttle with a lag

    def propeller_acceleration(self) -> float:
        """Return the rate of change of the propeller's speed, revolutions per s²."""


@dataclass(frozen=True, slots=True)
class Linear:
    """A and B about a trim, in the order of its k states and of CONTROLS."""

    trim: TrimResult
    states: tuple[str, ...]  # of STATES: all, or all but n
    a: Array  # (k, k)
    b: Array  # (k, 4)


def linearize(model: LinearModel, trim: TrimResult) -> Linear:
    """Linearise a flight model about a trim, at the position of the trim."""
    held, a, b = trim.controls, np.empty((9, 9)), np.empty((9, 4))
    propeller = _of_propeller(model, trim)
    for j, name in enumerate(STATES):
        if name == "n":
            a[:, j] = 0.0 if propeller is None else propeller
        else:
            step = _STEPS[name]
            _, back = _evaluate(model, trim, _moved(trim.placement, name, -step), held)
            _, ahead = _evaluate(model, trim, _moved(trim.placement, name, step), held)
            a[:, j] = (ahead - back) / (2.0 * step)
    for j, name in enumerate(CONTROLS):
        low, high = _within(name, getattr(held, name), _CONTROL_STEP)
        settled = name == "throttle" and model.throttle_lags
        slow, back = _evaluate_control(model, trim, name, low, settled=settled)
        fast, ahead = _evaluate_control(model, trim, name, high, settled=settled)
        change = ahead - back
        if settled and propeller is not None:
            change -= propeller * (fast - slow)
        b[:, j] = change / (high - low)
    kept = [j for j, name in enumerate(STATES) if name != "n" or propeller is not None]
    return Linear(trim, tuple(STATES[j] for j in kept), a[np.ix_(kept, kept)], b[kept])


def _of_propeller(model: LinearModel, trim: TrimResult) -> Array | None:
    """Return the derivatives (9,) by the propeller's speed; None: it is no state."""
    if not model.has_propeller:
        return None
    if model.throttle_lags:
        (slow, back), (fast, ahead) = (
            _evaluate(model, trim, trim.placement, trim.controls, airspeed=1.0 + change)
            for change in (-_AIRSPEED_STEP, _AIRSPEED_STEP)
        )
    else:
        (slow, back), (fast, ahead) = (
            _evaluate(model, trim, trim.placement, trim.controls, throttle=each)
            for each in _within("n", trim.controls.throttle, _THROTTLE_STEP)
        )
    if abs(fast - slow) < _GOVERNED * abs(fast):
        return None
    derivatives: Array = (ahead - back) / (fast - slow)
    return derivatives


def _evaluate_control(
    model: LinearModel, trim: TrimResult, name: str, value: float, *, settled: bool
) -> tuple[float, Array]:
    """Return the propeller's speed and ẋ (9,) with one control moved; settled: at its throttle."""
    moved = replace(trim.controls, **{name: value})
    throttle = value if settled else trim.controls.throttle
    return _evaluate(model, trim, trim.placement, moved, throttle=throttle)


def _evaluate(
    model: LinearModel,
    trim: TrimResult,
    placement: Placement,
    controls: Controls,
    *,
    throttle: float | None = None,
    airspeed: float = 1.0,
) -> tuple[float, Array]:
    """Return the propeller's speed and ẋ (9,) of a placement.

    The propeller has settled in the trim, at a throttle, by default that of the trim, and at so
    many times its airspeed.
    """
    idle = trim.controls.throttle if throttle is None else throttle
    settling = trim.placement
    if airspeed != 1.0:
        u, v, w = (airspeed * each for each in settling.velocity_body)
        settling = replace(settling, velocity_body=(u, v, w))
    model.accelerations(settling, replace(controls, throttle=idle), spin=True)
    speed = model.propeller_rps
    du, dv, dw, dp, dq, dr = model.accelerations(placement, controls, spin=False).tolist()
    attitude = np.array([placement.roll, placement.pitch, 0.0])
    dphi, dtheta, _ = euler_rates(attitude, np.array(placement.rates_body)).tolist()
    dn = model.propeller_acceleration() if model.has_propeller else 0.0
    return speed, np.array([du, dw, dq, dtheta, dn, dv, dp, dr, dphi])


def _moved(placement: Placement, name: str, change: float) -> Placement:
    if name == "theta":
        return replace(placement, pitch=placement.pitch + change)
    if name == "phi":
        return replace(placement, roll=placement.roll + change)
    if name in "uvw":
        return replace(
            placement, velocity_body=_added(placement.velocity_body, name, "uvw", change)
        )
    return replace(placement, rates_body=_added(placement.rates_body, name, "pqr", change))


def _added(values: Vector, name: str, names: str, change: float) -> Vector:
    first, second, third = (
        value + change if each == name else value for each, value in zip(names, values, strict=True)
    )
    return first, second, third


def _within(name: str, value: float, step: float) -> tuple[float, float]:
    """Return two values of a control around a value, within its travel."""
    least = -1.0 if name in ("aileron", "elevator", "rudder") else 0.0
    return max(value - step, least), min(value + step, 1.0)


_LONGITUDINAL = ("u", "w", "q", "theta", "n")
_FIT = 0.4  # smallest participation of the states that name a mode
_REAL = 1e-9  # 1/s: an eigenvalue with a smaller imaginary part is real


@dataclass(frozen=True, slots=True)
class NaturalMode:
    """A real eigenvalue, or a complex pair given by its upper member."""

    name: str  # "unclassified" if the participation fits no known mode
    eigenvalue: complex  # 1/s
    participation: dict[str, float]  # by state, sums to 1

    @property
    def oscillates(self) -> bool:
        """Return whether the mode is a complex pair."""
        return self.eigenvalue.imag > 0.0

    @property
    def frequency(self) -> float:
        """Undamped natural frequency |λ|, rad/s."""
        return abs(self.eigenvalue)

    @property
    def damping(self) -> float | None:
        """Damping ratio of a pair, negative if it grows."""
        return -self.eigenvalue.real / abs(self.eigenvalue) if self.oscillates else None

    @property
    def time_constant(self) -> float | None:
        """−1 / Re λ, s, negative if the mode grows; None without a real part."""
        return -1.0 / self.eigenvalue.real if self.eigenvalue.real else None

    @property
    def period(self) -> float | None:
        """Period of a pair, s; None for a real mode."""
        return 2.0 * math.pi / self.eigenvalue.imag if self.oscillates else None

    @property
    def half_or_double(self) -> float | None:
        """Time to half the amplitude, or to twice it if the mode grows, s."""
        rate = abs(self.eigenvalue.real)
        return math.log(2.0) / rate if rate else None


def find_modes(a: Array, states: tuple[str, ...] = STATES) -> tuple[NaturalMode, ...]:
    """Find the modes of A (k, k) over its states, the fastest first.

    Longitudinal pairs are the short period (largest participation of w and q) and the phugoid (u
    and θ). The lateral pair is the Dutch roll (v and r), and real lateral modes are roll (p) and
    spiral (φ); the real mode of n is the propeller's. Each name is used once, for the mode that it
    fits best; the others are unclassified.
    """
    values, right = np.linalg.eig(a)
    share = np.abs(right * np.linalg.inv(right).T)
    share /= share.sum(axis=0)
    found: list[tuple[float, str, complex, dict[str, float]]] = []
    for value, column in zip(values, share.T, strict=True):
        if value.imag < -_REAL:
            continue
        eigenvalue = complex(value) if value.imag > _REAL else complex(value.real, 0.0)
        # the two members of a pair have the same participation
        participation = dict(zip(states, column.tolist(), strict=True))
        fit, name = _best_name(participation, oscillates=eigenvalue.imag > 0.0)
        found.append((fit, name, eigenvalue, participation))
    taken: set[str] = set()
    modes = []
    for _, name, eigenvalue, participation in sorted(found, key=lambda one: -one[0]):
        modes.append(
            NaturalMode("unclassified" if name in taken else name, eigenvalue, participation)
        )
        taken.add(name)
    return tuple(sorted(modes, key=lambda mode: -mode.frequency))


def _best_name(part: dict[str, float], *, oscillates: bool) -> tuple[float, str]:
    """Return the fit of the best name, 0..1, and the name."""
    if sum(part.get(name, 0.0) for name in _LONGITUDINAL) > 0.5:
        names = (
            {"short period": ("w", "q"), "phugoid": ("u", "theta")}
            if oscillates
            else {"propeller": ("n",)}
        )
    else:
        names = {"Dutch roll": ("v", "r")} if oscillates else {"roll": ("p",), "spiral": ("phi",)}
    fits = {name: sum(part.get(state, 0.0) for state in states) for name, states in names.items()}
    best = max(fits, key=lambda name: fits[name])
    return (fits[best], best) if fits[best] > _FIT else (0.0, "unclassified")
