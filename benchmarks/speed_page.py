"""Tables and figure of what `speed.py` measured."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rooms import ROOMS
from tables import row

from testbed.sim.world import versions
from testbed.views.panels import (
    BLACK,
    BLUE,
    DASHED,
    GOLD,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    Band,
    Line,
    Panel,
    Sheet,
)

FIGURE = Path(__file__).parent.parent / "docs" / "images" / "speed.png"
PAGE_MARK = "make bench"
SIMULATION, TROUBLES = "simulation-3", "all troubles"
BARS = {SIMULATION: 1.6, TROUBLES: 2.0}
BROWN = "#6b4423"
# What is drawn together, from the bottom up, by the name in the legend.
PILE: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "physics": (BLUE, ("physics",)),
    "truth": (SKY, ("truth",)),
    "air": (GREEN, ("air",)),
    "sensing": (PURPLE, ("sensing",)),
    "autopilot": (ORANGE, ("autopilot",)),
    "network": (GOLD, ("network",)),
    "control, leader": (BLACK, ("control", "leader")),
    "log, metrics": (GREY, ("log", "metrics")),
    "loop, events": (BROWN, ("loop", "events")),
}
OPACITY = 0.7

Told = Mapping[str, Any]


def machine() -> dict[str, Any]:
    """What it is measured on and with, and how busy that is before."""
    said = Path("/proc/cpuinfo")
    lines = said.read_text(encoding="utf-8").splitlines() if said.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    return {
        "processor": processor,
        "processors": os.cpu_count(),
        "load": os.getloadavg()[0],
        "versions": versions(),
    }


def cases(result: Told) -> dict[str, Told]:
    """Everything measured, by what it is called in tables."""
    fleets = {f"vee of {count}": told for count, told in result["by_aircraft"].items()}
    return {name: result[name] for name in BARS} | fleets


def text(result: Told) -> str:
    """All tables."""
    said = result["machine"]
    flown = ", ".join(f"{name} {of}" for name, of in said["versions"].items())
    looked = max(told["looking_costs"] for told in cases(result).values())
    return "\n".join(
        [
            *ratios(result),
            "",
            "Full / bare by the clock on the wall and by the process's processor time: median and "
            f"range, of {result[SIMULATION]['turns']} turns of `simulation-3` and of all troubles, "
            f"of which the first {result[SIMULATION]['simulated_s']:g} s are flown, and of fewer "
            "and longer ones of the others. *Least*: the quickest flight by the quickest bare loop "
            "of any turn, on the wall, as if nobody else had been there. *Set and read*, by "
            "processor time: the bare loop with controls set and motions read at the autopilot "
            "rate, and nothing else.",
            "",
            *rooms(result),
            "",
            "Microseconds of processor time for one second of flight of one aircraft. Looking made "
            f"the flights at most {100.0 * max(looked - 1.0, 0.0):.0f} % longer.",
            "",
            *growth(result),
            "![Where the time goes](images/speed.png)",
            "",
            f"Measured on {said['processors']} processors ({said['processor']}) that others kept "
            f"busy with a load of {said['load']:.1f}, with {flown}.",
        ]
    )


def ratios(result: Told) -> Iterator[str]:
    """Full over bare, and how much faster than real time."""
    heads = ("", "aircraft", "full / bare", "by processor time", "least", "bar")
    more = ("set and read / bare", "× real time", "bare", "building, s")
    crewed = ("processes", "full / bare", "× real time")
    yield row(*heads, *more, *crewed)
    yield "|---|" + "--:|" * 12
    for name, told in cases(result).items():
        yield row(
            name,
            str(told["aircraft"]),
            _spread(told, "full_over_bare"),
            _spread(told, "full_over_bare_processor"),
            f"{told['least_full_over_least_bare']:.2f}",
            f"{BARS[name]:g}" if name in BARS else "",
            f"{told['held_over_bare_processor']:.2f}",
            f"{told['real_time_factor']:.3g}",
            f"{told['bare_real_time_factor']:.3g}",
            f"{told['build_s']:.2f}",
            *_crewed(told.get("crew")),
        )


def _crewed(told: Told | None) -> tuple[str, str, str]:
    if told is None:
        return "", "", ""
    factor = f"{told['real_time_factor']:.3g}"
    return str(told["processes"]), _spread(told, "full_over_bare"), factor


def _spread(told: Told, key: str) -> str:
    low, high = told[f"{key}_spread"]
    return f"{told[key]:.2f} ({low:.2f}–{high:.2f})"


def rooms(result: Told) -> Iterator[str]:
    """Time by room."""
    each = cases(result)
    yield row("µs", *each)
    yield "|---|" + "--:|" * len(each)
    for room, about in ROOMS.items():
        yield row(
            f"{room}: {about}",
            *(f"{told['us_per_aircraft_second'][room]:.0f}" for told in each.values()),
        )
    for key, about in (("full", "all"), ("bare", "bare loop")):
        yield row(about, *(f"{told['us_per_aircraft_second'][key]:.0f}" for told in each.values()))


def growth(result: Told) -> Iterator[str]:
    """Many aircraft beside four, and what memory they need."""
    by_count = result["by_aircraft"]
    counts = sorted(map(int, by_count))
    if 4 in counts and counts[-1] > 4:
        few, many = by_count["4"], by_count[str(counts[-1])]
        alone, bare = (
            many["us_per_aircraft_second"][key] / few["us_per_aircraft_second"][key]
            for key in ("full", "bare")
        )
        said = (
            f"An aircraft among {counts[-1]} costs {alone:.2f} times as much processor time as one "
            f"among 4, and {bare:.2f} times as much in the bare loop"
        )
        if "crew" in many:
            crewed = many["crew"]["us_per_aircraft_second"] / few["wall_us_per_aircraft_second"]
            said += (
                f"; stepped by {many['crew']['processes']} processes, {crewed:.2f} times as much "
                "time by the clock on the wall"
            )
        yield f"{said}."
    if "memory" in result:
        told = result["memory"]
        yield (
            f"{told['aircraft']} aircraft need {told['peak_mb']:.0f} MB for the first "
            f"{told['simulated_s']:g} s."
        )
    yield ""


def picture(result: Told) -> Sheet:
    """Rooms as stacked columns, and the ratios and factors by the number of aircraft."""
    counts = sorted(map(int, result["by_aircraft"]))
    by_count = [result["by_aircraft"][str(count)] for count in counts]
    columns = [*by_count, *(result[name] for name in BARS)]
    names = [*map(str, counts), "simulation-3\n4", "all troubles\n4"]
    ticks = [(float(k), name) for k, name in enumerate(names)]
    x = np.array(counts, dtype=float)
    decades = [(float(count), str(count)) for count in counts]
    ratio = np.array([told["full_over_bare"] for told in by_count])
    spread = np.array([told["full_over_bare_spread"] for told in by_count]).T
    factor = np.array([told["real_time_factor"] for told in by_count])
    ideal = np.array([told["bare_real_time_factor"] for told in by_count])
    ends = np.array([x[0], x[-1]])
    marked = [
        (name, result[name]["full_over_bare"], colour, sign)
        for name, colour, sign in ((SIMULATION, ORANGE, "s"), (TROUBLES, GREEN, "^"))
    ]
    top = float(max(spread.max(), *(each for _, each, _, _ in marked)))
    return Sheet(
        "Where the time goes",
        "Processor time by room, and what a whole flight costs beside the bare flight models",
        [
            [
                _stacks(columns, ticks),
                Panel(
                    "Whole flight over bare loop",
                    "flight models",
                    "full / bare",
                    [
                        Line(x, ratio, BLUE, "vees", 1.5, marker="o", marks=0),
                        *(
                            Line(
                                np.array([4.0]),
                                np.array([each]),
                                colour,
                                name,
                                1.5,
                                True,
                                "-",
                                sign,
                            )
                            for name, each, colour, sign in marked
                        ),
                        *(
                            Line(ends, np.full(2, bar), GREY, dashes=DASHED)
                            for bar in BARS.values()
                        ),
                    ],
                    [Band(x, spread[0], spread[1], BLUE)],
                    x_log=True,
                    y_limits=(0.0, 1.1 * top),
                    x_ticks=decades,
                ),
                Panel(
                    "Faster than real time",
                    "flight models",
                    "simulated s / s",
                    [
                        Line(x, factor, BLUE, width=1.5, marker="o", marks=0),
                        Line(x, ideal, BLACK, width=1.5, dashes=DASHED),
                        Line(ends, np.ones(2), GREY),
                    ],
                    x_log=True,
                    y_log=True,
                    x_ticks=decades,
                ),
            ]
        ],
        [2.4, 1.0, 1.0],
        (19.0, 8.0),
    )


def _stacks(columns: Sequence[Told], ticks: Sequence[tuple[float, str]]) -> Panel:
    """A column of rooms for each case, and the bare loop across it."""
    bands, lines = [], []
    for at, told in enumerate(columns):
        costs, low = told["us_per_aircraft_second"], np.zeros(2)
        x = at + np.array([-0.36, 0.36])
        for name, (colour, rooms) in PILE.items():
            high = low + sum(costs[room] for room in rooms)
            bands.append(Band(x, low, high, colour, "" if at else name, OPACITY))
            low = high
        bare = np.full(2, costs["bare"])
        lines.append(Line(x, bare, BLACK, "" if at else "bare loop", 2.0, dashes=DASHED))
    return Panel(
        "Processor time for one second of flight of one aircraft",
        "flight models",
        "µs",
        lines,
        bands,
        y_limits=(0.0, max(each["us_per_aircraft_second"]["full"] for each in columns) * 1.05),
        x_ticks=ticks,
    )
