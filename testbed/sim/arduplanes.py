"""Aircraft that ArduPlane flies, beside others of the same fleet behind virtual autopilots."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from testbed.ardupilot.packets import motion_columns
from testbed.ardupilot.process import end
from testbed.scenario import Scenario
from testbed.scenario.pilots import ArduPlane
from testbed.sim.vehicles import Flown, choose
from testbed.state import Event, FbwaCommand, Origin, Surfaces, Truths, VehicleState
from testbed.vehicle.fleet import JsbsimFleet
from testbed.vehicle.legs import Leg
from testbed.vehicle.tables import FbwaGains

if TYPE_CHECKING:
    from testbed.ardupilot.link import Plane


class ArduPlanes(Flown):
    """A fleet of which some aircraft are flown by an ArduPlane each, in lockstep.

    Each tick ArduPlane gets the truth, the pitot tube's airspeed of its last period and the sticks
    as they are, and what it then sends to its servos moves the aircraft through that tick. What
    breaks breaks behind its servo outputs.
    """

    def __init__(
        self,
        fleet: JsbsimFleet,
        gains: FbwaGains,
        planes: Mapping[int, Plane],
        arduplane: Path | None,
    ) -> None:
        """Aircraft in trim; no ArduPlane is started.

        Args:
            fleet: of all these aircraft.
            gains: of all virtual autopilots, the unused ones, too.
            planes: by row of the fleet.
            arduplane: the program, where the page says nothing.
        """
        super().__init__(fleet, gains)
        self._planes, self._arduplane = dict(planes), arduplane
        self._every = tuple(self._planes.values())
        self._news: list[tuple[Plane, str, str]] = []
        self._raw = self.surfaces
        self._pitot = self.read().equivalent_airspeed
        self._outputs = {row: tuple(float(each[row]) for each in self._raw) for row in planes}

    def check(self) -> None:
        """See `Partner`."""
        for plane in self._every:
            plane.find(self._arduplane)

    def begin(self, heed: Callable[[], None]) -> None:
        """Start all of them, and bring up one after the other on the motion at the start."""
        for plane in self._every:
            plane.start(self._arduplane, heed)
        state, air = self.read(), self.air()
        columns = motion_columns(state, air.wind_ned, state.equivalent_airspeed)
        for row, plane in self._planes.items():
            roll, pitch, _ = state.euler[row].tolist()
            trim = roll, pitch, float(self.surfaces.throttle[row])
            text = plane.bring_up(columns[row].tolist(), float(air.battery_voltage[row]), trim)
            # what it says of its boot is no news unless it warns
            said = [each for each in plane.news() if each[0] != "info"]
            self._news += [(plane, *each) for each in said]
            if text:
                self._news.append((plane, "info", text))

    def news(self, now: float) -> list[Event]:
        """See `Partner`."""
        told, self._news = self._news, []
        return [Event(now, level, plane.name, text) for plane, level, text in told]

    def summary(self) -> dict[str, str]:
        """See `Partner`: the version of each ArduPlane."""
        return {plane.name: plane.station.version or "of no known version" for plane in self._every}

    def close(self) -> None:
        """See `Partner`."""
        self._end(self._every)

    def act(self, estimate: VehicleState, told: FbwaCommand) -> None:
        """One period of the virtual autopilots; the others only get their sticks moved."""
        super().act(estimate, told)
        for row, plane in self._planes.items():
            plane.tell(float(told.roll[row]), float(told.pitch[row]), float(told.throttle[row]))
            self._news += [(plane, *each) for each in plane.news()]
        self._raw, self._pitot = self.surfaces, estimate.equivalent_airspeed.copy()
        self.surfaces = self._with_outputs()

    def remove(self, rows: Truths) -> None:
        """Fly them no more; an ArduPlane whose aircraft is lost is ended."""
        super().remove(rows)
        lost = [row for row in self._planes if rows[row]]
        self._end([self._planes.pop(row) for row in lost])

    def step(self, ticks: int, legs: tuple[Leg, ...] = ()) -> None:
        """Tick by tick: motion out, pulses in, and the flight models run."""
        planes = self._planes
        rows = np.array(list(planes), dtype=np.intp)
        air = self.air()
        wind_ned, voltage = air.wind_ned[rows], air.battery_voltage[rows].tolist()
        pitot = self._pitot[rows]
        for _ in range(ticks):
            if planes:
                columns = motion_columns(choose(self.read(), rows), wind_ned, pitot)
                each = zip(planes.values(), columns.tolist(), voltage, strict=True)
                for plane, own, volts in each:
                    plane.answer(own, volts)
                for row, plane in planes.items():
                    self._outputs[row] = plane.surfaces(plane.collect())
            self.surfaces = self._reached(self._with_outputs())
            self.fleet.step(self.surfaces, 1)

    def _with_outputs(self) -> Surfaces:
        """What the autopilots say, ArduPlane's in the place of the virtual ones."""
        columns = np.array(self._raw)
        for row, output in self._outputs.items():
            columns[:, row] = output
        return Surfaces(*columns)

    def _end(self, planes: Sequence[Plane]) -> None:
        for plane in planes:
            plane.hang_up()
        end([plane.process for plane in planes if plane.process is not None])


def make_flown(
    page: Scenario,
    fleet: JsbsimFleet,
    gains: FbwaGains,
    rows: Sequence[int],
    tunes: Sequence[Path],
    arduplane: Path | None,
) -> Flown:
    """The aircraft of a page that have flight models, behind their autopilots.

    Args:
        page: the scenario.
        fleet: their flight models.
        gains: of their virtual autopilots.
        rows: which of the N aircraft they are.
        tunes: N parameter files.
        arduplane: the program that flies those with `autopilot: ardupilot`, where the page says
            nothing.

    Raises:
        InputError: an airframe cannot be flown by ArduPlane.
    """
    if not any(isinstance(page.aircraft[row].autopilot, ArduPlane) for row in rows):
        return Flown(fleet, gains)
    from testbed.ardupilot.link import Plane, Wanted  # few pages need them

    origin = Origin(**page.scenario.origin.model_dump())
    yaw = fleet.read().euler[:, 2]
    planes = {}
    for place, row in enumerate(rows):
        asked = page.aircraft[row].autopilot
        if not isinstance(asked, ArduPlane):
            continue
        wanted = Wanted(
            name=page.aircraft[row].name,
            instance=row if asked.instance is None else asked.instance,
            start=asked.start,
            binary=asked.binary,
            tune=tunes[row],
            patience_s=asked.patience_s,
            heading_deg=math.degrees(float(yaw[place])) % 360.0,
            elevon_mixing=float(fleet.rig.mixing[place]),
        )
        planes[place] = Plane(
            wanted,
            origin,
            physics_hz=page.rates.physics_hz,
            autopilot_hz=page.rates.autopilot_hz,
        )
    return ArduPlanes(fleet, gains, planes, arduplane)
