"""What an autopilot has sent: its own state, mode, health, time and parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from testbed.flight.own_state import OWN_STATE
from testbed.mavlink.codec import Message

ATTITUDE, AUTOPILOT = "ATTITUDE", 1  # the component
GLOBAL, LOCAL, HUD, IMU = "GLOBAL_POSITION_INT", "LOCAL_POSITION_NED", "VFR_HUD", "SCALED_IMU"
OWN_STATE_MESSAGES = (ATTITUDE, GLOBAL, LOCAL, HUD)
SAME_BASE_MS = 2  # GPS time at boot, of whole ms, differs by rounding
_VARIANCES = ("velocity", "pos_horiz", "pos_vert", "compass")
_STICKS = ("chan1_raw", "chan2_raw", "chan4_raw")  # roll, pitch, yaw
_NO_STICK = (0, 65535)
_ARMED = 128  # MAV_MODE_FLAG_SAFETY_ARMED

# Names of earlier ArduPlane, with the present name and the factor to its unit.
EARLIER_NAMES: Mapping[str, tuple[str, float]] = {
    "LIM_ROLL_CD": ("ROLL_LIMIT_DEG", 0.01),
    "LIM_PITCH_MAX": ("PTCH_LIM_MAX_DEG", 0.01),
    "LIM_PITCH_MIN": ("PTCH_LIM_MIN_DEG", 0.01),
    "TRIM_PITCH_CD": ("PTCH_TRIM_DEG", 0.01),
    "ARSPD_FBW_MIN": ("AIRSPEED_MIN", 1.0),
    "ARSPD_FBW_MAX": ("AIRSPEED_MAX", 1.0),
    "TRIM_ARSPD_CM": ("AIRSPEED_CRUISE", 0.01),
}


class AutopilotState:
    """The newest messages of one autopilot.

    Attributes:
        own: (1,) of OWN_STATE, of the messages of the own state.
        boot_ms: of the newest ATTITUDE; None: none has come.
        position_ms: `time_boot_ms` of GLOBAL_POSITION_INT.
        base_ms: GPS time at boot, ms since 1970; None: not known.
        mode: of HEARTBEAT.
        armed: of HEARTBEAT.
        ekf_flags: of EKF_STATUS_REPORT.
        ekf_variances: of EKF_STATUS_REPORT.
        fix_type: of GPS_RAW_INT.
        sticks_us: of RC_CHANNELS.
        parameters: by ArduPlane's present names.
        received_s: when each message came last, by its name; s of the monotonic clock.
        counts: of the messages that have come, by name.
        other_system: system id of an autopilot that is not the own one; 0: none was received.
    """

    def __init__(self, system: int) -> None:
        """Begin without a message; `system` is the id of the own autopilot."""
        self._system = system
        self.own = np.zeros(1, OWN_STATE)
        self.boot_ms: int | None = None
        self.position_ms = 0
        self.base_ms: int | None = None
        self.mode: int | None = None
        self.armed = False
        self.ekf_flags, self.fix_type = 0, 0
        self.ekf_variances: tuple[float, ...] = ()
        self.sticks_us: tuple[float, float, float] | None = None
        self.parameters: dict[str, float] = {}
        self.received_s: dict[str, float] = {}
        self.counts: dict[str, int] = {}
        self.other_system = 0
        self._take: Mapping[str, Callable[[Any], None]] = {
            ATTITUDE: self._attitude,
            GLOBAL: self._global,
            LOCAL: self._local,
            HUD: self._hud,
            IMU: self._imu,
            "HEARTBEAT": self._heartbeat,
            "SYSTEM_TIME": self._system_time,
            "EKF_STATUS_REPORT": self._ekf,
            "GPS_RAW_INT": self._gps,
            "RC_CHANNELS": self._rc,
            "PARAM_VALUE": self._parameter,
        }

    @property
    def has_own_state(self) -> bool:
        """Whether every message of the own state has come."""
        return all(name in self.received_s for name in OWN_STATE_MESSAGES)

    def add(self, message: Message, received_s: float) -> bool:
        """Take a message.

        Args:
            message: of any sender; those of others than the autopilot change nothing.
            received_s: when it came, s of the monotonic clock.

        Returns:
            Whether it is an ATTITUDE of the autopilot, which ends a sample.
        """
        if message.component != AUTOPILOT:
            return False
        if message.system != self._system:
            if message.name == "HEARTBEAT":
                self.other_system = message.system
            return False
        take = self._take.get(message.name)
        if take is None:
            return False
        take(message.fields)
        self.received_s[message.name] = received_s
        self.counts[message.name] = self.counts.get(message.name, 0) + 1
        return message.name == ATTITUDE

    def _attitude(self, fields: Mapping[str, Any]) -> None:
        own = self.own[0]
        own["euler"] = fields["roll"], fields["pitch"], fields["yaw"]
        own["rates_body"] = fields["rollspeed"], fields["pitchspeed"], fields["yawspeed"]
        self.boot_ms = fields["time_boot_ms"]

    def _global(self, fields: Mapping[str, Any]) -> None:
        own = self.own[0]
        own["lat"], own["lon"], own["alt"] = fields["lat"], fields["lon"], fields["alt"]
        self.position_ms = fields["time_boot_ms"]

    def _local(self, fields: Mapping[str, Any]) -> None:
        own = self.own[0]
        own["velocity_ned"] = fields["vx"], fields["vy"], fields["vz"]
        own["time_boot_ms"] = fields["time_boot_ms"]  # of the velocity, for its difference
        own["received"] = True

    def _hud(self, fields: Mapping[str, Any]) -> None:
        self.own[0]["airspeed"] = fields["airspeed"]

    def _imu(self, fields: Mapping[str, Any]) -> None:
        self.own[0]["specific_force"] = fields["xacc"], fields["yacc"], fields["zacc"]

    def _heartbeat(self, fields: Mapping[str, Any]) -> None:
        self.mode = fields["custom_mode"]
        self.armed = bool(fields["base_mode"] & _ARMED)

    def _system_time(self, fields: Mapping[str, Any]) -> None:
        unix_us, boot_ms = fields["time_unix_usec"], fields["time_boot_ms"]
        if not unix_us:
            self.base_ms = None
            return
        found = (unix_us + 500) // 1000 - boot_ms
        if self.base_ms is None or abs(found - self.base_ms) > SAME_BASE_MS:
            self.base_ms = found

    def _ekf(self, fields: Mapping[str, Any]) -> None:
        self.ekf_flags = fields["flags"]
        self.ekf_variances = tuple(fields[f"{name}_variance"] for name in _VARIANCES)

    def _gps(self, fields: Mapping[str, Any]) -> None:
        self.fix_type = fields["fix_type"]

    def _rc(self, fields: Mapping[str, Any]) -> None:
        roll, pitch, yaw = (fields[name] for name in _STICKS)
        unknown = any(each in _NO_STICK for each in (roll, pitch, yaw))
        self.sticks_us = None if unknown else (float(roll), float(pitch), float(yaw))

    def _parameter(self, fields: Mapping[str, Any]) -> None:
        name, value = fields["param_id"], fields["param_value"]
        name, factor = EARLIER_NAMES.get(name, (name, 1.0))
        if math.isfinite(value):
            self.parameters[name] = value * factor
