"""Margins of a formation with many sets of gains, of one steady flight.

Aircraft and autopilots are linearised once. For each set of gains law and middle loop alone are
linearised again, at the same steady flight: with other gains it would differ by some centimetres.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from testbed.core.errors import InputError, NotCopied
from testbed.core.records import Records
from testbed.linear.linear_formation import command_margins, join
from testbed.linear.linear_system import LinearSystem
from testbed.linear.linearise import fly_or_refuse
from testbed.linear.loop_margins import CommandMargins
from testbed.linear.period_map import linearise_control
from testbed.linear.predicted_margins import linearise
from testbed.linear.steady_flight import build_compiled, steady_scenario
from testbed.scenario import Scenario, load_scenario
from testbed.scenario.arguments import check_overrides, check_path

SAME_COMMANDS = 2e-3  # rad, and of the throttle, between the steady commands of two sets of gains


class GainScan(NotCopied):
    """A steady flight in which gains are changed.

    Args:
        scenario: name or path of a scenario.
        overrides: `key=value` as for `--set`, of the flight.
        bank_deg: the highest of a follower, clockwise if positive; 0: straight.
        climb_mps: of the leader, m/s.

    Raises:
        InputError: see `testbed.linearise`.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str],
        overrides: Sequence[str] = (),
        *,
        bank_deg: float = 0.0,
        climb_mps: float = 0.0,
    ) -> None:
        """Fly, and linearise."""
        self._name = check_path("scenario", scenario)
        self._overrides = check_overrides("overrides", overrides)
        self._turn = bank_deg, climb_mps
        flown = load_scenario(self._name, self._overrides)
        self._flight = fly_or_refuse(flown, bank_deg, climb_mps)
        self._maps = linearise(self._flight)
        self._fixed, self._law = _without_gains(flown), flown.controller.law

    def _why_not_copied(self) -> str:
        """See `NotCopied`: it holds a flight."""
        return (
            f"the scan of {self._name} cannot be copied or pickled (make another one, with the "
            "same arguments)"
        )

    def formation(self, overrides: Sequence[str] = ()) -> LinearSystem:
        """Linearise the formation with other gains.

        Args:
            overrides: `key=value` as for `--set`, of keys of `controller`, also the options of a
                user's law, and of gains of `formation`.

        Raises:
            InputError: the scenario cannot be flown with them, or they change more than gains.
        """
        texts = (*self._overrides, *check_overrides("overrides", overrides))
        scenario = load_scenario(self._name, texts)
        if scenario.controller.law != self._law or _without_gains(scenario) != self._fixed:
            raise InputError(
                f"overrides: {', '.join(overrides)}: changes more than gains (write keys of "
                "controller but its law, or of formation but its offsets)"
            )
        steady = steady_scenario(scenario, self._turn[0], "compiled", self._turn[1])
        world = build_compiled(steady)
        own = self._flight.world.formation.built_control
        new = world.formation.built_control
        if not np.array_equal(new.neighbours["used"], own.neighbours["used"]):
            raise InputError(
                f"overrides: {', '.join(overrides)}: changes which messages are used (write gains "
                "of the same neighbours, none of them 0)"
            )
        before = own.controllers.copy(), own.neighbours.copy()
        _copy_gains(new.controllers, new.neighbours, own.controllers, own.neighbours)
        if not own.builtin:
            self._flight.use_laws(new.groups)  # with other options
        try:
            maps = linearise_control(self._flight, self._maps)
        finally:
            own.controllers[:], own.neighbours[:] = before
            self._flight.use_laws(None)
        return join(maps)

    def margins(self, overrides: Sequence[str] = ()) -> dict[str, dict[str, CommandMargins]]:
        """Return the margins with other gains, by follower and command; see `formation`."""
        formation = self.formation(overrides)
        return {name: command_margins(formation, name) for name in self._flight.world.names[1:]}


def _without_gains(scenario: Scenario) -> dict[str, object]:
    """Return what a scan may not change."""
    data = scenario.model_dump(mode="json", by_alias=True)
    data.pop("controller")
    data["scenario"].pop("published")  # lists the differences from the paper
    data["formation"] = data["formation"]["offsets_m"]
    return data


def _copy_gains(
    controllers: Records, neighbours: Records, to_controllers: Records, to_neighbours: Records
) -> None:
    """Copy gains and options of law and middle loop, without their memory."""
    for name in ("law", "loop"):
        to_controllers[name] = controllers[name]
    to_neighbours["gain"] = neighbours["gain"]
