"""Numbers of a study that predicts margins in place of flights."""

from __future__ import annotations

from typing import Any

from testbed.core.errors import FlightError
from testbed.plan.world import versions
from testbed.scenario import Scenario

PART = "margins"  # of the document with the numbers


def predicted_names() -> tuple[str, ...]:
    """Return the names of the numbers, as columns of a study."""
    from testbed.linear.held_flight import COMMANDS

    of_commands = [
        f"{command}_{number}"
        for command in COMMANDS
        for number in ("factor", "latency_s", "phase_deg", "distance")
    ]
    return tuple(f"{PART}.{name}" for name in ("damping", "frequency_hz", *of_commands))


def predict_numbers(bank_deg: float, scenario: Scenario) -> dict[str, Any]:
    """Predict the margins of a scenario, each the worst of all followers and both directions.

    A factor, latency or phase margin beyond the largest value that is tried is that value; damping
    and frequency are None where nothing oscillates.

    Args:
        bank_deg: of the steady flight, of the follower that banks most, 0 or more.
        scenario: whose followers they are.

    Returns:
        The numbers by name, and the versions of the code.

    Raises:
        FlightError: the flight is not steady.
        InputError: the scenario cannot be linearised.
    """
    # scipy is imported by the workers that need it
    from testbed.linear.flown_margins import directions
    from testbed.linear.held_flight import COMMANDS
    from testbed.linear.loop_margins import MAX_GAIN, MAX_LATENCY_S
    from testbed.linear.predicted_margins import predict_margins, worse_prediction

    found = worse_prediction([predict_margins(scenario, bank) for bank in directions(bank_deg)])
    if found.problem:
        raise FlightError(found.problem)
    modes = [each.least_damped for each in found.followers if each.least_damped is not None]
    least = min(modes, key=lambda mode: mode.damping, default=None)
    numbers: dict[str, float | None] = {
        "damping": None if least is None else least.damping,
        "frequency_hz": None if least is None else least.frequency_hz,
    }
    for command in COMMANDS:
        margins = [each.commands[command] for each in found.followers]
        numbers |= {
            f"{command}_factor": min(MAX_GAIN, *(each.gain for each in margins)),
            f"{command}_latency_s": min(MAX_LATENCY_S, *(each.latency_s for each in margins)),
            f"{command}_phase_deg": min(180.0, *(each.phase_deg for each in margins)),
            f"{command}_distance": min(each.distance for each in margins),
        }
    return {"versions": versions(), PART: numbers}
