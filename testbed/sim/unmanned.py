"""Aircraft that nobody can command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from testbed.links.cockpit import Item, Mode, Refusal


class Unmanned:
    """The cockpit of an aircraft that has no autopilot of ours, which refuses everything."""

    armed, failsafe, external, lockstep = True, False, False, False
    parameters: Mapping[str, float] = {}
    mission: Sequence[Item] = ()
    item = 0
    target = None

    def __init__(self, name: str, mode: Mode, why: str) -> None:
        """Answer everything with this text."""
        self.name, self.mode = name, mode
        self._refusal = Refusal(why)

    def change_mode(self, mode: Mode) -> Refusal | None:
        """See `Cockpit`."""
        return None if mode == self.mode else self._refusal

    def arm(self, armed: bool, *, force: bool) -> Refusal | None:
        """See `Cockpit`."""
        return None if armed else self._refusal

    def change_parameter(self, name: str, value: float) -> Refusal | None:
        """See `Cockpit`."""
        return Refusal(f"{name}: it has no parameters here", supported=False)

    def change_mission(self, items: Sequence[Item]) -> Refusal | None:
        """See `Cockpit`."""
        return self._refusal

    def go_on_at(self, item: int) -> Refusal | None:
        """See `Cockpit`."""
        return self._refusal

    def fly_to(
        self,
        latitude_deg: float,
        longitude_deg: float,
        altitude: float | None,
        radius: float | None,
    ) -> Refusal | None:
        """See `Cockpit`."""
        return self._refusal

    def change_airspeed(self, airspeed: float) -> Refusal | None:
        """See `Cockpit`."""
        return self._refusal

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
        return self._refusal
