"""Who flies the leader: guidance through its own autopilot, or a recording."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.guidance import leader as guidance
from testbed.guidance.longitudinal import HoldGains
from testbed.guidance.mission import Plan
from testbed.guidance.replay import Track
from testbed.state import AirData, Array, FbwaCommand, Surfaces, VehicleState


class MissionPilot:
    """The leader flies a mission."""

    def __init__(
        self, plan: Plan, memory: guidance.LeaderMemory, *, dt: float, gains: HoldGains
    ) -> None:
        """Begin the plan with this memory, stepping every `dt` s."""
        self._plan, self._memory, self._dt, self._gains = plan, memory, dt, gains

    def command(self, estimate: VehicleState) -> tuple[float, float, float]:
        """Pitch (rad), roll (rad), throttle (0..1) from the leader's row 0; once per period."""
        pitch, roll, throttle, self._memory = guidance.step(
            self._memory,
            estimate.position_ned[0].tolist(),
            estimate.velocity_ned[0].tolist(),
            float(estimate.euler[0, 0]),
            float(estimate.airspeed[0]),
            plan=self._plan,
            dt=self._dt,
            gains=self._gains,
        )
        return pitch, roll, throttle


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recorded flight on the loop's own times: one row per stride."""

    track: Track
    equivalent_airspeed: Array  # (T,) m/s

    def prepend(self, row: int, state: VehicleState) -> VehicleState:
        """The followers' state (n) with the recorded leader as row 0."""
        track = self.track
        return VehicleState(
            position_ned=_above(track.position_ned[row], state.position_ned),
            velocity_ned=_above(track.velocity_ned[row], state.velocity_ned),
            acceleration_ned=_above(track.acceleration_ned[row], state.acceleration_ned),
            euler=_above(track.euler[row], state.euler),
            rates_body=_above(track.rates_body[row], state.rates_body),
            airspeed=_above(track.airspeed[row], state.airspeed),
            equivalent_airspeed=_above(self.equivalent_airspeed[row], state.equivalent_airspeed),
        )

    @staticmethod
    def prepend_air(air: AirData) -> AirData:
        """The followers' air data (n); the recording tells nothing of its own: zero."""
        return AirData(
            alpha=_above(np.zeros(1), air.alpha),
            beta=_above(np.zeros(1), air.beta),
            propeller_rps=_above(np.zeros(1), air.propeller_rps),
            wind_ned=_above(np.zeros(3), air.wind_ned),
        )

    def prepend_command(self, row: int, command: FbwaCommand) -> FbwaCommand:
        """The followers' command (n); what the leader did stands for what it was told."""
        pitch, roll = self.track.euler[row, 1], self.track.euler[row, 0]
        return FbwaCommand(
            pitch=_above(pitch, command.pitch),
            roll=_above(roll, command.roll),
            throttle=_above(self.track.throttle[row], command.throttle),
        )

    def prepend_surfaces(self, row: int, surfaces: Surfaces) -> Surfaces:
        """The followers' surfaces (n); the recording has none but the throttle."""
        still = np.zeros(1)
        return Surfaces(
            aileron=_above(still, surfaces.aileron),
            elevator=_above(still, surfaces.elevator),
            rudder=_above(still, surfaces.rudder),
            throttle=_above(self.track.throttle[row], surfaces.throttle),
        )


def with_leader(lead: tuple[float, float, float], command: FbwaCommand) -> FbwaCommand:
    """The followers' command (n) behind the leader's pitch, roll, throttle: (n + 1)."""
    told = np.empty((3, len(command.roll) + 1))
    told[:, 0] = lead
    told[0, 1:] = command.pitch
    told[1, 1:] = command.roll
    told[2, 1:] = command.throttle
    return FbwaCommand(*told)


def _above(first: Array, rest: Array) -> Array:
    return np.concatenate([np.reshape(first, (1, *rest.shape[1:])), rest])
