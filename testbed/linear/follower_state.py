"""The state of the followers of a flight as vectors in the leader's frame.

The state of a follower is that of its flight model, its autopilot, its middle loop and its filter
of the leader's messages, or the memory of a compiled law: the numbers that the flight carries from
one control step to the next. The leader's frame is horizontal: forward, right, down.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from testbed.compiled.columns import CONSTANTS, CONTROLS, START, WIND
from testbed.compiled.frame import quaternion_of
from testbed.core.frames import course
from testbed.core.records import Array, Records
from testbed.formation.compiled_law import CompiledLaw
from testbed.formation.follower_hbh23 import HBH23_MEMORY
from testbed.formation.law import Law
from testbed.linear.held_flight import HeldFlight
from testbed.plan.fmu_law import FmuLaw

LAW = "law"
CONTROL_MEMORY = ("middle loop/", "leader filter/", f"{LAW}/")  # labels of the state of control
NED = "_ned"  # end of the names of a law's vectors that are north, east, down
_INERTIAL = ("position/eci-", "velocities/eci-", "memory/velocity_", "memory/acceleration_")
_ATTITUDE = ("attitude/eci-", "memory/attitude_dot_")
_STEP = 1e-5  # of a central difference, where the table has no other
_STEPS = {  # by the beginning of names
    "position/": 1e-3,  # ft
    "velocities/eci": 1e-4,  # ft/s
    "memory/velocity": 1e-4,
    "memory/acceleration": 1e-4,
    "accelerations/": 1e-4,
    "propulsion/": 1e-2,  # rpm
    "autopilot/pressure": 1e-3,  # m²/s²
}


class _Numbers(NamedTuple):
    """Some consecutive numbers of a state: a view of where the flight has them."""

    names: tuple[str, ...]
    view: Array
    kind: str  # "scalar", or a vector: "inertial", "ned", or "attitude": a quaternion or its rate


class FollowerStates:
    """The states of n followers.

    Attributes:
        labels: names of the S numbers of each.
        steps: (S,) of each, of their central differences.
        ahead: rad, by which the leader's course is ahead of that of the frame.
    """

    def __init__(self, flight: HeldFlight) -> None:
        """Find the numbers of a flight in which all filters have started."""
        self._flight, self.ahead = flight, 0.0
        self._numbers = [list(self._find(i)) for i in range(len(flight.world.followers))]
        self._views = [[each.view for each in one] for one in self._numbers]
        widths = [[len(each) for each in one] for one in self._views]
        self._begins = [[0, *np.cumsum(each).tolist()] for each in widths]
        self._owners = [np.repeat(np.arange(len(each)), each) for each in widths]
        self._attitudes: list[Array | None] = [None] * len(self._numbers)
        self.labels = [tuple(name for each in one for name in each.names) for one in self._numbers]
        self.steps = [np.array([_step_of(name) for name in one]) for one in self.labels]

    def _find(self, i: int) -> Iterator[_Numbers]:
        vehicles, fleet = self._flight.vehicles, self._flight.fleet
        row = vehicles.rows.tolist().index(i + 1)
        [kind] = [each for each in fleet.kinds if row in each.which]
        clock = self._flight.world.clock
        # a control step between two periods of the autopilot, whose controls are those before
        between = clock.control_phases[i] % clock.autopilot != 0
        columns = list(kind.aircraft.columns)
        yield from _model_numbers(columns, kind.state[row], with_controls=between)
        controls = tuple(f"last {name}" for name in CONTROLS.columns)
        yield _Numbers(controls, fleet.last_controls[row], "scalar")
        autopilots, formation = vehicles.autopilots, self._flight.world.formation
        # the slew limiter acts on large motions only
        yield from _float_fields("autopilot", autopilots.memory, row, skip=("slew",))
        delayed = autopilots.delay_line[row].reshape(-1)
        yield _Numbers(
            tuple(f"autopilot/delay-{k}" for k in range(len(delayed))), delayed, "scalar"
        )
        controllers = formation.built_control.controllers
        yield from _float_fields("middle loop", controllers["integrals"], i)
        yield from _float_fields("leader filter", controllers["leader"], i, skip=("time_s",))
        for group in formation.built_control.groups:
            memory = law_memory(group.law)
            if memory is not None and i in group.rows:
                yield from _law_fields(memory, group.rows.tolist().index(i))

    def read(self, i: int) -> Array:
        """Return the numbers of a follower (S,), as the flight has them."""
        return np.concatenate(self._views[i])

    def add(self, i: int, change: Array) -> None:
        """Add to the numbers of a follower (S,)."""
        # of a few numbers in most calls
        for number in set(self._owners[i][np.flatnonzero(change)].tolist()):
            view, at = self._views[i][number], self._begins[i][number]
            view += change[at : at + len(view)]

    def frames(self) -> tuple[Array, Array]:
        """Return the rotations (3, 3) from NED, and from inertial axes, to the leader's frame."""
        world, fleet = self._flight.world, self._flight.fleet
        turn = float(course(world.aircraft["truth"]["velocity_ned"][0])) - self.ahead
        from_ned = about_vertical(turn)
        origin, kind = world.info.origin, fleet.kinds[0]
        earth_angle = float(kind.state[kind.which[0], START["earth_angle"]])
        lat, lon = math.radians(origin.latitude_deg), math.radians(origin.longitude_deg)
        sl, cl = math.sin(lat), math.cos(lat)
        so, co = math.sin(lon + earth_angle), math.cos(lon + earth_angle)
        to_ned = np.array([[-co * sl, -so * sl, cl], [-so, co, 0.0], [-co * cl, -so * cl, -sl]])
        return from_ned, from_ned @ to_ned

    def basis(self, i: int) -> Array:
        """Return the orthogonal matrix (S, S) from a follower's numbers to the leader's frame."""
        from_ned, from_inertial = self.frames()
        a, b, c, d = quaternion_of(tuple(map(tuple, from_inertial.tolist())))
        turned = _left_product((a, -b, -c, -d))
        basis, at = np.eye(len(self.labels[i])), 0
        for each in self._numbers[i]:
            to = slice(at, at + len(each.view))
            if each.kind == "attitude":
                if each.names[0].startswith("attitude/"):
                    turned = self._same_sign(i, turned, each.view)
                basis[to, to] = turned
            elif each.kind != "scalar":
                basis[to, to] = from_inertial if each.kind == "inertial" else from_ned
            at += len(each.view)
        return basis

    def _same_sign(self, i: int, turned: Array, attitude: Array) -> Array:
        """Return ± `turned`: of the two quaternions of an attitude, the one as before."""
        own = turned @ attitude
        before = self._attitudes[i]
        if before is None:
            self._attitudes[i] = before = own
        return turned if own @ before > 0.0 else -turned


def about_vertical(angle: float) -> Array:
    """Return the rotation (3, 3) of vectors to axes turned to the right by an angle, rad."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _model_numbers(names: Sequence[str], row: Array, *, with_controls: bool) -> Iterator[_Numbers]:
    """Yield the numbers of a row of a flight model that are no inputs or constants."""
    inputs = (WIND,) if with_controls else (CONTROLS, WIND)
    skipped = {name for each in (*CONSTANTS, *inputs) for name in each.columns}
    skipped.add("position/epa-rad")
    at = 0
    while at < len(names):
        name, width, kind = names[at], 1, "scalar"
        if name.startswith(_INERTIAL) or at == START["acceleration"]:
            width, kind = 3, "inertial"
        elif name.startswith(_ATTITUDE):
            width, kind = 4, "attitude"
        if name not in skipped:
            yield _Numbers(tuple(names[at : at + width]), row[at : at + width], kind)
        at += width


def _float_fields(
    owner: str, records: Records, row: int, skip: Sequence[str] = ()
) -> Iterator[_Numbers]:
    """Yield the numbers of a record that have a value, those of records in it, too."""
    for name in records.dtype.names or ():
        inner = records.dtype[name]
        if name in skip:
            continue
        if inner.names:
            yield from _float_fields(f"{owner}/{name}", records[name], row)
        elif inner.base == np.float64:
            view = records[name][row : row + 1].reshape(-1)
            if np.isfinite(view).all():
                several = len(view) > 1
                names = tuple(f"{owner}/{name}{k if several else ''}" for k in range(len(view)))
                yield _Numbers(names, view, "ned" if len(view) == 3 else "scalar")


def law_memory(law: Law | None) -> Records | None:
    """Return the memory (m,) of a compiled law; None: it has none, or is no compiled law."""
    return law.memory if isinstance(law, CompiledLaw) else None


def _law_fields(memory: Records, row: int) -> Iterator[_Numbers]:
    """Yield the floating-point numbers of a row of a law's memory that have a value."""
    for name in memory.dtype.names or ():
        if memory.dtype[name].base == HBH23_MEMORY:
            skip = ("time_s",)  # as of the built-in law
            yield from _float_fields(f"{LAW}/{name}", memory[name], row, skip)
        if memory.dtype[name].base != np.float64:
            continue
        view = memory[name][row : row + 1].reshape(-1)
        if not np.isfinite(view).all():
            continue
        scalar = memory.dtype[name].shape == ()
        names = tuple(f"{LAW}/{name}{'' if scalar else f'[{k}]'}" for k in range(len(view)))
        if name.endswith(NED):
            for k in range(0, len(view), 3):
                yield _Numbers(names[k : k + 3], view[k : k + 3], "ned")
        else:
            yield _Numbers(names, view, "scalar")


def held_fields(law: Law | None) -> tuple[str, ...]:
    """Return the fields of a law's memory that are no state: whole numbers and flags."""
    memory = law_memory(law)
    if memory is None:
        return ()
    names: tuple[str, ...] = memory.dtype.names or ()
    return tuple(name for name in names if memory.dtype[name].base.kind in "biu")


def problem_of_memory(law: Law | None) -> tuple[str, str]:
    """Return why the memory of a law cannot be linearised, and what to write; "": it can."""
    if isinstance(law, FmuLaw):
        remedy = "write the law as a function under @testbed.kernel"
        return f"the state of {law.name} is in bytes of its own", remedy
    memory = law_memory(law)
    for name in () if memory is None else memory.dtype.names or ():
        assert memory is not None
        base, shape = memory.dtype[name].base, memory.dtype[name].shape
        if base.kind == "f" and base != np.float64:
            return f"memory {name} of the law is {base}", "write float in its declaration"
        if name.endswith(NED) and shape[-1:] != (3,):
            return (
                f"memory {name} of the law is no vector",
                f"declare 3 numbers, north, east and down, or a name without {NED}",
            )
    return "", ""


def _step_of(name: str) -> float:
    return next((step for start, step in _STEPS.items() if name.startswith(start)), _STEP)


def _left_product(q: tuple[float, float, float, float]) -> Array:
    """Return the matrix (4, 4) of the product q ⊗ ·."""
    a, b, c, d = q
    return np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
