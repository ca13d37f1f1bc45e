"""What is read of N flight models and set in them, in SI units and the testbed's signs.

Feet, revolutions per minute and JSBSim's signs (elevator positive nose down, rudder positive nose
left) stop here and in `jsbsim_model`.
"""

from __future__ import annotations

from testbed.compiled import ready_of
from testbed.frames import FOOT
from testbed.state import AirData, AirFelt, Array, Surfaces, Truths
from testbed.vehicle.motion import motion
from testbed.vehicle.properties import Nodes, read, write

# Of each aircraft, in the order of the fields of `VehicleState`.
MOTION = (
    *(f"position/{each}" for each in ("lat-geod-rad", "long-gc-rad", "geod-alt-ft")),
    *(f"velocities/v-{axis}-fps" for axis in ("north", "east", "down")),
    *(f"accelerations/{each}-ft_sec2" for each in ("udot", "vdot", "wdot")),
    *(f"attitude/{angle}-rad" for angle in ("phi", "theta", "psi")),
    *(f"velocities/{rate}-rad_sec" for rate in ("p", "q", "r")),
    *("velocities/vt-fps", "velocities/ve-fps"),
)
AIR = (
    *(f"atmosphere/total-wind-{axis}-fps" for axis in ("north", "east", "down")),
    *("aero/alpha-rad", "aero/beta-rad", "propulsion/engine/propeller-rpm"),
)
# Of those that have a battery.
BATTERY = ("battery/state-of-charge", "battery/voltage-v")


def note(nodes: Nodes, numbers: Array, notes: Array, row: int, leg: int) -> None:
    """Read the motion of one aircraft, and write it down.

    Args:
        nodes: (17,) MOTION
        numbers: (17,) what they say.
        notes: (legs, N, 17) where it is written down.
        row: of the aircraft.
        leg: after which.
    """
    read(nodes, numbers)
    notes[leg, row] = numbers


def look(notes: Array, wanted: Truths, zero: Array, scale: Array, flat: Array, leg: int) -> None:
    """Write the motion after a leg, of those whose is wanted; the others' stays.

    Args:
        notes: (legs, N, 17) what was written down.
        wanted: (legs, N)
        zero: (17,) as `motion` has it, and scale.
        scale: (17,)
        flat: (17 N,) becomes the numbers of `state_of`.
        leg: after which.
    """
    motion(notes[leg], wanted[leg], zero, scale, flat)


def sense_air(nodes: Nodes, raw: Array, felt: AirFelt, air: AirData) -> None:
    """Read the air, and what batteries say.

    Args:
        nodes: (8 N,) of each aircraft AIR, BATTERY.
        raw: (8 N,) what they say.
        felt: (N) what they were told last.
        air: (N) becomes what the air does.
    """
    read(nodes, raw)
    each = raw.reshape(-1, len(AIR) + len(BATTERY))
    air.wind_ned[:] = each[:, :3] * FOOT
    air.alpha[:], air.beta[:], rpm, *battery = each[:, 3:].T
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
        nodes: (4 N,) of each aircraft the aileron, elevator, rudder and throttle.
        surfaces: (N)
        told: (4 N,) becomes what they are told.
    """
    each = told.reshape(-1, 4)
    each[:, 0], each[:, 1] = surfaces.aileron, -surfaces.elevator
    each[:, 2], each[:, 3] = -surfaces.rudder, surfaces.throttle
    write(nodes, told)


READY_NOTE = ready_of(note, "testbed.vehicle.instruments_twin")
READY_LOOK = ready_of(look, "testbed.vehicle.instruments_twin")
READY_SENSE_AIR = ready_of(sense_air, "testbed.vehicle.instruments_twin")
READY_BLOW = ready_of(blow, "testbed.vehicle.instruments_twin")
READY_COMMAND = ready_of(command, "testbed.vehicle.instruments_twin")
