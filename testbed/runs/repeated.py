"""Fly scenarios one after another, where those that differ by their seeds are built once."""

from __future__ import annotations

from testbed.metrics.model import Metrics
from testbed.runs.batch import Batch
from testbed.runs.run import run
from testbed.scenario import Scenario, code_references, set_seed
from testbed.scenario.aircraft import ByFormation, VirtualAutopilot
from testbed.scenario.set_keys import SetKeys


class RepeatedFlights:
    """Flights as of `testbed.run` without files, to the bit; the last one is kept for other seeds.

    One that differs from the kept flight by its seed alone returns this to its start in place of
    being built. An error drops the kept flight, so that the next one is built.
    """

    def __init__(self) -> None:
        self._kept: Batch | None = None

    def fly(self, scenario: Scenario) -> tuple[Metrics, bool]:
        """Fly a scenario to its end.

        Returns:
            The metrics, and whether another seed may change them.

        Raises:
            InputError, ExternalProgramLost: see `testbed.run`.
        """
        kept, self._kept = self._kept, None
        scenario = scenario.with_set_keys(SetKeys())  # they are those of all flights together
        if not _is_in_process(scenario):
            return run(scenario, write=False, progress=False).metrics, True
        seed = scenario.scenario.seed
        if kept is not None and set_seed(kept.scenario(0), seed) == scenario:
            kept.reset(seeds=[seed])
        else:
            kept = None  # before another one needs memory
            kept = Batch(scenario, threads=1, progress=False)
        (metrics,) = kept.run()
        depends_on_seed = kept.depends_on_seed(0)
        if depends_on_seed:  # else the next flight shall show that its seed changes nothing
            self._kept = kept
        return metrics, depends_on_seed


def _is_in_process(scenario: Scenario) -> bool:
    """Return whether a flight is compiled code and objects that can return to their start.

    Code of the user is not: it may keep something in a module.
    """
    return not any(code_references(scenario)) and all(
        isinstance(each.autopilot, VirtualAutopilot) and isinstance(each.commanded_by, ByFormation)
        for each in scenario.aircraft
    )
