"""What a companion computer knows at one moment: its own aircraft, and the others it receives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

Vector = tuple[float, float, float]

UNKNOWN: Vector = (math.nan, math.nan, math.nan)
STATE_MESSAGES = ("ATTITUDE", "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "VFR_HUD")
STATUS_MESSAGES = ("HEARTBEAT", "EKF_STATUS_REPORT", "GPS_RAW_INT", "SYSTEM_TIME")
HEARTBEAT, STICKS = "HEARTBEAT", "RC_CHANNELS"


@dataclass(frozen=True, slots=True)
class PeerObservation:
    """Another aircraft, by its newest message.

    Attributes:
        age_s: time since its receipt, s; infinite: none was received.
        stamp_s: of its measurement, in the own autopilot's boot time, s.
        position_ned: in the frame of scenario.origin, m.
        velocity_ned: m/s.
        height_m: above mean sea level, m.
        digests: `custom_state`: of its scenario and its autopilot's parameters.
        offset_s: its time minus the own GPS time, s, as `ClockOffset` estimates it; NaN: unknown.
    """

    age_s: float = math.inf
    stamp_s: float = -math.inf
    position_ned: Vector = UNKNOWN
    velocity_ned: Vector = UNKNOWN
    height_m: float = math.nan
    digests: int = 0
    offset_s: float = math.nan


@dataclass(frozen=True, slots=True)
class Observation:
    """What is known at one pass of the companion's loop.

    All ages count from the kernel's time of receipt, so that a message that waited while the
    process was stopped is as old as it is.

    Attributes:
        now_s: monotonic clock, s; in lockstep the boot time of the autopilot's newest sample.
        boot_s: autopilot's time since boot of the newest sample, s; None: there is none.
        ages_s: time since the receipt of the last message, by its name, s.
        mode: custom_mode of the last HEARTBEAT; None: there is none.
        armed: by the last HEARTBEAT.
        ekf_flags: of EKF_STATUS_REPORT.
        ekf_variances: of EKF_STATUS_REPORT, of their bounds.
        fix_type: of GPS_RAW_INT.
        airspeed_mps: equivalent airspeed, m/s.
        position_ned: of GLOBAL_POSITION_INT in the frame of scenario.origin, m.
        velocity_ned: m/s.
        height_m: of GLOBAL_POSITION_INT above mean sea level, m.
        base_ms: GPS time at the autopilot's boot by the last SYSTEM_TIME, ms since 1970; None: it
            has no GPS time.
        sticks_us: pulses of the pilot's roll, pitch and yaw sticks, µs; None: no receiver.
        parameters: of the autopilot, by ArduPlane's present names.
        digests: `custom_state` as the companion sends it: of its scenario and `parameters`.
        peers: aircraft that the law uses by name, the leader among them.
        stopping: the companion has got a signal to end.
    """

    now_s: float
    boot_s: float | None = None
    ages_s: Mapping[str, float] = field(default_factory=dict)
    mode: int | None = None
    armed: bool = False
    ekf_flags: int = 0
    ekf_variances: tuple[float, ...] = ()
    fix_type: int = 0
    airspeed_mps: float = math.nan
    position_ned: Vector = UNKNOWN
    velocity_ned: Vector = UNKNOWN
    height_m: float = math.nan
    base_ms: int | None = None
    sticks_us: Vector | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    digests: int = 0
    peers: Mapping[str, PeerObservation] = field(default_factory=dict)
    stopping: bool = False

    def age_s(self, message: str) -> float:
        """Return the time since the receipt of a message, s; infinite: there was none."""
        return self.ages_s.get(message, math.inf)

    def peer(self, name: str) -> PeerObservation:
        """Return an aircraft; one of which nothing is known has an infinite age."""
        return self.peers.get(name, _NEVER)


_NEVER = PeerObservation()
