"""A formation in steady flight as the matrices of a discrete, linear system."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from testbed.core.errors import InputError
from testbed.core.records import Array
from testbed.scenario import Scenario, find_loaded
from testbed.scenario.validate import shown_value
from testbed.trials.frequency_response import AXES, LEADER_SIZE
from testbed.trials.held_flight import COMMANDS, LEADER_MESSAGE, HeldFlight
from testbed.trials.linear_formation import LinearFormation, join
from testbed.trials.predicted_margins import fly_linearisable
from testbed.trials.predicted_margins import linearise as linearise_flight
from testbed.trials.steady_flight import MarginsError

_ANGLES = ("roll", "pitch", "yaw")
MAX_BANK_DEG, MAX_CLIMB_MPS = 60.0, 20.0


class StateSpace(NamedTuple):
    """A discrete, linear system: x⁺ = a x + b u, y = c x + d u, with deviations from steady flight.

    Attributes:
        a: (n, n).
        b: (n, k).
        c: (K, n).
        d: (K, k).
        dt: s, control period.
        states: (n,) names.
        inputs: (k,) names: of a uniform wind, `wind.forward`; of the leader's message as used,
            `leader.position_ned.right`; of additions to commands, `uav1.roll`.
        outputs: (K,) names: of computed commands, `uav1.roll`; of slot errors with the leader's
            slot held, `uav1.error.down`; of attitudes, `uav1.attitude.pitch`.

    Units are m, s, rad; throttle is 0 to 1. Axes are those of the leader: forward along its course,
    right, down.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    dt: float
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


def linearise(
    scenario: Scenario | str | os.PathLike[str],
    overrides: Sequence[str] = (),
    *,
    bank_deg: float = 0.0,
    climb_mps: float = 0.0,
) -> StateSpace:
    """Linearise a scenario's formation in steady flight behind a virtual leader.

    The flight is that of `testbed margins`: in still air, with exact estimates, without faults.

    Args:
        scenario: a scenario, or the name or path of one.
        overrides: `key=value` as for `--set`; only with a name or path.
        bank_deg: the highest of a follower, clockwise if positive; 0: straight. At most 60.
        climb_mps: of the leader, m/s; descending if negative. At most 20.

    Raises:
        InputError: an argument is wrong, or the scenario has no such steady flight, or cannot be
            linearised; the message has what to write instead.
    """
    flight = fly_or_refuse(find_loaded(scenario, overrides), bank_deg, climb_mps)
    return state_space(join(linearise_flight(flight)))


def fly_or_refuse(scenario: Scenario, bank_deg: float, climb_mps: float) -> HeldFlight:
    """Fly a scenario's formation steadily; see `linearise` for arguments and errors."""
    limits = (("bank_deg", bank_deg, MAX_BANK_DEG), ("climb_mps", climb_mps, MAX_CLIMB_MPS))
    for name, value, largest in limits:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and abs(value) <= largest):
            raise InputError(
                f"{name}: is {shown_value(value)} (write a number from {-largest:g} to {largest:g})"
            )
    flight, problem = fly_linearisable(scenario, bank_deg, climb_mps)
    if problem:
        raise MarginsError(f"{problem} (write a smaller bank_deg or climb_mps)")
    return flight


def state_space(formation: LinearFormation) -> StateSpace:
    """Return the matrices of a formation, with all its inputs and outputs."""
    n, names = len(formation.names), formation.names
    commands = formation.b_command.sum(axis=1)  # (n, S, 3) of a whole period
    b = np.concatenate(
        (formation.b_wind, formation.b_leader, *(commands[i] for i in range(n))), axis=1
    )
    outputs = [
        (formation.c_command[i], formation.c_error[i], formation.c_attitude[i]) for i in range(n)
    ]
    c = np.concatenate([rows for each in outputs for rows in each])
    d = np.zeros((len(c), b.shape[1]))
    size, wind = len(c) // n, formation.b_wind.shape[1]
    for i in range(n):
        d[size * i : size * i + len(COMMANDS), wind : wind + LEADER_SIZE] = formation.d_leader[i]
    return StateSpace(
        formation.a,
        b,
        c,
        d,
        formation.dt,
        formation.labels,
        (
            *(f"wind.{axis}" for axis in AXES),
            *(
                f"leader.{field}.{part}"
                for field in LEADER_MESSAGE
                for part in (_ANGLES if field.startswith("euler") else AXES)
            ),
            *(f"{name}.{command}" for name in names for command in COMMANDS),
        ),
        tuple(
            f"{name}.{output}"
            for name in names
            for output in (
                *COMMANDS,
                *(f"error.{axis}" for axis in AXES),
                *(f"attitude.{angle}" for angle in _ANGLES[:2]),
            )
        ),
    )
