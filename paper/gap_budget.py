"""Write tables and figures of gap.md: errors of the experiments, and the share of each factor.

usage: make gap  (ARGS="--only table-2 --jobs N")

Flies the studies `joint-fit`, `as-flown`, `turn-direction` and `gap-budget-0` to `-3`, each into a
Parquet file, and resumes an interrupted call.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import joint_fit
import numpy as np
from inputs import Inputs
from study_rows import Rows, fly, fly_rows, write_tables
from tables import draw, row

from testbed.core.records import Array
from testbed.scenario import Scenario, library, load_scenario
from testbed.views.panels import BLUE, GREY, ORANGE, Line, Panel, PanelGrid

FIGURE = Path(__file__).parent / "images" / "gap-budget.png"
RESULTS = Path("logs") / "studies" / "gap"
TABLE_2, REFERENCE, MIRRORED = "as-flown", "gap-budget-0", "turn-direction"
BUDGETS = {1: "circles", 2: "rectangles", 3: "rectangles"}
TOLERANCE = 0.25  # of the paper's number
FEW = 5  # seeds of the study of the other direction of turns
FACTORS = {
    "offsets": "larger offsets",
    "attitude": "slower attitude",
    "gains": "middle loop",
    "battery": "battery",
    "air": "wind, turbulence",
    "rates": "10 Hz",
    "radio": "loss, delay",
    "estimator": "estimator",
    "power": "power ceiling",
    "temperature": "temperature",
    "companion": "companion",
}
AIRFRAMES = {"rascal110": "four Rascals", "skywalker_x8": "four X8s"}
IDEAL, FLOWN = "ideal", "as-flown"
# ways to measure a factor, in the order of `shares`: legend, colour, marker, row above or below
ENDS = (
    ("added to the ideal flight, alone", BLUE, "o", 0.14),
    ("removed from the flight as flown, alone", ORANGE, "s", -0.14),
)

Studies = Mapping[str, Rows]


def flown_studies(folder: Path, jobs: int, names: Sequence[str]) -> tuple[Studies, str]:
    """Return the rows of studies, and the versions they were flown with."""
    each = {name: fly(name, folder / f"{name}.parquet", jobs) for name in names}
    return {name: rows for name, (rows, _) in each.items()}, each[names[0]][1]


def seeds(rows: Rows) -> tuple[int, ...]:
    """Return the seeds that every case was flown with."""
    cases = {case for case, _ in rows}
    drawn = sorted({seed for _, seed in rows})
    return tuple(seed for seed in drawn if all((case, seed) in rows for case in cases))


def of_seeds(rows: Rows, case: str, key: str, most: int | None = None) -> list[float]:
    """Return one number of a case, by seed; of the first `most` seeds."""
    return [rows[case, seed][key] for seed in seeds(rows)[:most]]


def load_flown(name: str) -> Scenario:
    """Return an experiment with the conditions of its flight."""
    return load_scenario(library() / "scenarios/studies/gap-budget" / f"{name}-as-flown.yaml")


def title(name: str) -> str:
    """Return the experiment of a case as text."""
    return name.replace("experiment-", "Experiment ")


def paper_table(rows: Rows) -> Iterator[str]:
    """Return the rows of the paper's Table 2 beside ours."""
    yield "| | window | follower | [HBH23], m | testbed, m | ratio | estimated, m |"
    yield "|---|---|---|--:|--:|--:|--:|"
    for name in dict.fromkeys(case for case, _ in rows):
        scenario = load_flown(name)
        published = scenario.scenario.published
        assert published is not None
        for window, printed in published.rms_m.items():
            for follower, paper in zip(scenario.fleet, printed, strict=True):
                key = f"windows.{window}.{{}}.{follower.name}"
                true = of_seeds(rows, name, key.format("rms_m"))
                estimated = of_seeds(rows, name, key.format("estimated_rms_m"))
                middle = statistics.median(true)
                ratio = f"{100.0 * middle / paper:.0f} %"
                if abs(middle / paper - 1.0) > TOLERANCE:
                    ratio += " (outside)"
                yield row(
                    title(name),
                    window,
                    follower.name,
                    f"{paper:g}",
                    f"{middle:.1f} ({min(true):.1f}–{max(true):.1f})",
                    ratio,
                    f"{statistics.median(estimated):.1f}",
                )


def percent_table(rows: Rows) -> Iterator[str]:
    """Return the rows of the percent errors of the paper's Table 2 beside ours."""
    yield "| error, % | window | [HBH23] | testbed |"
    yield "|---|---|--:|--:|"
    for name in dict.fromkeys(case for case, _ in rows):
        published = load_flown(name).scenario.published
        assert published is not None
        for window, printed in published.percent_error.items():
            flown = of_seeds(rows, name, f"windows.{window}.percent_error")
            middle = f"{statistics.median(flown):.0f} ({min(flown):.0f}–{max(flown):.0f})"
            yield row(title(name), window, f"{printed:g}", middle)


def limits_table(rows: Rows) -> Iterator[str]:
    """Return the rows of the time at limits of the commands, and of the slots' speeds."""
    yield (
        "| | follower | at a limit, % of the time | pitch | roll | throttle | slot moves at, m/s "
        "| bounds S, m/s |"
    )
    yield "|---|---|--:|--:|--:|--:|---|---|"
    for name in dict.fromkeys(case for case, _ in rows):
        scenario = load_flown(name)
        samples = scenario.rates.log_hz * scenario.scenario.duration_s
        for follower in scenario.fleet:
            head = f"saturations.{follower.name}"
            seconds = of_seeds(rows, name, f"{head}.seconds")
            shares = [100.0 * value / scenario.scenario.duration_s for value in seconds]
            counts = [
                statistics.median(of_seeds(rows, name, f"{head}.by_kind.{kind}"))
                for kind in ("pitch", "roll", "throttle")
            ]
            speed = f"slot_speed_mps.{follower.name}"
            low, high = (of_seeds(rows, name, f"{speed}.{end}") for end in (0, 1))
            bounds = "–".join(f"{value:g}" for value in scenario.formation.speed_mps)
            yield row(
                title(name),
                follower.name,
                f"{statistics.median(shares):.0f} ({min(shares):.0f}–{max(shares):.0f})",
                *(f"{100.0 * count / samples:.0f}" for count in counts),
                f"{min(low):.1f}–{max(high):.1f}",
                bounds,
            )


def directions_table(studies: Studies) -> Iterator[str]:
    """Return the rows of the followers' errors by the direction of the leader's turns."""
    yield "| RMS error, m | follower | [HBH23] | clockwise | anticlockwise |"
    yield "|---|---|--:|--:|--:|"
    for name in dict.fromkeys(case for case, _ in studies[MIRRORED]):
        scenario = load_flown(name)
        published = scenario.scenario.published
        assert published is not None
        for follower, paper in zip(scenario.fleet, published.rms_m["rectangles"], strict=True):
            key = f"windows.rectangles.rms_m.{follower.name}"
            cells = []
            for study in (TABLE_2, MIRRORED):
                flown = of_seeds(studies[study], name, key, FEW)
                cells.append(f"{statistics.median(flown):.1f} ({min(flown):.1f}–{max(flown):.1f})")
            yield row(title(name), follower.name, f"{paper:g}", *cells)


def order_sentence(rows: Rows) -> str:
    """Return a sentence on the order of the followers of Experiment 3."""
    scenario = load_flown("experiment-3")
    published = scenario.scenario.published
    assert published is not None
    names = [follower.name for follower in scenario.fleet]
    printed = dict(zip(names, published.rms_m["rectangles"], strict=True))
    flown = {
        name: statistics.median(of_seeds(rows, "experiment-3", f"windows.rectangles.rms_m.{name}"))
        for name in names
    }
    paper, here = (sorted(each, key=each.__getitem__) for each in (printed, flown))
    order = "the paper's order" if paper == here else "another order than the paper's"
    of_paper = ", ".join(f"{name} {printed[name]:g}" for name in names)
    of_flown = ", ".join(f"{name} {flown[name]:.1f}" for name in names)
    return (
        f"Experiment 3's followers come out in {order}: {of_flown} m here (medians), {of_paper} m "
        "there."
    )


def comparison_sentence(rows: Rows) -> str:
    """Return a sentence that compares Experiments 2 and 3."""
    names = ("experiment-2", "experiment-3")
    two, three = (np.array(of_seeds(rows, name, "windows.rectangles.mean_rms_m")) for name in names)
    printed = []
    for name in names:
        published = load_flown(name).scenario.published
        assert published is not None
        printed.append(statistics.mean(published.rms_m["rectangles"]))
    smaller = int((three < two).sum())
    return (
        f"Mean over the followers, median of {len(two)} seeds: Experiment 2 "
        f"{np.median(two):.1f} m, Experiment 3 {np.median(three):.1f} m "
        f"(the paper: {printed[0]:.1f} and {printed[1]:.1f} m); with {smaller} of the {len(two)} "
        "seeds Experiment 3 has the smaller error."
    )


def mean_squares(rows: Rows, window: str) -> dict[str, Array]:
    """Return the mean of the followers' squared errors, by case, one per seed, m²."""
    head = f"windows.{window}.rms_m."
    return {
        case: np.array(
            [
                np.mean([v * v for key, v in rows[case, seed].items() if key.startswith(head)])
                for seed in seeds(rows)
            ]
        )
        for case in dict.fromkeys(case for case, _ in rows)
    }


def shares(squares: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
    """Return each factor's share of the gap in mean square: switched on alone, off alone."""
    gap = squares[FLOWN] - squares[IDEAL]
    return {
        factor: (
            (squares[f"with-{factor}"] - squares[IDEAL]) / gap,
            (squares[FLOWN] - squares[f"without-{factor}"]) / gap,
        )
        for factor in FACTORS
    }


def rms(squares: Array) -> str:
    """Return the root of the mean over all seeds as text, m."""
    return f"{np.sqrt(squares.mean()):.2f}"


def percent(share: Array) -> str:
    """Return a share with its standard deviation over the seeds as text, %."""
    spread = f" ± {100.0 * share.std(ddof=1):z.0f}" if len(share) > 1 else ""
    return f"{100.0 * share.mean():z.0f}{spread}"


def airframe_table(rows: Rows) -> Iterator[str]:
    """Return the rows of Simulation 3 by its airframe, roots of mean squares over the followers."""
    yield "| RMS error of the followers, m | rectangles | circle |"
    yield "|---|--:|--:|"
    each = [mean_squares(rows, window) for window in ("rectangles", "circles")]
    for case, name in AIRFRAMES.items():
        yield row(f"Simulation 3 with {name}", *(rms(squares[case]) for squares in each))


def steps_table(studies: Studies) -> Iterator[str]:
    """Return the rows of errors from the ideal flight to the flown one, m."""
    yield "| RMS error, m | Experiment 1, circle | Experiment 2 | Experiment 3 |"
    yield "|---|--:|--:|--:|"
    squares = [mean_squares(studies[f"gap-budget-{n}"], window) for n, window in BUDGETS.items()]
    yield row("ideal", *(rms(each[IDEAL]) for each in squares))
    for factor, name in FACTORS.items():
        yield row(f"ideal, with {name}", *(rms(each[f"with-{factor}"]) for each in squares))
    yield row("as flown", *(rms(each[FLOWN]) for each in squares))
    for factor, name in FACTORS.items():
        yield row(
            f"as flown, without {name}", *(rms(each[f"without-{factor}"]) for each in squares)
        )


def shares_table(studies: Studies) -> Iterator[str]:
    """Return the rows of each factor's share of the gap, %."""
    yield "| share of the gap, % | 1: alone | last | 2: alone | last | 3: alone | last | middle |"
    yield "|---|" + "--:|" * 7
    each = [
        shares(mean_squares(studies[f"gap-budget-{n}"], window)) for n, window in BUDGETS.items()
    ]
    sums = np.zeros(7)
    for factor, name in FACTORS.items():
        ends = [end for one in each for end in one[factor]]
        middle = np.mean([end.mean() for end in ends])
        sums += [*(end.mean() for end in ends), middle]
        yield row(name, *map(percent, ends), f"{100.0 * middle:z.0f}")
    yield row("sum", *(f"{100.0 * each:z.0f}" for each in sums))


def figure(studies: Studies) -> PanelGrid:
    """Return the figure: the share of each factor by experiment, added alone and removed alone."""
    found = {
        number: shares(mean_squares(studies[f"gap-budget-{number}"], window))
        for number, window in BUDGETS.items()
    }
    # the largest at the top
    order = sorted(FACTORS, key=lambda each: -np.mean([one[each] for one in found.values()]))
    rows = {factor: -float(k) for k, factor in enumerate(order)}
    drawn = 100.0 * np.concatenate(
        [end for one in found.values() for e in one.values() for end in e]
    )
    limits = (float(drawn.min()) - 4.0, float(drawn.max()) + 4.0)
    panels = []
    for number, each in found.items():
        lines = [Line(np.zeros(2), np.array([0.5, 0.5 - len(rows)]), GREY)]
        for end, (label, colour, marker, shift) in enumerate(ENDS):
            values = [100.0 * each[factor][end] for factor in rows]
            at = np.array([*rows.values()]) + shift
            ranges = zip(values, at, strict=True)
            lines += [
                Line(np.array([np.min(v), np.max(v)]), np.full(2, y), colour, width=2.2)
                for v, y in ranges
            ]
            means = np.array([np.mean(v) for v in values])
            lines.append(Line(means, at, colour, label, dots=True, marker=marker))
        names = [(at, FACTORS[factor]) for factor, at in rows.items()]
        panels.append(
            Panel(
                f"Experiment {number}, {BUDGETS[number]}", "share of the gap, %", "", lines,
                y_ticks=names, x_limits=limits, y_limits=(0.5 - len(rows), 0.5),
            )
        )  # fmt: skip
    return PanelGrid(
        "Why flight is worse than simulation",
        "Share of the mean square error that is in the flight as flown and not in the ideal one; "
        "marker: mean of the seeds, line: their range",
        [panels],
        [1.0] * len(panels),
        (15.0, 5.0),
    )


def joint_fit_text(folder: Path, jobs: int) -> str:
    """Return the tables of the joint fit as text, and draw its figure."""
    rows, versions = fly_rows(joint_fit.STUDY, folder / f"{joint_fit.STUDY}.parquet", jobs)
    flown = {f"experiment-{number}": load_flown(f"experiment-{number}") for number in BUDGETS}
    first = flown["experiment-1"]
    chosen = np.array(
        [
            first.network.delay_s,
            first.controller.companion.state_latency_s,
            first.air.turbulence.w20_mps,
            first.fleet[0].battery.state_of_charge,
        ]
    )
    found = joint_fit.fit(joint_fit.table_2(flown), rows)
    text = joint_fit.text(found, chosen, 100.0 * TOLERANCE)
    return f"{text}\n\nJoint fit flown with {versions}."


def table_2_text(folder: Path, jobs: int) -> str:
    """Return the tables of the experiments as flown as text."""
    studies, versions = flown_studies(folder, jobs, [TABLE_2])
    rows = studies[TABLE_2]
    drawn = seeds(rows)
    return "\n".join(
        [
            *paper_table(rows),
            "",
            f"Testbed: median of seeds {drawn[0]} to {drawn[-1]}, and their range. "
            f"{comparison_sentence(rows)} {order_sentence(rows)}",
            "",
            *percent_table(rows),
            "",
            *limits_table(rows),
            "",
            "Medians and ranges of the same seeds; extremes of the slots' speeds.",
            "",
            f"Table 2 flown with {versions}.",
        ]
    )


def directions_text(folder: Path, jobs: int) -> str:
    """Return the table of the direction of turns as text."""
    studies, versions = flown_studies(folder, jobs, [TABLE_2, MIRRORED])
    notes = (
        f"Medians and ranges of the first {FEW} seeds. Direction of turns flown with {versions}."
    )
    return "\n".join([*directions_table(studies), "", notes])


def airframe_text(folder: Path, jobs: int) -> str:
    """Return the table of Simulation 3 with two airframes as text."""
    studies, versions = flown_studies(folder, jobs, [REFERENCE])
    notes = f"Roots of mean squares over the followers. Airframes flown with {versions}."
    return "\n".join([*airframe_table(studies[REFERENCE]), "", notes])


def budget_text(folder: Path, jobs: int) -> str:
    """Return the tables of the budget as text, and draw its figure."""
    flown = [f"gap-budget-{number}" for number in BUDGETS]
    studies, versions = flown_studies(folder, jobs, flown)
    draw(figure(studies), FIGURE)
    drawn = sorted({seed for n in BUDGETS for seed in seeds(studies[f"gap-budget-{n}"])})
    names = f"seeds {drawn[0]} to {drawn[-1]}" if len(drawn) > 1 else f"seed {drawn[0]}"
    spread = "Mean and standard deviation over the seeds." if len(drawn) > 1 else f"S{names[1:]}."
    return "\n".join(
        [
            *steps_table(studies),
            "",
            f"Roots of mean squares over the followers; {names}.",
            "",
            *shares_table(studies),
            "",
            spread,
            "",
            "![Shares of the gap by factor](images/gap-budget.png)",
            "",
            f"Budget flown with {versions}.",
        ]
    )


PARTS = {
    "make gap, joint-fit": joint_fit_text,
    "make gap, table-2": table_2_text,
    "make gap, turn-direction": directions_text,
    "make gap, airframe": airframe_text,
    "make gap, budget": budget_text,
}
BUDGET_STUDIES = tuple(f"gap-budget-{number}" for number in BUDGETS)
INPUTS = {
    "make gap, joint-fit": Inputs(studies=(joint_fit.STUDY,)),
    "make gap, table-2": Inputs(studies=(TABLE_2,)),
    "make gap, turn-direction": Inputs(studies=(TABLE_2, MIRRORED)),
    "make gap, airframe": Inputs(studies=(REFERENCE,)),
    "make gap, budget": Inputs(studies=BUDGET_STUDIES),
}

if __name__ == "__main__":
    write_tables(__doc__ or "", RESULTS, INPUTS, PARTS)
