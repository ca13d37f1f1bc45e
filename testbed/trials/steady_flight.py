"""The followers of a scenario in steady flight, and copies of the flight with one disturbance.

The formation flies behind a virtual leader, straight or in a level circle, in still air, without
faults and with exact estimates, until it is steady. Then copies of the process fly on, each with
one change of the commands or positions. A response is the difference from a copy without one.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from testbed.core.call_list import run_steps
from testbed.core.errors import InputError
from testbed.core.frames import GRAVITY, course
from testbed.core.records import Array, BoolArray, join_names
from testbed.flight.loop import Flight
from testbed.flight.vehicles import JsbsimVehicles
from testbed.flight.world import World
from testbed.formation.law import Saturation
from testbed.formation.slots import write_formation_state
from testbed.plan.world import build
from testbed.scenario import Scenario
from testbed.scenario.aircraft import ArduPlane
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.forked_trial import run_forked

SETTLE_S, LONGEST_SETTLE_S = 60.0, 180.0
LOOK_S = 5.0  # before the disturbance: banks are averaged over it, and must not change
STEADY_DEG = 0.25  # largest change of a bank in that time
RECORD_S, LONG_RECORD_S = 12.0, 90.0  # of a response to a kick, and to a displacement
KICK_S = 0.2
BANK, COMMAND, SATURATIONS = 0, 5, 6  # columns of what a flight records
ROLL_RESERVE_DEG = 2.0  # to the limit of the bank, for a kick and its response


class MarginsError(InputError):
    """A scenario or a bank of which no margins can be measured."""


@dataclass(frozen=True, slots=True)
class Change:
    """What a copy of the flight does differently from then on, by default nothing.

    Numbers are those of all followers, arrays (n,) those of each.

    Args:
        kick_deg: added to the roll and pitch commands for KICK_S.
        displacement_m: to the right of the course and down, at the beginning.
        roll_gain: factor of the roll command's deviation from that of the steady flight.
        roll_latency_s: of the roll command, in addition.
        record_s: length of the record.
    """

    kick_deg: float | Array = 0.0
    displacement_m: float | Array = 0.0
    roll_gain: float | Array = 1.0
    roll_latency_s: float | Array = 0.0
    record_s: float = RECORD_S


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
    scenario: Scenario, bank_deg: float, engine: str = "jsbsim", climb_mps: float = 0.0
) -> Scenario:
    """Return a scenario's formation behind a virtual leader, straight or in a circle.

    Args:
        scenario: as resolved; see `check_measurable`.
        bank_deg: of a coordinated turn of the outermost slot, clockwise if positive; 0: straight.
        engine: of the flight models; JSBSim can move aircraft in flight.
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
    duration_s = 2.0 * LONGEST_SETTLE_S + LONG_RECORD_S + 1.0
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


def _radius(speed: float, bank: float, outside: float) -> float:
    """Return the radius, m, of a leader's circle in which a slot farther out has a bank.

    The slot moves at V (R + d)/R, so R² g tan φ = V² (R + d).
    """
    half = 0.5 * speed**2 / (GRAVITY * math.tan(bank))
    return half + math.sqrt(half * half + 2.0 * half * outside)


class SteadyFlight:
    """A formation in steady flight, of which copies are flown on.

    Attributes:
        names: of the n followers.
        dt: s, between the samples of a response.
        bank_deg: (n,) of the followers.
        problem: why responses have no meaning here; "": they have.
        note: a limit at which a follower flies nevertheless; "": none.
    """

    def __init__(self, scenario: Scenario, bank_deg: float, climb_mps: float = 0.0) -> None:
        """Fly until the followers are steady, at most `LONGEST_SETTLE_S`.

        Args:
            scenario: whose formation it is.
            bank_deg: see `steady_scenario`.
            climb_mps: of the leader, m/s.

        Raises:
            MarginsError: the bank is too near the limit of a follower.
        """
        self._world = world = build(steady_scenario(scenario, bank_deg, climb_mps=climb_mps))
        self.names = world.names[1:]
        self.dt = world.clock.control / world.clock.base_rate_hz
        self._limit_deg = check_roll_limits(world, abs(bank_deg))
        self._flight = Flight(world, [])
        self._flight.prepare()
        self._schedule = world.clock.schedule(world.duration_s)
        flown_s, looked = 0.0, round(LOOK_S / self.dt)
        while True:
            last = self._fly(SETTLE_S, _Disturbance(world, Change()))[-looked:]
            flown_s += SETTLE_S
            moved_deg = np.degrees(np.ptp(last[:, BANK], axis=0))
            if moved_deg.max() < STEADY_DEG or flown_s >= LONGEST_SETTLE_S:
                break
        self.bank_deg: Array = np.degrees(last[:, BANK].mean(axis=0))
        self.problem = self._find_problem(last, moved_deg)
        saturations = last[:, SATURATIONS].astype(int) & int(Saturation.THROTTLE)
        at_limit: BoolArray = np.any(saturations, axis=0)
        self.note = f"{self._join(at_limit)} at a limit of the throttle" if at_limit.any() else ""

    def _find_problem(self, last: Array, moved_deg: Array) -> str:
        """Return why the last seconds of the flight are not steady; "": they are."""
        commanded_deg = np.degrees(np.abs(last[:, COMMAND]).max(axis=0))
        limited = commanded_deg > self._limit_deg - ROLL_RESERVE_DEG
        moving = ~(moved_deg < STEADY_DEG)  # also where it is not a number
        if moving.any():
            worst = int(np.nan_to_num(moved_deg, nan=np.inf).argmax())
            reason = f"the bank of {self.names[worst]} still changes by {moved_deg[worst]:.1f}°"
            return f"not steady: {reason}" + (", at its limit" if limited[worst] else "")
        if limited.any():
            return f"{self._join(limited)} too near the limit of the bank for kicks"
        return ""

    def _join(self, those: BoolArray) -> str:
        names = [self.names[i] for i in np.flatnonzero(those)]
        return f"{join_names(names)} {'is' if len(names) == 1 else 'are'}"

    def respond(self, change: Change) -> Array:
        """Fly on with a change, in a copy of the process.

        Returns:
            (K, 5, n): bank and pitch, rad, and the error north, east and down, m.

        Raises:
            InputError: the copy failed.
        """
        done = run_forked(partial(self._record, change))()
        if done.value is None:
            raise InputError(f"a copy of the steady flight failed: {done.error or done.end}")
        return np.array(done.value)

    def _record(self, change: Change, _: Callable[[str], None]) -> list[Any]:
        rows = self._fly(change.record_s, _Disturbance(self._world, change))
        listed: list[Any] = rows[:, :COMMAND].tolist()
        return listed

    def _fly(self, duration_s: float, disturb: _Disturbance) -> Array:
        """Fly for a time; return (K, 7, n): what `respond` does, the roll command, saturations."""
        world, flight, rows = self._world, self._flight, []
        first: float | None = None
        for tick, due, ticks, needed in self._schedule:
            now = world.clock.time_s(tick)
            first = now if first is None else first
            flight.steer(now, due)
            if due.autopilot:
                disturb(now - first)
                for vehicles in world.vehicles:
                    run_steps((*vehicles.autopilot_steps, *vehicles.output_steps), now)
            if due.guidance:
                rows.append(self._look())
            for vehicles in world.vehicles:
                vehicles.step(ticks, needed)
            if tick + ticks >= world.clock.ticks(first + duration_s):
                break
        return np.array(rows)

    def _look(self) -> Array:
        world = self._world
        slots = world.formation.control.offsets, world.formation.altitudes
        write_formation_state(world.aircraft, world.followers, *slots)
        own, followers = world.aircraft[1:], world.followers
        euler = own["truth"]["euler"][:, :2]
        commanded = np.stack((own["command"]["roll"], followers["saturations"]))
        return np.concatenate((euler.T, followers["error_ned"].T, commanded))


def check_roll_limits(world: World, bank_deg: float) -> Array:
    """Return the limits (n,) of the followers' bank, of middle loop and autopilot, degrees.

    Raises:
        MarginsError: a bank is too near one of them.
    """
    [autopilots] = [
        each.autopilots.gains for each in world.vehicles if isinstance(each, JsbsimVehicles)
    ]
    followers = world.formation.built_control.config
    limits_deg: Array = np.degrees(np.minimum(followers.roll_limit, autopilots["roll_limit"]))
    low = int(limits_deg.argmin())
    if bank_deg > limits_deg[low] - ROLL_RESERVE_DEG:
        raise MarginsError(
            f"a bank of {bank_deg:g}° is too near the limit of {world.names[1 + low]}, "
            f"{limits_deg[low]:g}°, for kicks (write at most "
            f"{limits_deg[low] - ROLL_RESERVE_DEG:g})"
        )
    return limits_deg


class _Disturbance:
    """A change of the followers' commands and positions."""

    def __init__(self, world: World, change: Change) -> None:
        """Move the followers."""
        self._command, self._gain = world.aircraft["command"][1:], change.roll_gain
        n = len(self._command)
        if np.any(change.displacement_m) and isinstance(world.fleet, JsbsimFleet):
            right = course(world.aircraft["truth"]["velocity_ned"][1:]) + 0.5 * math.pi
            shift = np.stack((np.cos(right), np.sin(right), np.ones(n)), axis=-1)
            distance = np.broadcast_to(change.displacement_m, n)
            world.fleet.displace(distance[:, np.newaxis] * shift)
        self._kick = np.radians(change.kick_deg)
        self._steady = self._command["roll"].copy()
        rate_hz = world.clock.base_rate_hz / world.clock.autopilot
        periods = np.broadcast_to(change.roll_latency_s, n) * rate_hz
        self._late = np.floor(periods).astype(int)
        self._part = periods - self._late
        line = int(self._late.max()) + 2
        self._line = deque([self._steady] * line, line)  # roll commands, the newest first
        self._rows = np.arange(n)

    def __call__(self, since_s: float) -> None:
        """Change the commands that the autopilots are about to read."""
        command = self._command
        self._line.appendleft(command["roll"].copy())
        line = np.stack(self._line)
        sooner, later = line[self._late, self._rows], line[self._late + 1, self._rows]
        roll = sooner + self._part * (later - sooner)
        kick = self._kick if since_s < KICK_S else 0.0
        command["roll"] = self._steady + self._gain * (roll - self._steady) + kick
        command["pitch"] += kick
