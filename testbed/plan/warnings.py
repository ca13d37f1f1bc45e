"""Warn before the flight: assumptions of [HBH23], limits and sensor settings that do not hold."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from testbed.autopilot.parameters import sitl_gyro_cutoff, unusual_values
from testbed.core.errors import InputError
from testbed.core.records import Array, Event, join_names
from testbed.flight.control import BuiltControl
from testbed.flight.world import LeaderSetup
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
from testbed.formation.sampled_gains import check_not_tiny, check_rate
from testbed.formation.slots import (
    frame_rates,
    slot_attitude,
    slot_attitude_range,
    slot_speed,
    slot_speed_range,
)
from testbed.plan.fleet import Fleet, FormationPlan, PlannedFollower
from testbed.scenario import Scenario, SingleAircraft
from testbed.scenario.sections import Rates
from testbed.scenario.unusual import unusual_numbers
from testbed.vehicle.fleet import FlightModels
from testbed.vehicle.jsbsim_adapter import modes_of_aircraft
from testbed.vehicle.step_size import describe_coarse_step, find_coarse_step
from testbed.vehicle.trim import STILL, TrimPoint, Vector

MAX_SLOT_WARNINGS = 6  # above which only the worst is given, with the number of the others
USUAL_GAIN_SCALE = (0.1, 10.0)
_KAPPA = "formation.kappa_mps"


def assumption_warnings(
    scenario: Scenario,
    fleet: FormationPlan,
    built: BuiltControl,
    leader: LeaderSetup,
    wind_ned: Vector,
) -> tuple[Event, ...]:
    """Return a warning for each assumption that does not hold, or may not."""
    findings = list(_findings(scenario, fleet, built, leader, wind_ned))
    found: dict[str, list[str]] = {}
    for text, rows in by_text(findings).items():
        found.setdefault(text, []).extend(built.config.names[row] for row in rows)
    margins = {each.text: each.number for each in findings if each.about == _KAPPA}
    if len(margins) > MAX_SLOT_WARNINGS:
        found = _only_worst_slot(found, margins)
    order = fleet.names
    for names in found.values():
        names.sort(key=order.index)
    return (
        *_wind_warnings(scenario, wind_ned),
        *_scale_warnings(scenario),
        *_warnings(found),
    )


def unusual_warnings(scenario: Scenario | SingleAircraft) -> Iterator[Event]:
    """Return a warning for each key with a number that is allowed, and larger than usual."""
    for text in unusual_numbers(scenario):
        yield Event(0.0, "warning", "run", text)


def _scale_warnings(scenario: Scenario) -> Iterator[Event]:
    """Warn where all gains of the middle loop are far from those that were identified."""
    scale = scenario.controller.gain_scale
    low, high = USUAL_GAIN_SCALE
    if not low <= scale <= high:
        text = (
            f"controller.gain_scale: {scale:g} multiplies every gain of the middle loop, far from "
            f"those that were tuned (write {low:g} to {high:g})"
        )
        yield Event(0.0, "warning", "run", text)


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
    scenario: Scenario,
    fleet: FormationPlan,
    built: BuiltControl,
    leader: LeaderSetup,
    wind_ned: Vector,
) -> Iterator[Finding]:
    config, law = built.config, built.controllers["law"]
    kappa = fleet.of_followers(lambda each: each.agent.kappa_mps)
    yield from check_kappa(kappa, config.airspeed_min, config.airspeed_max)
    if built.builtin:
        bound = law["mu"]["bound"]
        fixed = [each.agent.speed_desired_mps is not None for each in fleet.followers]
        yield from (each for each in check_gain(law["k"], kappa, bound) if not fixed[each.agent])
        control_hz = scenario.rates.control_hz
        turning = law["c"] + law["c_speed"] * law["speed_max"] ** 2
        weights = np.where(config.gains > 0.0, config.gains, np.inf).min(axis=(1, 2))
        yield from check_rate("formation.a", law["a"], control_hz)
        yield from check_rate("formation.c", turning, control_hz)
        yield from check_rate("formation.speed_pole_per_s", law["speed_pole"], control_hz)
        yield from check_not_tiny("formation.k", law["k"], " m/s")
        yield from check_not_tiny("leader_gains or neighbour_gains", weights, "")
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
        config.airspeed_min,
        config.airspeed_max,
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


def limit_warnings(fleet: FormationPlan) -> Iterator[Event]:
    """Return a warning for each limit that undercuts another one, with the aircraft."""
    found: dict[str, list[str]] = {}
    for follower in fleet.followers:
        if not follower.has_model:
            continue
        tune, limits = follower.params, follower.gains.limits
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
    path = fleet.leader.section.path
    if fleet.leader.has_model and path.kind == "mission":
        reached = fleet.leader.params.roll_limit_deg
        bank = path.bank_limit_deg
        limit = _Limit("roll", bank, reached, "ROLL_LIMIT_DEG", "leader.path.bank_limit_deg")
        if bank > reached + TOLERANCE:
            found[f"its guidance commands {_text(limit)}"] = [fleet.leader.name]
    yield from _warnings(found)


def tune_warnings(fleet: Fleet) -> Iterator[Event]:
    """Warn of parameters outside the usual range, which may make an aircraft oscillate or dull."""
    found: dict[str, list[str]] = {}
    for each in fleet.aircraft:
        if each.has_model and (texts := list(unusual_values(each.params))):
            found.setdefault(f"{each.tune_file}: {', '.join(texts)}", []).append(each.name)
    yield from _warnings(found)


def sitl_gyro_warnings(fleet: Fleet, rate_hz: int) -> Iterator[Event]:
    """Warn of the gyro filters of ArduPlane processes, which depend on the rate of the physics."""
    found: dict[str, list[str]] = {}
    for each in fleet.aircraft:
        if each.arduplane:
            cutoff, own = sitl_gyro_cutoff(each.params, rate_hz), each.params.ins_gyro_filter
            if cutoff != own:
                text = (
                    f"SITL at rates.physics_hz {rate_hz} has a gyro filter of {cutoff:g} Hz in "
                    f"place of INS_GYRO_FILTER, {own:g} Hz (a virtual autopilot has the same with "
                    "autopilot: {kind: virtual, gyro_filter: sitl})"
                )
                found.setdefault(text, []).append(each.name)
    for text, names in found.items():
        yield Event(0.0, "warning", "run", f"{join_names(names)}: {text}")


class _Demand(NamedTuple):
    """What slots need of one quantity, and the limits of the followers."""

    what: str
    needed: Array  # (n,) degrees, the largest
    beyond_s: Array  # (n,) time that a slot needs more than the limits allow; NaN: not known
    limits: Mapping[str, Array]  # (n,) degrees, by key of the scenario or the tune
    remedy: str


def leader_warnings(
    fleet: FormationPlan,
    config: FormationConfig,
    leader: LeaderSetup,
    duration_s: float,
    wind_ned: Vector,
) -> Iterator[Event]:
    """Warn where followers need more bank or climb to fly their slots than their limits allow.

    The speeds of the slots are in `assumption_warnings`.

    Args:
        fleet: the aircraft; those without an autopilot have no limits.
        config: of the n followers.
        leader: the leader.
        duration_s: of the run.
        wind_ned: at the start, m/s.
    """
    limited = np.array([each.has_model for each in fleet.followers])
    names = config.names
    for each in _demands(fleet.followers, config, leader, duration_s, wind_ned):
        allowed = np.minimum.reduce([*each.limits.values()])
        excess = np.where(limited, each.needed - allowed, 0.0)
        rows = np.flatnonzero(excess > TOLERANCE).tolist()
        if not rows:
            continue
        worst = int(excess.argmax())
        needed, limit = float(each.needed[worst]), float(allowed[worst])
        # a limit above what is needed, as of the other one, is not in the way
        keys = [key for key, value in each.limits.items() if value[worst] < needed]
        known = not math.isnan(each.beyond_s[worst])
        verb = "needs" if known else "may need"
        beyond = f", {each.beyond_s[worst]:.1f} s of it" if known else ","
        numbers = f"{verb} up to {needed:.1f}° of {each.what}{beyond} beyond {limit:g}°"
        text = (
            f"the slot{f' of {names[worst]}' if rows[1:] else ''} {numbers}, the limit by "
            f"{' and '.join(keys)}: it cannot be held there (write {each.remedy}, or higher limits)"
        )
        yield from _warnings({text: [names[row] for row in rows]})


def _demands(
    followers: Sequence[PlannedFollower],
    config: FormationConfig,
    leader: LeaderSetup,
    duration_s: float,
    wind_ned: Vector,
) -> Iterator[_Demand]:
    """Yield what slots need of bank, climb and descent, with the limits of the followers."""
    roll, pitch = np.degrees(config.roll_limit), np.degrees(config.pitch_limit)
    key, tunes = "controller.gains.limits", [each.params for each in followers]
    limits = {
        "bank": {
            f"{key}.roll_deg": roll,
            "ROLL_LIMIT_DEG": np.array([tune.roll_limit_deg for tune in tunes]),
        },
        "climb": {
            f"{key}.pitch_deg": pitch,
            "PTCH_LIM_MAX_DEG": np.array([tune.ptch_lim_max_deg for tune in tunes]),
        },
        "descent": {
            f"{key}.pitch_deg": pitch,
            "PTCH_LIM_MIN_DEG": np.array([-tune.ptch_lim_min_deg for tune in tunes]),
        },
    }
    climbs = np.isnan([each.altitude for each in followers])
    offsets = config.offsets[config.agents]
    if leader.limits_in_air:
        bank, gamma = map(
            np.degrees, slot_attitude_range(offsets, **leader.limits_in_air._asdict())
        )
        gamma = np.where(climbs, gamma, 0.0)
        unknown = np.full(len(offsets), np.nan)
        lower = "a lower leader.path.bank_limit_deg", "a lower leader.path.climb_limit_mps"
        yield _Demand("bank", bank, unknown, limits["bank"], lower[0])
        for what in ("climb", "descent"):
            yield _Demand(what, gamma, unknown, limits[what], lower[1])
        return
    assert leader.motion is not None, "a leader has limits or a known motion"
    allowed = {what: np.minimum.reduce([*each.values()]) for what, each in limits.items()}
    largest = {what: np.zeros(len(offsets)) for what in limits}
    beyond = {what: np.zeros(len(offsets)) for what in limits}
    for velocity, acceleration in leader.motion:
        bank, gamma = map(
            np.degrees, slot_attitude(velocity, acceleration, offsets, np.array(wind_ned))
        )
        gamma = np.where(climbs, gamma, 0.0)
        for what, values in {"bank": np.abs(bank), "climb": gamma, "descent": -gamma}.items():
            np.maximum(largest[what], values.max(axis=0), out=largest[what])
            beyond[what] += (values > allowed[what] + TOLERANCE).sum(axis=0)
    period = duration_s / sum(len(each) for each, _ in leader.motion)
    for what in limits:
        remedy = "a leader that turns wider" if what == "bank" else f"a leader with less {what}"
        yield _Demand(what, largest[what], period * beyond[what], limits[what], remedy)


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


def step_warnings(fleet: Fleet, rates: Rates, models: FlightModels | None) -> Iterator[Event]:
    """Warn of flight models whose modes are too fast for rates.physics_hz.

    Eigenvalues grow with the airspeed: of several aircraft of a kind the fastest is examined.

    Raises:
        InputError: a mode is unstable at this rate.
    """
    if models is None:
        return
    fastest = dict[Path, TrimPoint]()
    multiple_hz = math.lcm(rates.autopilot_hz, rates.control_hz, rates.broadcast_hz, rates.log_hz)
    names: dict[Path, list[str]] = {}
    for row, trim in zip(fleet.model_rows, models.trims, strict=True):
        folder, point = fleet.aircraft[row].folder, trim.point
        names.setdefault(folder, []).append(fleet.names[row])
        if folder not in fastest or point.airspeed > fastest[folder].airspeed:
            fastest[folder] = point
    found: dict[str, list[str]] = {}
    for folder, point in fastest.items():
        modes = modes_of_aircraft(folder, point, fleet.origin)
        coarse = find_coarse_step(modes, rates.physics_hz, multiple_hz)
        if coarse is None:
            continue
        text = describe_coarse_step(coarse, folder.name, point.airspeed, rates.physics_hz)
        text += f" (write rates.physics_hz: {coarse.rate_hz})"
        if not coarse.stable:
            raise InputError(f"rates.physics_hz: {join_names(names[folder])}: {text}")
        found[text] = names[folder]
    yield from _warnings(found)


PERIOD_TOLERANCE = 1e-6  # of a period


def sensor_warnings(fleet: Fleet, rate_hz: int) -> Iterator[Event]:
    """Warn of each GPS latency that is not a whole number of autopilot periods."""
    found: dict[str, list[str]] = {}
    for each in fleet.aircraft:
        sensors = each.section.sensors
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
