"""Tables and figure of the results of `speed.py`."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tables import row

from testbed.plan.world import versions
from testbed.views.panels import (
    BLACK,
    BLUE,
    DASHED,
    GREEN,
    GREY,
    ORANGE,
    Band,
    Line,
    Panel,
    PanelGrid,
)

FIGURE = Path(__file__).parent.parent / "docs" / "images" / "speed.png"
MARK = "make bench"
SIMULATION, ALL_EFFECTS = "simulation-3", "all effects"
TARGETS = {SIMULATION: 0.35, ALL_EFFECTS: 0.9}  # at the rate of the bare loop

Results = Mapping[str, Any]


def machine() -> dict[str, Any]:
    """Return the processor, the load before the measurement, and the versions."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text(encoding="utf-8").splitlines() if cpuinfo.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.processor() or platform.machine()
    return {
        "processor": processor,
        "processors": os.cpu_count(),
        "load": os.getloadavg()[0],
        "versions": versions(),
    }


def cases(result: Results) -> dict[str, Results]:
    """Return all results by their name in the tables."""
    fleets = {f"vee of {count}": numbers for count, numbers in result["by_aircraft"].items()}
    return {name: result[name] for name in TARGETS} | fleets


def text(result: Results) -> str:
    """Return all tables as text."""
    setup = result["machine"]
    flown = ", ".join(f"{name} {of}" for name, of in setup["versions"].items())
    return "\n".join(
        [
            *ratio_table(result),
            "",
            "Full / bare: median and range of "
            f"{result[SIMULATION]['turns']} turns of `simulation-3` and of all effects, each the "
            f"first {result[SIMULATION]['simulated_s']:g} s, and of fewer and longer turns of the "
            "others; by wall-clock time, and by processor time of the process. At the scenario's "
            "own rate of the flight models, 100 Hz, and at that of the bare loop, 200 Hz, with a "
            "log and without.",
            "",
            *growth(result),
            "![The cost of a flight](images/speed.png)",
            "",
            f"Measured on {setup['processors']} processors ({setup['processor']}) with a load "
            f"of {setup['load']:.1f} from other programs, with {flown}.",
        ]
    )


def ratio_table(result: Results) -> Iterator[str]:
    """Return the rows of full / bare and of the speed relative to real time."""
    rates = ("100 Hz, full / bare", "200 Hz, full / bare", "without a log", "target")
    heads = ("", "aircraft", *rates, "processor time: 100 Hz", "200 Hz", "without a log")
    yield row(*heads, "× real time", "bare", "building, s")
    yield "|---|" + "--:|" * 11
    for name, numbers in cases(result).items():
        keys = ("full_over_bare", "at_bare_hz", "no_log")
        yield row(
            name,
            str(numbers["aircraft"]),
            *(_spread(numbers, key) for key in keys),
            f"{TARGETS[name]:g}" if name in TARGETS else "",
            *(f"{numbers[f'{key}_processor']:.2f}" for key in keys),
            f"{numbers['real_time_factor']:.3g}",
            f"{numbers['bare_real_time_factor']:.3g}",
            f"{numbers['build_s']:.2f}",
        )


def _spread(numbers: Results, key: str) -> str:
    low, high = numbers[f"{key}_spread"]
    return f"{numbers[key]:.2f} ({low:.2f}–{high:.2f})"


def growth(result: Results) -> Iterator[str]:
    """Return sentences on the cost of many aircraft, and their memory."""
    by_count = result["by_aircraft"]
    counts = sorted(map(int, by_count))
    if 4 in counts and counts[-1] > 4:
        few, many = by_count["4"], by_count[str(counts[-1])]
        full, bare = (
            many["us_per_aircraft_second"][key] / few["us_per_aircraft_second"][key]
            for key in ("full", "bare")
        )
        sentence = (
            f"An aircraft among {counts[-1]} costs {full:.2f} times as much processor time as one "
            f"among 4, and {bare:.2f} times as much in the bare loop"
        )
        yield f"{sentence}."
    if "memory" in result:
        numbers = result["memory"]
        yield (
            f"{numbers['aircraft']} aircraft need {numbers['peak_mb']:.0f} MB for the first "
            f"{numbers['simulated_s']:g} s."
        )
    yield ""


def picture(result: Results) -> PanelGrid:
    """Return the figure: ratios and speed by number of aircraft."""
    counts = sorted(map(int, result["by_aircraft"]))
    by_count = [result["by_aircraft"][str(count)] for count in counts]
    x = np.array(counts, dtype=float)
    decades = [(float(count), str(count)) for count in counts]
    ratio = np.array([numbers["at_bare_hz"] for numbers in by_count])
    spread = np.array([numbers["at_bare_hz_spread"] for numbers in by_count]).T
    factor = np.array([numbers["real_time_factor"] for numbers in by_count])
    ideal = np.array([numbers["bare_real_time_factor"] for numbers in by_count])
    ends = np.array([x[0], x[-1]])
    marked = [
        (name, result[name]["at_bare_hz"], colour, sign)
        for name, colour, sign in ((SIMULATION, ORANGE, "s"), (ALL_EFFECTS, GREEN, "^"))
    ]
    top = float(max(spread.max(), *TARGETS.values(), *(each for _, each, _, _ in marked)))
    return PanelGrid(
        "The cost of a flight",
        "A whole flight with its log, relative to the bare loop of JSBSim",
        [
            [
                Panel(
                    "Whole flight over bare loop, 200 Hz",
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
                            Line(ends, np.full(2, bar), colour, f"target of {name}", dashes=DASHED)
                            for (name, bar), (_, _, colour, _) in zip(
                                TARGETS.items(), marked, strict=True
                            )
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
                        Line(x, ideal, BLACK, "bare loop", 1.5, dashes=DASHED),
                        Line(ends, np.ones(2), GREY, "real time", 2.0),
                    ],
                    x_log=True,
                    y_log=True,
                    x_ticks=decades,
                ),
            ]
        ],
        [1.0, 1.0],
        (13.0, 6.5),
    )
