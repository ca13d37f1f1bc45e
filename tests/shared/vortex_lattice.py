"""A vortex lattice: flat wings whose wakes trail straight back, without rolling up.

After J. Katz and A. Plotkin, "Low-Speed Aerodynamics" (2nd ed.), sections 10.4.6 and 12.3: each
panel has a horseshoe vortex on its quarter chord and no flow through its middle at three
quarters. Axes: x back, y right, z up; airspeed 1; the quarter chords of the wing lie on x = 0.
"""

import numpy as np
from scipy.linalg import lu_factor, lu_solve

BACK = np.array([1.0, 0.0, 0.0])


def rectangular(span, area):
    return lambda y: np.full_like(y, area / span)


def elliptic(span, area):
    return lambda y: 4.0 * area / (np.pi * span) * np.sqrt(1.0 - (2.0 * y / span) ** 2)


def along_segment(points, start, end, core):
    """Velocity (p, v, 3) per circulation of straight vortices; Katz and Plotkin eq. (2.72)."""
    first, second, whole = points[:, None] - start, points[:, None] - end, end - start
    normal = np.cross(first, second)
    unit1 = first / np.linalg.norm(first, axis=-1, keepdims=True)
    unit2 = second / np.linalg.norm(second, axis=-1, keepdims=True)
    square = np.sum(normal**2, axis=-1) + core**2 * np.sum(whole**2, axis=-1)
    along = np.sum((unit1 - unit2) * whole, axis=-1)
    return normal * (along / square / (4.0 * np.pi))[..., None]


def to_infinity(points, start, core):
    """The same of vortices that start there and go straight back for ever."""
    arm = points[:, None] - start
    normal = np.cross(BACK, arm)
    reach = 1.0 + arm[..., 0] / np.linalg.norm(arm, axis=-1)
    return normal * (reach / (np.sum(normal**2, axis=-1) + core**2) / (4.0 * np.pi))[..., None]


class Wing:
    """A flat wing as chordwise × spanwise horseshoes, closer together towards the tips."""

    def __init__(self, span, area, chord, chordwise=4, spanwise=40):
        self.span, self.area = span, area
        edges = -0.5 * span * np.cos(np.linspace(0.0, np.pi, spanwise + 1))
        middles = 0.5 * (edges[1:] + edges[:-1])
        self.width = np.tile(np.diff(edges), chordwise)
        self.y = np.tile(middles, chordwise)
        self.start, self.end, self.control = [], [], []
        for row in range(chordwise):
            bound = ((row + 0.25) / chordwise - 0.25) * chord(middles)
            control = ((row + 0.75) / chordwise - 0.25) * chord(middles)
            zero = np.zeros_like(middles)
            self.start.append(np.stack([bound, edges[:-1], zero], axis=-1))
            self.end.append(np.stack([bound, edges[1:], zero], axis=-1))
            self.control.append(np.stack([control, middles, zero], axis=-1))
        self.start, self.end, self.control = (
            np.concatenate(each) for each in (self.start, self.end, self.control)
        )
        self.influence = lu_factor(self.upwash_per_circulation(self.control, 0.0))

    def upwash_per_circulation(self, points, core):
        """(p, panels)"""
        velocity = along_segment(points, self.start, self.end, core)
        velocity += to_infinity(points, self.end, core) - to_infinity(points, self.start, core)
        return velocity[..., 2]

    def circulations(self, upwash):
        """(panels,) with which nothing flows through the wing in an upwash (panels,)."""
        return lu_solve(self.influence, -upwash)

    def lift_coefficient(self, circulations):
        return 2.0 * np.sum(circulations * self.width) / self.area

    def wake_delta_cl(self, circulations):
        """Right wing down."""
        moment = np.sum(circulations * self.width * self.y)
        return -2.0 * moment / (self.area * self.span)

    def lift_slope(self):
        return self.lift_coefficient(self.circulations(np.ones(len(self.y))))

    def lifting(self, lift_coefficient):
        flat = self.circulations(np.ones(len(self.y)))
        return flat * lift_coefficient / self.lift_coefficient(flat)

    def behind(self, leader, circulations, offset, core):
        """Circulations (panels,) of this wing in a leader's wake, at an offset (3,) from it."""
        field = leader.upwash_per_circulation(self.control + offset, core)
        return self.circulations(field @ circulations)
