"""One aircraft as a ground station commands it: modes, arming, sticks, parameters, a mission."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from testbed.frames import ned_from_geodetic
from testbed.links.cockpit import Item, Mode, Refusal, Target
from testbed.scenario.pilots import External
from testbed.sim.missions import FARTHEST_M, HIGHEST_M, LOWEST_M, Flyable
from testbed.sim.navigator import Course, Navigator
from testbed.sim.pilots import MissionPilot, Sticks
from testbed.sim.tuning import Tuning
from testbed.state import Event, VehicleState
from testbed.vehicle.params import FbwaParams

_DEFAULT_RADIUS = 60.0  # m, ArduPlane's
_STEEPEST = math.radians(75.0)  # what sticks can say
_STAMPS_S = 5e-4  # a state's stamp has whole milliseconds

Own = tuple[Flyable, tuple[Item, ...], MissionPilot]


class Seat:
    """An aircraft behind a virtual autopilot; a `links.cockpit.Cockpit`.

    In the mode that the page gives it, the page's own controller flies it, to the bit as if nobody
    were looking on. What is asked of it holds from the next tick on.
    """

    def __init__(
        self,
        name: str,
        course: Course,
        tune: FbwaParams,
        retune: Callable[[FbwaParams], None],
        *,
        external: External | None,
        own: Own | None,
    ) -> None:
        """Begin in the page's mode.

        Args:
            name: of the aircraft.
            course: how it flies what it is told.
            tune: the parameters of its autopilot.
            retune: gives its autopilot other parameters.
            external: who commands it, if that is a program outside.
            own: of a leader, its mission on the page and who flies it.
        """
        self.name, self._course = name, course
        self._external, self._leads = external, own is not None
        self._navigator = Navigator(course, _DEFAULT_RADIUS)
        self._tuning = Tuning(tune, retune, self._navigator)
        if own:
            self._navigator.take_over(*own)
        self.mode = Mode.AUTO if own and not external else Mode.FBWA
        self.armed, self.failsafe = True, False
        self.lost = self.hangs = False  # the aircraft, and its autopilot
        self._told: Sticks = course.trim  # by sticks or an attitude target
        self._told_s: float | None = 0.0  # when; None: GUIDED has heard of a place since
        self._guided: Sticks = course.trim
        self._now = 0.0
        self._asked_s: float | None = None  # of the frame that lockstep waits to be answered
        self._news: list[Event] = []
        self.asked: Counter[str] = Counter()  # what programs outside had done, by kind

    @property
    def external(self) -> bool:
        """See `Cockpit`."""
        return self._external is not None

    @property
    def lockstep(self) -> bool:
        """See `Cockpit`."""
        return self._external is not None and self._external.lockstep

    @property
    def patience_s(self) -> float:
        """How long lockstep waits for it, s of wall-clock time."""
        return (self._external or External()).patience_s

    @property
    def parameters(self) -> Mapping[str, float]:
        """See `Cockpit`."""
        return self._tuning.values

    @property
    def mission(self) -> Sequence[Item]:
        """See `Cockpit`."""
        return self._navigator.items

    @property
    def item(self) -> int:
        """See `Cockpit`."""
        return self._navigator.item

    @property
    def target(self) -> Target | None:
        """See `Cockpit`."""
        return self._navigator.target

    @property
    def waiting(self) -> bool:
        """Whether lockstep waits for a command."""
        asked = self._asked_s is not None and self._by_hand
        return asked and not (self.lost or self.hangs)

    @property
    def commanded(self) -> Sticks | None:
        """What it is told now; None: what the page's controller of a follower says."""
        if self._by_hand and not self.failsafe:
            sticks = self._told
        elif self.mode is Mode.FBWA and not self._takes_sticks:
            return None if self.armed else (*self._course.trim[:2], 0.0)
        else:
            sticks = self._guided
        return sticks if self.armed else (*sticks[:2], 0.0)

    def guide(self, now: float, estimate: VehicleState) -> None:
        """Once per control period: where it is at `now` s, and a step of whatever guides it."""
        self._now = now
        self._navigator.look(estimate)
        self._mind_silence()
        if self.mode is Mode.AUTO:
            self._guided = self._navigator.fly_mission(estimate)
        elif self.failsafe or not (self._by_hand or self.mode is Mode.FBWA):
            self._guided = self._navigator.fly_circle(estimate)

    def ask(self, now: float) -> None:
        """A frame of this time, s, has gone out; in lockstep it is to be answered."""
        if self.lockstep:
            self._asked_s = now

    def news(self) -> list[Event]:
        """What has happened since the last call."""
        news, self._news = self._news, []
        return news

    def change_mode(self, mode: Mode) -> Refusal | None:
        """See `Cockpit`."""
        if self.lost:
            return Refusal("lost: takes no commands")
        if mode is Mode.AUTO and not self._navigator.has_mission:
            return Refusal("AUTO: has no mission; upload one")
        if mode is self.mode:
            return None
        if mode is Mode.AUTO:
            self._navigator.resume()
        elif mode is not Mode.FBWA:
            self._navigator.circle(self._navigator.here)
        self._told = self._guided = self._course.trim
        self._told_s = None if mode is Mode.GUIDED else self._now
        self.mode, self.failsafe, self._asked_s = mode, False, None
        self._say(f"mode {mode.name}", "modes")
        return None

    def arm(self, armed: bool, *, force: bool) -> Refusal | None:
        """See `Cockpit`."""
        if armed == self.armed:
            return None
        if self.lost:
            return Refusal("lost: takes no commands")
        if not armed and not force:
            return Refusal("in flight: disarming must be forced (param2 21196)")
        self.armed = armed
        if armed:
            self._say("armed", "arming")
        else:
            self._say("disarmed: motor off", "arming", level="warning")
        return None

    def change_parameter(self, name: str, value: float) -> Refusal | None:
        """See `Cockpit`."""
        said = self._tuning.change(name, value)
        if isinstance(said, Refusal):
            return said
        if said:
            self._say(said, "parameters")
        return None

    def change_mission(self, items: Sequence[Item]) -> Refusal | None:
        """See `Cockpit`."""
        if len(items) <= 1:
            if self.mode is Mode.AUTO:
                return Refusal("mission: it is being flown; change the mode first")
            self._navigator.clear_mission()
            self._say("mission cleared", "missions")
            return None
        slow, fast = self._tuning.tune.airspeed_min, self._tuning.tune.airspeed_max
        refusal = self._navigator.change_mission(items, slow, fast)
        if refusal is None:
            self._say(f"mission of {len(items) - 1} items", "missions")
        return refusal

    def go_on_at(self, item: int) -> Refusal | None:
        """See `Cockpit`."""
        if not self._navigator.go_on_at(item):
            return Refusal(f"mission: item {item} is no place to fly to")
        self._say(f"goes on at mission item {self.item}", "missions")
        return None

    def fly_to(
        self,
        latitude_deg: float,
        longitude_deg: float,
        altitude: float | None,
        radius: float | None,
    ) -> Refusal | None:
        """See `Cockpit`."""
        if self.mode is not Mode.GUIDED:
            return Refusal(f"in {self.mode.name}: places are for GUIDED")
        here = self._navigator.here
        place = np.array([latitude_deg, longitude_deg, 0.0])
        north, east, _ = ned_from_geodetic(place, self._course.origin).tolist()
        far = math.hypot(north - here[0], east - here[1])
        height = here[2] if altitude is None else altitude
        if not (far <= FARTHEST_M and LOWEST_M <= height <= HIGHEST_M):
            return Refusal("write a place within 100 km, 5 m to 20 km up")
        self._navigator.circle((north, east, height), radius)
        self._told_s, self.failsafe = None, False
        self._say(f"flies to {north:.0f} m north, {east:.0f} m east, {height:.0f} m up", "places")
        return None

    def change_airspeed(self, airspeed: float) -> Refusal | None:
        """See `Cockpit`."""
        slow, fast = self._tuning.tune.airspeed_min, self._tuning.tune.airspeed_max
        if not slow <= airspeed <= fast:
            return Refusal(f"{airspeed:g} m/s: write {slow:g} to {fast:g}")
        self._navigator.fly_at(airspeed)
        self._say(f"airspeed {airspeed:g} m/s", "airspeeds")
        return None

    def sticks(
        self,
        roll: float,
        pitch: float,
        throttle: float,
        *,
        attitude: bool = False,
        answers_s: float | None = None,
    ) -> Refusal | None:
        """See `Cockpit`."""
        if self.lost:
            return Refusal("lost: takes no commands")
        if self.mode is Mode.FBWA and not self._takes_sticks:
            return Refusal("flown by the formation, not commanded_by: external")
        if self.mode is not Mode.FBWA and not (self.mode is Mode.GUIDED and attitude):
            return Refusal(f"in {self.mode.name}: sticks are for FBWA")
        if not all(map(math.isfinite, (roll, pitch, throttle))):
            return Refusal("sticks that are not numbers")
        asked, answers = self._asked_s, answers_s
        if asked is not None and answers is not None and answers < asked - _STAMPS_S:
            return None
        self._told = (
            min(max(pitch, -_STEEPEST), _STEEPEST),
            min(max(roll, -_STEEPEST), _STEEPEST),
            min(max(throttle, 0.0), 1.0),
        )
        self._told_s, self._asked_s = self._now, None
        self.asked["commands"] += 1
        if self.failsafe:
            self.failsafe = False
            self._say("hears commands again")
        return None

    @property
    def _takes_sticks(self) -> bool:
        """Whether FBWA is flown from outside: an external's is, and a leader's."""
        return self.external or self._leads

    @property
    def _by_hand(self) -> bool:
        """Whether sticks or an attitude target are flown, or would be but for the failsafe."""
        if self.mode is Mode.FBWA:
            return self._takes_sticks
        return self.mode is Mode.GUIDED and self._told_s is not None

    def _mind_silence(self) -> None:
        patience = (self._external or External()).failsafe_s
        silent = self._by_hand and self._told_s is not None and self._now - self._told_s > patience
        if not silent or self.failsafe:
            return
        self.failsafe = True
        self._navigator.circle(self._navigator.here)
        self._say(f"hears no commands for {patience:g} s: circles where it is", level="warning")

    def _say(self, text: str, kind: str = "", level: str = "info") -> None:
        """Say what has happened; with a kind it is counted as asked from outside."""
        self._news.append(Event(self._now, level, self.name, text))
        if kind:
            self.asked[kind] += 1
