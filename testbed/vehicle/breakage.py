"""What broken parts make of what autopilots say: surfaces that stick or float, motors that fade.

Commands have the signs of `state.Surfaces`; an elevon's is positive where its trailing edge goes
up, as an elevator's that pitches up. Elevons are commanded by mixing,

    left = clip(m (elevator − aileron))        right = clip(m (elevator + aileron))

with clip to −1..1 and m the share of their travel that full elevator alone commands. A broken one
leaves the other to both axes; the pair is turned back into the aileron and elevator that give it.

A motor without power is a throttle of zero: the propeller windmills and brakes. It does so with
1.0 N on the Rascal at 19 m/s, whose shaft power is in proportion to the throttle, and with 1.4 N on
the X8 at 18 m/s, whose ESC freewheels and lets it turn freely. In level flight they pull with 7.5
and 3.8 N at 20 m/s.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from testbed.errors import InputError
from testbed.state import Array, Failing, Surfaces, Truths
from testbed.vehicle.trim import STILL, Controls, Placement

SURFACES = ("aileron", "elevator", "rudder", "left-elevon", "right-elevon")
# How far each surface is blown by the flow, per angle of attack and per sideslip: trailing edges
# give way, upwards to air from below and to the left to air from the right, and ailerons both
# upwards, which rolls nobody.
_BLOWN = np.array([[0.0, 1.0, 0.0, 1.0, 1.0], [0.0, 0.0, -1.0, 0.0, 0.0]])


class Rig(NamedTuple):
    """The surfaces of N aircraft, in the order of SURFACES."""

    fitted: Truths  # (N, 5) which there are
    mixing: Array  # (N,) m of the elevons; not a number where there are none
    up: Array  # (N, 5) rad ≥ 0, deflection at a command of 1; 0: its model does not say
    down: Array  # (N, 5) rad ≥ 0, deflection at a command of −1, the other way


class Rigged(Protocol):
    """A flight model that can be put into the air, where its surfaces do as they are told."""

    has_rudder: bool  # its command changes something
    has_lag: bool  # its surfaces follow their commands later, unless it spins

    def place(self, placement: Placement, controls: Controls, *, spin: bool) -> None:
        """Put it there; with `spin` surfaces settle first."""

    def deflections(self) -> Array:
        """How far the surfaces (5,) are turned, rad ≥ 0; 0 where that is not known."""


class Servos(NamedTuple):
    """What the servos of N aircraft remember from one period to the next."""

    told: Surfaces  # (N) what the autopilots said last, hanging ones before they hung
    stood: Array  # (N, 5) -1..1 where the surfaces were


def resting(surfaces: Surfaces, rig: Rig) -> Servos:
    """The servos of N aircraft that have long done as they are told."""
    return Servos(surfaces, _positions(surfaces, rig))


def broken(
    surfaces: Surfaces, before: Servos, failing: Failing, flow: Array, rig: Rig
) -> tuple[Surfaces, Servos]:
    """One period of servos and motors of N aircraft, of which some are broken.

    A surface that sticks without saying where stays at what it was told in the period before, and
    none floats that sticks. One that floats follows the flow at once, within its travel. Aircraft
    of which no surface is broken get what they were told, to the bit.

    Args:
        surfaces: what the autopilots say.
        before: returned by the period before, or `resting(surfaces, rig)`.
        failing: what is broken.
        flow: (N, 2) angle of attack and sideslip, rad.
        rig: of the aircraft.

    Returns:
        What reaches surfaces and motors, and the memory for the next period.
    """
    frozen = failing.frozen
    told = Surfaces(
        *(np.where(frozen, old, new) for old, new in zip(before.told, surfaces, strict=True))
    )
    stand = _positions(told, rig)
    stuck, floating = failing.stuck & rig.fitted, failing.floating & rig.fitted
    astray = stuck | floating
    if astray.any():
        stand = np.where(floating, _afloat(failing.floats, flow, rig), stand)
        held = np.where(np.isnan(failing.stuck_at), before.stood, failing.stuck_at)
        stand = np.where(stuck, held, stand)
    aileron, elevator, rudder, left, right = stand.T
    mixed = astray[:, 3:].any(axis=1)
    reach = 2.0 * rig.mixing
    return Surfaces(
        aileron=np.where(mixed, (right - left) / reach, aileron),
        elevator=np.where(mixed, (right + left) / reach, elevator),
        rudder=rudder.copy(),
        throttle=told.throttle * failing.power,
    ), Servos(told, stand)


def _positions(surfaces: Surfaces, rig: Rig) -> Array:
    """Where the surfaces (N, 5) of N aircraft go when they are told this."""
    aileron, elevator, rudder, _ = surfaces
    left = np.clip(rig.mixing * (elevator - aileron), -1.0, 1.0)
    right = np.clip(rig.mixing * (elevator + aileron), -1.0, 1.0)
    return np.stack([aileron, elevator, rudder, left, right], axis=1)


def _afloat(floats: Array, flow: Array, rig: Rig) -> Array:
    """Where the flow holds surfaces (N, 5) that nothing else holds, as commands."""
    angle = floats * (flow @ _BLOWN)
    travel = np.where(angle > 0.0, rig.up, rig.down)
    # a travel of 0 is refused when the world is built, but columns of missing surfaces are computed
    command: Array = np.clip(angle / np.where(travel > 0.0, travel, np.inf), -1.0, 1.0)
    return command


def check_faults(
    name: str, aircraft: str, rig: Rig, row: int, *, battery: bool, faults: Iterable[Any]
) -> None:
    """See that an aircraft has what is to break.

    Args:
        name: of the aircraft on the page, "uav1".
        aircraft: of its kind, "rascal110".
        rig: of all aircraft.
        row: of this one in the rig.
        battery: whether it has one.
        faults: of the page; each has a `kind`, and some a `surface` that breaks, and a `when`.

    Raises:
        InputError: if it has not, with what to write.
    """
    fitted = [each for each, there in zip(SURFACES, rig.fitted[row], strict=True) if there]
    for fault in faults:
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
                f"{name}: fault {fault.kind}: no {surface} to break; {aircraft} has "
                f"{', '.join(fitted)}"
            )
        if fault.kind == "surface-floating" and _still(rig, row, surface):
            raise InputError(
                f"{name}: fault surface-floating: the model of {aircraft} does not say how far its "
                f"{surface} goes (no fcs/…-pos-rad moves); write surface-stuck"
            )


def find_rig(model: Rigged) -> Rig:
    """Look what the surfaces of an aircraft do when each of them is told to go all the way.

    Args:
        model: located.
    """
    ahead = Placement((20.0, 0.0, 0.0), STILL, 0.0, 0.0, 0.0)

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
    return Rig(np.array([fitted]), np.array([mixing]), up[np.newaxis], down[np.newaxis])


def stacked(rigs: Sequence[Rig]) -> Rig:
    """The rigs of several aircraft as one."""
    return Rig(*(np.concatenate(each) for each in zip(*rigs, strict=True)))


def _still(rig: Rig, row: int, surface: str) -> bool:
    """Whether nothing is known of a surface's travel; a floating aileron needs none."""
    column = SURFACES.index(surface)
    blown = bool(_BLOWN[:, column].any())
    return blown and not (rig.up[row, column] > 0.0 and rig.down[row, column] > 0.0)
