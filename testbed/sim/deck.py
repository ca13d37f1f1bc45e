"""Who flies each aircraft of a run that programs outside may command."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from testbed.formation.law import Diagnosis
from testbed.guidance.longitudinal import HoldGains
from testbed.guidance.mission import Mission
from testbed.links.cockpit import Cockpit, Mode
from testbed.scenario import Scenario, load_guidance
from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.pilots import ArduPlane, External
from testbed.sim.clock import Clock
from testbed.sim.leaders import Led
from testbed.sim.mission_items import items_of, items_of_parts
from testbed.sim.missions import Flyable
from testbed.sim.navigator import Course
from testbed.sim.pilots import MissionPilot, Sticks, Turn
from testbed.sim.seat import Seat
from testbed.sim.unmanned import Unmanned
from testbed.sim.vehicles import Flown
from testbed.state import Event, FbwaCommand, Origin, Truths, VehicleState
from testbed.vehicle.params import FbwaParams
from testbed.vehicle.start import Start

_BANK_DEG, _CLIMB_MPS = 45.0, 1.5  # of circles, where the page says nothing


class Deck:
    """The cockpits of N aircraft; also the pilot of a leader that has one."""

    def __init__(self, cockpits: Sequence[Cockpit]) -> None:
        """Everybody flies as the page says."""
        self.cockpits = tuple(cockpits)
        self._seats = [(i, each) for i, each in enumerate(cockpits) if isinstance(each, Seat)]
        self._lockstep = [seat for _, seat in self._seats if seat.lockstep]
        self._said: list[Event] = []

    @property
    def leads(self) -> bool:
        """Whether the leader is among them, and this its pilot."""
        return bool(self._seats) and self._seats[0][0] == 0

    @property
    def waiting(self) -> list[str]:
        """Names of those whose commands lockstep waits for."""
        return [seat.name for seat in self._lockstep if seat.waiting]

    @property
    def patience_s(self) -> float:
        """How long lockstep waits, s of wall-clock time."""
        return min((seat.patience_s for seat in self._lockstep), default=math.inf)

    def guide(self, now: float, estimate: VehicleState, gone: Truths, hung: Truths | None) -> None:
        """Once per control period of the leader, before it and the followers are told anything.

        Args:
            now: s
            estimate: of N aircraft.
            gone: (N,) who is lost.
            hung: (N,) whose autopilots hang; None: nobody's.
        """
        for row, seat in self._seats:
            seat.lost = bool(gone[row])
            seat.hangs = hung is not None and bool(hung[row])
            if not seat.lost:
                seat.guide(now, estimate)

    def command(self, estimate: VehicleState) -> tuple[Sticks, Turn | None]:
        """What the leader is told, as its `Pilot`."""
        _, leader = self._seats[0]
        sticks = leader.commanded
        assert sticks is not None  # a leader's seat always knows
        return sticks, None

    def told(self, command: FbwaCommand) -> FbwaCommand:
        """The commands of N aircraft, with those of whom nobody on the page commands."""
        columns = None
        for row, seat in self._seats:
            sticks = seat.commanded
            if sticks is not None:
                columns = np.array(command) if columns is None else columns
                columns[:, row] = sticks
        return command if columns is None else FbwaCommand(*columns)

    def heeded(self, diagnosis: Diagnosis) -> Diagnosis:
        """What the control of the n followers did, without those who fly something else."""
        away = self._away()
        if not away:
            return diagnosis
        guards, saturations = diagnosis.guards.copy(), diagnosis.saturations.copy()
        guards[away] = saturations[away] = 0
        return diagnosis._replace(guards=guards, saturations=saturations)

    def away(self, apart: Truths) -> Truths:
        """Who of the n followers is apart from its slot: these, and who flies something else."""
        away = self._away()
        if not away:
            return apart
        out = apart.copy()
        out[away] = True
        return out

    def _away(self) -> list[int]:
        """Followers that fly something else."""
        return [row - 1 for row, seat in self._seats if row and seat.commanded is not None]

    def asked(self) -> Mapping[str, Mapping[str, int]]:
        """How often programs outside had what done, by aircraft and kind; for the metrics."""
        return {seat.name: dict(seat.asked) for _, seat in self._seats if seat.asked}

    def news(self) -> list[Event]:
        """What has happened since the last call."""
        news = [*self._said, *(event for _, seat in self._seats for event in seat.news())]
        self._said = []
        return news

    def report(self, events: Sequence[Event]) -> None:
        """Have something said that concerns them."""
        self._said += events

    def ask(self, now: float) -> None:
        """A frame of this time has gone out; in lockstep it is to be answered."""
        for seat in self._lockstep:
            seat.ask(now)


def make_deck(
    page: Scenario,
    clock: Clock,
    led: Led,
    starts: Sequence[Start],
    tunes: Sequence[FbwaParams],
    folders: Sequence[Path],
    flown: Flown | None,
    rows: Sequence[int],
) -> Deck:
    """The cockpits of a page's aircraft.

    Args:
        page: the scenario.
        clock: its clock.
        led: its leader.
        starts: of all N aircraft.
        tunes: N
        folders: N, of their airframes.
        flown: those behind a virtual autopilot,
        rows: and which of the N they are.
    """
    cockpits: list[Cockpit] = []
    for row, one in enumerate(page.aircraft):
        if flown is None or row not in rows or isinstance(one.autopilot, ArduPlane):
            cockpits.append(_unmanned(row, one, led))
            continue
        tune, place = tunes[row], rows.index(row)
        trim = flown.fleet.trims[place]
        north, east, down = starts[row].position_ned
        own = led.pilot if row == 0 and isinstance(led.pilot, MissionPilot) else None
        manner = own.plan.mission if own else _manner(tune, starts[row].airspeed)
        course = Course(
            row=row,
            start=(north, east, -down),
            trim=(trim.placement.pitch, trim.placement.roll, trim.controls.throttle),
            hold=HoldGains(**load_guidance(folders[row]).model_dump()),
            manner=manner,
            origin=Origin(**page.scenario.origin.model_dump()),
            dt=clock.control / clock.base_rate_hz,
        )
        mission = None
        if own:
            numbers = items_of_parts(manner)
            whole = Flyable(own.plan, numbers, (manner.airspeed,) * len(numbers))
            mission = (whole, items_of(manner, course.origin), own)
        cockpits.append(
            Seat(
                one.name,
                course,
                tune,
                partial(flown.retune, place),
                external=one.commanded_by if isinstance(one.commanded_by, External) else None,
                own=mission,
            )
        )
    return Deck(cockpits)


def _unmanned(row: int, one: Leader | Follower, led: Led) -> Unmanned:
    if row == 0 and led.moves is not None:
        return Unmanned(one.name, Mode.AUTO, "moves by itself: nobody flies it")
    mode = Mode.AUTO if row == 0 else Mode.FBWA
    if one.vehicle == "ideal":
        return Unmanned(one.name, mode, "an ideal vehicle: it has no autopilot")
    return Unmanned(one.name, mode, "flown by ArduPlane: speak to that")


def _manner(tune: FbwaParams, airspeed: float) -> Mission:
    """How a follower flies when it is on its own."""
    return Mission(
        legs=(),
        airspeed=airspeed,
        bank_limit=math.radians(min(tune.roll_limit_deg, _BANK_DEG)),
        climb_limit=_CLIMB_MPS,
        period=tune.navl1_period,
        damping=tune.navl1_damping,
    )
