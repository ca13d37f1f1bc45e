"""Write tables and figure of docs/sensors.md: Simulation 3 with sensor errors.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from inputs import Case, Inputs
from tables import COMMAND, Metrics, draw, row, versions, write_tables

import testbed
from testbed.core.records import Array, Event, RunInfo, Sample
from testbed.reports.plot_selection import LEADER_COLOUR, STYLES
from testbed.views.panels import GREY, Line, Panel, PanelGrid

FIGURE = Path(__file__).parents[1] / "docs" / "images" / "sensors-pixhawk.png"
COLOURS = (LEADER_COLOUR, *(colour for colour, _ in STYLES))  # of the leader and its followers
SEEDS = (1, 2, 3)
WINDOWS = ("rectangles", "circles")
GPS_DRIFT = "sensors.gps.own_drift_m=[0.4, 0.8]"
ERRORS = {
    "horizontal_m": "{:.2f}",
    "height_m": "{:.2f}",
    "velocity_mps": "{:.2f}",
    "airspeed_mps": "{:.2f}",
    "tilt_deg": "{:.1f}",
    "heading_deg": "{:.1f}",
}


def on_all_aircraft(*keys: str) -> tuple[str, ...]:
    """Return these keys of an aircraft for the leader and all followers."""
    return tuple(f"{part}.{key}" for key in keys for part in ("leader", "fleet.*"))


ALL = on_all_aircraft("sensors=pixhawk")
SETS = {
    "`truth`": (),
    "`gps-ins`": on_all_aircraft("sensors=gps-ins"),
    "`pixhawk`": ALL,
    "`degraded`": on_all_aircraft("sensors=degraded"),
}
CHANGED = {
    "own GPS drift of 0.4 m and 0.8 m": (*ALL, *on_all_aircraft(GPS_DRIFT)),
    "GPS 0.1 s later, all aircraft": (*ALL, *on_all_aircraft("sensors.gps.latency_s=0.22")),
    "GPS 0.1 s later, `uav2` only": (*ALL, "fleet.uav2.sensors.gps.latency_s=0.22"),
    "no errors of the GPS": (*ALL, *on_all_aircraft("sensors.gps=null")),
    "no errors of the barometer": (*ALL, *on_all_aircraft("sensors.barometer=null")),
    "no errors of the pitot tube": (*ALL, *on_all_aircraft("sensors.airspeed=null")),
    "no errors of gyros and accelerometers": (
        *ALL,
        *on_all_aircraft("sensors.gyro=null", "sensors.accelerometer=null"),
    ),
    "no errors of the compass": (*ALL, *on_all_aircraft("sensors.magnetometer=null")),
}
FLIGHTS = {
    (name, seed): Case("simulation-3", (*keys, f"scenario.seed={seed}"))
    for name, keys in {**SETS, **CHANGED}.items()
    for seed in SEEDS
}
Flown = Mapping[Case, Metrics]


class Trace:
    """Record position errors of the estimates and of the formation, as an observer."""

    def begin(self, info: RunInfo) -> None:
        """InitialState with nothing."""
        self.names = info.names
        self.time_s: list[float] = []
        self.estimate_error: list[Array] = []  # (N, 3) estimate minus truth, NED, m
        self.error: list[Array] = []  # (n,) distance from the slot, m
        self.estimated: list[Array] = []

    def observe(self, sample: Sample) -> None:
        """Record one sample."""
        self.time_s.append(sample.time_s)
        self.estimate_error.append(sample.estimate.position_ned - sample.truth.position_ned)
        self.error.append(np.linalg.norm(sample.formation.error_ned, axis=1))
        self.estimated.append(np.linalg.norm(sample.formation.estimated_error_ned, axis=1))

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Do nothing."""


def seeds(flown: Flown, name: str) -> list[Metrics]:
    """Return the flights of a row."""
    return [flown[FLIGHTS[name, seed]] for seed in SEEDS]


def root_mean_square(values: Sequence[float]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def estimate_table(flown: Flown) -> Iterator[str]:
    """Return the rows of estimate errors over all aircraft."""
    yield row("sensors", "horizontal, m", "height, m", "relative to the leader, m",
              "velocity, m/s", "airspeed, m/s", "tilt, °", "heading, °")  # fmt: skip
    yield "|---|" + "--:|" * 7
    for name in list(SETS)[1:]:
        flights = seeds(flown, name)
        errors = [each for flight in flights for each in flight["estimate_error"].values()]
        cells = [
            form.format(root_mean_square([each[key] for each in errors]))
            for key, form in ERRORS.items()
        ]
        relative = root_mean_square(
            [r for flight in flights for r in flight["relative_position_error_m"].values()]
        )
        yield row(name, *cells[:2], f"{relative:.2f}", *cells[2:])


def formation_table(flown: Flown) -> Iterator[str]:
    """Return the rows of RMS errors of the formation, true and estimated."""
    yield row("sensors", "true, rectangles", "circles", "estimated, rectangles", "circles",
              "smallest separation")  # fmt: skip
    yield "|---|" + "--:|" * 5
    for name in (*SETS, *CHANGED):
        flights = seeds(flown, name)
        cells = []
        for key in ("mean_rms_m", "estimated_mean_rms_m"):
            for window in WINDOWS:
                values = [flight["windows"][window][key] for flight in flights]
                shown = f"{np.mean(values):.2f}"
                if key == "mean_rms_m" and min(values) < max(values):
                    shown += f" ({min(values):.2f}–{max(values):.2f})"
                cells.append(shown)
        separation = min(flight["min_separation_m"] for flight in flights)
        yield row(name, *cells, f"{separation:.1f}")


def figure(trace: Trace) -> PanelGrid:
    """Return the figure: estimate errors, their differences, and distances from the slots."""
    time_s = np.array(trace.time_s)
    lists = (trace.estimate_error, trace.error, trace.estimated)
    offset, error, estimated = (np.array(each) for each in lists)
    limits = (0.0, float(time_s[-1]))

    def lines(values: Array, first: int) -> list[Line]:
        return [
            Line(time_s, values[:, i], COLOURS[first + i], trace.names[first + i], 1.2)
            for i in range(values.shape[1])
        ]

    def panel(title: str, curves: list[Line], low: float, high: float, x_label: str = "") -> Panel:
        return Panel(title, x_label, "m", curves, x_limits=limits, y_limits=(low, high))

    top = [
        panel("error of the position estimate, north", lines(offset[..., 0], 0), -4.0, 4.0),
        panel("error of the height estimate", lines(-offset[..., 2], 0), -4.0, 4.0),
    ]
    relative = offset[:, 1:] - offset[:, :1]
    middle = [
        panel("error minus the leader's, north", lines(relative[..., 0], 1), -4.0, 4.0),
        panel("error minus the leader's, height", lines(-relative[..., 2], 1), -4.0, 4.0),
    ]
    bottom = [
        panel(
            f"distance of {trace.names[1 + i]} from its slot",
            [
                Line(time_s, error[:, i], COLOURS[1 + i], "", 1.2),
                Line(time_s, estimated[:, i], GREY, "distance from the slot by estimates", 1.2),
            ],
            0.0,
            4.0,
            "time, s",
        )
        for i in (0, 2)
    ]
    return PanelGrid(
        "Simulation 3 on estimates",
        "Sensors of the preset pixhawk on every aircraft, seed 1",
        [top, middle, bottom],
        (1.0, 1.0),
        (15.0, 8.5),
    )


def text(flown: Flown) -> list[str]:
    """Return the tables as Markdown lines, and draw the figure."""
    trace = Trace()
    testbed.run("simulation-3", [*ALL, "scenario.seed=1"], write=False, observers=[trace])
    draw(figure(trace), FIGURE)
    return [
        f"Flown with {versions(flown)}.",
        f"Simulation 3 with these sensors on every aircraft and seeds {SEEDS[0]} to {SEEDS[-1]}.",
        "",
        "RMS errors of the estimates over the flight and all aircraft:",
        "",
        *estimate_table(flown),
        "",
        "The followers' mean RMS error in m, as the mean over the seeds (and the range of the true",
        "one), and the smallest separation in m. Below `degraded`: `pixhawk` with one change.",
        "",
        *formation_table(flown),
        "",
        "![Errors of four estimates, their differences, and the formation's errors]"
        "(images/sensors-pixhawk.png)",
    ]


INPUTS = {COMMAND: Inputs(tuple(FLIGHTS.values()))}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, {COMMAND: text})
