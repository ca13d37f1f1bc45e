"""What a flight costs beside bare JSBSim, in which rooms, and how that grows with the fleet.

usage: make bench  (or: python benchmarks/speed.py [--repeats N] [--work AIRCRAFT_SECONDS]
[--counts N ...] [--json FILE] [--into docs/speed.md])

All pages are measured in one process, one after the other, and that several times over. Each turn
of a page is the first half of the bare loop, the flight, the same flight with a timer that looks in
which room it is, and the other half.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fleets import COUNTS, busy, vee
from full_over_bare import Turn, flight_models, full, median, turn
from memory import memory
from rooms import Rooms
from speed_page import BARS, FIGURE, PAGE_MARK, SIMULATION, TROUBLES, machine, picture, text
from tables import insert

from testbed.scenario import Scenario, load, shorten
from testbed.vehicle.crew import crew_of
from testbed.views.figure_door import draw

WARM_S = 2.0
LONGEST_S = 1080.0  # what Simulation 3 lasts
MEMORY_S = 60.0
# Pages that have a bar take as many shorter turns for each of the others: a machine that others
# use too is fast and slow in turns of seconds.
OFTEN = 5


def measure(pages: Mapping[str, Scenario], repeats: int) -> dict[str, dict[str, Any]]:
    """Numbers of every page, by its name."""
    for page in pages.values():
        full(shorten(page, WARM_S))  # compiles what is compiled once
    turns: dict[str, list[Turn]] = {name: [] for name in pages}
    rooms = {name: Rooms() for name in pages}
    for number in range(repeats):
        for name, page in pages.items():
            taken = [turn(page, rooms[name]) for _ in range(OFTEN if name in BARS else 1)]
            turns[name] += taken
            ratio = median([each.ratio for each in taken])
            _tell(f"turn {number + 1}: {name}: full / bare {ratio.wall_s:.2f}")
    return {name: numbers(page, turns[name], rooms[name].shares) for name, page in pages.items()}


def numbers(page: Scenario, turns: Sequence[Turn], shares: Mapping[str, float]) -> dict[str, Any]:
    """What the turns of a page say, and each room's share of the time, ready for JSON."""
    flown, bare = (median([getattr(each, of) for each in turns]) for of in ("full", "bare"))
    ratio = median([each.ratio for each in turns])
    seconds, aircraft = page.scenario.duration_s, flight_models(page)
    each_us = 1e6 / (seconds * aircraft)
    held = [each.held.processor_s / each.bare.processor_s for each in turns]
    told: dict[str, Any] = {"aircraft": aircraft, "simulated_s": seconds, "turns": len(turns)}
    for kind, key in (("wall_s", ""), ("processor_s", "_processor")):
        ratios = [getattr(one.ratio, kind) for one in turns]
        told["full_over_bare" + key] = getattr(ratio, kind)
        told[f"full_over_bare{key}_spread"] = [min(ratios), max(ratios)]
    # what others do on the machine only adds
    least = [min(getattr(each, of).wall_s for each in turns) for of in ("full", "bare")]
    told["least_full_over_least_bare"] = least[0] / least[1]
    if turns[0].crewed:
        costs = [one.crewed for one in turns if one.crewed]
        crewed, shares_of_bare = (
            median(costs),
            [one.wall_s / each.bare.wall_s for one, each in zip(costs, turns, strict=True)],
        )
        told["crew"] = {
            "processes": crew_of(aircraft),
            "full_over_bare": statistics.median(shares_of_bare),
            "full_over_bare_spread": [min(shares_of_bare), max(shares_of_bare)],
            "real_time_factor": seconds / crewed.wall_s,
            "us_per_aircraft_second": crewed.wall_s * each_us,
        }
    return told | {
        "real_time_factor": seconds / flown.wall_s,
        "bare_real_time_factor": seconds / bare.wall_s,
        "held_over_bare_processor": statistics.median(held),
        "build_s": sorted(one.build_s for one in turns)[len(turns) // 2],
        "wall_us_per_aircraft_second": flown.wall_s * each_us,
        "us_per_aircraft_second": {
            "bare": bare.processor_s * each_us,
            "full": flown.processor_s * each_us,
            **{room: share * flown.processor_s * each_us for room, share in shares.items()},
        },
        "looking_costs": median([one.looked_at / one.full for one in turns]).processor_s,
    }


def lasting(work: float, aircraft: int) -> float:
    """Seconds of flight for so many aircraft-seconds."""
    return min(work / aircraft, LONGEST_S)


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, print, and write what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    # many short turns: a machine that others use too drifts within seconds
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--work", type=float, default=600.0, help="aircraft-seconds of a flight")
    parser.add_argument("--counts", type=int, nargs="*", default=COUNTS)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--into", type=Path, help="a page with the two markers")
    asked = parser.parse_args(arguments)
    pages = {SIMULATION: load(SIMULATION), TROUBLES: busy()}
    pages = {name: shorten(each, lasting(asked.work / OFTEN, 4)) for name, each in pages.items()}
    pages |= {str(count): vee(count, lasting(asked.work, count)) for count in asked.counts}
    beforehand = machine()
    measured = measure(pages, asked.repeats)
    result: dict[str, Any] = {
        "machine": beforehand,
        **{name: measured[name] for name in (SIMULATION, TROUBLES)},
        "by_aircraft": {str(count): measured[str(count)] for count in asked.counts},
    }
    if asked.counts:
        result["memory"] = memory(max(asked.counts), MEMORY_S)
    lines = text(result)
    print(lines)
    if asked.json:
        asked.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    if asked.into:
        draw(picture(result), FIGURE)
        page = insert(asked.into.read_text(encoding="utf-8"), lines, PAGE_MARK)
        asked.into.write_text(page, encoding="utf-8")


def _tell(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
