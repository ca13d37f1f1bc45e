"""What an aircraft demands of the page that ArduPlane flies, or a program outside commands."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from testbed.scenario.aircraft import Leader
from testbed.scenario.fault_checks import Finding, crafts
from testbed.scenario.pilots import ArduPlane, External

if TYPE_CHECKING:
    from testbed.scenario.schema import Scenario

_SLOWEST_HZ = 50  # of ArduPlane's SCHED_LOOP_RATE


def check_pilots(page: Scenario) -> Iterator[Finding]:
    """Yield every contradiction: where, and what to write instead."""
    yield from _arduplanes(page)
    yield from _externals(page)


def _externals(page: Scenario) -> Iterator[Finding]:
    for at, craft in crafts(page):
        asked = craft.commanded_by
        if not isinstance(asked, External):
            continue
        where = (*at, "commanded_by")
        instead = "leave this out"
        if isinstance(craft, Leader) and craft.path.kind != "mission":
            yield (
                where,
                f"is external, and a leader with a path of kind {craft.path.kind} moves by itself "
                f"(write a path of kind: mission, or {instead})",
            )
        elif craft.vehicle == "ideal":
            yield (
                where,
                "is external, and an ideal vehicle has no autopilot to command (write vehicle: "
                f"jsbsim, or {instead})",
            )
        elif isinstance(craft.autopilot, ArduPlane):
            yield (
                where,
                "is external, and ArduPlane has a link of its own to command it by (write "
                f"autopilot: virtual, or {instead})",
            )
        if asked.lockstep and page.rates.log_hz != page.rates.control_hz:
            yield (
                ("rates", "log_hz"),
                f"is {page.rates.log_hz}, and in lockstep {craft.name} hears of a frame at every "
                f"control period (write control_hz's {page.rates.control_hz})",
            )


def _arduplanes(page: Scenario) -> Iterator[Finding]:
    taken: dict[int, str] = {}
    for row, (at, craft) in enumerate(crafts(page)):
        asked = craft.autopilot
        if not isinstance(asked, ArduPlane):
            continue
        where = (*at, "autopilot")
        if isinstance(craft, Leader) and craft.path.kind != "mission":
            yield (
                where,
                f"is ardupilot, and a leader with a path of kind {craft.path.kind} is flown by "
                "nobody (write a path of kind: mission, or leave this out)",
            )
        elif craft.vehicle == "ideal":
            yield (
                where,
                "is ardupilot, and an ideal vehicle has no surfaces (write vehicle: jsbsim, or "
                "leave this out)",
            )
        instance = row if asked.instance is None else asked.instance
        if instance in taken:
            yield (
                (*where, "instance"),
                f"{instance} is that of {taken[instance]}, too (write another: ports depend on it)",
            )
        taken.setdefault(instance, craft.name)
        if page.rates.autopilot_hz < _SLOWEST_HZ:
            yield (
                ("rates", "autopilot_hz"),
                f"is {page.rates.autopilot_hz}, and ArduPlane, which flies {craft.name}, has "
                f"{_SLOWEST_HZ} Hz and more (write {_SLOWEST_HZ})",
            )
