"""Write small tables of docs/own-law.md and docs/large.md: repulsion, and gains in a vee of thirty.

usage: make results  (ARGS="--jobs N")
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from inputs import Case, Inputs
from tables import COMMAND, Metrics, row, write_tables

from testbed.scenario import load_scenario

REPULSION, VEE = "own-law-repulsion", "vee-30"
NO_COLLISION = "limits.collision_m=null"
OPTIONS = load_scenario(REPULSION).controller.options
GAINS = tuple(sorted({1, 2, 4, 8, OPTIONS["gain"]}))
REPELLED = {
    "the paper's": Case(REPULSION, (NO_COLLISION, "controller.law=hbh23", "controller.options={}"))
} | {
    f"gain {gain:g}" + ", as in the scenario" * (gain == OPTIONS["gain"]): Case(
        REPULSION, (NO_COLLISION, f"controller.options.gain={gain}")
    )
    for gain in GAINS
}
IDEAL = "fleet.vehicle=unicycle"
AHEAD = (IDEAL, "fleet.leader_gain=0", "formation.leader_gains={uav1: 1, uav2: 1}")
VEES = {
    "every follower with a leader gain": (Case(VEE, (IDEAL,)), ""),
    "`leader_gain: 0`, `neighbours_from: ahead`": (
        Case(VEE, (*AHEAD, "fleet.neighbours_from=ahead")),
        "",
    ),
    "the same with `neighbours: 1`": (
        Case(VEE, (*AHEAD, "fleet.neighbours_from=ahead", "fleet.neighbours=1")),
        "",
    ),
    "`leader_gain: 0`, `neighbours_from: all`": (
        Case(VEE, (*AHEAD, "fleet.neighbours_from=all")),
        ": the leader's position spreads through the graph as by diffusion, in a time that grows "
        "with the square of the length",
    ),
}
LAST_RANK = ("uav29", "uav30")


def repulsion_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of the paper's law and of repulsion."""
    yield row("law", "closest", "error afterwards")
    yield "|---|--:|--:|"
    first = f"repulsion, radius {OPTIONS['radius_m']:g} m, "
    for label, case in REPELLED.items():
        closest = flown[case]["min_separation_m"]
        error = flown[case]["windows"]["afterwards"]["mean_rms_m"]
        yield row(
            first + label if label == "gain 1" else label, f"{closest:.2f} m", f"{error:.3f} m"
        )


def vee_table(flown: Mapping[Case, Metrics]) -> Iterator[str]:
    """Return the rows of the last rank of a vee by its gains."""
    yield row("setting", "RMS")
    yield "|---|--:|"
    for label, (case, more) in VEES.items():
        errors = flown[case]["windows"]["turning"]["rms_m"]
        error = float(np.sqrt(np.mean([errors[name] ** 2 for name in LAST_RANK])))
        yield row(label, f"{error:.{1 if error < 10.0 else 0}f} m{more}")


INPUTS = {
    f"{COMMAND}, repulsion": Inputs(tuple(REPELLED.values())),
    f"{COMMAND}, vee": Inputs(tuple(case for case, _ in VEES.values())),
}
TEXTS = {
    f"{COMMAND}, repulsion": lambda flown: list(repulsion_table(flown)),
    f"{COMMAND}, vee": lambda flown: list(vee_table(flown)),
}

if __name__ == "__main__":
    write_tables(__doc__ or "", INPUTS, TEXTS)
