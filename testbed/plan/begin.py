"""Begin a flight as another one was at some time."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from testbed.core.errors import InputError
from testbed.core.records import Event
from testbed.flight.loop import Flight
from testbed.plan.scenario_files import file_digests, referents
from testbed.scenario import Scenario, load_scenario
from testbed.scenario.arguments import with_changes
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
_Prior = tuple[Scenario, float, dict[str, str], Flight, Flight]  # with the digests of its files
_last: list[_Prior] = []  # at most one: flights of a study begin alike


def make_begin(
    scenario: Scenario, models: FlightModels | None, fly: Callable[[Scenario], Flight]
) -> Callable[[Flight], None] | None:
    """Return the function that begins a flight as `scenario.begin` says; None: it begins at 0 s.

    Args:
        scenario: of the flight.
        models: its flight models, if there are any.
        fly: returns the flight of a scenario, at its first tick.

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
    if models is not None and models.engine != "compiled":
        raise InputError("scenario.begin: flight models of JSBSim have no state to take over")
    rates = scenario.rates
    ticks, period = begin.at_s * rates.physics_hz, rates.physics_hz // rates.autopilot_hz
    if abs(ticks / period - round(ticks / period)) > 1e-6:
        raise InputError(
            f"scenario.begin.at_s: is no time at which autopilots step (write a multiple of "
            f"{1.0 / rates.autopilot_hz:g} s)"
        )
    return partial(_begin, prior, begin.at_s, fly)


def _begin(prior: Scenario, at_s: float, fly: Callable[[Scenario], Flight], flight: Flight) -> None:
    """Let a flight begin as another one is at a time, s."""
    before, after = _flights(prior, at_s, fly)
    left = flight.take_over(before, after)
    parts = [words for name, words in _PARTS.items() if any(name in each for each in left)]
    anew = f"; {', '.join(parts)} begin anew" if parts else ""
    flight.add_event(Event(after.time_s, "info", "run", f"begins as {prior.name}{anew}"))


def _flights(
    prior: Scenario, at_s: float, fly: Callable[[Scenario], Flight]
) -> tuple[Flight, Flight]:
    """Return the flight of a scenario as it begins, and as it is at a time, s."""
    now = prior, at_s, file_digests(referents(prior))
    if not (_last and _last[0][:3] == now):
        # from 0 s on: what changed in a flight that it begins with in turn counts, too
        from_zero = with_changes(prior, scenario=with_changes(prior.scenario, begin=None))
        before, after = fly(from_zero), fly(prior)
        if not after.fly_to(at_s):
            raise InputError(
                f"scenario.begin.at_s: {prior.name} ends at {after.time_s:g} s: {after.ending} "
                "(write an earlier time)"
            )
        _last[:] = [(*now, before, after)]
    return _last[0][3:]
