"""What the loop tells: broadcasts to the other aircraft, truths to the observers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from testbed.compiled import twin_of
from testbed.formation import geometry
from testbed.formation.law import Diagnosis
from testbed.frames import euler_rates
from testbed.state import Array, Broadcast, Event, FormationState, Truths, VehicleState

EULER_RATES = twin_of(euler_rates, "testbed.vehicle.twin")


def broadcast(estimate: VehicleState, now: float) -> Broadcast:
    """Every aircraft's own estimate (N), measured and stamped at the time `now` (s)."""
    return Broadcast(
        stamp_s=np.full(len(estimate.airspeed), now),
        position_ned=estimate.position_ned,
        velocity_ned=estimate.velocity_ned,
        acceleration_ned=estimate.acceleration_ned,
        euler_rates=EULER_RATES(estimate.euler, estimate.rates_body),
    )


def formation_state(truth: VehicleState, diagnosis: Diagnosis, offsets: Array) -> FormationState:
    """The followers' true slots χ + q_g and errors, beside what their law reported."""
    slot, error, (speed, course, climb) = geometry.TRUE_SLOTS(
        truth.position_ned, truth.velocity_ned, offsets
    )
    return FormationState(
        slot_ned=slot,
        error_ned=error,
        speed=speed,
        speed_desired=diagnosis.speed_desired,
        speed_command=diagnosis.speed_command,
        course=course,
        course_desired=diagnosis.course_desired,
        flight_path_angle=climb,
        flight_path_angle_desired=diagnosis.flight_path_angle_desired,
        guards=diagnosis.guards,
        saturations=diagnosis.saturations,
        age_s=diagnosis.age_s,
    )


def losses(now: float, lost: Truths, names: Sequence[str]) -> tuple[Event, ...]:
    """One error per aircraft that hit the ground or left its models' range."""
    return tuple(
        Event(now, "error", name, "lost: on the ground, or beyond what its flight model can do")
        for name, gone in zip(names, lost, strict=True)
        if gone
    )
