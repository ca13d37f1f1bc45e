"""Engines, propellers, battery and fuel of one JSBSim aircraft.

All engines have one throttle. Engines that burn fuel are started before a flight, and the fuel is
frozen unless the flight burns it, so that the mass is that of the trim.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from testbed.core.errors import InputError

_IGNITION = 3  # of both magnetos
_ALL_ENGINES = -1
_RESTS = 1e-9  # relative change in a step
_TURNS = 1.0  # rpm
_FREE, _FROZEN = 0.0, 1.0


class AircraftError(InputError):
    """An aircraft folder that JSBSim cannot fly."""


class Powerplant:
    """What drives an aircraft, by JSBSim's properties.

    Attributes:
        set_throttle: commands all engines, 0..1; without an engine it has no effect.
        has_engine: there is one.
        has_pistons: engines that only a starter starts, in steps of time.
        burns_fuel: some engine does.
        throttle_lags: the power follows the throttle with a lag that is no state of `linearize`.
    """

    def __init__(self, name: str, find: Callable[[str], Any]) -> None:
        """Bind the properties, freeze the fuel, and set levers and landing gear for flight.

        Args:
            name: of the aircraft, for errors.
            find: returns the node of a property; None: there is none.
        """
        self._name, self._find = name, find
        count = 0
        while find(f"propulsion/engine[{count}]/thrust-lbs") is not None:
            count += 1
        each = range(count)
        self.has_engine = count > 0
        self.set_throttle = _common_setter(
            [find(f"fcs/throttle-cmd-norm[{k}]").set_double_value for k in each]
        )
        pistons = [k for k in each if find(f"propulsion/engine[{k}]/map-inhg")]
        gas_turbines = [k for k in each if find(f"propulsion/engine[{k}]/n1")]
        self.has_pistons = bool(pistons)
        self.burns_fuel = bool(pistons or gas_turbines)
        self._pistons, self._turbines = (
            [node.get_double_value for node in self._nodes(which, "set-running")]
            for which in (pistons, gas_turbines)
        )
        self._senses = self._nodes(each, "propeller-sense")
        self._rotation = [node.get_double_value() for node in self._senses]
        self._speeds = [node.get_double_value for node in self._nodes(each, "propeller-rpm")]
        self.throttle_lags = bool(self._speeds) and self.burns_fuel
        self._settling = list(self._speeds)
        self._settling += [node.get_double_value for node in self._nodes(each, "blade-angle")]
        self._settling += [node.get_double_value for node in self._nodes(pistons, "map-inhg")]
        jets = [k for k in gas_turbines if not find(f"propulsion/engine[{k}]/propeller-rpm")]
        self._settling += [node.get_double_value for node in self._nodes(jets, "thrust-lbs")]
        turboprops = [k for k in gas_turbines if k not in jets]
        self._spools = self._nodes(turboprops, "n1")
        self._freeze = find("propulsion/fuel_freeze")
        self.freeze_fuel(frozen=True)
        for k in each:
            for lever in ("mixture", "advance"):
                find(f"fcs/{lever}-cmd-norm[{k}]").set_double_value(1.0)
        for gear in ("gear/gear-cmd-norm", "gear/gear-pos-norm"):
            find(gear).set_double_value(0.0)

    def _nodes(self, engines: Sequence[int], name: str) -> list[Any]:
        found = [self._find(f"propulsion/engine[{k}]/{name}") for k in engines]
        return [node for node in found if node is not None]

    # engines

    @property
    def has_propeller(self) -> bool:
        """Return whether an engine has one."""
        return bool(self._speeds)

    @property
    def propeller_rpm(self) -> float:
        """Revolutions per minute of the first propeller; NaN without one."""
        return float(self._speeds[0]()) if self._speeds else math.nan

    @property
    def runs(self) -> bool:
        """Return whether all engines that are started run."""
        return self.pistons_run and all(get() for get in self._turbines)

    @property
    def stands_still(self) -> bool:
        """Return whether a propeller of an engine that burns fuel does not turn."""
        return self.burns_fuel and any(get() < _TURNS for get in self._speeds)

    @property
    def pistons_run(self) -> bool:
        """Return whether all piston engines run."""
        return all(get() for get in self._pistons)

    def crank(self, *, starter: bool) -> None:
        """Switch the ignition on, and the starters of all piston engines on or off."""
        self._find("propulsion/magneto_cmd").set_double_value(_IGNITION)
        self._find("propulsion/starter_cmd").set_double_value(float(starter))

    def set_running(self) -> None:
        """Let all engines run at the speed of their throttle, as JSBSim finds it."""
        self._find("propulsion/set-running").set_double_value(_ALL_ENGINES)

    def spools(self) -> list[float]:
        """Return the speeds of the gas generators of turboprops, which JSBSim lets idle again."""
        return [node.get_double_value() for node in self._spools]

    def set_spools(self, speeds: Sequence[float]) -> None:
        """Set these speeds; JSBSim overwrites them in the first step after an initial condition."""
        for node, speed in zip(self._spools, speeds, strict=True):
            node.set_double_value(speed)

    def remove_torque(self, *, removed: bool) -> None:
        """Let propellers turn without torque on the airframe, or with it again."""
        for node, value in zip(self._senses, self._rotation, strict=True):
            node.set_double_value(0.0 if removed else value)

    def settling_values(self) -> list[float]:
        """Return what follows the throttle with a lag: speeds, blade angles, pressures, thrusts."""
        return [get() for get in self._settling]

    # fuel and battery

    def freeze_fuel(self, *, frozen: bool) -> None:
        """Keep the contents of the tanks, or let the engines burn them."""
        if self._freeze is not None:
            self._freeze.set_double_value(_FROZEN if frozen else _FREE)

    def check_fuel(self) -> None:
        """Check that there is fuel to burn.

        Raises:
            AircraftError: no engine burns fuel, or the tanks are empty.
        """
        if not self.burns_fuel:
            raise AircraftError(
                f"{self._name}: has no engine that burns fuel (remove the key fuel_burn)"
            )
        fuel = self._find("propulsion/total-fuel-lbs")
        if fuel is None or not fuel.get_double_value() > 0.0:
            raise AircraftError(
                f"{self._name}: its tanks are empty, so there is no fuel to burn (write <contents> "
                "of its tanks, or remove the key fuel_burn)"
            )

    def set_cells(self, cells: int) -> None:
        """Set the number of cells of the battery in series; 0: that of the airframe.

        Raises:
            AircraftError: the aircraft has no battery with a number of cells.
        """
        if not cells:
            return
        node = self._find("battery/cells")
        if node is None:
            raise AircraftError(
                f"{self._name}: has no battery/cells, so there cannot be {cells:g} cells (remove "
                "the key)"
            )
        node.set_double_value(cells)

    def charge(self, state_of_charge: float) -> None:
        """Set the state of charge of the battery, from the next placement on.

        Raises:
            AircraftError: the aircraft has no battery, and the state of charge is below 1.
        """
        node = self._find("battery/initial-state-of-charge")
        if node is not None:
            node.set_double_value(state_of_charge)
        elif state_of_charge != 1.0:
            raise AircraftError(
                f"{self._name}: has no battery, so its state of charge cannot be "
                f"{state_of_charge:g} (remove the key)"
            )

    def discharge(self, state_of_charge: float) -> None:
        """Discharge the battery in flight to a state of charge; never charge it.

        Raises:
            AircraftError: the aircraft has no battery.
        """
        initial = self._find("battery/initial-state-of-charge")
        if initial is None:
            raise AircraftError(f"{self._name}: has no battery that could be discharged")
        more = state_of_charge - self._find("battery/state-of-charge").get_double_value()
        initial.set_double_value(initial.get_double_value() + min(more, 0.0))


def at_rest(before: Sequence[float], after: Sequence[float], share: float = _RESTS) -> bool:
    """Return whether values have changed in a step by less than a share, by default rounding."""
    for old, new in zip(before, after, strict=True):  # faster than `all`: most of a trim's steps
        if not (abs(new - old) < share * abs(new) or new == old):
            return False
    return True


def _common_setter(setters: Sequence[Callable[[float], None]]) -> Callable[[float], None]:
    """Return a function that sets all of them, fast where there is one."""
    if len(setters) == 1:
        return setters[0]

    def set_all(value: float) -> None:
        for each in setters:
            each(value)

    return set_all
