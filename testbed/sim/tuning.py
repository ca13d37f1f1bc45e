"""An aircraft's parameters, by ArduPlane's names, as a ground station reads and sets them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace

import numpy as np

from testbed.links.cockpit import Refusal
from testbed.sim.navigator import Navigator
from testbed.vehicle.params import FbwaParams, ParamError, with_param

RADIUS, ACCEPTANCE = "WP_LOITER_RAD", "WP_RADIUS"


class Tuning:
    """The autopilot's parameters, and those of how it goes where nobody holds its sticks.

    Attributes:
        tune: the autopilot's.
        values: all of them, by name, in a fixed order.
    """

    def __init__(
        self, tune: FbwaParams, retune: Callable[[FbwaParams], None], navigator: Navigator
    ) -> None:
        """Begin with these; `retune` gives the autopilot others."""
        self.tune, self._retune, self._navigator = tune, retune, navigator
        self._bank_limit = navigator.manner.bank_limit
        self.values: Mapping[str, float] = {}
        self._read()

    def change(self, name: str, value: float) -> str | Refusal:
        """Fly with this parameter from now on; what has changed in words, empty: nothing has."""
        before = self.values.get(name)
        if before is None:
            return Refusal(f"{name}: no such parameter", supported=False)
        if np.float32(value) == np.float32(before):  # as far as MAVLink can say
            return ""
        refusal = self._set(name, value)
        if refusal:
            return refusal
        self._read()
        return f"{name} {value:.6g} (was {before:.6g})"

    def _set(self, name: str, value: float) -> Refusal | None:
        navigator = self._navigator
        if name in (RADIUS, ACCEPTANCE):
            least = value if name == ACCEPTANCE else abs(value)
            if not (least >= 1.0 and math.isfinite(value)):
                return Refusal(f"{name}: write 1 m or more")
            if name == RADIUS:
                navigator.change_radius(value)
            else:
                navigator.behave(replace(navigator.manner, waypoint_radius=value))
            return None
        try:
            self.tune = with_param(self.tune, name, value)
        except ParamError as error:
            return Refusal(str(error))
        self._retune(self.tune)
        navigator.behave(
            replace(
                navigator.manner,
                period=self.tune.navl1_period,
                damping=self.tune.navl1_damping,
                bank_limit=min(self._bank_limit, math.radians(self.tune.roll_limit_deg)),
            )
        )
        return None

    def _read(self) -> None:
        own = {field.name.upper(): getattr(self.tune, field.name) for field in fields(self.tune)}
        self.values = own | {
            RADIUS: self._navigator.radius,
            ACCEPTANCE: self._navigator.manner.waypoint_radius,
        }
