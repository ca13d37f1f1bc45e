"""A formation in steady flight as one linear, time-invariant, discrete system.

The maps of the control periods (`period_map`) are averaged over the periods after which the flight
repeats, and joined by the messages of the scenario's graph, each as many control periods old as in
the flight. The average stands for filters that step in some periods only; tests compare its
eigenvalues with those of the product of the maps, which is exact.
"""

from __future__ import annotations

import numpy as np

from testbed.core.records import Array
from testbed.linear.follower_state import about_vertical
from testbed.linear.held_flight import COMMANDS, LEADER_MESSAGE, MESSAGE
from testbed.linear.linear_system import LinearSystem, append
from testbed.linear.loop_margins import CommandMargins
from testbed.linear.period_map import PeriodMaps

AXES = ("forward", "right", "down")
_ANGLES = ("roll", "pitch", "yaw")
MESSAGE_SIZE = 3 * len(MESSAGE)  # of a follower
LEADER_SIZE = 3 * len(LEADER_MESSAGE)
# names after those of a follower, in the order of FollowerMap
_RECEIVED = tuple(
    f"{field}.{part}"
    for field in LEADER_MESSAGE
    for part in (_ANGLES if field.startswith("euler") else AXES)
)
_MESSAGE = tuple(f"message.{name}" for name in _RECEIVED[:MESSAGE_SIZE])
_SHOWN = (*(f"error.{axis}" for axis in AXES), *(f"attitude.{angle}" for angle in _ANGLES[:2]))


def received(follower: str, sender: str) -> str:
    """Return the beginning of the names of a follower's inputs by another one's message."""
    return f"{follower}.received.{sender}"


def turned_message(angle: float) -> Array:
    """Return the matrix (9, 9) of a follower's message to axes turned right by an angle, rad."""
    return np.asarray(np.kron(np.eye(3), about_vertical(angle)), dtype=float)


def average(maps: PeriodMaps, follower: int) -> LinearSystem:
    """Average the maps of a follower, and drop the states that nothing reads.

    Its inputs are the wind, the leader's message, its commands and the messages of others,
    `uav2.received.uav1.position_ned.forward`; its outputs are its commands, its message,
    `uav2.message.position_ned.forward`, its slot error and its attitude.

    Args:
        maps: of the control periods.
        follower: 0..n-1.
    """
    own = maps.followers[follower]
    senders = sorted({0, *own.b_message})
    b, inputs = [own.b_wind, own.b_command], [f"wind.{axis}" for axis in AXES]
    inputs += [f"{own.name}.{command}" for command in COMMANDS]
    d = [np.zeros((len(own.a), len(COMMANDS), len(inputs)))]
    for j in senders:
        prefix = received(own.name, maps.followers[j - 1].name) if j else "leader"
        names = _RECEIVED if j == 0 else _RECEIVED[:MESSAGE_SIZE]
        inputs += [f"{prefix}.{name}" for name in names]
        b.append(own.b_message.get(j, np.zeros((*own.a.shape[:2], len(names)))))
        d.append(own.d_message.get(j, np.zeros((len(own.a), len(COMMANDS), len(names)))))
    outputs = (*COMMANDS, *_MESSAGE, *_SHOWN)
    direct = np.concatenate(d, axis=-1).mean(axis=0)
    whole = LinearSystem(
        a=own.a.mean(axis=0),
        b=np.concatenate(b, axis=-1).mean(axis=0),
        c=np.concatenate((own.c_command, own.c_output), axis=1).mean(axis=0),
        d=np.pad(direct, ((0, len(outputs) - len(COMMANDS)), (0, 0))),
        dt=maps.dt,
        states=tuple(f"{own.name}.{label}" for label in own.labels),
        inputs=tuple(inputs),
        outputs=tuple(f"{own.name}.{name}" for name in outputs),
        speed=maps.speed,
    )
    return whole.without_unread()


def join(maps: PeriodMaps) -> LinearSystem:
    """Join the followers of a formation by their messages; see `LinearSystem` for the names.

    Args:
        maps: of their control periods.
    """
    names = [each.name for each in maps.followers]
    system = append([average(maps, i) for i in range(len(names))])
    turned = turned_message(maps.turn)
    for i, each in enumerate(maps.followers):
        for j in each.b_message:
            if j:
                late = maps.periods_late(i, j - 1)
                to = received(each.name, names[j - 1])
                system = system.connect(f"{names[j - 1]}.message", to, late=late, turned=turned)
    return system.select(
        ["wind", "leader", *(f"{name}.{command}" for name in names for command in COMMANDS)],
        [f"{name}.{output}" for name in names for output in (*COMMANDS, *_SHOWN)],
    )


def command_margins(system: LinearSystem, follower: str) -> dict[str, CommandMargins]:
    """Return the margins of a follower's commands, by their names.

    Args:
        system: of `join`.
        follower: its name.
    """
    return {name: system.loop(f"{follower}.{name}").margins() for name in COMMANDS}
