"""How close aircraft come with the separation filter: the table of docs/formation.md.

    python benchmarks/separation.py [--count 10000]

Encounters of tests/formation/theorems: COUNT of ideal aircraft in each row, a tenth of them of five
at once and of Rascals.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "formation" / "theorems"))
from separation_encounters import CROSSINGS, SLOT_CHANGES, encounters  # noqa: E402
from test_separation import LATE, LATE_MESSAGES, SEPARATION_M, fly_rascals  # noqa: E402

LAG = {"lag": 0.4}
ALL = {**LATE, "wind": 8.0}
Row = tuple[str, int, int, dict[str, float]]
IDEAL: tuple[Row, ...] = (  # what meets, how many aircraft, and conditions
    ("two change slots", SLOT_CHANGES, 2, {}),
    ("the same, late", SLOT_CHANGES, 2, LATE),
    ("the same, late, wind of 8 m/s", SLOT_CHANGES, 2, ALL),
    ("the same, one of two filtered, roll lag", SLOT_CHANGES, 2, {**LAG, "filtered": 1}),
    ("the same, rate 1 1/s without margin", SLOT_CHANGES, 2, {"rate": 1.0, "margin_m": 0.0}),
    ("the same, without filter", SLOT_CHANGES, 2, {"filtered": 0}),
    ("two cross without a leader", CROSSINGS, 2, {}),
    ("the same, late", CROSSINGS, 2, LATE),
    ("the same, late, wind of 8 m/s", CROSSINGS, 2, ALL),
    ("the same, late, at climb angles up to 8.6°", CROSSINGS, 2, {**LATE, "vertical": 0.15}),
    ("the same, without filter", CROSSINGS, 2, {"filtered": 0}),
    ("five change slots at once", SLOT_CHANGES, 5, {}),
    ("the same, late", SLOT_CHANGES, 5, LATE),
)
RASCALS = (
    ("two Rascals change slots before and in a corner", 2, ()),
    ("the same, late", 2, LATE_MESSAGES),
    ("the same, late, margin 2 m", 2, (*LATE_MESSAGES, "controller.safety.margin_m=2")),
    ("the same, without filter", 2, ("controller.safety=null",)),
    ("three Rascals, late", 3, LATE_MESSAGES),
)


def rows(count: int) -> Iterator[str]:
    """Yield the lines of the table as they are flown."""
    below = f"below {SEPARATION_M:g} m"
    yield f"| encounters | flights | {below} | closest, m | not in slot after 90 s |"
    yield "|---|--:|--:|--:|--:|"
    for name, kind, n, conditions in IDEAL:
        flights = count if n == 2 else count // 10
        closest, away = encounters(flights, kind, n, **conditions)
        yield _line(name, closest, str((away > 5.0).sum()))
    for name, followers, settings in RASCALS:
        among, behind = fly_rascals(count // 10, followers, settings)
        yield _line(name, np.minimum(among, behind), "")


def _line(name: str, closest: np.ndarray, away: str) -> str:
    below = (closest < SEPARATION_M).sum()
    return f"| {name} | {len(closest):,} | {below:,} | {closest.min():.2f} | {away} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000)
    for line in rows(parser.parse_args().count):
        print(line, flush=True)


if __name__ == "__main__":
    main()
