"""Write the table of damping and margins of docs/margins.md, per aircraft, profile and bank.

Each number is the least, of settling the longest, of all followers of Simulations 1 to 3.

usage: make margins  (ARGS="--jobs N")
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from tables import insert, row

from testbed.plan.world import versions
from testbed.scenario import Scenario, find_aircraft, load_scenario
from testbed.scenario.yaml_io import read
from testbed.studies.flight_pool import open_flight_pool
from testbed.studies.margins import margins_of
from testbed.trials.margins import MAX_ROLL_GAIN, MAX_ROLL_LATENCY_S, FollowerMargins, Margins
from testbed.trials.steady_flight import LONG_RECORD_S

MARK = "make margins"
SIMULATIONS = (1, 2, 3)
BANKS_DEG = (0.0, 30.0, 45.0)
AIRCRAFT = {
    "rascal110": ("Rascal 110", ()),
    "skywalker_x8": (
        "Skywalker X8",
        ("fleet.*.aircraft=skywalker_x8", "formation.speed_pole_per_s=0.4"),
    ),
}
HEADER = (
    *("aircraft", "profile", "bank", "least damped oscillation, Hz", "its damping ratio"),
    *("1 m settles in, s", "factor of the roll command", "latency of it, ms"),
)


def profiles(aircraft: str) -> list[str]:
    """Return the profiles of an airframe's middle_loop.yaml."""
    return list(read(find_aircraft(aircraft) / "middle_loop.yaml").value)


def cases() -> Iterator[tuple[tuple[str, str, float], Scenario]]:
    """Yield the row of the table, and each scenario in it."""
    for aircraft, (_, overrides) in AIRCRAFT.items():
        for profile in profiles(aircraft):
            for bank_deg in BANKS_DEG:
                for number in SIMULATIONS:
                    changes = (*overrides, f"controller.profile={profile}")
                    yield (
                        (aircraft, profile, bank_deg),
                        load_scenario(f"simulation-{number}", changes),
                    )


def cells(found: Sequence[Margins]) -> tuple[str, ...]:
    """Return the cells of one row, with the least of all followers of all simulations."""
    if any(each.problem for each in found):
        return ("not steady", *("–",) * 4)
    mark = "†" if any(each.note for each in found) else ""
    followers: list[FollowerMargins] = [one for each in found for one in each.followers]
    modes = [each.least_damped for each in followers if each.least_damped is not None]
    least = min(modes, key=lambda mode: mode.damping)
    settling = [each.settling_s for each in followers]
    gains = [each.roll_gain for each in followers if each.roll_gain is not None]
    latencies = [each.roll_latency_s for each in followers if each.roll_latency_s is not None]
    longest = max((each for each in settling if each is not None), default=0.0)
    return (
        f"{least.frequency_hz:.2f}{mark}",
        f"{least.damping:.2f}",
        f"> {LONG_RECORD_S:g}" if None in settling else f"{longest:.1f}",
        f"{min(gains):.2f}" if gains else f"> {MAX_ROLL_GAIN:g}",
        f"{1000.0 * min(latencies):.0f}" if latencies else f"> {1000.0 * MAX_ROLL_LATENCY_S:g}",
    )


def text(jobs: int) -> str:
    """Measure everything; return the table as Markdown."""
    rows, scenarios = zip(*cases(), strict=True)
    with open_flight_pool(jobs=jobs, report=_report) as pool:
        found = margins_of(
            [(scenario, bank) for (*_, bank), scenario in zip(rows, scenarios, strict=True)],
            pool,
            lambda done, of: _report(f"{done} of {of}") if done % 10 == 0 else None,
        )
    lines = [row(*HEADER), "|---|---|--:|" + "--:|" * (len(HEADER) - 3)]
    for each in dict.fromkeys(rows):
        aircraft, profile, bank_deg = each
        here = [margins for where, margins in zip(rows, found, strict=True) if where == each]
        name = AIRCRAFT[aircraft][0]
        lines.append(row(name, f"`{profile}`", f"{bank_deg:g}°", *cells(here)))
    notes = "† A follower is at a limit of its throttle."
    about = ", ".join(f"{name} {of}" for name, of in versions().items())
    return "\n".join([*lines, "", notes, "", f"Measured with {about}."])


def _report(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--into", type=Path, help="a Markdown file with the two markers")
    options = parser.parse_args()
    table = text(options.jobs)
    print(table)
    if options.into:
        page = insert(options.into.read_text(encoding="utf-8"), table, MARK)
        options.into.write_text(page, encoding="utf-8")
