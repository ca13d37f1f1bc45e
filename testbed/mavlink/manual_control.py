"""Manual control over MAVLink: RC_CHANNELS_OVERRIDE, MANUAL_CONTROL, SET_ATTITUDE_TARGET."""

from __future__ import annotations

import math
from collections.abc import Mapping

from testbed.core.frames import angles_from_quaternion
from testbed.core.records import FbwaCommand
from testbed.mavlink.codec import Message
from testbed.mavlink.outgoing import Handler, OutgoingMessage
from testbed.mavlink.rc_channels import PITCH, ROLL, THROTTLE, PwmRange, RcScaling
from testbed.mavlink.vehicle_context import VehicleContext

HOLD_S = 3.0  # simulated s without a message after which all sticks are released
QUATERNION_NORM = (0.9, 1.1)  # accepted range
_RELEASE, _IGNORE = 0, 65535  # in place of a pulse
_NO_AXIS = 32767  # of MANUAL_CONTROL
_NO_RATES, _NO_THROTTLE, _NO_ATTITUDE = 7, 64, 128  # ATTITUDE_TARGET_TYPEMASK
_THRUST_VECTOR = 32
_CRUISE = "TRIM_THROTTLE"  # %, throttle while its stick is released
# By field of a command: its channel, and the conversion of the channel's pulses.
_STICKS = {
    "roll": (ROLL, RcScaling.roll_angle),
    "pitch": (PITCH, RcScaling.pitch_angle),
    "throttle": (THROTTLE, RcScaling.throttle_share),
}
_RELEASED: FbwaCommand[float | None] = FbwaCommand(None, None, None)


class ManualControl:
    """Convert stick and attitude messages to fly-by-wire-A commands.

    A stick without a new value keeps its last one. A released stick is centred, the throttle is
    then TRIM_THROTTLE. While all are released no command is sent.
    """

    def __init__(self, context: VehicleContext) -> None:
        """Start with all sticks released."""
        self._context = context
        self._sticks = _RELEASED
        self._latest_s = -math.inf
        self.handlers: Mapping[str, Handler] = {
            "RC_CHANNELS_OVERRIDE": self._override,
            "MANUAL_CONTROL": self._manual,
            "SET_ATTITUDE_TARGET": self._attitude,
        }

    def _override(self, message: Message) -> list[OutgoingMessage]:
        """Take pulses in place of those of an RC receiver."""
        scaling = self._context.rc_scaling()
        self._release_stale()
        for stick, (channel, convert) in _STICKS.items():
            pulse_us = int(message.number(f"chan{channel}_raw"))
            if pulse_us == _RELEASE:
                self._move(stick, None)
            elif pulse_us != _IGNORE:
                self._move(stick, convert(scaling, pulse_us))
        return self._send_command()

    def _manual(self, message: Message) -> list[OutgoingMessage]:
        """Take joystick axes: x forward is nose down, y right, z throttle from 0.

        Like ArduPlane, it converts them to whole µs over the range of the stick.
        """
        scaling = self._context.rc_scaling()
        self._release_stale()
        axes = (
            ("roll", "y", scaling.roll, 1.0, (-1000.0, 1000.0)),
            ("pitch", "x", scaling.pitch, -1.0, (-1000.0, 1000.0)),
            ("throttle", "z", scaling.throttle, 1.0, (0.0, 1000.0)),
        )
        for stick, axis, pwm_range, sign, ends in axes:
            value = int(message.number(axis))
            if value != _NO_AXIS:
                pulse_us = _pulse_of_axis(sign * value, ends, pwm_range)
                _, convert = _STICKS[stick]
                self._move(stick, convert(scaling, pulse_us))
        return self._send_command()

    def _attitude(self, message: Message) -> list[OutgoingMessage]:
        """Take roll and pitch of a quaternion, and a thrust; rates beside them are ignored."""
        mask, thrust = int(message.number("type_mask")), message.number("thrust")
        q = message.fields["q"]
        if mask & _THRUST_VECTOR:
            return self._context.warn("Attitude target: give thrust 0 to 1, no vector")
        if mask & _NO_ATTITUDE and mask & _NO_RATES != _NO_RATES:
            return self._context.warn("Attitude target: give an attitude, not just rates")
        if not mask & _NO_THROTTLE and not math.isfinite(thrust):
            return self._context.warn("Attitude target: write a thrust of 0 to 1, not NaN")
        angles = None
        if not mask & _NO_ATTITUDE:
            assert isinstance(q, tuple)
            w, x, y, z = (float(each) for each in q)
            norm = math.sqrt(w * w + x * x + y * y + z * z)
            if not QUATERNION_NORM[0] <= norm <= QUATERNION_NORM[1]:
                return self._context.warn("Attitude target: give a unit quaternion w, x, y, z")
            roll, pitch, _ = angles_from_quaternion(x, y, z, w)
            angles = self._context.rc_scaling().limits.clamp(roll, pitch)
        self._release_stale()
        if angles is not None:
            roll, pitch = angles
            self._sticks = self._sticks._replace(roll=roll, pitch=pitch)
        if not mask & _NO_THROTTLE:
            self._sticks = self._sticks._replace(throttle=min(max(thrust, 0.0), 1.0))
        return self._send_command(attitude=True, answers_s=self._answered_s(message))

    def _move(self, stick: str, value: float | None) -> None:
        self._sticks = self._sticks._replace(**{stick: value})

    def _answered_s(self, message: Message) -> float | None:
        """Return the time, s, of the sample that an attitude target answers.

        None: its time stamp is not that of a sample.
        """
        stamp, snapshot = int(message.number("time_boot_ms")), self._context.snapshot
        return 1e-3 * stamp if snapshot is not None and 0 < stamp <= snapshot.boot_ms else None

    def _release_stale(self) -> None:
        """Release all sticks after `HOLD_S` without a message."""
        snapshot = self._context.snapshot
        now = 0.0 if snapshot is None else snapshot.sample.time_s
        if now - self._latest_s > HOLD_S:
            self._sticks = _RELEASED
        self._latest_s = now

    def _send_command(
        self, *, attitude: bool = False, answers_s: float | None = None
    ) -> list[OutgoingMessage]:
        sticks = self._sticks
        if sticks == _RELEASED:
            return []
        throttle = sticks.throttle
        if throttle is None:
            throttle = self._context.parameters().get(_CRUISE, 0.0) / 100.0
        rejection = self._context.control.set_manual_command(
            FbwaCommand(pitch=sticks.pitch or 0.0, roll=sticks.roll or 0.0, throttle=throttle),
            attitude=attitude,
            answers_s=answers_s,
        )
        return [] if rejection is None else self._context.warn(rejection.text)


def _pulse_of_axis(value: float, ends: tuple[float, float], pwm_range: PwmRange) -> float:
    low, high = ends
    share = (value - low) / (high - low)
    return math.trunc(pwm_range.min + share * (pwm_range.max - pwm_range.min))
