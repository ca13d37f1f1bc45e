"""What faults on the page demand: of themselves, of the aircraft they befall, and of the run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.faults import Fault

if TYPE_CHECKING:
    from testbed.scenario.schema import Scenario

Path = tuple[str | int, ...]
Finding = tuple[Path, str]
_SAYS_NOTHING = {
    "autopilot-frozen": "an autopilot that hangs tells nobody",
    "radio-mute": "an aircraft that is mute tells nobody",
}


def crafts(page: Scenario) -> Iterator[tuple[Path, Leader | Follower]]:
    """Every aircraft of the page and where it stands, the leader first."""
    yield ("leader",), page.leader
    for index, follower in enumerate(page.fleet):
        yield ("fleet", index), follower


def check_faults(page: Scenario) -> Iterator[Finding]:
    """Yield every contradiction of a fault: where, and what to write instead."""
    duration = page.scenario.duration_s
    for at, craft in crafts(page):
        why, cure = _flies_on(craft)
        for index, fault in enumerate(craft.faults):
            where = (*at, "faults", index)
            yield from _begins(where, fault, duration)
            yield from _says(where, fault)
            if why:
                yield from _befalls(where, fault, why, cure)


def _begins(at: Path, fault: Fault, duration: float) -> Iterator[Finding]:
    when = fault.when
    if fault.at_s is None and when is None:
        yield (
            at,
            "never begins (write at_s: 20, say, in s, or when: {quantity: airspeed_mps, below: "
            "15})",
        )
    elif fault.at_s is not None and fault.at_s > duration:
        yield (
            (*at, "at_s"),
            f"{fault.at_s:g} s is after the run, which lasts {duration:g} s (write less, or a "
            "longer duration_s)",
        )
    if when is not None and (when.above is None) == (when.below is None):
        said = "neither above nor below" if when.above is None else "above and below"
        yield (*at, "when"), f"says {said} (write one of the two, as in below: 15)"


def _says(at: Path, fault: Fault) -> Iterator[Finding]:
    if fault.kind == "battery-low" and fault.lasts_s is not None:
        yield (*at, "lasts_s"), "a battery in flight does not recharge (leave this out)"
    if fault.declared and fault.kind in _SAYS_NOTHING:
        yield (*at, "declared"), f"{_SAYS_NOTHING[fault.kind]} (leave this out)"


def _flies_on(craft: Leader | Follower) -> tuple[str, str]:
    """Why this aircraft flies on whatever breaks, and the cure; empty if it does not."""
    if isinstance(craft, Leader) and craft.path.kind != "mission":
        why = f"the leader flies its {craft.path.kind} path whatever breaks"
        return why, "a path of kind: mission"
    if craft.vehicle == "ideal":
        return "an ideal vehicle has no parts that break", "vehicle: jsbsim"
    return "", ""


def _befalls(at: Path, fault: Fault, why: str, cure: str) -> Iterator[Finding]:
    if fault.OF_FLIGHT:
        yield (*at, "kind"), f"is {fault.kind}, and {why} (leave the fault out, or write {cure})"
    elif fault.when is not None and fault.when.quantity == "state_of_charge":
        yield (
            (*at, "when", "quantity"),
            f"is state_of_charge, and no battery is simulated here (write another, or {cure})",
        )
