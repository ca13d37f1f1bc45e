"""What is read of N flight models and set in them, in SI units and the testbed's signs.

Feet, revolutions per minute and JSBSim's signs (elevator positive nose down, rudder positive nose
left) stop here and in `jsbsim_model`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from testbed.compiled import ready_of
from testbed.frames import FOOT
from testbed.state import AirData, AirFelt, Array, Surfaces
from testbed.vehicle.jsbsim_model import JsbsimModel
from testbed.vehicle.motion import motion
from testbed.vehicle.properties import Nodes, read, write

# Three numbers per aircraft each, and one each.
MOTION = (
    ("position/lat-geod-rad", "position/long-gc-rad", "position/geod-alt-ft"),
    ("velocities/v-north-fps", "velocities/v-east-fps", "velocities/v-down-fps"),
    ("accelerations/udot-ft_sec2", "accelerations/vdot-ft_sec2", "accelerations/wdot-ft_sec2"),
    ("attitude/phi-rad", "attitude/theta-rad", "attitude/psi-rad"),
    ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec"),
)
SPEEDS = ("velocities/vt-fps", "velocities/ve-fps")
WIND = tuple(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down"))
FLOW = ("aero/alpha-rad", "aero/beta-rad", "propulsion/engine/propeller-rpm")
# One each, of those that have a battery.
BATTERY = ("battery/state-of-charge", "battery/voltage-v")


def nodes_of(
    models: Sequence[JsbsimModel], triples: Sequence[Sequence[str]], singles: Sequence[str]
) -> list[Any]:
    """Properties of N aircraft: three of each, and again, then one of each, and again."""
    named = [model.node(name) for names in triples for model in models for name in names]
    return named + [model.node(name) for name in singles for model in models]


def numbers_of(
    i: int, aircraft: int, triples: Sequence[Sequence[str]], singles: Sequence[str]
) -> list[int]:
    """Which of `nodes_of` are those of aircraft i."""
    vectors = [3 * (aircraft * row + i) + axis for row in range(len(triples)) for axis in range(3)]
    first = 3 * aircraft * len(triples)
    return vectors + [first + aircraft * row + i for row in range(len(singles))]


def look(nodes: Nodes, raw: Array, zero: Array, scale: Array, flat: Array) -> None:
    """Read the motion.

    Args:
        nodes: (17 N,) MOTION, SPEEDS.
        raw: (17 N,) what they say.
        zero: (17 N,) as `motion` has it, and scale.
        scale: (17 N,)
        flat: (17 N,) becomes the numbers of `state_of`.
    """
    read(nodes, raw)
    motion(raw, zero, scale, flat)


def sense_air(nodes: Nodes, raw: Array, felt: AirFelt, air: AirData) -> None:
    """Read the air, and what batteries say.

    Args:
        nodes: (8 N,) WIND, FLOW, BATTERY.
        raw: (8 N,) what they say.
        felt: (N) what they were told last.
        air: (N) becomes what the air does.
    """
    read(nodes, raw)
    n = len(felt.wind_ned)
    air.wind_ned[:] = raw[: 3 * n].reshape(n, 3) * FOOT
    air.alpha[:], air.beta[:], rpm, *battery = raw[3 * n :].reshape(5, n)
    air.state_of_charge[:], air.battery_voltage[:] = battery
    air.propeller_rps[:] = rpm / 60.0
    air.rates_body[:], air.roll_coefficient[:] = felt.rates_body, felt.roll_coefficient


def blow(nodes: Nodes, felt: AirFelt, told: Array) -> None:
    """Say what the air does.

    Args:
        nodes: (7 N,) of each aircraft the wind's north, east and down, its turns about the body's
            axes, and what it adds to the rolling moment.
        felt: (N)
        told: (7 N,) becomes what they are told.
    """
    each = told.reshape(-1, 7)
    each[:, :3], each[:, 3:6] = felt.wind_ned / FOOT, felt.rates_body
    each[:, 6] = felt.roll_coefficient
    write(nodes, told)


def command(nodes: Nodes, surfaces: Surfaces, told: Array) -> None:
    """Say where the surfaces and throttles are to be.

    Args:
        nodes: (4 N,) ailerons of all, elevators, rudders, throttles.
        surfaces: (N)
        told: (4 N,) becomes what they are told.
    """
    each = told.reshape(4, -1)
    each[0], each[1] = surfaces.aileron, -surfaces.elevator
    each[2], each[3] = -surfaces.rudder, surfaces.throttle
    write(nodes, told)


READY_LOOK = ready_of(look, "testbed.vehicle.instruments_twin")
READY_SENSE_AIR = ready_of(sense_air, "testbed.vehicle.instruments_twin")
READY_BLOW = ready_of(blow, "testbed.vehicle.instruments_twin")
READY_COMMAND = ready_of(command, "testbed.vehicle.instruments_twin")
