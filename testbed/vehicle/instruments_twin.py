"""The compiled twins of `instruments`.

A test holds them to the functions there.
"""

# The numpy functions carry the docstrings and the types.
# ruff: noqa: ANN001, ANN201, ANN202, D103
# mypy: ignore-errors

from __future__ import annotations

from testbed.compiled import twin
from testbed.frames import FOOT
from testbed.vehicle.properties_twin import read, reading, setting, write
from testbed.vehicle.twin import motion


@twin
def look(getter, nodes, raw, zero, scale, flat):
    read(getter, nodes, raw)
    motion(raw, zero, scale, flat)


@twin
def sense_air(getter, nodes, raw, felt, air):
    read(getter, nodes, raw)
    n = air.alpha.size
    for i in range(n):
        air.alpha[i], air.beta[i] = raw[3 * n + i], raw[4 * n + i]
        air.propeller_rps[i] = raw[5 * n + i] / 60.0
        air.state_of_charge[i], air.battery_voltage[i] = raw[6 * n + i], raw[7 * n + i]
        for axis in range(3):
            air.wind_ned[i, axis] = raw[3 * i + axis] * FOOT
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
    n = surfaces.aileron.size
    for i in range(n):
        told[i], told[n + i] = surfaces.aileron[i], -surfaces.elevator[i]
        told[2 * n + i], told[3 * n + i] = -surfaces.rudder[i], surfaces.throttle[i]
    write(setter, nodes, told)


ready_look, ready_sense_air = reading(look), reading(sense_air)
ready_blow, ready_command = setting(blow), setting(command)
