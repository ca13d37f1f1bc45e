"""Write the tables of docs/physics.md: NASA's check cases for simulations of flight.

usage: python benchmarks/nesc.py --into docs/physics.md
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from inputs import Inputs
from tables import add_output_arguments, publish, row

from testbed.scenario.sections import Rates
from testbed.vehicle.environment import (
    ADAMS_BASHFORTH_2,
    ADAMS_BASHFORTH_3,
    ADAMS_BASHFORTH_4,
    EULER,
    INTEGRATORS,
    JSBSIM_DEFAULT_INTEGRATORS,
)

sys.path.append(str(Path(__file__).parents[1] / "tests" / "shared"))
from nesc_cases import (  # noqa: E402
    CASES,
    PITCH,
    PITCH_RATE,
    ROLL,
    ROLL_RATE,
    ROUNDING,
    YAW,
    YAW_RATE,
    Difference,
    fly,
)

COMMAND = "python benchmarks/nesc.py"
INPUTS = {COMMAND: Inputs(packages=("jsbsim",))}  # JSBSim alone, by the tests
RATE_HZ = Rates().physics_hz
GROUPS = {"1, 6, 7, 8: falling spheres": (1, 6, 7, 8), "2, 3: tumbling bricks": (2, 3)}
GROUPS["9, 10: cannonballs"] = (9, 10)
NAMES = {
    "altitudeMsl_ft": "altitude, ft",
    "latitude_deg": "latitude, °",
    "longitude_deg": "longitude, °",
    "feVelocity_ft_s_X": "velocity north, ft/s",
    "feVelocity_ft_s_Y": "velocity east, ft/s",
    "feVelocity_ft_s_Z": "velocity down, ft/s",
    YAW: "yaw, °",
    PITCH: "pitch, °",
    ROLL: "roll, °",
    ROLL_RATE: "roll rate, °/s",
    PITCH_RATE: "pitch rate, °/s",
    YAW_RATE: "yaw rate, °/s",
    "speedOfSound_ft_s": "speed of sound, ft/s",
    "airDensity_slug_ft3": "density, slug/ft³",
    "trueAirspeed_nmi_h": "true airspeed, kn",
}
TUMBLING = (YAW, PITCH, ROLL, ROLL_RATE, PITCH_RATE, YAW_RATE)
ORDERS = {EULER: "1", ADAMS_BASHFORTH_2: "2", ADAMS_BASHFORTH_3: "3", ADAMS_BASHFORTH_4: "4"}
STATES = 4  # of the integrators; the last field is no order
HIGHER = INTEGRATORS._replace(
    rate_rotational=ADAMS_BASHFORTH_3, position_rotational=ADAMS_BASHFORTH_3
)


def cell(differences: Sequence[Difference], quantity: str) -> str:
    """Return the largest difference of a quantity, and the spread at that time, as text."""
    each = [one for one in differences if one.quantity == quantity]
    if not each:
        return ""
    largest = max(each, key=lambda one: abs(one.value))
    bold = "**" if any(one.outside for one in each) else ""
    if abs(largest.value) < ROUNDING:
        return "rounding"
    return f"{bold}{abs(largest.value):.2g}{bold} ({largest.spread:.2g})"


def cases_table() -> Iterator[str]:
    """Return the rows of the largest differences in all cases."""
    yield row("", *(f"cases {name}" for name in GROUPS))
    yield "|---|" + "--:|" * len(GROUPS)
    flown = [[each for n in numbers for each in fly(n, RATE_HZ)] for numbers in GROUPS.values()]
    for quantity, name in NAMES.items():
        yield row(name, *(cell(differences, quantity) for differences in flown))


def integrators_table() -> Iterator[str]:
    """Return the rows of the tumbling brick by integrators and rate."""
    yield row("case 2 by orders of the integrators", "Hz", *(NAMES[each] for each in TUMBLING))
    yield "|---|--:|" + "--:|" * len(TUMBLING)
    for name, integrators in (
        ("JSBSim's defaults", JSBSIM_DEFAULT_INTEGRATORS),
        ("the testbed's", INTEGRATORS),
        ("one order more for rates and attitude", HIGHER),
    ):
        orders = ", ".join(ORDERS[each] for each in integrators[:STATES])
        for rate_hz in (100, 200):
            flown = fly(2, rate_hz, integrators)
            cells = (cell(flown, quantity) for quantity in TUMBLING)
            yield row(f"{orders}: {name}", str(rate_hz), *cells)


def main() -> None:
    """Fly, print and insert the text."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    add_output_arguments(parser)
    options = parser.parse_args()
    text = "\n".join(
        [
            *cases_table(),
            "",
            f"At {RATE_HZ} Hz, {len(CASES)} cases, every 5 s to 30 s: the largest difference from "
            "the median tool, and in brackets how far the tools are apart at that time.",
            "",
            *integrators_table(),
            "",
            "Orders of body rates, velocity, attitude and position; bold: outside.",
        ]
    )
    sys.exit(0 if publish(options, {COMMAND: text}, INPUTS) else 1)


if __name__ == "__main__":
    main()
