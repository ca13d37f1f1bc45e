"""Actuator faults: surfaces that are stuck or float, motors that lose power.

Commands have the signs of `records.ActuatorCommand`; an elevon's is positive where its trailing
edge goes up, as an elevator's that pitches up. Elevons are commanded by mixing,

    left = clip(m (elevator − aileron))        right = clip(m (elevator + aileron))

with clip to −1..1 and m the share of their travel that full elevator alone commands. If one elevon
fails, the other serves both axes; the deflections are converted back to the equivalent aileron and
elevator.

A motor without power is a throttle of zero: the propeller windmills and brakes, with 1.1 N on the
Rascal at 19 m/s, whose shaft power is proportional to the throttle, and with 1.4 N on the X8 at
18 m/s, whose ESC freewheels. In level flight at 20 m/s their thrust is 7.5 and 3.8 N.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import ActuatorCommand, Array, BoolArray, FaultState
from testbed.vehicle.trim import STILL, Controls, Placement

SURFACES = ("aileron", "elevator", "rudder", "left-elevon", "right-elevon")
# Deflection of a floating surface per angle of attack and per sideslip: trailing edges move with
# the flow, up in air from below and left in air from the right; ailerons both up, without a
# rolling moment.
_FLOW_DEFLECTION = np.array([[0.0, 1.0, 0.0, 1.0, 1.0], [0.0, 0.0, -1.0, 0.0, 0.0]])


class ControlGeometry(NamedTuple):
    """The surfaces of N aircraft, in the order of SURFACES."""

    fitted: BoolArray  # (N, 5) whether the aircraft has the surface
    mixing: Array  # (N,) m of the elevons; NaN without elevons
    up: Array  # (N, 5) rad ≥ 0, deflection at a command of 1; 0: not in the model
    down: Array  # (N, 5) rad ≥ 0, deflection in the other direction at a command of −1


class SurfaceModel(Protocol):
    """A flight model that can be placed in the air with commanded surfaces."""

    has_rudder: bool  # the rudder command has an effect
    has_lag: bool  # surfaces lag behind their commands, unless placed with `spin`
    probe_speed: float  # m/s, at which the aircraft is examined

    def place(self, placement: Placement, controls: Controls, *, spin: bool) -> None:
        """Place the aircraft; with `spin` surfaces settle first."""

    def deflections(self) -> Array:
        """Return the deflections (5,) of the surfaces, rad ≥ 0; 0 where unknown."""


class Servos(NamedTuple):
    """State of the servos of N aircraft between two periods."""

    commanded: ActuatorCommand  # (N) last command; of frozen autopilots, that before they froze
    positions: Array  # (N, 5) -1..1 of the surfaces


def initial_servos(surfaces: ActuatorCommand, geometry: ControlGeometry) -> Servos:
    """Return servos of N aircraft at their commanded positions."""
    return Servos(surfaces, _positions(surfaces, geometry))


def apply_actuator_faults(
    surfaces: ActuatorCommand,
    before: Servos,
    faults: FaultState,
    flow: Array,
    geometry: ControlGeometry,
) -> tuple[ActuatorCommand, Servos]:
    """Apply the faults of servos and motors of N aircraft for one period.

    A stuck surface without a given position stays where it was in the period before; a surface that
    is stuck does not float. A floating surface follows the flow at once, within its travel. Where
    no surface has failed the commands are unchanged, to the bit.

    Args:
        surfaces: commands of the autopilots (N).
        before: returned by the period before, or `initial_servos(surfaces, geometry)`.
        faults: active faults (N).
        flow: (N, 2) angle of attack and sideslip, rad.
        geometry: of the surfaces.

    Returns:
        The commands that reach surfaces and motors, and the servos for the next period.
    """
    commanded = ActuatorCommand(
        *(
            np.where(faults.frozen, old, new)
            for old, new in zip(before.commanded, surfaces, strict=True)
        )
    )
    positions = _positions(commanded, geometry)
    stuck, floating = faults.stuck & geometry.fitted, faults.floating & geometry.fitted
    failed = stuck | floating
    if failed.any():
        positions = np.where(floating, _floating(faults.floats, flow, geometry), positions)
        held = np.where(np.isnan(faults.stuck_at), before.positions, faults.stuck_at)
        positions = np.where(stuck, held, positions)
    aileron, elevator, rudder, left, right = positions.T
    mixed = failed[:, 3:].any(axis=1)
    reach = 2.0 * geometry.mixing
    return ActuatorCommand(
        aileron=np.where(mixed, (right - left) / reach, aileron),
        elevator=np.where(mixed, (right + left) / reach, elevator),
        rudder=rudder.copy(),
        throttle=commanded.throttle * faults.power,
    ), Servos(commanded, positions)


def _positions(surfaces: ActuatorCommand, geometry: ControlGeometry) -> Array:
    """Return the commanded positions (N, 5) of the surfaces."""
    aileron, elevator, rudder, _ = surfaces
    left = np.clip(geometry.mixing * (elevator - aileron), -1.0, 1.0)
    right = np.clip(geometry.mixing * (elevator + aileron), -1.0, 1.0)
    return np.stack([aileron, elevator, rudder, left, right], axis=1)


def _floating(floats: Array, flow: Array, geometry: ControlGeometry) -> Array:
    """Return the positions (N, 5) of floating surfaces, as commands."""
    angle = floats * (flow @ _FLOW_DEFLECTION)
    travel = np.where(angle > 0.0, geometry.up, geometry.down)
    # columns of missing surfaces are computed too; for others a travel of 0 is an input error
    command: Array = np.clip(angle / np.where(travel > 0.0, travel, np.inf), -1.0, 1.0)
    return command


def check_faults(
    name: str,
    aircraft: str,
    geometry: ControlGeometry,
    row: int,
    *,
    engine: bool,
    battery: bool,
    faults: Iterable[Any],
) -> None:
    """Check that an aircraft has the parts that fail.

    Args:
        name: of the aircraft in the scenario, "uav1".
        aircraft: its model, "rascal110".
        geometry: of all aircraft.
        row: of this aircraft.
        engine: whether it has one.
        battery: the same.
        faults: of the scenario; each has a `kind`, and some a `surface` and a `when`.

    Raises:
        InputError: a part is missing; the message has what to write.
    """
    fitted = [each for each, has in zip(SURFACES, geometry.fitted[row], strict=True) if has]
    for fault in faults:
        if fault.kind in ("engine-out", "thrust-loss") and not engine:
            raise InputError(
                f"{name}: fault {fault.kind}: {aircraft} has no engine (leave the fault out)"
            )
        if fault.kind == "battery-low" and not battery:
            raise InputError(
                f"{name}: fault battery-low: {aircraft} has no battery; write engine-out or "
                "thrust-loss, or fly skywalker_x8"
            )
        condition = getattr(fault, "when", None)
        if condition and condition.quantity == "state_of_charge" and not battery:
            raise InputError(
                f"{name}: fault {fault.kind}: when: state_of_charge: {aircraft} has no battery, so "
                "it would never begin; write another quantity, or fly skywalker_x8"
            )
        surface = getattr(fault, "surface", None)
        if surface is None:
            continue
        if surface not in fitted:
            raise InputError(
                f"{name}: fault {fault.kind}: {aircraft} has no {surface}; write one of "
                f"{', '.join(fitted)}"
            )
        if fault.kind == "surface-floating" and _unknown_travel(geometry, row, surface):
            raise InputError(
                f"{name}: fault surface-floating: the model of {aircraft} has no travel of its "
                f"{surface} (no property fcs/…-pos-rad moves); write surface-stuck"
            )


def find_control_geometry(model: SurfaceModel) -> ControlGeometry:
    """Find the surfaces of an aircraft and their travel by full commands.

    Args:
        model: located.
    """
    ahead = Placement((model.probe_speed, 0.0, 0.0), STILL, 0.0, 0.0, 0.0)

    def at(aileron: float, elevator: float) -> Array:
        model.place(ahead, Controls(aileron, elevator, elevator, 0.0), spin=model.has_lag)
        return model.deflections()

    # both commands drive an elevon to its stop; the left one goes up with the left aileron
    is_left = np.array([name == "left-elevon" for name in SURFACES])
    up = np.where(is_left, at(-1.0, 1.0), at(1.0, 1.0))
    down = np.where(is_left, at(1.0, -1.0), at(-1.0, -1.0))
    elevons = bool(np.all(up[3:] > 0.0))
    fitted = [not elevons, not elevons, model.has_rudder, elevons, elevons]
    mixing = at(0.0, 1.0)[3] / up[3] if elevons else np.nan
    return ControlGeometry(np.array([fitted]), np.array([mixing]), up[np.newaxis], down[np.newaxis])


def stack_geometry(each: Sequence[ControlGeometry]) -> ControlGeometry:
    """Join the geometry of several aircraft."""
    return ControlGeometry(*(np.concatenate(arrays) for arrays in zip(*each, strict=True)))


def _unknown_travel(geometry: ControlGeometry, row: int, surface: str) -> bool:
    """Return whether the needed travel of a surface is unknown; a floating aileron needs none."""
    column = SURFACES.index(surface)
    moves = bool(_FLOW_DEFLECTION[:, column].any())
    return moves and not (geometry.up[row, column] > 0.0 and geometry.down[row, column] > 0.0)
