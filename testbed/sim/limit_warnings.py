"""Warn before the flight of limits of an autopilot that differ from those of its commands."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from testbed.autopilot.parameters import FbwaParams
from testbed.core.records import Event, join_names
from testbed.scenario import Scenario, middle_loop_gains

TOLERANCE = 1e-6  # degrees


class _Limit(NamedTuple):
    """A limit of commands and that of the autopilot which receives them, degrees."""

    what: str
    commanded: float
    flown: float
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
    found: dict[tuple[str, str], list[str]] = {}
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
                found.setdefault(("the middle loop commands", text), []).append(follower.name)
    path = scenario.leader.path
    if kinds[0] == "jsbsim" and path.kind == "mission":
        flown = tunes[0].roll_limit_deg
        bank = path.bank_limit_deg
        limit = _Limit("roll", bank, flown, "ROLL_LIMIT_DEG", "leader.path.bank_limit_deg")
        if bank > flown + TOLERANCE:
            found["its guidance commands", _text(limit)] = [scenario.leader.name]
    for (subject, text), names in found.items():
        about = "run" if len(names) > 1 else names[0]
        prefix = f"{join_names(names)}: " if len(names) > 1 else ""
        yield Event(0.0, "warning", about, f"{prefix}{subject} {text}")


def _text(limit: _Limit) -> str:
    """Describe a limit of an autopilot that differs from that of the commands; "" if none does."""
    what, commanded, flown, parameter, key = limit
    if commanded > flown + TOLERANCE:
        return (
            f"up to {commanded:g}° of {what}, and the autopilot stops at {flown:g}°, {parameter} "
            f"of its tune: what is cut off is not counted as saturation (write {key}: {flown:g}, "
            f"or a {parameter} of {commanded:g})"
        )
    # the autopilot's limits of pitch need not be symmetrical
    if flown > commanded + TOLERANCE and parameter != "PTCH_LIM_MIN_DEG":
        return (
            f"at most {commanded:g}° of {what}, and {parameter} of its tune, {flown:g}°, is never "
            f"reached (write {key}: {flown:g} to fly it, or a {parameter} of {commanded:g})"
        )
    return ""
