"""Draw each airframe as meshes made in code: no asset files.

Body axes, metres, the centre of gravity at the origin. Airframes are found by name; one without a
drawing is drawn as a generic aeroplane of its wingspan.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from testbed.core.records import Array
from testbed.views.meshes import (
    DARK,
    LIGHT,
    MAIN,
    Mesh,
    cut_control_surface,
    disc,
    fuselage,
    join,
    mirror,
    move,
    rod,
    surface,
    wheel,
    wing,
)

AILERON, ELEVATOR, RUDDER = np.eye(3)
RASCAL_TRAVEL = np.radians(20.0)  # by eye: its flight model has no deflection angles
ELEVON_TRAVEL = np.radians(35.0)  # as in the X8's SOURCE.md


@dataclass(frozen=True, slots=True)
class ControlSurface:
    """A control surface and its hinge."""

    name: str
    mesh: Mesh  # relative to the hinge's inner end
    hinge: Array  # (3,) m, the hinge's inner end
    axis: Array  # (3,) unit: a positive angle moves the trailing edge down, or to the right
    mix: Array  # (3,) of aileron, elevator and rudder, -1..1, to the fraction of its travel
    travel: float  # rad, at most

    def quaternion(self, deflection: Array) -> Array:
        """Rotate by deflections (m, 3) of aileron, elevator and rudder; (m, 4) x, y, z, w."""
        half = 0.5 * self.travel * np.clip(deflection @ self.mix, -1.0, 1.0)[:, None]
        return np.concatenate([np.sin(half) * self.axis, np.cos(half)], axis=-1)


@dataclass(frozen=True, slots=True)
class AirframeDrawing:
    """The meshes of one aircraft."""

    body: Mesh
    disc: Mesh | None  # of the propeller, drawn translucent
    control_surfaces: tuple[ControlSurface, ...] = ()


def control_surface(
    name: str, moving: Array, mix: Array, travel: float, axis: int = 1
) -> ControlSurface:
    """Make a control surface of sections (k, 4), hinged at its leading edges.

    Args:
        name: of the entity.
        moving: sections from the inner end to the outer.
        mix: see `ControlSurface`.
        travel: see `ControlSurface`.
        axis: body axis of the hinge: 1 right, or 2 up for a fin.
    """
    hinge = moving[0, :3]
    along = moving[-1, :3] - hinge
    along = along / np.linalg.norm(along)
    forward = along[1] > 0.0 if axis == 1 else along[2] < 0.0
    # thicker relative to its own chord, as it is the rear of a larger surface
    mesh = surface(moving - [*hinge, 0.0], LIGHT, 0.2)
    return ControlSurface(name, mesh, hinge, along if forward else -along, mix, travel)


def control_surface_pair(
    name: str, moving: Array, right: Array, left: Array, travel: float
) -> tuple[ControlSurface, ControlSurface]:
    """Make a right control surface of sections (k, 4) and its mirror image, with their mixes."""
    return (
        control_surface(f"right_{name}", moving, right, travel),
        control_surface(f"left_{name}", mirror(moving), left, travel),
    )


def rascal110(wingspan_m: float) -> AirframeDrawing:
    """Draw the Sig Rascal 110: a high wing with elliptic tips, a cabin, tail-dragger gear.

    Proportions from the public three-view: 110 in of span on 76 in of length, 18 in propeller.
    """
    b = wingspan_m / 2.794
    half_wing = b * np.array(
        [
            [0.130, 0.00, -0.135, 0.375],
            [0.130, 0.85, -0.150, 0.375],
            [0.105, 1.10, -0.156, 0.330],
            [0.070, 1.27, -0.161, 0.262],
            [0.020, 1.36, -0.164, 0.170],
            [-0.040, 1.397, -0.165, 0.050],
        ]
    )
    half_tail = b * np.array(
        [
            [-0.930, 0.0, -0.035, 0.270],
            [-0.945, 0.28, -0.035, 0.235],
            [-0.985, 0.40, -0.035, 0.165],
            [-1.040, 0.445, -0.035, 0.060],
        ]
    )
    fin = b * np.array(
        [
            [-0.800, 0.0, -0.030, 0.400],
            [-0.930, 0.0, -0.130, 0.275],
            [-0.985, 0.0, -0.270, 0.215],
            [-1.045, 0.0, -0.345, 0.110],
        ]
    )
    fixed_wing, aileron = cut_control_surface(half_wing, 0.50, 0.92, 0.24)
    fixed_tail, elevator = cut_control_surface(half_tail, 0.06, 0.96, 0.42)
    fixed_fin, rudder = cut_control_surface(fin, 0.05, 0.97, 0.45)
    hull = np.array(
        [
            [0.725, 0.045, 0.045, 0.030, 2.0],
            [0.700, 0.075, 0.080, 0.030, 2.3],
            [0.560, 0.095, 0.105, 0.025, 2.8],
            [0.330, 0.110, 0.120, 0.020, 3.2],
            [0.190, 0.112, 0.135, 0.010, 3.5],
            [0.110, 0.112, 0.148, -0.002, 3.5],
            [-0.230, 0.105, 0.140, 0.000, 3.2],
            [-0.420, 0.082, 0.098, 0.000, 2.8],
            [-0.820, 0.045, 0.055, -0.012, 2.4],
            [-1.190, 0.015, 0.035, -0.020, 2.2],
        ]
    ) * [b, b, b, b, 1.0]
    windscreen = np.array(
        [
            [0.300, 0.085, 0.020, -0.095, 2.6],
            [0.180, 0.115, 0.052, -0.088, 3.0],
            [-0.130, 0.113, 0.052, -0.080, 3.0],
            [-0.250, 0.100, 0.026, -0.080, 2.6],
        ]
    ) * [b, b, b, b, 1.0]
    spinner = np.array(
        [
            [0.800, 0.004, 0.004, 0.030, 2.0],
            [0.765, 0.030, 0.030, 0.030, 2.0],
            [0.725, 0.042, 0.042, 0.030, 2.0],
        ]
    ) * [b, b, b, b, 1.0]
    band = half_wing[1:3] * [1, 1, 1, 0.76] + b * np.array([0.003, 0.0, 0.0, 0.002])
    stripe = [surface(each, LIGHT, 0.125) for each in (band, mirror(band))]
    legs = [
        part
        for side in (1.0, -1.0)
        for part in (
            rod(
                (0.10 * b, 0.09 * side * b, 0.12 * b),
                (0.08 * b, 0.33 * side * b, 0.36 * b),
                0.012 * b,
            ),
            wheel((0.08 * b, 0.34 * side * b, 0.37 * b), 0.060 * b, 0.040 * b),
        )
    ]
    tail_wheel = wheel((-1.06 * b, 0.0, 0.075 * b), 0.025 * b, 0.018 * b)
    body = join(
        fuselage(hull, LIGHT),
        fuselage(windscreen, DARK),
        fuselage(spinner, DARK),
        wing(fixed_wing, MAIN),
        wing(fixed_tail, MAIN),
        surface(fixed_fin, MAIN),
        *stripe,
        *legs,
        tail_wheel,
    )
    return AirframeDrawing(
        body,
        disc((0.74 * b, 0.0, 0.03 * b), 0.229 * b),
        (
            *control_surface_pair("aileron", aileron, -AILERON, AILERON, RASCAL_TRAVEL),
            *control_surface_pair("elevator", elevator, -ELEVATOR, -ELEVATOR, RASCAL_TRAVEL),
            control_surface("rudder", rudder, RUDDER, RASCAL_TRAVEL, axis=2),
        ),
    )


def skywalker_x8(wingspan_m: float) -> AirframeDrawing:
    """Draw the Skywalker X8: a swept flying wing with a pod, winglets and a pusher propeller.

    Span, wing area and propeller (2.1 m, 0.75 m², 14 in) are from its SOURCE.md, the rest by eye.
    """
    b = wingspan_m / 2.1
    half_wing = b * np.array(
        [
            [0.250, 0.00, 0.000, 0.500],
            [0.205, 0.12, 0.000, 0.475],
            [0.140, 0.24, -0.005, 0.430],
            [-0.295, 1.00, -0.040, 0.235],
            [-0.340, 1.05, -0.042, 0.175],
        ]
    )
    fixed_wing, elevon = cut_control_surface(half_wing, 0.32, 0.93, 0.28)
    winglet = b * np.array([[-0.345, 1.035, 0.00, 0.175], [-0.455, 1.035, -0.21, 0.095]])
    pod = np.array(
        [
            [0.400, 0.020, 0.018, 0.010, 2.0],
            [0.375, 0.050, 0.045, 0.005, 2.2],
            [0.300, 0.085, 0.075, -0.005, 2.5],
            [0.120, 0.105, 0.090, -0.015, 2.6],
            [-0.080, 0.095, 0.085, -0.020, 2.5],
            [-0.230, 0.045, 0.050, -0.025, 2.0],
            [-0.275, 0.028, 0.028, -0.025, 2.0],
        ]
    ) * [b, b, b, b, 1.0]
    spinner = np.array(
        [
            [-0.275, 0.022, 0.022, -0.025, 2.0],
            [-0.310, 0.018, 0.018, -0.025, 2.0],
            [-0.335, 0.004, 0.004, -0.025, 2.0],
        ]
    ) * [b, b, b, b, 1.0]
    hatch = np.array(
        [
            [0.270, 0.030, 0.010, -0.070, 2.4],
            [0.200, 0.060, 0.018, -0.088, 2.6],
            [0.060, 0.062, 0.018, -0.095, 2.6],
            [-0.010, 0.035, 0.010, -0.092, 2.4],
        ]
    ) * [b, b, b, b, 1.0]
    body = join(
        fuselage(pod, LIGHT),
        fuselage(hatch, DARK),
        fuselage(spinner, DARK),
        wing(fixed_wing, MAIN),
        surface(winglet, LIGHT),
        surface(mirror(winglet), LIGHT),
    )
    return AirframeDrawing(
        body,
        disc((-0.30 * b, 0.0, -0.025 * b), 0.178 * b),
        control_surface_pair(
            "elevon", elevon, -ELEVATOR - AILERON, -ELEVATOR + AILERON, ELEVON_TRAVEL
        ),
    )


def generic_aeroplane(wingspan_m: float) -> AirframeDrawing:
    """Draw an aeroplane with a mid wing, for airframes without a drawing of their own."""
    b = wingspan_m
    half_wing = b * np.array([[0.06, 0.0, 0.0, 0.15], [0.03, 0.5, -0.02, 0.09]])
    half_tail = b * np.array([[-0.34, 0.0, 0.0, 0.10], [-0.36, 0.17, 0.0, 0.07]])
    fin = b * np.array([[-0.32, 0.0, -0.01, 0.12], [-0.38, 0.0, -0.14, 0.06]])
    hull = np.array(
        [
            [0.27, 0.005, 0.005, 0.0, 2.0],
            [0.22, 0.030, 0.030, 0.0, 2.0],
            [0.05, 0.042, 0.045, 0.0, 2.0],
            [-0.15, 0.030, 0.030, 0.0, 2.0],
            [-0.44, 0.008, 0.010, 0.0, 2.0],
        ]
    ) * [b, b, b, b, 1.0]
    body = join(
        fuselage(hull, LIGHT),
        wing(half_wing, MAIN),
        wing(half_tail, MAIN),
        surface(fin, MAIN),
    )
    return AirframeDrawing(body, None)


def draw_fleet(names: Sequence[str], wingspans_m: Sequence[float]) -> list[AirframeDrawing]:
    """Draw the airframe of each aircraft."""
    return [draw_airframe(*each) for each in zip(names, wingspans_m, strict=True)]


def whole(drawing: AirframeDrawing) -> Mesh:
    """Join the body and its control surfaces in their neutral positions."""
    return join(drawing.body, *(move(each.mesh, each.hinge) for each in drawing.control_surfaces))


DRAWINGS: dict[str, Callable[[float], AirframeDrawing]] = {
    "rascal110": rascal110,
    "skywalker_x8": skywalker_x8,
}


def draw_airframe(name: str, wingspan_m: float) -> AirframeDrawing:
    """Draw an airframe at its wingspan; a generic aeroplane if the name is unknown."""
    return DRAWINGS.get(name, generic_aeroplane)(wingspan_m)
