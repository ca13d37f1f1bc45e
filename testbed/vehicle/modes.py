"""Natural modes of an aircraft: eigenvalues with names.

A mode is named by the states that take part in it. The participation of state k in mode i,
|W_ik V_ki| with the right eigenvectors in V and W = V⁻¹, summing to 1 over the states, does not
depend on the units of the states.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.vehicle.linearize import STATES

_LONGITUDINAL = ("u", "w", "q", "theta", "n")
_FIT = 0.4  # smallest participation of the states that name a mode
_REAL = 1e-9  # 1/s: an eigenvalue with a smaller imaginary part is real


@dataclass(frozen=True, slots=True)
class Mode:
    """A real eigenvalue, or a complex pair given by its upper member."""

    name: str  # "unclassified" if the participation fits no known mode
    eigenvalue: complex  # 1/s
    participation: dict[str, float]  # by state, sums to 1

    @property
    def oscillates(self) -> bool:
        """Whether the mode is a complex pair."""
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
        """−1 / Re λ, s, negative if the mode grows; None if it neither grows nor decays."""
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


def find_modes(a: Array) -> tuple[Mode, ...]:
    """Find the modes of ẋ = A x with A (9, 9) over `linearize.STATES`, the fastest first.

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
        participation = dict(zip(STATES, column.tolist(), strict=True))
        fit, name = _best_name(participation, oscillates=eigenvalue.imag > 0.0)
        found.append((fit, name, eigenvalue, participation))
    taken: set[str] = set()
    modes = []
    for _, name, eigenvalue, participation in sorted(found, key=lambda one: -one[0]):
        modes.append(Mode("unclassified" if name in taken else name, eigenvalue, participation))
        taken.add(name)
    return tuple(sorted(modes, key=lambda mode: -mode.frequency))


def _best_name(part: dict[str, float], *, oscillates: bool) -> tuple[float, str]:
    """Return the fit of the best name, 0..1, and the name."""
    if sum(part[name] for name in _LONGITUDINAL) > 0.5:
        names = (
            {"short period": ("w", "q"), "phugoid": ("u", "theta")}
            if oscillates
            else {"propeller": ("n",)}
        )
    else:
        names = {"Dutch roll": ("v", "r")} if oscillates else {"roll": ("p",), "spiral": ("phi",)}
    fits = {name: sum(part[state] for state in states) for name, states in names.items()}
    best = max(fits, key=lambda name: fits[name])
    return (fits[best], best) if fits[best] > _FIT else (0.0, "unclassified")
