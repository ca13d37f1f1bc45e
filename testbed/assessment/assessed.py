"""The scenario that is assessed: its flights with settings and seeds, and their commands."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass

from testbed.metrics.expectations import compares_flights
from testbed.plan.measured_fleet import resolve
from testbed.scenario import Scenario, ScenarioFile, set_duration, set_seed
from testbed.scenario.arguments import with_changes
from testbed.scenario.schema import SECOND_HALF
from testbed.scenario.set_keys import SetKeys

FLIGHTS = 59  # all of which keep the criteria: 95 % do, with 95 % confidence, 0.95^59 < 0.05
MAX_RMS_M = 2.0  # of each follower in each window, where the scenario has no bounds
STOPPING = (
    *("limits.on_loss=stop", "limits.on_limit_exceeded=stop"),
    "limits.on_violation=stop",
)


@dataclass(frozen=True, slots=True)
class Assessed:
    """A scenario, and how it is flown.

    Attributes:
        name: of the scenario, as a command has it.
        file: of the scenario.
        overrides: of all flights, texts `key.path=value`.
        duration_s: of all flights, s; None: that of the scenario.
        flights: number of seeds of each row that seeds change.
        params: parameter files of real aircraft, `FILE` or `NAME=FILE`.
    """

    name: str
    file: ScenarioFile
    overrides: tuple[str, ...] = ()
    duration_s: float | None = None
    flights: int = FLIGHTS
    params: tuple[str, ...] = ()

    def scenario(self, settings: Sequence[str] = (), seed: int | None = None) -> Scenario:
        """Return the scenario of a flight.

        Raises:
            ScenarioError: it cannot be flown with these settings.
        """
        found = self.file.resolve((*self.overrides, *settings)).with_set_keys(SetKeys())
        if self.duration_s is not None:
            found = set_duration(found, self.duration_s)
        return found if seed is None else set_seed(found, seed)

    @property
    def seeds(self) -> range:
        """The seeds: from that of the scenario on."""
        first = self.scenario().scenario.seed
        return range(first, first + self.flights)

    def criteria(self) -> tuple[str, ...]:
        """Return settings with the criteria: none where the scenario has bounds of its own.

        Else separations of a wingspan, errors of 2 m RMS in each window, and no speed that leaves
        its bounds.
        """
        scenario = self.scenario()
        if compares_flights(scenario.expect.model_dump()):
            return ()
        spans = [
            each.airframe.span
            for each in resolve(scenario).aircraft
            if each.row or scenario.leader.path.kind != "virtual"
        ]
        # without a window that the flight reaches its bounds would be dropped with it
        end_s = scenario.scenario.duration_s
        own = self.file.resolve(self.overrides).scenario.windows
        reached = any(start_s < end_s for start_s, _ in own.values())
        window = () if reached else (_window(SECOND_HALF, end_s / 2.0, end_s),)
        return (
            *window,
            f"expect.rms_m.max={MAX_RMS_M:g}",
            f"expect.min_separation_m.min={max(spans):.4g}",
            "expect.left_speed_set.max=0",
        )

    def run_command(self, settings: Sequence[str], seed: int) -> str:
        """Return the command that flies one flight again."""
        return self._command("run", settings, ["--seed", str(seed)])

    def command(self, row: str = "") -> str:
        """Return the command that finds one row again, or all."""
        flights = ["--flights", str(self.flights)] if self.flights != FLIGHTS else []
        params = [word for each in self.params for word in ("--param", each)]
        more = ["--only", row] if row else params
        return self._command("assess", (), [*more, *flights])

    def margins_command(self, bank_deg: float, climb_mps: float, settings: Sequence[str]) -> str:
        """Return the command that predicts margins again."""
        words = ["testbed", "margins", self.name, "--bank", f"{bank_deg:g}"]
        words += ["--climb", f"{climb_mps:g}"] if climb_mps else []
        return shlex.join([*words, *self._set(settings)])

    def _command(self, name: str, settings: Sequence[str], more: Sequence[str]) -> str:
        duration = [] if self.duration_s is None else ["--duration", f"{self.duration_s:g}"]
        return shlex.join(["testbed", name, self.name, *self._set(settings), *duration, *more])

    def _set(self, settings: Sequence[str]) -> list[str]:
        return [word for text in (*self.overrides, *settings) for word in ("--set", text)]


def without_chance(scenario: Scenario) -> Scenario:
    """Return the scenario with a network that only delays."""
    network = type(scenario.network)(delay_s=scenario.network.delay_s)
    return with_changes(scenario, network=network)


def _window(name: str, start_s: float, end_s: float) -> str:
    return f"scenario.windows.{name}=[{start_s:g}, {end_s:g}]"


def window_setting(name: str, start_s: float, end_s: float) -> str:
    """Return the setting that adds a window, s."""
    return _window(name, start_s, end_s)
