"""The page's faults, and what the formation is to make of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.errors import InputError
from testbed.scenario import Scenario
from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.faults import Fault, GpsJump, GpsLost
from testbed.sensing.estimators import filtered
from testbed.sim.breakdowns import Breakdowns, words
from testbed.sim.roster import Roster
from testbed.sim.teams import cut_off, make_altitudes, make_gains, make_offsets
from testbed.state import Event
from testbed.vehicle.fleet import JsbsimFleet


def make_breakdowns(
    page: Scenario, fleet: JsbsimFleet | None, rows: Sequence[int]
) -> Breakdowns | None:
    """What will break; None: nothing.

    Args:
        page: the scenario.
        fleet: the flight models.
        rows: which aircraft they are.

    Raises:
        InputError: an aircraft cannot break in that way.
    """
    faults = [[_felt(one, each) for one in each.faults] for each in page.aircraft]
    if not any(faults):
        return None
    names = page.aircraft_names
    if fleet is not None:
        for model, row in enumerate(rows):
            fleet.check_faults(model, names[row], faults[row])
    return Breakdowns(names, faults, page.formation.on_failure.after_s)


def make_roster(page: Scenario, breakdowns: Breakdowns | None) -> Roster | None:
    """What followers make of neighbours that tell them that they have failed; None: nothing.

    Raises:
        InputError: the law cannot do that.
    """
    answer = page.formation.on_failure.answer
    if breakdowns is None or answer == "fly-on":
        return None
    if answer == "re-slot" and page.controller.law != "paper":
        raise InputError(
            "formation.on_failure.answer: re-slot moves the paper's law to other slots, and the "
            f"law is {page.controller.law} (write drop, or law: paper)"
        )
    return Roster(
        page.aircraft_names,
        make_offsets(page),
        make_gains(page),
        breakdowns,
        page.formation.on_failure.clear_m if answer == "re-slot" else None,
    )


def _felt(fault: Fault, aircraft: Leader | Follower) -> Fault:
    """The fault as the aircraft notices it: what changes nothing is told nobody."""
    return fault if _matters(fault, aircraft) else fault.model_copy(update={"declared": False})


def _matters(fault: Fault, aircraft: Leader | Follower) -> bool:
    return not isinstance(fault, GpsLost | GpsJump) or filtered(aircraft.sensors)


def unfelt(page: Scenario) -> Iterator[Event]:
    """Warnings of faults that change nothing, and of drops that leave somebody without a place."""
    for each in page.aircraft:
        for fault in each.faults:
            if not _matters(fault, each):
                text = (
                    f"{words(fault)}: changes nothing, its estimate comes from no GPS (write "
                    "sensors: pixhawk, say)"
                )
                yield Event(0.0, "warning", each.name, text)
    yield from _stranded(page)


def _stranded(page: Scenario) -> Iterator[Event]:
    """Whom nobody tells where to be once an aircraft that may fail is left out."""
    if page.formation.on_failure.answer == "fly-on":
        return
    gains, names = make_gains(page), [each.name for each in page.fleet]
    level = ~np.isnan(make_altitudes(page))
    for lost, follower in enumerate(page.fleet):
        if any(_felt(fault, follower).is_declared for fault in follower.faults):
            left = [i for i in range(len(names)) if i != lost]
            rest = gains[np.ix_(left, [0, *(i + 1 for i in left)])]
            for i in cut_off(rest, level[left]):
                text = (
                    f"without {names[lost]} nobody tells it where to be: write a leader gain for "
                    "it, or answer: fly-on"
                )
                yield Event(0.0, "warning", names[left[i]], text)
