"""The followers of a scenario in steady flight.

The formation flies behind a virtual leader, straight or in a circle, in still air, without faults
and with exact estimates, until it is steady.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from testbed.compiled.compiled_fleet import ENGINE_REMEDY, NotCompiledError
from testbed.core.errors import InputError
from testbed.core.flags import Saturation
from testbed.core.frames import GRAVITY
from testbed.core.records import Array, BoolArray, join_names
from testbed.flight.vehicles import JsbsimVehicles
from testbed.flight.world import World
from testbed.linear.held_flight import COMMANDS, HeldFlight
from testbed.plan.world import build
from testbed.scenario import Scenario
from testbed.scenario.aircraft import ArduPlane

SETTLE_S, LONGEST_SETTLE_S = 60.0, 180.0
LOOK_S = 5.0  # before the disturbance: banks are averaged over it, and must not change
STEADY_DEG = 0.25  # largest change of a bank in that time
LONGEST_RECORD_S = 150.0  # that is flown on from there
BANK_TOLERANCE_DEG = 0.5  # between the bank that is asked for and the highest one flown
ROLL_RESERVE_DEG = 2.0  # to the limit of the bank, for a kick and its response
RECENTRE_S = 2.0
# then an unstable flight is used, before it leaves its steady state
UNSTABLE_STEADY_DEG = 0.02
ROLL = COMMANDS.index("roll")
_ROUNDING = 1e-9


class MarginsError(InputError):
    """A scenario or a bank of which no margins can be measured."""


def check_measurable(scenario: Scenario) -> None:
    """Check that a scenario's followers can be flown in copies of the process.

    Raises:
        MarginsError: they cannot; with the key.
    """
    for k, follower in enumerate(scenario.fleet):
        if follower.vehicle != "jsbsim":
            raise MarginsError(
                f"fleet.{k}.vehicle: {follower.name} has no roll command whose margins could be "
                "measured (write jsbsim)"
            )
        if isinstance(follower.autopilot, ArduPlane):
            raise MarginsError(
                f"fleet.{k}.autopilot: an ArduPlane process cannot be copied in flight (write "
                "virtual)"
            )
    if _leader_speed(scenario) is None:
        raise MarginsError(
            "leader.path: a recorded leader has no speed at which the formation could be steady "
            "(write a scenario whose leader flies a mission, or is virtual)"
        )


def _leader_speed(scenario: Scenario) -> float | None:
    path = scenario.leader.path
    return getattr(path, "airspeed_mps", None) or getattr(path, "speed_mps", None)


def steady_scenario(
    scenario: Scenario, bank_deg: float, engine: str, climb_mps: float = 0.0
) -> Scenario:
    """Return a scenario's formation behind a virtual leader, straight or in a circle.

    Args:
        scenario: as resolved; see `check_measurable`.
        bank_deg: of a coordinated turn of the outermost slot, clockwise if positive; 0: straight.
        engine: of the flight models.
        climb_mps: of the leader, m/s; descending if negative.
    """
    speed = _leader_speed(scenario)
    assert speed is not None
    curve: dict[str, Any] = {"kind": "straight", "climb_mps": climb_mps}
    if bank_deg:
        side = math.copysign(1.0, bank_deg)
        outside = max(-side * offset[1] for offset in scenario.formation.offsets_m.values())
        curve = {
            "kind": "circle",
            "radius_m": _radius(speed, abs(math.radians(bank_deg)), max(outside, 0.0)),
            "direction": "clockwise" if side > 0.0 else "anticlockwise",
            "climb_mps": climb_mps,
        }
    data = scenario.model_dump(mode="json", by_alias=True)
    for section in ("air", "expect", "limits"):
        data.pop(section)
    # an unstable flight is settled twice
    duration_s = 2.0 * LONGEST_SETTLE_S + LOOK_S + LONGEST_RECORD_S + 1.0
    start = data["leader"]["start"]
    start["altitude_m"] += max(-climb_mps, 0.0) * duration_s
    data["leader"] = {
        **{key: data["leader"][key] for key in ("name", "aircraft")},
        "start": start | {"course_deg": 0.0},
        "path": {"kind": "virtual", "speed_mps": speed, "curve": curve},
    }
    for each in data["fleet"]:
        for key in ("sensors", "faults", "commanded_by"):
            each.pop(key, None)
        each["start_m"] = scenario.formation.offsets_m[each["name"]]
    data["scenario"] |= {"windows": {}, "published": None, "engine": engine}
    data["scenario"]["duration_s"] = duration_s
    return Scenario.model_validate(data)


def build_compiled(scenario: Scenario) -> World:
    """Build a flight of `steady_scenario` whose models are compiled, whatever the user's engine.

    Raises:
        InputError: an aircraft is not compiled, or as of any scenario.
    """
    try:
        return build(scenario)
    except NotCompiledError as error:
        reasons = str(error).removesuffix(ENGINE_REMEDY)
        raise InputError(
            f"{reasons} (predictions need compiled flight models: change the aircraft's files)"
        ) from None


def _radius(speed: float, bank: float, outside: float) -> float:
    """Return the radius, m, of a leader's circle in which a slot farther out has a bank.

    The slot moves at V (R + d)/R, so R² g tan φ = V² (R + d).
    """
    half = 0.5 * speed**2 / (GRAVITY * math.tan(bank))
    return half + math.sqrt(half * half + 2.0 * half * outside)


def fly_steadily(
    scenario: Scenario,
    bank_deg: float,
    climb_mps: float,
    engine: str,
    check: Callable[[World], None] = lambda world: None,
) -> tuple[HeldFlight, str]:
    """Fly until the highest bank of a follower is the one asked for.

    Args:
        scenario: whose formation, network and controller they have.
        bank_deg: the highest of a follower; clockwise if positive; 0: straight.
        climb_mps: of the leader, m/s.
        engine: of the flight models.
        check: called with the world of each flight before it begins.

    Raises:
        MarginsError: see `check_measurable` and `check_roll_limits`.

    Returns:
        The flight, and what is not steady in it; "": it is.
    """
    check_measurable(scenario)

    def fly(bank_deg: float) -> tuple[HeldFlight, str]:
        world = build(steady_scenario(scenario, bank_deg, engine, climb_mps))
        check(world)
        check_roll_limits(world, abs(bank_deg))
        flight = HeldFlight(world)
        return flight, settle(flight)

    flight, problem = fly(bank_deg)
    # with sideslip an aircraft banks more than in a coordinated turn
    excess = float(np.abs(banks_deg(flight)).max() - abs(bank_deg))
    if bank_deg and abs(excess) > BANK_TOLERANCE_DEG and math.isfinite(excess):
        flight, problem = fly(math.copysign(max(abs(bank_deg) - excess, 1.0), bank_deg))
    return flight, problem


def banks_deg(flight: HeldFlight) -> Array:
    """Return the present banks (n,) of the followers."""
    banks: Array = np.degrees(flight.world.aircraft["truth"]["euler"][1:, 0])
    return banks


def suitable_banks(scenario: Scenario, banks_deg: Sequence[float], *, asked: bool) -> list[float]:
    """Return the banks at which a scenario's followers can be kicked, before any flight.

    Args:
        scenario: whose followers they are.
        banks_deg: 0 or more.
        asked: a user has asked for these; else those too near a limit become the highest possible.

    Raises:
        MarginsError: see `check_measurable` and `check_roll_limits`.
    """
    check_measurable(scenario)
    world = build(steady_scenario(scenario, 0.0, scenario.scenario.engine))
    if asked:
        check_roll_limits(world, max(banks_deg))
        return list(banks_deg)
    highest_deg = float(roll_limits_deg(world).min()) - ROLL_RESERVE_DEG
    return list(dict.fromkeys(min(each, highest_deg) for each in banks_deg))


def roll_limits_deg(world: World) -> Array:
    """Return the limits (n,) of the followers' bank, of middle loop and autopilot."""
    [autopilots] = [
        each.autopilots.gains for each in world.vehicles if isinstance(each, JsbsimVehicles)
    ]
    followers = world.formation.built_control.config
    limits_deg: Array = np.degrees(np.minimum(followers.roll_limit, autopilots["roll_limit"]))
    return limits_deg


def check_roll_limits(world: World, bank_deg: float) -> None:
    """Check that a bank leaves room for kicks below the limits of the followers.

    Raises:
        MarginsError: it is too near one of them.
    """
    limits_deg = roll_limits_deg(world)
    low = int(limits_deg.argmin())
    if bank_deg > limits_deg[low] - ROLL_RESERVE_DEG + _ROUNDING:
        raise MarginsError(
            f"a bank of {bank_deg:g}° is too near the limit of {world.names[1 + low]}, "
            f"{limits_deg[low]:g}°, for kicks (write at most "
            f"{limits_deg[low] - ROLL_RESERVE_DEG:g})"
        )


def settle(flight: HeldFlight) -> str:
    """Fly until the banks are steady, also where that flight is unstable.

    Returns:
        Why they are not; "": they are.
    """
    moved_deg = np.array([math.inf])
    while flight.time_s < LONGEST_SETTLE_S and not moved_deg.max() < STEADY_DEG:
        flight.fly_to(flight.time_s + SETTLE_S - LOOK_S)
        moved_deg, _ = _look(flight, LOOK_S)
    if not moved_deg.max() < STEADY_DEG:
        moved_deg = _settle_unstable(flight)
    # also one that has been lost on the way, and moves no more
    gone = flight.world.aircraft["down"][1:] | flight.world.aircraft["stopped"][1:]
    if gone.any():
        return f"not steady: {flight.world.names[1 + int(gone.argmax())]} has been lost"
    if moved_deg.max() < STEADY_DEG:
        return ""
    worst = int(np.nan_to_num(moved_deg, nan=np.inf).argmax())
    name = flight.world.names[1 + worst]
    return f"not steady: the bank of {name} still changes by {moved_deg[worst]:.1f}°"


def _settle_unstable(flight: HeldFlight) -> Array:
    """Fly on to a steady flight that is unstable; return how much banks (n,) move, degrees.

    Deviations of the commands from their mean over the time before are halved: the steady flight
    is the same, and the loops have half their gain.
    """
    inputs, moved_deg = flight.inputs, np.array([math.inf])
    _, mean = _look(flight, RECENTRE_S)
    for _ in range(round(LONGEST_SETTLE_S / RECENTRE_S)):
        inputs.gain[:] = 0.5
        inputs.begin(mean)
        moved_deg, mean = _look(flight, RECENTRE_S)
        if moved_deg.max() < UNSTABLE_STEADY_DEG:
            break
    inputs.end()
    return moved_deg


def look_at_limits(flight: HeldFlight) -> tuple[str, str]:
    """Fly on; return why small kicks would meet a limit, and which throttles are at one.

    Returns:
        A problem and a note; "": none.
    """
    world, commands, saturations = flight.world, [], []
    for _ in range(round(LOOK_S / flight.dt)):
        flight.fly_to(flight.time_s + flight.dt)
        commands.append(np.abs(flight.inputs.computed[:, ROLL]))
        saturations.append(world.followers["saturations"].astype(int))
    highest_deg = np.degrees(np.max(commands, axis=0))
    limited = highest_deg > roll_limits_deg(world) - ROLL_RESERVE_DEG
    if limited.any():
        return f"{_join(world, limited)} too near the limit of the bank for kicks", ""
    at_limit: BoolArray = np.any(np.array(saturations) & int(Saturation.THROTTLE), axis=0)
    return "", f"{_join(world, at_limit)} at a limit of the throttle" if at_limit.any() else ""


def _join(world: World, those: BoolArray) -> str:
    names = [world.names[1 + i] for i in np.flatnonzero(those)]
    return f"{join_names(names)} {'is' if len(names) == 1 else 'are'}"


def _look(flight: HeldFlight, duration_s: float) -> tuple[Array, Array]:
    """Fly on; return how much banks move (n,), degrees, and the mean commands (n, 3)."""
    banks, commands = [], []
    for _ in range(round(duration_s / flight.dt)):
        flight.fly_to(flight.time_s + flight.dt)
        banks.append(flight.world.aircraft["truth"]["euler"][1:, 0].copy())
        commands.append(flight.inputs.computed.copy())
    moved_deg: Array = np.degrees(np.ptp(np.array(banks), axis=0))
    return moved_deg, np.mean(commands, axis=0)
