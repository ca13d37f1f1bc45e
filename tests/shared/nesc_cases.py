"""NASA's check cases for six-degree-of-freedom simulations, flown by JSBSim as the product sets it.

NESC-RP-12-00770, NASA/TM-2015-218675; tests/data/ORIGIN.md has the origin of the figures.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from places import TESTS

from testbed.vehicle.environment import INTEGRATORS, Integrators, set_environment
from testbed.vehicle.jsbsim_adapter import load_executive

DATA = TESTS / "data" / "nesc"
DURATION_S, EVERY_S = 30, 5
KNOT = 1852.0 / 0.3048 / 3600.0  # ft/s
OMEGA = 7.292115e-5  # rad/s, rotation of the Earth
ROLL, PITCH, YAW = (f"eulerAngle_deg_{name}" for name in ("Roll", "Pitch", "Yaw"))
ROLL_RATE, PITCH_RATE, YAW_RATE = (
    f"bodyAngularRateWrtEi_deg_s_{name}" for name in ("Roll", "Pitch", "Yaw")
)
# Property of JSBSim and unit, by quantity.
QUANTITIES = {
    "altitudeMsl_ft": ("position/geod-alt-ft", 1.0),
    "latitude_deg": ("position/lat-geod-deg", 1.0),
    "longitude_deg": ("position/long-gc-deg", 1.0),
    "feVelocity_ft_s_X": ("velocities/v-north-fps", 1.0),
    "feVelocity_ft_s_Y": ("velocities/v-east-fps", 1.0),
    "feVelocity_ft_s_Z": ("velocities/v-down-fps", 1.0),
    ROLL: ("attitude/phi-rad", math.radians(1.0)),
    PITCH: ("attitude/theta-rad", math.radians(1.0)),
    YAW: ("attitude/psi-rad", math.radians(1.0)),
    ROLL_RATE: ("velocities/pi-rad_sec", math.radians(1.0)),
    PITCH_RATE: ("velocities/qi-rad_sec", math.radians(1.0)),
    YAW_RATE: ("velocities/ri-rad_sec", math.radians(1.0)),
    "speedOfSound_ft_s": ("atmosphere/a-fps", 1.0),
    "airDensity_slug_ft3": ("atmosphere/rho-slugs_ft3", 1.0),
    "trueAirspeed_nmi_h": ("velocities/vt-fps", KNOT),
}
# Differences that are allowed where the tools agree more closely.
ROUNDING = 1e-9  # in the unit of the quantity: some print nine digits, some all
FLOORS = {
    # JSBSim's molar mass of air is 28.9645 g/mol, that of the US standard atmosphere 28.9644
    "speedOfSound_ft_s": 2e-6 * 1000.0,
    # and its pressure at sea level 2116.228 lbf/ft², 101325 Pa being 2116.2166
    "airDensity_slug_ft3": 1e-5 * 0.0024,
}


class Case(NamedTuple):
    """A check case: at the equator and the prime meridian, level, headed north.

    Attributes:
        model: folder of the JSBSim model.
        title: what happens.
        altitude_ft: at the start.
        velocity_fps: north, east, down, relative to the Earth.
        rates_deg_s: roll, pitch, yaw rate, relative to inertial space.
        coefficient: property of the model and its value.
        wind_fps: from the west, at the ground and at 30,000 ft; linear in altitude.
    """

    model: str
    title: str
    altitude_ft: float = 30_000.0
    velocity_fps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rates_deg_s: tuple[float, float, float] = (OMEGA / math.radians(1.0), 0.0, 0.0)
    coefficient: tuple[str, float] = ("case/drag-coefficient", 0.1)
    wind_fps: tuple[float, float] | None = None


_TUMBLING = (10.0, 20.0, 30.0)
CASES = {
    1: Case("sphere", "sphere without drag", coefficient=("case/drag-coefficient", 0.0)),
    2: Case(
        "brick",
        "tumbling brick",
        rates_deg_s=_TUMBLING,
        coefficient=("case/damping-coefficient", 0.0),
    ),
    3: Case(
        "brick",
        "tumbling brick with damping",
        rates_deg_s=_TUMBLING,
        coefficient=("case/damping-coefficient", -1.0),
    ),
    6: Case("sphere", "sphere with drag"),
    7: Case("sphere", "sphere in wind", wind_fps=(20.0, 20.0)),
    8: Case("sphere", "sphere in wind shear", wind_fps=(-20.0, 70.0)),
    9: Case("sphere", "cannonball to the east", 0.0, (0.0, 1000.0, -1000.0)),
    10: Case("sphere", "cannonball to the north", 0.0, (1000.0, 0.0, -1000.0)),
}


class Difference(NamedTuple):
    """A flown value minus the median of the tools, beside their spread."""

    quantity: str
    time_s: float
    value: float
    spread: float

    @property
    def outside(self) -> bool:
        """Whether the tools are closer to each other than the flown value is to their median."""
        return abs(self.value) > max(self.spread, FLOORS.get(self.quantity, ROUNDING))


@cache
def tools(number: int) -> Mapping[tuple[int, str], tuple[float, float]]:
    """Read median and spread of the tools in a case, by time in s and quantity."""
    with (DATA / "check_cases.csv").open(encoding="utf-8", newline="") as file:
        return {
            (int(row["time_s"]), row["quantity"]): (
                float(row["median"]),
                float(row["largest"]) - float(row["least"]),
            )
            for row in csv.DictReader(file)
            if int(row["case"]) == number
        }


def fly(
    number: int,
    rate_hz: int,
    integrators: Integrators = INTEGRATORS,
    changes: Mapping[str, float] | None = None,
    folder: Path = DATA,
) -> list[Difference]:
    """Fly a case, and compare every quantity that the tools give with them, every 5 s.

    Args:
        number: of the case.
        rate_hz: steps per second.
        integrators: of JSBSim.
        changes: properties to be set after the product's environment.
        folder: of the models.
    """
    case, compared = CASES[number], tools(number)
    fdm = load_executive(folder / case.model)
    fdm.set_dt(1.0 / rate_hz)
    set_environment(fdm, integrators)
    for name, value in (changes or {}).items():
        fdm[name] = value
    _place(fdm, case)
    differences = []
    for tick in range(DURATION_S * rate_hz + 1):
        time_s, rest = divmod(tick, rate_hz)
        if rest == 0 and time_s % EVERY_S == 0:
            differences += _compare(fdm, time_s, compared)
        _blow(fdm, case, 1.0 / rate_hz)
        fdm.run()
    assert len(differences) == len(compared)
    return differences


def _place(fdm: Any, case: Case) -> None:  # noqa: ANN401 - JSBSim's
    fdm[case.coefficient[0]] = case.coefficient[1]
    for name in ("long-gc-deg", "lat-geod-deg", "phi-deg", "theta-deg", "psi-true-deg"):
        fdm[f"ic/{name}"] = 0.0
    fdm["ic/h-sl-ft"] = case.altitude_ft
    for axis, speed in zip(("vn", "ve", "vd"), case.velocity_fps, strict=True):
        fdm[f"ic/{axis}-fps"] = speed
    # JSBSim's are relative to the Earth, which turns about the north.
    earth = (OMEGA, 0.0, 0.0)
    for axis, rate, turn in zip("pqr", case.rates_deg_s, earth, strict=True):
        fdm[f"ic/{axis}-rad_sec"] = math.radians(rate) - turn
    fdm.run_ic()
    _blow(fdm, case, 0.0)
    fdm.suspend_integration()
    fdm.run()  # the airspeed of the first row, with the wind
    fdm.resume_integration()


def _blow(fdm: Any, case: Case, ahead_s: float) -> None:  # noqa: ANN401
    """Set the wind at the altitude to be reached: it acts at the end of the next step."""
    if case.wind_fps is None:
        return
    ground, aloft = case.wind_fps
    altitude = fdm["position/geod-alt-ft"] - ahead_s * fdm["velocities/v-down-fps"]
    fdm["atmosphere/wind-east-fps"] = ground + (aloft - ground) * altitude / 30_000.0


def _compare(
    fdm: Any,  # noqa: ANN401
    time_s: int,
    compared: Mapping[tuple[int, str], tuple[float, float]],
) -> Iterator[Difference]:
    for quantity, (name, unit) in QUANTITIES.items():
        if (time_s, quantity) not in compared:
            continue
        median, spread = compared[time_s, quantity]
        value = fdm[name] / unit - median
        if quantity in (ROLL, PITCH, YAW):
            value = (value + 180.0) % 360.0 - 180.0
        yield Difference(quantity, time_s, value, spread)
