"""Tables and figure of docs/sensors.md: what sensors that err do to Simulation 3.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tables import Case, Metrics, row, versions, write_tables

import testbed
from testbed.state import Array, Event, Frame, RunInfo
from testbed.views.figure_door import draw
from testbed.views.panels import BLACK, BLUE, GREEN, GREY, ORANGE, Line, Panel, Sheet

FIGURE = Path(__file__).parents[1] / "docs" / "images" / "sensors-pixhawk.png"
COLOURS = (BLACK, BLUE, GREEN, ORANGE)  # of the leader and its followers
SEEDS = (1, 2, 3)
PORTIONS = ("rectangles", "circles")
GPS_DRIFT = "sensors.gps.own_drift_m=[0.4, 0.8]"
ERRORS = {
    "horizontal_m": "{:.2f}",
    "height_m": "{:.2f}",
    "velocity_mps": "{:.2f}",
    "airspeed_mps": "{:.2f}",
    "tilt_deg": "{:.1f}",
    "heading_deg": "{:.1f}",
}


def everyone(*keys: str) -> tuple[str, ...]:
    """Keys of an aircraft, set in all of them."""
    return tuple(f"{who}.{key}" for key in keys for who in ("leader", "fleet.*"))


ALL = everyone("sensors=pixhawk")
SETS = {
    "`truth`": (),
    "`gps-ins`": everyone("sensors=gps-ins"),
    "`pixhawk`": ALL,
    "`degraded`": everyone("sensors=degraded"),
}
CHANGED = {
    "GPS drift of its own 0.4 m and 0.8 m": (*ALL, *everyone(GPS_DRIFT)),
    "GPS 0.1 s later, all of them": (*ALL, *everyone("sensors.gps.latency_s=0.22")),
    "GPS 0.1 s later, `uav2` only": (*ALL, "fleet.uav2.sensors.gps.latency_s=0.22"),
    "no errors of the GPS": (*ALL, *everyone("sensors.gps=null")),
    "no errors of the barometer": (*ALL, *everyone("sensors.barometer=null")),
    "no errors of the pitot tube": (*ALL, *everyone("sensors.airspeed=null")),
    "no errors of gyros and accelerometers": (
        *ALL,
        *everyone("sensors.gyro=null", "sensors.accelerometer=null"),
    ),
    "no errors of the compass": (*ALL, *everyone("sensors.magnetometer=null")),
}
FLIGHTS = {
    (name, seed): Case("simulation-3", (*keys, f"scenario.seed={seed}"))
    for name, keys in {**SETS, **CHANGED}.items()
    for seed in SEEDS
}
Flown = Mapping[Case, Metrics]


class Trace:
    """An observer that keeps errors of position: of estimates, and of the formation."""

    def begin(self, info: RunInfo) -> None:
        """Start with nothing."""
        self.names = info.names
        self.time_s: list[float] = []
        self.off: list[Array] = []  # (N, 3) estimate less truth, NED, m
        self.error: list[Array] = []  # (n,) distance from the slot, m
        self.believed: list[Array] = []

    def observe(self, frame: Frame) -> None:
        """Take one frame."""
        self.time_s.append(frame.time_s)
        self.off.append(frame.estimate.position_ned - frame.truth.position_ned)
        self.error.append(np.linalg.norm(frame.formation.error_ned, axis=1))
        self.believed.append(np.linalg.norm(frame.formation.believed_ned, axis=1))

    def end(self, summary: Mapping[str, Any], events: Sequence[Event]) -> None:
        """Nothing is left to do."""


def seeds(flown: Flown, name: str) -> list[Metrics]:
    """The flights of a row."""
    return [flown[FLIGHTS[name, seed]] for seed in SEEDS]


def mean(values: Sequence[float]) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def estimate_table(flown: Flown) -> Iterator[str]:
    """What the estimates of all aircraft were off by."""
    yield row("sensors", "horizontal, m", "height, m", "relative to the leader, m",
              "velocity, m/s", "airspeed, m/s", "tilt, °", "heading, °")  # fmt: skip
    yield "|---|" + "--:|" * 7
    for name in list(SETS)[1:]:
        flights = seeds(flown, name)
        off = [each for flight in flights for each in flight["estimate_error"].values()]
        cells = [form.format(mean([each[key] for each in off])) for key, form in ERRORS.items()]
        apart = mean([r for flight in flights for r in flight["relative_position_m"].values()])
        yield row(name, *cells[:2], f"{apart:.2f}", *cells[2:])


def formation_table(flown: Flown) -> Iterator[str]:
    """RMS errors of the formation, true and as the followers believe."""
    yield row("sensors", "true, rectangles", "circles", "as believed, rectangles", "circles",
              "apart at least")  # fmt: skip
    yield "|---|" + "--:|" * 5
    for name in (*SETS, *CHANGED):
        flights = seeds(flown, name)
        cells = []
        for key in ("mean_rms_m", "believed_mean_rms_m"):
            for portion in PORTIONS:
                values = [flight["portions"][portion][key] for flight in flights]
                shown = f"{np.mean(values):.2f}"
                if key == "mean_rms_m" and min(values) < max(values):
                    shown += f" ({min(values):.2f}–{max(values):.2f})"
                cells.append(shown)
        apart = min(flight["min_separation_m"] for flight in flights)
        yield row(name, *cells, f"{apart:.1f}")


def figure(trace: Trace) -> Sheet:
    """Errors of the estimates, what two of them differ by, and what the formation makes of it."""
    time_s = np.array(trace.time_s)
    off, error, believed = (np.array(each) for each in (trace.off, trace.error, trace.believed))
    limits = (0.0, float(time_s[-1]))

    def lines(values: Array, first: int) -> list[Line]:
        return [
            Line(time_s, values[:, i], COLOURS[first + i], trace.names[first + i], 1.2)
            for i in range(values.shape[1])
        ]

    def panel(title: str, unit: str, curves: list[Line], low: float, high: float) -> Panel:
        return Panel(title, "time, s", unit, curves, x_limits=limits, y_limits=(low, high))

    top = [
        panel("estimate − truth, north", "m", lines(off[..., 0], 0), -4.0, 4.0),
        panel("estimate − truth, height", "m", lines(-off[..., 2], 0), -4.0, 4.0),
    ]
    relative = off[:, 1:] - off[:, :1]
    middle = [
        panel("the same, less the leader's", "m", lines(relative[..., 0], 1), -4.0, 4.0),
        panel("the same, less the leader's", "m", lines(-relative[..., 2], 1), -4.0, 4.0),
    ]
    bottom = [
        panel(
            f"distance of {trace.names[1 + i]} from its slot",
            "m",
            [
                Line(time_s, error[:, i], COLOURS[1 + i], "", 1.2),
                Line(time_s, believed[:, i], GREY, "as it and the leader believe", 1.2),
            ],
            0.0,
            4.0,
        )
        for i in (0, 2)
    ]
    return Sheet(
        "Simulation 3 on estimates",
        "Sensors of the preset pixhawk on every aircraft, seed 1",
        [top, middle, bottom],
        (1.0, 1.0),
    )


def text(flown: Flown) -> list[str]:
    """The tables; the figure is drawn beside."""
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


if __name__ == "__main__":
    write_tables(__doc__ or "", list(FLIGHTS.values()), text)
