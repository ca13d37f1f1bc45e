"""Begin a flight as another one was at some time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

from testbed.core.errors import InputError
from testbed.core.records import Event
from testbed.flight.loop import Flight
from testbed.plan.scenario_files import file_digests, referents
from testbed.scenario import Scenario, load_scenario
from testbed.vehicle.fleet import FlightModels

# Parts of a flight, by what their names in it contain.
_PARTS = {
    "world.parts.control": "law and middle loop",
    "world.parts.radio": "messages on their way",
    "world.parts.leader": "guidance of the leader",
    "world.estimators": "sensors and filters",
    "world.air": "air",
    "world.faults": "faults",
    "world.vehicles": "autopilots",
}


class MakeFlight(Protocol):
    """Make the flight of a scenario."""

    def __call__(self, scenario: Scenario, *, blank: bool) -> Flight:
        """See `make_begin`."""


_Prior = tuple[Scenario, float, dict[str, str], Flight, Flight]  # with the digests of its files
_last: list[_Prior] = []  # at most one: flights of a study begin alike


def make_begin(
    scenario: Scenario, models: FlightModels | None, make: MakeFlight
) -> Callable[[Flight], None] | None:
    """Return the function that begins a flight as `scenario.begin` says; None: it begins at 0 s.

    Args:
        scenario: of the flight.
        models: its flight models, if there are any.
        make: returns the flight of a scenario before its first tick; `blank`: as at 0 s, also where
            it begins as another one.

    Raises:
        InputError: the flight cannot take over the other one.
    """
    begin = scenario.scenario.begin
    if begin is None:
        return None
    prior = load_scenario(begin.scenario)
    here, there = (
        (
            each.aircraft_names,
            [str(one.aircraft) for one in each.aircraft],
            each.rates.model_dump(),
        )
        for each in (scenario, prior)
    )
    for what, one, other in zip(("names", "airframes", "rates"), here, there, strict=True):
        if one != other:
            raise InputError(f"scenario.begin: {prior.name} has other {what} than {scenario.name}")
    for each, there_too in zip(scenario.aircraft, prior.aircraft, strict=True):
        for fault in each.faults:
            late = fault.at_s is None or fault.at_s >= begin.at_s
            if not late and fault not in there_too.faults:
                raise InputError(
                    f"{each.name}: fault {fault.kind}: at_s: {fault.at_s:g} s is before the flight "
                    f"begins, at {begin.at_s:g} s, and {prior.name} has no such fault (write a "
                    f"later time, or give {prior.name} the same fault)"
                )
    if models is not None and models.engine != "compiled":
        raise InputError("scenario.begin: flight models of JSBSim have no state to take over")
    rates = scenario.rates
    ticks, period = begin.at_s * rates.physics_hz, rates.physics_hz // rates.autopilot_hz
    if abs(ticks / period - round(ticks / period)) > 1e-6:
        raise InputError(
            f"scenario.begin.at_s: is no time at which autopilots step (write a multiple of "
            f"{1.0 / rates.autopilot_hz:g} s)"
        )
    return partial(_begin, prior, begin.at_s, make)


def _begin(prior: Scenario, at_s: float, make: MakeFlight, flight: Flight) -> None:
    """Let a flight begin as another one is at a time, s."""
    before, after = _flights(prior, at_s, make)
    left = flight.take_over(before, after)
    parts = [words for name, words in _PARTS.items() if any(name in each for each in left)]
    anew = f"; {', '.join(parts)} begin anew" if parts else ""
    flight.add_event(Event(after.time_s, "info", "run", f"begins as {prior.name}{anew}"))


def _flights(prior: Scenario, at_s: float, make: MakeFlight) -> tuple[Flight, Flight]:
    """Return the flight of a scenario as at 0 s, and as it is at a time, s."""
    now = prior, at_s, file_digests(referents(prior))
    if not (_last and _last[0][:3] == now):
        before, after = make(prior, blank=True), make(prior, blank=False)
        if not after.fly_to(at_s):
            raise InputError(
                f"scenario.begin.at_s: {prior.name} ends at {after.time_s:g} s: {after.ending} "
                "(write an earlier time)"
            )
        _last[:] = [(*now, before, after)]
    return _last[0][3:]
