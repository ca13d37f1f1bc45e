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
from math import inf, isnan
from typing import Any, NamedTuple, Protocol

import numpy as np

from testbed.core.compile import entry, kernel
from testbed.core.errors import InputError
from testbed.core.records import ACTUATORS, Array, BoolArray, Indices, Record, Records
from testbed.vehicle.trim import STILL, Controls, Placement

SURFACES = ("aileron", "elevator", "rudder", "left-elevon", "right-elevon")
_LEFT_ELEVON = 3  # the column, before that of the right one
# Deflection of a floating surface per angle of attack and per sideslip: trailing edges move with
# the flow, up in air from below and left in air from the right; ailerons both up, without a
# rolling moment.
_FLOW_DEFLECTION = (0.0, 1.0, 0.0, 1.0, 1.0), (0.0, 0.0, -1.0, 0.0, 0.0)


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


# The servos of one aircraft between two periods.
SERVO = np.dtype(
    [
        ("commanded", ACTUATORS),  # last command; of frozen autopilots, that before they froze
        ("positions", "f8", (len(SURFACES),)),  # -1..1 of the surfaces
        ("flow", "f8", (2,)),  # angle of attack and sideslip, rad, that surfaces float in
        ("known", "?"),  # false: they are those of trimmed flight
    ],
    align=True,
)


@entry
def keep_flow(rows: Indices, aircraft: Records, servos: Records) -> None:
    """Write the flow at each aircraft, in which its surfaces float until the next call.

    Args:
        rows: (M,) of the flight models among the aircraft.
        aircraft: (N,) of AIRCRAFT, with the air data of this tick.
        servos: (M,) of SERVO; `flow` is written.
    """
    for k in range(len(rows)):
        air = aircraft[rows[k]].air
        servos[k].flow[0], servos[k].flow[1] = air.alpha, air.beta


@entry
def any_floats(rows: Indices, aircraft: Records) -> bool:
    """Return whether a surface floats of the aircraft (N,) of AIRCRAFT in these rows (M,)."""
    for k in range(len(rows)):
        for column in range(len(SURFACES)):
            if aircraft[rows[k]].faults.floating[column]:
                return True
    return False


@entry
def apply_actuator_faults(
    rows: Indices,
    aircraft: Records,
    servos: Records,
    trimmed: Array,
    fitted: BoolArray,
    mixing: Array,
    up: Array,
    down: Array,
) -> bool:
    """Turn commands of autopilots into the state of surfaces and motors, for one period.

    A stuck surface without a given position stays where it was in the period before; a surface that
    is stuck does not float. A floating surface follows the flow at once, within its travel. Where
    no surface has failed the commands are unchanged, to the bit.

    Args:
        rows: (M,) of the flight models among the aircraft.
        aircraft: (N,) of AIRCRAFT, with active faults; `surfaces` is read and written.
        servos: (M,) of SERVO; written, for the next period.
        trimmed: (M, 4) aileron, elevator, rudder and throttle before the first period.
        fitted: (M, 5) see `ControlGeometry`, as what follows.
        mixing: (M,)
        up: (M, 5) rad
        down: (M, 5) rad

    Returns:
        Whether a battery drops now.
    """
    drops = False
    for k in range(len(rows)):
        a, servo = aircraft[rows[k]], servos[k]
        surfaces, faults, last = a.surfaces, a.faults, servo.commanded
        if not servo.known:
            servo.known = True
            last.aileron, last.elevator = trimmed[k, 0], trimmed[k, 1]
            last.rudder, last.throttle = trimmed[k, 2], trimmed[k, 3]
            _write_positions(last, mixing[k], servo.positions)
        if not faults.frozen:
            last.aileron, last.elevator = surfaces.aileron, surfaces.elevator
            last.rudder, last.throttle = surfaces.rudder, surfaces.throttle
        mixed = _move_servos(servo, faults, fitted[k], mixing[k], up[k], down[k])
        positions = servo.positions
        surfaces.aileron, surfaces.elevator = positions[0], positions[1]
        if mixed:
            reach = 2.0 * mixing[k]
            surfaces.aileron = (positions[4] - positions[3]) / reach
            surfaces.elevator = (positions[4] + positions[3]) / reach
        surfaces.rudder = positions[2]
        surfaces.throttle = last.throttle * faults.power
        if not isnan(faults.charge):
            drops = True
    return drops


@kernel
def _move_servos(
    servo: Record, faults: Record, fitted: BoolArray, mixing: float, up: Array, down: Array
) -> bool:
    """Move the surfaces of one aircraft that can move; return whether an elevon has failed."""
    before = (
        *(servo.positions[0], servo.positions[1], servo.positions[2]),
        *(servo.positions[3], servo.positions[4]),
    )
    _write_positions(servo.commanded, mixing, servo.positions)
    elevon_failed = False
    for column in range(len(before)):
        if not fitted[column] or not (faults.stuck[column] or faults.floating[column]):
            continue
        if faults.stuck[column]:
            at = faults.stuck_at[column]
            servo.positions[column] = before[column] if isnan(at) else at
        else:
            along = _FLOW_DEFLECTION[0][column], _FLOW_DEFLECTION[1][column]
            # 0 is not −0 in the log
            angle = 0.0 + servo.flow[0] * along[0] + servo.flow[1] * along[1]
            angle *= faults.floats[column]
            travel = up[column] if angle > 0.0 else down[column]
            servo.positions[column] = _clip(angle / travel if travel > 0.0 else angle / inf)
        if column >= _LEFT_ELEVON:
            elevon_failed = True
    return elevon_failed


@kernel
def _write_positions(command: Record, mixing: float, positions: Array) -> None:
    """Write the commanded positions (5,) of the surfaces of one aircraft."""
    positions[0], positions[1], positions[2] = command.aileron, command.elevator, command.rudder
    positions[3] = _clip(mixing * (command.elevator - command.aileron))
    positions[4] = _clip(mixing * (command.elevator + command.aileron))


@kernel
def _clip(value: float) -> float:
    """Return a position within −1 and 1; NaN stays NaN."""
    return -1.0 if value < -1.0 else (1.0 if value > 1.0 else value)


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
    moves = any(each[column] for each in _FLOW_DEFLECTION)
    return moves and not (geometry.up[row, column] > 0.0 and geometry.down[row, column] > 0.0)
