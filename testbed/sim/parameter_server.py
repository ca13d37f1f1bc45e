"""An aircraft's parameters by ArduPlane's names, as a ground station reads and sets them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, replace

import numpy as np

from testbed.autopilot.parameters import FbwaParams, ParamError, with_param
from testbed.mavlink.vehicle_control import Rejection
from testbed.sim.navigator import Navigator

LOITER_RADIUS, ACCEPTANCE_RADIUS = "WP_LOITER_RAD", "WP_RADIUS"


class ParameterServer:
    """Read and set the parameters of an aircraft's autopilot and navigator.

    Attributes:
        params: the autopilot's.
        values: all of them, by name, in a fixed order.
    """

    def __init__(
        self,
        params: FbwaParams,
        apply_params: Callable[[FbwaParams], None],
        navigator: Navigator,
    ) -> None:
        """Serve these; `apply_params` gives the autopilot others."""
        self.params, self._apply, self._navigator = params, apply_params, navigator
        self._bank_limit = navigator.flight_params.bank_limit
        self.values: Mapping[str, float] = {}
        self._update_values()

    @property
    def airspeed_limits(self) -> tuple[float, float]:
        """AIRSPEED_MIN and AIRSPEED_MAX, m/s."""
        return self.params.airspeed_min, self.params.airspeed_max

    def set(self, name: str, value: float) -> str | Rejection:
        """Set a parameter and return the change as text, empty if the value is unchanged."""
        before = self.values.get(name)
        if before is None:
            return Rejection(f"{name}: no such parameter", supported=False)
        if np.float32(value) == np.float32(before):  # MAVLink's resolution
            return ""
        if name in (LOITER_RADIUS, ACCEPTANCE_RADIUS):
            rejection = self._set_radius(name, value)
        else:
            rejection = self._set_autopilot(name, value)
        if rejection:
            return rejection
        self._update_values()
        return f"{name} {value:.6g} (was {before:.6g})"

    def _set_radius(self, name: str, value: float) -> Rejection | None:
        navigator = self._navigator
        size = abs(value) if name == LOITER_RADIUS else value
        if not (size >= 1.0 and math.isfinite(value)):
            return Rejection(f"{name}: write 1 m or more")
        if name == LOITER_RADIUS:
            navigator.set_loiter_radius(value)
        else:
            navigator.set_flight_params(replace(navigator.flight_params, waypoint_radius=value))
        return None

    def _set_autopilot(self, name: str, value: float) -> Rejection | None:
        try:
            self.params = with_param(self.params, name, value)
        except ParamError as error:
            return Rejection(str(error))
        self._apply(self.params)
        navigator = self._navigator
        navigator.set_flight_params(
            replace(
                navigator.flight_params,
                period=self.params.navl1_period,
                damping=self.params.navl1_damping,
                bank_limit=min(self._bank_limit, math.radians(self.params.roll_limit_deg)),
            )
        )
        return None

    def _update_values(self) -> None:
        own = {
            field.name.upper(): getattr(self.params, field.name) for field in fields(self.params)
        }
        self.values = own | {
            LOITER_RADIUS: self._navigator.loiter_radius,
            ACCEPTANCE_RADIUS: self._navigator.flight_params.waypoint_radius,
        }
