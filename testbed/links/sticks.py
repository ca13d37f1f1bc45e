"""Sticks held by a program outside: three ways to say a fly-by-wire-A command."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from testbed.frames import euler_from_quaternion
from testbed.links.channels import (
    PITCH,
    ROLL,
    THROTTLE,
    Range,
    pitch_of,
    roll_of,
    throttle_of,
    within,
)
from testbed.links.craft import Craft
from testbed.links.replies import Handler, Reply
from testbed.mavlink.door import Message

HOLD_S = 3.0  # for which a channel that is not mentioned stays as it was, simulated s
LENGTH = (0.9, 1.1)  # of an attitude's quaternion
_RELEASE, _IGNORE = 0, 65535  # pulses that are none
_NO_AXIS = 32767  # of MANUAL_CONTROL
_NO_RATES, _NO_THROTTLE, _NO_ATTITUDE = 7, 64, 128  # ATTITUDE_TARGET_TYPEMASK
_THRUST_VECTOR = 32
_CRUISE = "TRIM_THROTTLE"  # %, where the throttle is that nobody holds


class Sticks:
    """Turns what is said into commands for the cockpit.

    A stick that is not mentioned stays where it was put; one that is let go is at its centre, the
    throttle at TRIM_THROTTLE. With all let go, nothing is commanded.
    """

    def __init__(self, craft: Craft) -> None:
        """Nobody holds anything."""
        self._craft = craft
        self._held: list[float | None] = [None, None, None]  # roll, pitch, throttle
        self._heard_s = -math.inf
        self.handlers: Mapping[str, Handler] = {
            "RC_CHANNELS_OVERRIDE": self._override,
            "MANUAL_CONTROL": self._manual,
            "SET_ATTITUDE_TARGET": self._attitude,
        }

    def _override(self, message: Message, at_s: float) -> list[Reply]:
        """Pulses, as those of a radio."""
        scale = self._craft.scales()
        self._forget()
        for stick, (channel, meaning) in enumerate(_MEANINGS):
            pulse_us = int(message.number(f"chan{channel}_raw"))
            if pulse_us == _RELEASE:
                self._held[stick] = None
            elif pulse_us != _IGNORE:
                self._held[stick] = meaning(pulse_us, scale)
        return self._tell(at_s)

    def _manual(self, message: Message, at_s: float) -> list[Reply]:
        """Axes of a joystick: x forward is nose down, y right, z throttle from 0.

        ArduPlane makes pulses of them, whole µs from one end of the stick to the other.
        """
        scale = self._craft.scales()
        self._forget()
        axes = (
            ("y", scale.roll, 1.0, (-1000.0, 1000.0)),
            ("x", scale.pitch, -1.0, (-1000.0, 1000.0)),
            ("z", scale.throttle, 1.0, (0.0, 1000.0)),
        )
        for stick, (axis, reach, sign, ends) in enumerate(axes):
            value = int(message.number(axis))
            if value != _NO_AXIS:
                pulse_us = _pulse_of_axis(sign * value, ends, reach)
                self._held[stick] = _MEANINGS[stick][1](pulse_us, scale)
        return self._tell(at_s)

    def _attitude(self, message: Message, at_s: float) -> list[Reply]:
        """Roll and pitch of a quaternion, and a thrust; rates that come with them are not flown."""
        mask, thrust = int(message.number("type_mask")), message.number("thrust")
        q = message.fields["q"]
        if mask & _THRUST_VECTOR:
            return self._warn("Attitude target: give thrust 0 to 1, no vector", at_s)
        if mask & _NO_ATTITUDE and mask & _NO_RATES != _NO_RATES:
            return self._warn("Attitude target: give an attitude, not just rates", at_s)
        if not mask & _NO_THROTTLE and not math.isfinite(thrust):
            return self._warn("Attitude target: thrust is no number: give 0 to 1", at_s)
        angles = None
        if not mask & _NO_ATTITUDE:
            assert isinstance(q, tuple)
            w, x, y, z = (float(each) for each in q)
            length = math.sqrt(w * w + x * x + y * y + z * z)
            if not LENGTH[0] <= length <= LENGTH[1]:
                return self._warn("Attitude target: give a unit quaternion w, x, y, z", at_s)
            roll, pitch, _ = euler_from_quaternion(np.array([x, y, z, w])).tolist()
            angles = within(roll, pitch, self._craft.scales().limits)
        self._forget()
        if angles is not None:
            self._held[:2] = angles
        if not mask & _NO_THROTTLE:
            self._held[2] = min(max(thrust, 0.0), 1.0)
        return self._tell(at_s, attitude=True, answers_s=self._answered(message))

    def _answered(self, message: Message) -> float | None:
        """Time of the state that an attitude target answers, s; None: its stamp is its own."""
        stamp, scene = int(message.number("time_boot_ms")), self._craft.scene
        return 1e-3 * stamp if scene is not None and 0 < stamp <= scene.boot_ms else None

    def _forget(self) -> None:
        """What somebody held long ago is not held any more."""
        now = 0.0 if self._craft.scene is None else self._craft.scene.frame.time_s
        if now - self._heard_s > HOLD_S:
            self._held = [None, None, None]
        self._heard_s = now

    def _tell(
        self, at_s: float, *, attitude: bool = False, answers_s: float | None = None
    ) -> list[Reply]:
        roll, pitch, throttle = self._held
        if roll is None and pitch is None and throttle is None:
            return []
        if throttle is None:
            throttle = self._craft.parameters().get(_CRUISE, 0.0) / 100.0
        refusal = self._craft.cockpit.sticks(
            roll or 0.0, pitch or 0.0, throttle, attitude=attitude, answers_s=answers_s
        )
        return [] if refusal is None else self._warn(refusal.text, at_s)

    def _warn(self, why: str, at_s: float) -> list[Reply]:
        return self._craft.texts.warn(why, at_s)


_MEANINGS = ((ROLL, roll_of), (PITCH, pitch_of), (THROTTLE, throttle_of))


def _pulse_of_axis(value: float, ends: tuple[float, float], stick: Range) -> float:
    least, most = ends
    part = (value - least) / (most - least)
    return math.trunc(stick.least + part * (stick.most - stick.least))
