"""Checks of sections against each other: names, rates, windows, faults, control sources."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from testbed.scenario.air import Air, Turbulence, Wind
from testbed.scenario.aircraft import (
    MAX_LEGS,
    AircraftSection,
    ArduPlane,
    External,
    Follower,
    Leader,
    VirtualAutopilot,
)
from testbed.scenario.control import BUILT_IN
from testbed.scenario.expect import check_expect
from testbed.scenario.faults import AnyFault
from testbed.scenario.fields import SMALLEST, Finding, KeyPath
from testbed.scenario.network_checks import check_network
from testbed.scenario.problems import did_you_mean
from testbed.scenario.sections import Rates, Sections
from testbed.scenario.sensors import SENSOR_NAMES

# name of an aircraft, its position, m, the kind of position, and its path in the scenario
_Place = tuple[str, tuple[float, float, float], str, KeyPath]

LOWEST_START_M = 5.0  # above the origin; an aircraft starts in trimmed flight
_ARDUPLANE_MIN_HZ = 50  # smallest SCHED_LOOP_RATE
# Rate loops of the shipped tunes oscillate at 5 Hz: in simulation-3-30deg the RMS of the followers'
# roll rates is four times that at 50 Hz, and 1.2 times at 10 Hz.
_FBWA_MIN_HZ = 10
_NOT_DECLARABLE = {
    "autopilot-frozen": "a frozen autopilot cannot declare it",
    "transmitter-off": "an aircraft that sends nothing cannot declare it",
}


def cross_check(scenario: Sections) -> list[Finding]:
    """Return every contradiction between sections."""
    followers = [follower.name for follower in scenario.fleet]
    return [
        *_rates(scenario),
        *_names(scenario),
        *_starts(scenario),
        *_start_altitudes(scenario),
        *_laps(scenario),
        *_circle(scenario),
        *_formation(scenario),
        *_slots(scenario),
        *_agents(scenario),
        *_law(scenario),
        *(
            each
            for at, aircraft in _aircraft(scenario)
            for each in check_sensor_rates(at, aircraft, scenario.rates)
        ),
        *_fly_by_wire(scenario),
        *_ardupilot(scenario),
        *_external(scenario),
        *_faults(scenario),
        *_fuel(scenario),
        *_limits(scenario),
        *check_network(scenario),
        *check_air(scenario.air),
        *_begin(scenario),
        *_windows(scenario),
        *_published(scenario),
        *check_expect(scenario.expect, list(scenario.scenario.windows), followers),
    ]


def _aircraft(scenario: Sections) -> Iterator[tuple[KeyPath, Leader | Follower]]:
    """Yield every aircraft with its path, the leader first."""
    yield ("leader",), scenario.leader
    for index, follower in enumerate(scenario.fleet):
        yield ("fleet", index), follower


def _laps(scenario: Sections) -> Iterator[Finding]:
    path = scenario.leader.path
    if path.kind != "mission":
        return
    counts = [len(leg.points_m) * leg.laps if leg.kind == "waypoints" else 1 for leg in path.legs]
    if sum(counts) > MAX_LEGS:
        most = counts.index(max(counts))
        yield (
            ("leader", "path", "legs", most, "laps"),
            f"the mission has {sum(counts):,} legs with all laps (write {MAX_LEGS:,} or fewer)",
        )


def _circle(scenario: Sections) -> Iterator[Finding]:
    path = scenario.leader.path
    if path.kind != "virtual" or path.curve.kind != "circle":
        return
    curve = path.curve
    if (curve.radius_m is None) == (curve.bank_deg is None):
        size = "neither radius_m nor bank_deg" if curve.radius_m is None else "both sizes"
        yield (
            ("leader", "path", "curve"),
            f"has {size} (write one of the two, as in radius_m: 150 or bank_deg: 20; null takes an "
            "inherited one back)",
        )


def _unknown_followers(
    at: KeyPath, names: Iterable[str], followers: list[str]
) -> Iterator[Finding]:
    for name in names:
        if name not in followers:
            yield (
                (*at, name),
                f"no follower has this name{did_you_mean(name, followers)} (the fleet has "
                f"{', '.join(followers)})",
            )


# header and rates


def _rates(scenario: Sections) -> Iterator[Finding]:
    base = scenario.rates.physics_hz
    for key, rate in scenario.rates:
        if key != "synchronous" and base % rate:
            below = next(
                divisor for divisor in range(min(rate, base), 0, -1) if base % divisor == 0
            )
            yield (
                ("rates", key),
                f"{rate} Hz does not divide physics_hz, {base} Hz (write {below}, or another "
                "physics_hz)",
            )


def _begin(scenario: Sections) -> Iterator[Finding]:
    begin = scenario.scenario.begin
    if begin is None:
        return
    if begin.at_s >= scenario.scenario.duration_s:
        yield (
            ("scenario", "begin", "at_s"),
            f"is not before the end, at {scenario.scenario.duration_s:g} s (write a longer "
            "duration_s)",
        )
    for at, aircraft in _aircraft(scenario):
        if aircraft.commanded_by.kind == "external" or aircraft.autopilot.kind == "ardupilot":
            text = "is not for flights that begin with another one (write scenario.begin: null)"
            yield at, f"{aircraft.name} is commanded from outside or has an ArduPlane, which {text}"


def _windows(scenario: Sections) -> Iterator[Finding]:
    duration = scenario.scenario.duration_s
    start = scenario.scenario.begin.at_s if scenario.scenario.begin else 0.0
    for name, (begin, end) in scenario.scenario.windows.items():
        at = ("scenario", "windows", name)
        if begin < start:
            yield at, f"begins at {begin:g} s, before the flight, which begins at {start:g} s"
        if begin >= end:
            yield at, f"[{begin:g}, {end:g}] is not a window (write [from, to] in s)"
        elif end > duration:
            yield (
                at,
                f"ends at {end:g} s, after the run, which lasts {duration:g} s (end it earlier, or "
                "write a longer duration_s)",
            )


def _published(scenario: Sections) -> Iterator[Finding]:
    published = scenario.scenario.published
    if published is None:
        return
    windows = list(scenario.scenario.windows)
    for key in ("rms_m", "mean_rms_m", "percent_error"):
        for name in getattr(published, key):
            if name not in windows:
                yield (
                    ("scenario", "published", key, name),
                    f"no window has this name{did_you_mean(name, windows)} (windows has "
                    f"{', '.join(windows) or 'none'})",
                )
    for name, row in published.rms_m.items():
        if len(row) != len(scenario.fleet):
            yield (
                ("scenario", "published", "rms_m", name),
                f"has {len(row)} numbers for {len(scenario.fleet)} followers (write one per "
                "follower, in fleet order)",
            )


# aircraft


def _names(scenario: Sections) -> Iterator[Finding]:
    seen = {scenario.leader.name: "the leader"}
    for index, follower in enumerate(scenario.fleet):
        if follower.name in seen:
            yield (
                ("fleet", index, "name"),
                f"{follower.name!r} is already the name of {seen[follower.name]} (write another)",
            )
        else:
            seen[follower.name] = f"fleet.{index}"


def _starts(scenario: Sections) -> Iterator[Finding]:
    """Find aircraft that start in one place."""
    places: list[_Place] = []
    if scenario.leader.path.kind != "virtual":  # a point, not an aircraft
        places.append((scenario.leader.name, (0.0, 0.0, 0.0), "own", ("leader", "start")))
    for index, follower in enumerate(scenario.fleet):
        at: KeyPath = ("fleet", index, "start_m")
        places.append((follower.name, follower.start_m, "own", at))
    for (name, place, _, at), (other, _, _, other_at) in _coincident(places):
        yield (
            at,
            f"{_position(place)} puts {name} in the same place as {other} ({_dotted(other_at)}) at "
            "the start (write another start)",
        )


def _start_altitudes(scenario: Sections) -> Iterator[Finding]:
    """Find aircraft that start near or below the ground, with a mission's leader."""
    leader = scenario.leader
    if leader.path.kind != "mission":  # it starts on its path
        return
    altitudes: list[tuple[KeyPath, float]] = [
        (("leader", "start", "altitude_m"), leader.start.altitude_m),
        *(
            (("fleet", index, "start_m"), leader.start.altitude_m - follower.start_m[2])
            for index, follower in enumerate(scenario.fleet)
        ),
    ]
    for at, altitude in altitudes:
        if altitude < LOWEST_START_M:
            side = f"{-altitude:g} m below" if altitude < 0.0 else f"{altitude:g} m above"
            yield (
                at,
                f"is a start {side} the ground (write one at least {LOWEST_START_M:g} m above it)",
            )
            if at[0] == "leader":
                return


def _slots(scenario: Sections) -> Iterator[Finding]:
    """Find followers whose slots are in one place, or in that of the leader."""
    offsets, altitudes = scenario.formation.offsets_m, scenario.formation.altitudes_m
    places: list[_Place] = []
    if scenario.leader.path.kind != "virtual":
        places.append((scenario.leader.name, (0.0, 0.0, 0.0), "offset", ("leader",)))
    for name in (follower.name for follower in scenario.fleet):
        if name in offsets:
            forward, right, down = offsets[name]
            at: KeyPath = ("formation", "offsets_m", name)
            # its altitude and that of a slot below the leader cannot be compared before the flight
            kind = "altitude" if name in altitudes else "offset"
            height = altitudes.get(name, down)
            places.append((name, (forward, right, height), kind, at))
    for (name, _, _, at), (other, _, _, other_at) in _coincident(places):
        yield (
            at,
            f"{_position(offsets[name])} puts the slot of {name} in the same place as "
            f"{_slot_of(other, other_at)} (write another offset)",
        )


def _slot_of(name: str, at: KeyPath) -> str:
    return f"that of {name} ({_dotted(at)})" if len(at) > 1 else name


def _coincident(places: Iterable[_Place]) -> Iterator[tuple[_Place, _Place]]:
    """Yield pairs of positions that coincide to the centimetre, the later one first."""
    seen: dict[tuple[object, ...], _Place] = {}
    for each in places:
        _, position, kind, _ = each
        first = seen.setdefault((kind, *(round(value, 2) + 0.0 for value in position)), each)
        if first is not each:
            yield each, first


def _position(values: Iterable[float]) -> str:
    return f"[{', '.join(f'{value + 0.0:g}' for value in values)}]"


def _dotted(path: KeyPath) -> str:
    return ".".join(map(str, path))


def check_sensor_rates(at: KeyPath, aircraft: AircraftSection, rates: Rates) -> Iterator[Finding]:
    """Find sensors of the aircraft at a path that measure more often than they are read."""
    max_rate = rates.autopilot_hz
    for name in SENSOR_NAMES:
        rate = getattr(getattr(aircraft.sensors, name), "rate_hz", 0)
        if rate > max_rate:
            yield (
                (*at, "sensors", name, "rate_hz"),
                f"the {name} measures at {rate} Hz, above rates.autopilot_hz, {max_rate} Hz, "
                f"at which sensors are read (write a rate_hz of at most {max_rate})",
            )


def _fly_by_wire(scenario: Sections) -> Iterator[Finding]:
    rate = scenario.rates.autopilot_hz
    names = [
        aircraft.name
        for _, aircraft in _aircraft(scenario)
        if aircraft.vehicle != "unicycle"
        and isinstance(aircraft.autopilot, VirtualAutopilot)
        and not (isinstance(aircraft, Leader) and aircraft.path.kind != "mission")
    ]
    if names and rate < _FBWA_MIN_HZ:
        yield (
            ("rates", "autopilot_hz"),
            f"is {rate}, and fly-by-wire A, the autopilot of {', '.join(names)}, needs at least "
            f"{_FBWA_MIN_HZ} Hz, below which its rate loops oscillate (write {_FBWA_MIN_HZ} or "
            "more; 50 is usual)",
        )


def _ardupilot(scenario: Sections) -> Iterator[Finding]:
    used: dict[int, str] = {}
    for row, (at, aircraft) in enumerate(_aircraft(scenario)):
        autopilot = aircraft.autopilot
        if not isinstance(autopilot, ArduPlane):
            continue
        where = (*at, "autopilot")
        yield from _without_autopilot(
            where, aircraft, "ardupilot", "has no autopilot", "has no control surfaces"
        )
        instance = autopilot.fixed_instance(row)
        if instance in used:
            yield (
                (*where, "instance"),
                f"{instance} is also that of {used[instance]} (write another: it sets the ports)",
            )
        if instance is not None:
            used.setdefault(instance, aircraft.name)
        if scenario.rates.autopilot_hz < _ARDUPLANE_MIN_HZ:
            yield (
                ("rates", "autopilot_hz"),
                f"is {scenario.rates.autopilot_hz}, and ArduPlane, the autopilot of "
                f"{aircraft.name}, needs at least {_ARDUPLANE_MIN_HZ} Hz (write "
                f"{_ARDUPLANE_MIN_HZ})",
            )


def _external(scenario: Sections) -> Iterator[Finding]:
    for at, aircraft in _aircraft(scenario):
        source = aircraft.commanded_by
        if not isinstance(source, External):
            continue
        where = (*at, "commanded_by")
        found = list(
            _without_autopilot(
                where, aircraft, "external", "takes no commands", "has no autopilot to command"
            )
        )
        yield from found
        if not found and isinstance(aircraft.autopilot, ArduPlane):
            yield (
                where,
                "is external, and ArduPlane takes commands over its own link (write autopilot: "
                "virtual, or leave this out)",
            )
        if source.lockstep and scenario.rates.log_hz != scenario.rates.control_hz:
            yield (
                ("rates", "log_hz"),
                f"is {scenario.rates.log_hz}, and in lockstep {aircraft.name} needs a sample at "
                f"every control period (write {scenario.rates.control_hz}, as control_hz)",
            )


def _without_autopilot(
    at: KeyPath, aircraft: Leader | Follower, value: str, leader_reason: str, unicycle_reason: str
) -> Iterator[Finding]:
    """Refuse a value for an aircraft without a flight model, whose autopilot would control it."""
    if isinstance(aircraft, Leader) and aircraft.path.kind != "mission":
        yield (
            at,
            f"is {value}, and a leader with a path of kind {aircraft.path.kind} {leader_reason} "
            "(write a path of kind: mission, or leave this out)",
        )
    elif aircraft.vehicle == "unicycle":
        yield (
            at,
            f"is {value}, and a unicycle {unicycle_reason} (write vehicle: jsbsim, or leave this "
            "out)",
        )


# faults


def _faults(scenario: Sections) -> Iterator[Finding]:
    for at, aircraft in _aircraft(scenario):
        reason, cure = _no_flight_model(aircraft)
        for index, fault in enumerate(aircraft.faults):
            where = (*at, "faults", index)
            yield from _fault_beginning(where, fault, scenario.scenario.duration_s)
            if fault.kind == "battery-low" and fault.duration_s is not None:
                text = "a battery in flight does not recharge (leave this out)"
                yield (*where, "duration_s"), text
            if fault.declared and fault.kind in _NOT_DECLARABLE:
                yield (*where, "declared"), f"{_NOT_DECLARABLE[fault.kind]} (leave this out)"
            if reason:
                yield from _fault_without_flight_model(where, fault, reason, cure)


def _fuel(scenario: Sections) -> Iterator[Finding]:
    for at, aircraft in _aircraft(scenario):
        if aircraft.fuel_burn and _no_flight_model(aircraft)[0]:
            yield (*at, "fuel_burn"), "is true, and this aircraft has no engine (leave it out)"


def _fault_beginning(at: KeyPath, fault: AnyFault, duration: float) -> Iterator[Finding]:
    when = fault.when
    if fault.at_s is None and when is None:
        yield (
            at,
            "never begins (write at_s: 20 or when: {quantity: airspeed_mps, below: 15}, for "
            "example)",
        )
    elif fault.at_s is not None and fault.at_s > duration:
        yield (
            (*at, "at_s"),
            f"{fault.at_s:g} s is after the run, which lasts {duration:g} s (write less, or a "
            "longer duration_s)",
        )
    if when is not None and (when.above is None) == (when.below is None):
        limits = "neither above nor below" if when.above is None else "above and below"
        yield (*at, "when"), f"has {limits} (write one of the two, as in below: 15)"


def _no_flight_model(aircraft: Leader | Follower) -> tuple[str, str]:
    """Return why an aircraft has no flight model, and the cure; or ""."""
    if isinstance(aircraft, Leader) and aircraft.path.kind != "mission":
        reason = f"a leader on a path of kind {aircraft.path.kind} has no flight model"
        return reason, "a path of kind: mission"
    if aircraft.vehicle == "unicycle":
        return "a unicycle has no parts that fail", "vehicle: jsbsim"
    return "", ""


def _fault_without_flight_model(
    at: KeyPath, fault: AnyFault, reason: str, cure: str
) -> Iterator[Finding]:
    if fault.NEEDS_FLIGHT_MODEL:
        yield (*at, "kind"), f"is {fault.kind}, and {reason} (leave the fault out, or write {cure})"
    elif fault.when is not None and fault.when.quantity == "state_of_charge":
        yield (
            (*at, "when", "quantity"),
            f"is state_of_charge, and this aircraft has no battery (write another, or {cure})",
        )


# formation and controller


def _formation(scenario: Sections) -> Iterator[Finding]:
    followers = [follower.name for follower in scenario.fleet]
    formation = scenario.formation
    for name in followers:
        if name not in formation.offsets_m:
            yield (
                ("formation", "offsets_m"),
                f"the offset of {name!r} is missing (write {name}: [forward, right, down] in m)",
            )
    for key in ("offsets_m", "leader_gains", "neighbour_gains", "altitudes_m", "agents"):
        yield from _unknown_followers(("formation", key), getattr(formation, key), followers)
    for name, gains in formation.neighbour_gains.items():
        at = ("formation", "neighbour_gains", name)
        yield from _unknown_followers(at, gains, followers)
        if name in gains:
            yield (*at, name), "an aircraft is not its own neighbour (leave this key out)"
    if formation.on_failure.response == "reassign-slots" and formation.altitudes_m:
        yield (
            ("formation", "on_failure", "response"),
            "is reassign-slots, and altitudes_m sets altitudes by follower, not by slot (write "
            "drop, or leave altitudes_m out)",
        )


def _agents(scenario: Sections) -> Iterator[Finding]:
    """Check ranges of speeds, and that the desired ones lie within the bounds."""
    formation = scenario.formation
    parts: list[tuple[KeyPath, Any]] = [(("formation",), formation)]
    parts += [(("formation", "agents", name), own) for name, own in formation.agents.items()]
    for at, part in parts:
        for key in ("speed_mps", "speed_desired_mps"):
            speeds = getattr(part, key)
            if speeds is not None and not SMALLEST <= speeds[0] < speeds[1]:
                yield (
                    (*at, key),
                    f"[{speeds[0]:g}, {speeds[1]:g}] is not a range of speeds (write [lowest, "
                    "highest] in m/s, both above 0)",
                )

    for follower in scenario.fleet:
        own = formation.agents.get(follower.name)
        bounds = own.speed_mps if own and own.speed_mps else formation.speed_mps
        desired = own.speed_desired_mps if own else None
        at = ("formation", "agents", follower.name) if desired else ("formation",)
        desired = desired or formation.speed_desired_mps
        if desired and not bounds[0] <= desired[0] < desired[1] <= bounds[1]:
            yield (
                (*at, "speed_desired_mps"),
                f"[{desired[0]:g}, {desired[1]:g}] does not lie in the speed bounds of "
                f"{follower.name}, [{bounds[0]:g}, {bounds[1]:g}] m/s (write speeds between them)",
            )


def _law(scenario: Sections) -> Iterator[Finding]:
    if scenario.controller.law == BUILT_IN and scenario.controller.options:
        yield (
            ("controller", "options"),
            "the law hbh23 has no options (write its gains under formation, or leave this out)",
        )
    if scenario.controller.map and not scenario.controller.law.endswith(".fmu"):
        yield (
            ("controller", "map"),
            "names variables of an FMU, which controller.law is not (leave it out)",
        )


# air and limits


def _limits(scenario: Sections) -> Iterator[Finding]:
    collision, separation = scenario.limits.collision_m, scenario.limits.separation_m
    if collision is not None and separation is not None and collision > separation:
        yield (
            ("limits", "collision_m"),
            f"{collision:g} m is above separation_m, {separation:g} m: the warning would come "
            f"after the collision (write at most {separation:g}, or a larger separation_m)",
        )


def check_air(air: Air) -> Iterator[Finding]:
    """Find contradictions in the air."""
    yield from _wind(air.wind)
    yield from _turbulence(air.turbulence)
    yield from _gusts(air)


def _wind(wind: Wind) -> Iterator[Finding]:
    if wind.file is not None:
        for key, value in (("speed_mps", wind.speed_mps), ("from_deg", wind.from_deg)):
            if value:
                yield (
                    ("air", "wind", key),
                    f"is {value:g}, but the wind is that of {wind.file!r} (leave out this, or "
                    "file)",
                )
    profile = wind.profile
    if profile.kind == "log" and profile.roughness_m >= profile.height_m:
        yield (
            ("air", "wind", "profile", "roughness_m"),
            f"{profile.roughness_m:g} m is not below height_m, {profile.height_m:g} m (write the "
            "roughness length, about a tenth of the height of the vegetation, or another height_m)",
        )


def _turbulence(turbulence: Turbulence) -> Iterator[Finding]:
    at = ("air", "turbulence")
    if turbulence.model == "none":
        for key in ("w20_mps", "probability", "sigma_mps", "length_m"):
            if getattr(turbulence, key) is not None:
                yield (
                    (*at, key),
                    "has no effect with model: none (write model: dryden, von-karman or coherent, "
                    "or leave this out)",
                )
    if turbulence.model != "coherent" and turbulence.height_m is not None:
        yield (
            (*at, "height_m"),
            f"is for model: coherent, and the model is {turbulence.model} (leave this out: the "
            "height of each aircraft is used)",
        )
    if turbulence.model == "coherent":
        for key in ("sigma_mps", "length_m"):
            values = getattr(turbulence, key)
            if values is not None and values[0] != values[1]:
                yield (
                    (*at, key),
                    f"{values[0]:g} and {values[1]:g} differ, and a field for all aircraft has no "
                    "longitudinal direction (write the same number for the first two)",
                )


def _gusts(air: Air) -> Iterator[Finding]:
    seen: dict[str, int] = {}
    for index, gust in enumerate(air.gusts):
        first = seen.setdefault(gust.name, index)
        if first != index:
            yield (
                ("air", "gusts", index, "name"),
                f"{gust.name!r} is already the name of gusts.{first} (write another)",
            )
