"""A flight of one aircraft that a program commands, without a formation."""

from pydantic import Field

from testbed.scenario.air import Air
from testbed.scenario.aircraft import AircraftSection, Start
from testbed.scenario.expect import Expect
from testbed.scenario.fields import Section, Speed
from testbed.scenario.sections import Header, Limits, Log, Rates


class SingleAircraft(Section):
    """Everything that determines the numbers of such a flight; no file has it."""

    scenario: Header = Field(description="Name, duration and seed.")
    rates: Rates = Field(description="Rates of the loops, Hz.")
    only: AircraftSection = Field(description="The aircraft.")
    start: Start = Field(description="Position and course at time 0, m and degrees.")
    airspeed_mps: Speed = Field(description="True airspeed at time 0, m/s.")
    air: Air = Field(description="Wind, turbulence and gusts.")

    @property
    def name(self) -> str:
        """Return the name of the flight."""
        return self.scenario.name

    @property
    def aircraft(self) -> tuple[AircraftSection]:
        """Return the aircraft."""
        return (self.only,)

    @property
    def limits(self) -> Limits:
        """Return the limits: no other aircraft is near, and there is no slot to lose."""
        return Limits(min_separation_m=0, formation_lost_m=None)

    @property
    def expect(self) -> Expect:
        """Return the bounds of its numbers: there are none."""
        return Expect()

    @property
    def log(self) -> Log:
        """Return the files that it writes: none."""
        return Log(mcap=False)

    @property
    def published(self) -> None:
        """Return the published numbers to compare with: there are none."""
        return None
