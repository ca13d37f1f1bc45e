"""A scenario's formation in steady flight as a discrete, linear system."""

from __future__ import annotations

import os
from collections.abc import Sequence

from testbed.core.errors import InputError
from testbed.linear.held_flight import HeldFlight
from testbed.linear.linear_formation import join
from testbed.linear.linear_system import LinearSystem
from testbed.linear.predicted_margins import fly_linearisable
from testbed.linear.predicted_margins import linearise as linearise_flight
from testbed.linear.steady_flight import MarginsError
from testbed.scenario import Scenario, find_loaded
from testbed.scenario.validate import shown_value

MAX_BANK_DEG, MAX_CLIMB_MPS = 60.0, 20.0


def linearise(
    scenario: Scenario | str | os.PathLike[str],
    overrides: Sequence[str] = (),
    *,
    bank_deg: float = 0.0,
    climb_mps: float = 0.0,
) -> LinearSystem:
    """Linearise a scenario's formation in steady flight behind a virtual leader.

    The flight is that of `testbed margins`: in still air, with exact estimates, without faults. The
    memory of a compiled law is a part of the state, `uav1.law/integral`; its whole numbers and
    flags are held.

    Args:
        scenario: a scenario, or the name or path of one.
        overrides: `key=value` as for `--set`; only with a name or path.
        bank_deg: the highest of a follower, clockwise if positive; 0: straight. At most 60.
        climb_mps: of the leader, m/s; descending if negative. At most 20.

    Raises:
        InputError: an argument is wrong, or the scenario has no such steady flight, or cannot be
            linearised; the message has what to write instead.
    """
    flight = fly_or_refuse(find_loaded(scenario, overrides), bank_deg, climb_mps)
    return join(linearise_flight(flight))


def fly_or_refuse(scenario: Scenario, bank_deg: float, climb_mps: float) -> HeldFlight:
    """Fly a scenario's formation steadily; see `linearise` for arguments and errors."""
    limits = (("bank_deg", bank_deg, MAX_BANK_DEG), ("climb_mps", climb_mps, MAX_CLIMB_MPS))
    for name, value, largest in limits:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and abs(value) <= largest):
            raise InputError(
                f"{name}: is {shown_value(value)} (write a number from {-largest:g} to {largest:g})"
            )
    flight, problem = fly_linearisable(scenario, bank_deg, climb_mps)
    if problem:
        raise MarginsError(f"{problem} (write a smaller bank_deg or climb_mps)")
    return flight
