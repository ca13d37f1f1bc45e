"""Write the table of freedoms of docs/results/simulations.md: one changed choice per row.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from inputs import Case, Inputs
from tables import COMMAND, MARKS_TEXT, Metrics, mark, row, versions, write_tables

MARK = f"{COMMAND}, freedoms"
SIMULATIONS = (1, 2, 3)
ESTIMATORS = "controller.estimators"
HARD_LEGS = (
    "{kind: waypoints, points_m: [[800, 450, 100], [0, 450, 100], [0, 0, 100]]}",
    "{kind: waypoints, laps: 2, points_m: [[800, 0, 100], [800, 450, 100], [0, 450, 100], "
    "[0, 0, 100]]}",
    "{kind: waypoints, laps: 2, points_m: [[800, 0, 100], [800, 450, 145], [0, 450, 100], "
    "[0, 0, 145]]}",
    "{kind: loiter, centre_m: [400, 225], radius_m: 120, direction: clockwise, levels: "
    "[{altitude_m: 100, turns: 3}, {altitude_m: 145, turns: 3}, {altitude_m: 100, turns: 3}, "
    "{altitude_m: 145, turns: 3}, {altitude_m: 100, turns: 1}]}",
)
RECORDED_TUNE = ("leader.tune=recorded", "fleet.*.tune=recorded")
SMALLER = 1.2  # factor from which on a choice is listed
PRINTED = "(printed)"  # mark of what the paper does not leave open
X8 = ("leader.aircraft=skywalker_x8", "fleet.*.aircraft=skywalker_x8")
# What the paper leaves open, our choice, and another one with its overrides.
FREEDOMS: Sequence[tuple[str, str, str, tuple[str, ...]]] = (
    ("", "all as in the scenarios", "", ()),
    (
        "rectangle",
        "640 × 640 m, climbs of 2 m/s",
        "800 × 450 m, 3 m/s",
        (
            "leader.start={north_m: 800, east_m: -400, altitude_m: 100, course_deg: 90}",
            "leader.path.climb_limit_mps=3",
            f"leader.path.legs=[{', '.join(HARD_LEGS)}]",
            "scenario.windows={rectangles: [95, 530], circles: [650, 1080]}",
        ),
    ),
    ("leader's airspeed", "22 m/s", "20 m/s", ("leader.path.airspeed_mps=20",)),
    ("", "", "24 m/s", ("leader.path.airspeed_mps=24",)),
    ("leader's bank", "45°", "30°", ("leader.path.bank_limit_deg=30",)),
    (
        "source of q̈_g",
        "leader's accelerometers",
        "zero",
        (f"{ESTIMATORS}.leader_acceleration=none",),
    ),
    (
        "",
        "",
        "bank and differences",
        (
            f"{ESTIMATORS}.leader_acceleration=coordinated_turn",
            f"{ESTIMATORS}.leader_difference_blend=[0.4, 0.4]",
        ),
    ),
    ("gains of (19)-(21)", "ours, `tuned`", "`authors`", ("controller.profile=authors",)),
    (
        "autopilot's tune",
        "ours, `autopilot`",
        "`recorded`, of a recorded ArduPlane",
        RECORDED_TUNE,
    ),
    ("", "", "`recorded`, gains `authors`", (*RECORDED_TUNE, "controller.profile=authors")),
    (
        "rate of messages",
        "25 Hz",
        "10 Hz",
        ("rates.broadcast_hz=10",),
    ),
    ("rate of control", "25 Hz (printed)", "10 Hz", ("rates.control_hz=10",)),
    ("synchrony", "all act at once", "own phases", ("rates.synchronous=false",)),
    (
        "",
        "",
        "own phases, 10 Hz",
        ("rates.synchronous=false", "rates.control_hz=10", "rates.broadcast_hz=10"),
    ),
    (
        "age of the states in messages",
        "none",
        "0.12 s, positions extrapolated",
        ("network.delay_s=0.12", "controller.extrapolate_from=timestamp"),
    ),
    (
        "age of the own state",
        "none",
        "0.04 s, a control period",
        ("controller.companion.state_latency_s=0.04",),
    ),
    (
        "clocks",
        "equal",
        "of UAV 1 and 2, ±0.02 s; messages extrapolated from their stamps",
        (
            "network.clocks={uav1: {offset_s: 0.02}, uav2: {offset_s: -0.02}}",
            "controller.extrapolate_from=timestamp",
        ),
    ),
    (
        "state estimates",
        "exact",
        "GPS/INS noise",
        ("leader.sensors=gps-ins", "fleet.*.sensors=gps-ins"),
    ),
    ("airframe", "our Rascal 110", "Skywalker X8", (*X8, "formation.speed_pole_per_s=0.4")),
    ("wind", "none (printed)", "4 m/s", ("air.wind.speed_mps=4", "air.wind.from_deg=45")),
)


def case(number: int, overrides: tuple[str, ...]) -> Case:
    """Return a simulation with one choice changed."""
    return Case(f"simulation-{number}", overrides)


def smaller(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return a list of the choices that make the errors of Simulation 3 smaller, largest first."""
    plain = np.array(means(flown[case(3, ())]))
    freedom, choice, found = "", "", []
    for name, here, other, overrides in FREEDOMS:
        freedom, choice = (name, here) if name else (freedom, choice)
        laps, circle = np.array(means(flown[case(3, overrides)])) / plain
        if PRINTED not in choice and max(laps, circle) >= SMALLER:
            lost = mark(flown[case(3, overrides)])
            line = f"- {freedom} ({choice}) against {other}: {laps:.1f}{lost}, {circle:.1f}{lost}"
            found.append((laps * circle, line))
    yield (
        "Simulation 3's errors with the other choice, divided by those here, on laps and on the "
        f"circle, where one of them is at least {SMALLER:g}:"
    )
    yield ""
    yield from (line for _, line in sorted(found, reverse=True))


def means(metrics: Metrics) -> list[float]:
    """Return the mean RMS errors on laps and circle as printed, m."""
    return [round(window["mean_rms_m"], 2) for window in metrics["windows"].values()]


def text(flown: Mapping[Case, Metrics]) -> list[str]:
    """Return the table and the list as Markdown lines."""

    def lines() -> Iterator[str]:
        heads = [f"{number}: {window}" for number in SIMULATIONS for window in ("laps", "circle")]
        yield row("left open", "here", "instead", *heads, "lowest κ, m/s")
        yield "|---|---|---|" + "--:|" * (len(heads) + 1)
        for freedom, here, other, overrides in FREEDOMS:
            flights = [flown[case(number, overrides)] for number in SIMULATIONS]
            cells = [f"{mean:.2f}{mark(flight)}" for flight in flights for mean in means(flight)]
            kappa = min(flights[-1]["kappa_mps"].values())
            yield row(freedom, here, other, *cells, f"{kappa:.2f}")

    heading = "### Which of these make our errors smaller"
    notes = f"Seed 1; {versions(flown)}."
    return [*lines(), "", MARKS_TEXT, "", heading, "", *smaller(flown), "", notes]


INPUTS = {
    MARK: Inputs(
        tuple(case(number, overrides) for *_, overrides in FREEDOMS for number in SIMULATIONS)
    )
}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, {MARK: text})
