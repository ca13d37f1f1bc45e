"""What one part of the page demands of another."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

from testbed.scenario.fault_checks import check_faults, crafts
from testbed.scenario.messages import did_you_mean
from testbed.scenario.network_checks import check_network
from testbed.scenario.pilot_checks import check_pilots
from testbed.scenario.sensors import MEASURE

if TYPE_CHECKING:
    from testbed.scenario.schema import Scenario

Path = tuple[str | int, ...]
Finding = tuple[Path, str]


def cross_check(page: Scenario) -> list[Finding]:
    """Return every contradiction between the parts: where, and what to write instead."""
    return [
        *_rates(page),
        *_names(page),
        *_formation(page),
        *_agents(page),
        *_kinds(page),
        *_sensors(page),
        *check_pilots(page),
        *check_faults(page),
        *_limits(page),
        *check_network(page),
        *_wind(page),
        *_turbulence(page),
        *_gusts(page),
        *_portions(page),
        *_published(page),
    ]


def _rates(page: Scenario) -> Iterator[Finding]:
    base = page.rates.physics_hz
    for key, rate in page.rates:
        if key != "synchronous" and base % rate:
            below = next(
                divisor for divisor in range(min(rate, base), 0, -1) if base % divisor == 0
            )
            yield (
                ("rates", key),
                f"{rate} Hz does not divide physics_hz, {base} Hz (write {below}, or another "
                "physics_hz)",
            )


def _names(page: Scenario) -> Iterator[Finding]:
    seen = {page.leader.name: "the leader"}
    for index, follower in enumerate(page.fleet):
        if follower.name in seen:
            yield (
                ("fleet", index, "name"),
                f"{follower.name!r} is already the name of {seen[follower.name]} (write another)",
            )
        else:
            seen[follower.name] = f"fleet.{index}"


def _formation(page: Scenario) -> Iterator[Finding]:
    followers = [follower.name for follower in page.fleet]
    formation = page.formation
    for name in followers:
        if name not in formation.offsets_m:
            yield (
                ("formation", "offsets_m"),
                f"the offset of {name!r} is missing (write {name}: [forward, right, down] in m)",
            )
    yield from _known(("formation", "offsets_m"), formation.offsets_m, followers)
    yield from _known(("formation", "leader_gains"), formation.leader_gains, followers)
    yield from _known(("formation", "neighbour_gains"), formation.neighbour_gains, followers)
    for name, gains in formation.neighbour_gains.items():
        at = ("formation", "neighbour_gains", name)
        yield from _known(at, gains, followers)
        if name in gains:
            yield (*at, name), "an aircraft is not its own neighbour (leave this key out)"
    yield from _known(("formation", "altitudes_m"), formation.altitudes_m, followers)


def _agents(page: Scenario) -> Iterator[Finding]:
    formation = page.formation
    followers = [follower.name for follower in page.fleet]
    yield from _known(("formation", "agents"), formation.agents, followers)
    parts: list[tuple[Path, Any]] = [(("formation",), formation)]
    parts += [(("formation", "agents", name), own) for name, own in formation.agents.items()]
    for at, part in parts:
        for key in ("speed_mps", "speed_desired_mps"):
            speeds = getattr(part, key)
            if speeds is not None and not 0 < speeds[0] < speeds[1]:
                yield (
                    (*at, key),
                    f"[{speeds[0]:g}, {speeds[1]:g}] is not a range of speeds (write [lowest, "
                    "highest] in m/s, both above 0)",
                )

    for follower in followers:
        own = formation.agents.get(follower)
        bounds = own.speed_mps if own and own.speed_mps else formation.speed_mps
        desired = own.speed_desired_mps if own else None
        at = ("formation", "agents", follower) if desired else ("formation",)
        desired = desired or formation.speed_desired_mps
        if desired and not bounds[0] <= desired[0] < desired[1] <= bounds[1]:
            yield (
                (*at, "speed_desired_mps"),
                f"[{desired[0]:g}, {desired[1]:g}] does not lie in the speed bounds of "
                f"{follower}, [{bounds[0]:g}, {bounds[1]:g}] m/s (write speeds between them)",
            )


def _kinds(page: Scenario) -> Iterator[Finding]:
    if page.controller.law == "paper" and page.controller.options:
        yield (
            ("controller", "options"),
            "the paper's law takes no options (write its gains under formation, or leave this out)",
        )


def _sensors(page: Scenario) -> Iterator[Finding]:
    most = page.rates.autopilot_hz
    for at, craft in crafts(page):
        for name in MEASURE:
            sensor = getattr(craft.sensors, name)
            rate = getattr(sensor, "rate_hz", 0)
            if rate > most:
                yield (
                    (*at, "sensors", name, "rate_hz"),
                    f"the {name} measures at {rate} Hz, above rates.autopilot_hz, {most} Hz, at "
                    f"which sensors are read (write a rate_hz of at most {most})",
                )


def _limits(page: Scenario) -> Iterator[Finding]:
    collision, separation = page.limits.collision_m, page.limits.separation_m
    if collision is not None and separation is not None and collision > separation:
        yield (
            ("limits", "collision_m"),
            f"{collision:g} m is above separation_m, {separation:g} m: the warning would come "
            f"after the collision (write at most {separation:g}, or a larger separation_m)",
        )
    if page.formation.on_failure.answer == "re-slot" and page.formation.altitudes_m:
        yield (
            ("formation", "on_failure", "answer"),
            "is re-slot, and altitudes_m names followers whose altitude would stay with them in "
            "another's slot (write drop, or leave altitudes_m out)",
        )


def _wind(page: Scenario) -> Iterator[Finding]:
    wind = page.air.wind
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
            "roughness length, about a tenth of the height of what grows there, or another "
            "height_m)",
        )


def _turbulence(page: Scenario) -> Iterator[Finding]:
    turbulence = page.air.turbulence
    at = ("air", "turbulence")
    if turbulence.model == "none":
        for key in ("w20_mps", "probability", "sigma_mps", "length_m"):
            if getattr(turbulence, key) is not None:
                yield (
                    (*at, key),
                    "says how strong the turbulence is, and there is none (write model: dryden, "
                    "von-karman or coherent, or leave this out)",
                )
    if turbulence.model != "coherent" and turbulence.height_m is not None:
        yield (
            (*at, "height_m"),
            f"belongs to model: coherent, and the model is {turbulence.model} (leave this out: "
            "each aircraft's own height counts)",
        )
    if turbulence.model == "coherent":
        for key in ("sigma_mps", "length_m"):
            three = getattr(turbulence, key)
            if three is not None and three[0] != three[1]:
                yield (
                    (*at, key),
                    f"{three[0]:g} and {three[1]:g} differ, and one field for all has no "
                    "longitudinal direction (write the same number for the first two)",
                )


def _gusts(page: Scenario) -> Iterator[Finding]:
    seen: dict[str, int] = {}
    for index, gust in enumerate(page.air.gusts):
        first = seen.setdefault(gust.name, index)
        if first != index:
            yield (
                ("air", "gusts", index, "name"),
                f"{gust.name!r} is already the name of gusts.{first} (write another)",
            )


def _known(at: Path, names: Iterable[str], followers: list[str]) -> Iterator[Finding]:
    for name in names:
        if name not in followers:
            yield (
                (*at, name),
                f"no follower has this name{did_you_mean(name, followers)} (the fleet has "
                f"{', '.join(followers)})",
            )


def _portions(page: Scenario) -> Iterator[Finding]:
    duration = page.scenario.duration_s
    for name, (begin, end) in page.scenario.portions.items():
        at = ("scenario", "portions", name)
        if begin >= end:
            yield at, f"[{begin:g}, {end:g}] is not a window (write [from, to] in s)"
        elif end > duration:
            yield (
                at,
                f"ends at {end:g} s, after the run, which lasts {duration:g} s (end it earlier, or "
                "write a longer duration_s)",
            )


def _published(page: Scenario) -> Iterator[Finding]:
    published = page.scenario.published
    if published is None:
        return
    portions = list(page.scenario.portions)
    for key in ("rms_m", "mean_rms_m", "percent_error"):
        for name in getattr(published, key):
            if name not in portions:
                yield (
                    ("scenario", "published", key, name),
                    f"no portion has this name{did_you_mean(name, portions)} (portions has "
                    f"{', '.join(portions) or 'none'})",
                )
    for name, row in published.rms_m.items():
        if len(row) != len(page.fleet):
            yield (
                ("scenario", "published", "rms_m", name),
                f"has {len(row)} numbers for {len(page.fleet)} followers (write one per follower, "
                "in fleet order)",
            )
