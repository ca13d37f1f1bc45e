"""The compiled twins of `instruments`.

A test holds them to the functions there.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN002, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from testbed.compiled import bound, twin
from testbed.frames import FOOT
from testbed.vehicle.properties_twin import read, reading, setting, write
from testbed.vehicle.twin import motion


@twin
def note(getter, nodes, numbers, notes, row, leg):
    read(getter, nodes, numbers)
    for k in range(numbers.size):
        notes[leg, row, k] = numbers[k]


@twin
def look(notes, wanted, zero, scale, flat, leg):
    motion(notes[leg], wanted[leg], zero, scale, flat)


@twin
def sense_air(getter, nodes, raw, felt, air):
    read(getter, nodes, raw)
    n = air.alpha.size
    for i in range(n):
        at = 8 * i
        air.alpha[i], air.beta[i] = raw[at + 3], raw[at + 4]
        air.propeller_rps[i] = raw[at + 5] / 60.0
        air.state_of_charge[i], air.battery_voltage[i] = raw[at + 6], raw[at + 7]
        for axis in range(3):
            air.wind_ned[i, axis] = raw[at + axis] * FOOT
            air.rates_body[i, axis] = felt.rates_body[i, axis]
        air.roll_coefficient[i] = felt.roll_coefficient[i]


@twin
def blow(setter, nodes, felt, told):
    for i in range(len(felt.wind_ned)):
        for axis in range(3):
            told[7 * i + axis] = felt.wind_ned[i, axis] / FOOT
            told[7 * i + 3 + axis] = felt.rates_body[i, axis]
        told[7 * i + 6] = felt.roll_coefficient[i]
    write(setter, nodes, told)


@twin
def command(setter, nodes, surfaces, told):
    for i in range(surfaces.aileron.size):
        told[4 * i], told[4 * i + 1] = surfaces.aileron[i], -surfaces.elevator[i]
        told[4 * i + 2], told[4 * i + 3] = -surfaces.rudder[i], surfaces.throttle[i]
    write(setter, nodes, told)


def ready_look(*fixed):
    return bound(look, *fixed, more=(0,))


ready_note, ready_sense_air = reading(note, more=(0,)), reading(sense_air)
ready_blow, ready_command = setting(blow), setting(command)
