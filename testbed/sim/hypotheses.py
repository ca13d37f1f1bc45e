"""Which of the paper's hypotheses a page breaks, said before the flight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from testbed.formation.assumptions import (
    Finding,
    by_text,
    check_barrier,
    check_gain,
    check_kappa,
    check_slot_speed,
)
from testbed.formation.geometry import frame_rate, velocity_rates
from testbed.formation.paper_law import PaperLaw
from testbed.formation.slot_speed import slot_speed, slot_speed_range
from testbed.frames import flight_path_angle
from testbed.scenario import Scenario
from testbed.sim.control import Group
from testbed.sim.leaders import Led
from testbed.sim.teams import agent_value, follower_names
from testbed.state import Array, Event
from testbed.vehicle.trim import STILL, Vector

MOST_LINES = 6  # of slots whose speeds differ; of more the worst is told
_SLOTS = "formation.kappa_mps"


def warnings(
    page: Scenario, groups: Sequence[Group], led: Led, wind_ned: Vector
) -> tuple[Event, ...]:
    """One warning per hypothesis that does not hold, or may not, naming the followers."""
    said = []
    if page.leader.path.kind == "replay" and any(wind_ned):
        text = (
            "a recorded flight moves over the ground as it did: its attitude and airspeed are "
            "those of the wind it was flown in (leave air.wind out, or fly a mission)"
        )
        said.append(Event(0.0, "warning", page.leader.name, text))
    if page.air.wind.file and page.controller.bounds_of == "airspeed":
        text = (
            "kappa and the speeds of the slots are measured in the wind of the start, which the "
            "recorded wind leaves; the law itself bounds the airspeed"
        )
        said.append(Event(0.0, "warning", "run", text))
    found: dict[str, list[str]] = {}
    slots: dict[str, float] = {}  # by what is said of them, how much of κ there is
    for group in groups:
        findings = list(_findings(page, group, led, wind_ned))
        for text, rows in by_text(findings).items():
            found.setdefault(text, []).extend(group.team.names[row] for row in rows)
        slots |= {each.text: each.number for each in findings if each.about == _SLOTS}
    if len(slots) > MOST_LINES:
        found = _summed_up(found, slots)
    order = follower_names(page)
    for names in found.values():
        names.sort(key=order.index)
    for text, names in found.items():
        alone = len(names) == 1
        source = names[0] if alone else "run"
        said.append(Event(0.0, "warning", source, text if alone else f"{', '.join(names)}: {text}"))
    return tuple(said)


def _summed_up(found: dict[str, list[str]], slots: dict[str, float]) -> dict[str, list[str]]:
    """What is said of the slots said of the one with least room, and of how many others."""
    worst = min(slots, key=lambda text: slots[text])
    others = sum(len(found[text]) for text in slots) - len(found[worst])
    return {
        f"{text}; and so do the slots of {others} more, less so" if text == worst else text: names
        for text, names in found.items()
        if text == worst or text not in slots
    }


def _findings(page: Scenario, group: Group, led: Led, wind_ned: Vector) -> Iterator[Finding]:
    team, law = group.team, group.law
    kappa = np.array([agent_value(page, name, "kappa_mps") for name in team.names])
    yield from check_kappa(kappa, team.speed_low, team.speed_high)
    if isinstance(law, PaperLaw):
        bound = np.asarray(law.control_function.bound)
        open_ = [agent_value(page, name, "speed_desired_mps") is None for name in team.names]
        yield from (each for each in check_gain(law.k, kappa, bound) if open_[each.agent])
        yield from check_barrier(law.barrier, law.speeds)
    medium = wind_ned if page.controller.bounds_of == "airspeed" else None
    slowest, fastest, possible = _slot_speeds(group, led, medium)
    yield from check_slot_speed(
        slowest, fastest, kappa, team.speed_low, team.speed_high, possible=possible
    )


def _slot_speeds(group: Group, led: Led, wind_ned: Vector | None) -> tuple[Array, Array, bool]:
    """The slots' smallest and largest speed (m,) m/s, and whether that is only what may be.

    Over the ground, or if a wind is given through that air.
    """
    offsets = group.team.offsets[group.team.agents]
    if led.limits:
        limits = led.limits if wind_ned is None else led.limits_in_air
        assert limits is not None, "a flown leader has both"
        return (*slot_speed_range(offsets, **limits._asdict()), True)
    assert led.track is not None, "a leader is flown, or its track is known"
    velocity = led.track.velocity_ned - np.array(wind_ned or STILL)
    course_rate, climb_rate = velocity_rates(velocity, led.track.acceleration_ned)
    rate = frame_rate(flight_path_angle(velocity), course_rate, climb_rate)
    speeds = slot_speed(velocity, rate, offsets)
    return speeds.min(axis=0), speeds.max(axis=0), False
