"""Warn before the flight: assumptions of [HBH23], limits and sensor settings that do not hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from testbed.autopilot.parameters import FbwaParams
from testbed.core.records import Array, Event, join_names
from testbed.formation.assumptions import (
    Finding,
    SpeedSet,
    by_text,
    check_barrier,
    check_gain,
    check_kappa,
    check_slot_speed,
)
from testbed.formation.barrier import barriers_of
from testbed.formation.law import FormationConfig
from testbed.formation.slots import frame_rates, slot_speed, slot_speed_range
from testbed.scenario import Scenario, middle_loop_gains
from testbed.sim.build_control import BuiltControl, agent_value, follower_names
from testbed.sim.build_leader import LeaderSetup
from testbed.vehicle.trim import STILL, Vector

MAX_SLOT_WARNINGS = 6  # above which only the worst is given, with the number of the others
_KAPPA = "formation.kappa_mps"


def assumption_warnings(
    scenario: Scenario, built: BuiltControl, leader: LeaderSetup, wind_ned: Vector
) -> tuple[Event, ...]:
    """Return a warning for each assumption that does not hold, or may not."""
    findings = list(_findings(scenario, built, leader, wind_ned))
    found: dict[str, list[str]] = {}
    for text, rows in by_text(findings).items():
        found.setdefault(text, []).extend(built.config.names[row] for row in rows)
    margins = {each.text: each.number for each in findings if each.about == _KAPPA}
    if len(margins) > MAX_SLOT_WARNINGS:
        found = _only_worst_slot(found, margins)
    order = follower_names(scenario)
    for names in found.values():
        names.sort(key=order.index)
    return (*_wind_warnings(scenario, wind_ned), *_warnings(found))


def _warnings(found: Mapping[str, Sequence[str]]) -> Iterator[Event]:
    """Yield a warning for each text, with the names of all aircraft that have it."""
    for text, names in found.items():
        if len(names) == 1:
            yield Event(0.0, "warning", names[0], text)
        else:
            yield Event(0.0, "warning", "run", f"{join_names(names)}: {text}")


def _wind_warnings(scenario: Scenario, wind_ned: Vector) -> Iterator[Event]:
    """Warn where the wind is not the one for which speeds were computed."""
    if scenario.leader.path.kind == "replay" and any(wind_ned):
        text = (
            "a recorded flight repeats its ground track: its attitude and airspeed are those of "
            "the wind it was flown in (leave air.wind out, or fly a mission)"
        )
        yield Event(0.0, "warning", scenario.leader.name, text)
    if scenario.air.wind.file and scenario.controller.bounded_speed == "airspeed":
        text = (
            "kappa and the speeds of the slots are computed for the wind at the start, and the "
            "recorded wind changes; the law itself bounds the airspeed"
        )
        yield Event(0.0, "warning", "run", text)


def _only_worst_slot(
    found: dict[str, list[str]], margins: dict[str, float]
) -> dict[str, list[str]]:
    """Replace the warnings of all slots by the one with the smallest margin."""
    worst = min(margins, key=lambda text: margins[text])
    others = sum(len(found[text]) for text in margins) - len(found[worst])
    return {
        f"{text}; {others} other slots have the same problem to a lesser degree"
        if text == worst
        else text: names
        for text, names in found.items()
        if text == worst or text not in margins
    }


def _findings(
    scenario: Scenario, built: BuiltControl, leader: LeaderSetup, wind_ned: Vector
) -> Iterator[Finding]:
    config, law = built.config, built.controllers["law"]
    kappa = np.array([agent_value(scenario, name, "kappa_mps") for name in config.names])
    yield from check_kappa(kappa, config.speed_min, config.speed_max)
    if built.builtin:
        bound = law["mu"]["bound"]
        fixed = [
            agent_value(scenario, name, "speed_desired_mps") is not None for name in config.names
        ]
        yield from (each for each in check_gain(law["k"], kappa, bound) if not fixed[each.agent])
        speeds = SpeedSet(*(law[f"speed_{name}"] for name in SpeedSet._fields))
        yield from check_barrier(barriers_of(law["barrier"]), speeds)
    of_airspeed = scenario.controller.bounded_speed == "airspeed"
    slowest, fastest, possible = _slot_speeds(config, leader, wind_ned if of_airspeed else None)
    in_air = None
    if not of_airspeed and leader.limits != leader.limits_in_air:
        in_air = _slot_speeds(config, leader, wind_ned)[:2]
    yield from check_slot_speed(
        slowest,
        fastest,
        kappa,
        config.speed_min,
        config.speed_max,
        possible=possible,
        medium="through the air" if of_airspeed else "over the ground",
        in_air=in_air,
    )


def _slot_speeds(
    config: FormationConfig, leader: LeaderSetup, wind_ned: Vector | None
) -> tuple[Array, Array, bool]:
    """Compute the smallest and largest speeds of the slots.

    Returns:
        Smallest and largest speed of each slot (n,) m/s, and whether they are limits rather than
        speeds of a known path.
    """
    offsets = config.offsets[config.agents]
    if leader.limits:
        limits = leader.limits if wind_ned is None else leader.limits_in_air
        assert limits is not None, "a leader on a mission has both"
        return (*slot_speed_range(offsets, **limits._asdict()), True)
    assert leader.motion is not None, "a leader has limits or a known motion"
    slowest, fastest = np.full(len(offsets), np.inf), np.zeros(len(offsets))
    for over_ground, acceleration in leader.motion:
        velocity = over_ground - np.array(wind_ned or STILL)
        speeds = slot_speed(velocity, frame_rates(velocity, acceleration), offsets)
        np.minimum(slowest, speeds.min(axis=0), out=slowest)
        np.maximum(fastest, speeds.max(axis=0), out=fastest)
    return slowest, fastest, False


TOLERANCE = 1e-6  # degrees


class _Limit(NamedTuple):
    """A limit of commands and that of the autopilot which receives them, degrees."""

    what: str
    commanded: float
    reached: float
    parameter: str
    write: str  # the key of the scenario, to be formatted with a number


def limit_warnings(
    scenario: Scenario, tunes: Sequence[FbwaParams], kinds: Sequence[str]
) -> Iterator[Event]:
    """Return a warning for each limit that undercuts another one, with the aircraft.

    Args:
        scenario: as resolved.
        tunes: of N aircraft.
        kinds: of their N vehicles; those without an autopilot have no limits.
    """
    found: dict[str, list[str]] = {}
    for row, follower in enumerate(scenario.fleet, start=1):
        if kinds[row] != "jsbsim":
            continue
        gains = middle_loop_gains(scenario, follower.aircraft)
        tune, limits = tunes[row], gains.limits
        roll, pitch = "controller.gains.limits.roll_deg", "controller.gains.limits.pitch_deg"
        pitch_deg = limits.pitch_deg
        pairs = [
            _Limit("roll", limits.roll_deg, tune.roll_limit_deg, "ROLL_LIMIT_DEG", roll),
            _Limit("pitch up", pitch_deg, tune.ptch_lim_max_deg, "PTCH_LIM_MAX_DEG", pitch),
            _Limit("pitch down", pitch_deg, -tune.ptch_lim_min_deg, "PTCH_LIM_MIN_DEG", pitch),
        ]
        for each in pairs:
            if text := _text(each):
                found.setdefault(f"the middle loop commands {text}", []).append(follower.name)
    path = scenario.leader.path
    if kinds[0] == "jsbsim" and path.kind == "mission":
        reached = tunes[0].roll_limit_deg
        bank = path.bank_limit_deg
        limit = _Limit("roll", bank, reached, "ROLL_LIMIT_DEG", "leader.path.bank_limit_deg")
        if bank > reached + TOLERANCE:
            found[f"its guidance commands {_text(limit)}"] = [scenario.leader.name]
    yield from _warnings(found)


def _text(limit: _Limit) -> str:
    """Describe a limit of an autopilot that differs from that of the commands; "" if none does."""
    what, commanded, reached, parameter, key = limit
    if commanded > reached + TOLERANCE:
        return (
            f"up to {commanded:g}° of {what}, and the autopilot stops at {reached:g}°, {parameter} "
            f"of its tune: what is cut off is not counted as saturation (write {key}: {reached:g}, "
            f"or a {parameter} of {commanded:g})"
        )
    # the autopilot's limits of pitch need not be symmetrical
    if reached > commanded + TOLERANCE and parameter != "PTCH_LIM_MIN_DEG":
        return (
            f"at most {commanded:g}° of {what}, and {parameter} of its tune, {reached:g}°, is "
            f"never reached (write {key}: {reached:g} to fly it, or a {parameter} of {commanded:g})"
        )
    return ""


PERIOD_TOLERANCE = 1e-6  # of a period


def sensor_warnings(scenario: Scenario) -> Iterator[Event]:
    """Warn of each GPS latency that is not a whole number of autopilot periods."""
    rate_hz = scenario.rates.autopilot_hz
    found: dict[str, list[str]] = {}
    for each in scenario.aircraft:
        sensors = each.sensors
        if sensors.gps is None:
            continue
        for key, value in (
            ("gps.latency_s", sensors.gps.latency_s),
            ("estimator.gps_delay_s", sensors.estimator.gps_delay_s),
        ):
            periods = value * rate_hz
            if abs(periods - round(periods)) > PERIOD_TOLERANCE:
                low, high = math.floor(periods) / rate_hz, math.ceil(periods) / rate_hz
                text = (
                    f"sensors.{key}: {value:g} s flies as {round(periods) / rate_hz:g} s, a whole "
                    f"number of periods of rates.autopilot_hz, {rate_hz} Hz (write {low:g} or "
                    f"{high:g}, or another rate)"
                )
                found.setdefault(text, []).append(each.name)
    yield from _warnings(found)
