"""Translation of an aircraft's files to the source of one function that runs rows of states.

The order is that of a frame of JSBSim (see `frame`). Each of JSBSim's functions and components is
evaluated once, where JSBSim evaluates it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from testbed.compiled.aerodynamics import (
    STALL_HYSTERESIS,
    aerodynamics,
    reads_lift_squared,
)
from testbed.compiled.columns import (
    AIR_INPUTS,
    COLUMN,
    CONTROLS,
    FRAME,
    FRAME_COLUMNS,
    MOTION,
    OUTPUTS,
    WIND,
    RowQuantity,
)
from testbed.compiled.components import component, outputs
from testbed.compiled.elements import NotTranslated, XmlNode, read_aircraft
from testbed.compiled.propulsion import (
    ENGINE_OUTPUTS,
    engine_property,
    propulsion,
    throttle_property,
)
from testbed.compiled.source import GEAR, MOST_LINES, SURFACES, Recalled, StepSource
from testbed.vehicle.environment import (
    ADAMS_BASHFORTH_2,
    ADAMS_BASHFORTH_3,
    EULER,
    INTEGRATORS,
    Integrators,
)

_METHODS = {
    EULER: ("euler", 0),
    ADAMS_BASHFORTH_2: ("adams_bashforth_2", 1),
    ADAMS_BASHFORTH_3: ("adams_bashforth_3", 2),
}  # function of `frame`, and how many older derivatives it takes
_SYSTEMS = ("system", "autopilot", "flight_control")  # in the order in which JSBSim runs them

# Properties of the frame that an aircraft's files may read, where they become known.
_AFTER_PROPAGATE = {
    **{f"velocities/{each}-rad_sec": f"pqr[{k}]" for k, each in enumerate("pqr")},
    **{f"velocities/{each}i-rad_sec": f"rates[{k}]" for k, each in enumerate("pqr")},
    **{f"velocities/{each}-fps": f"uvw[{k}]" for k, each in enumerate("uvw")},
    **{
        f"velocities/v-{each}-fps": f"rotate_back(t_bl, uvw)[{k}]"
        for k, each in enumerate(("north", "east", "down"))
    },
    "velocities/h-dot-fps": "-rotate_back(t_bl, uvw)[2]",
    **{
        f"attitude/{name}-rad": f"euler_angles(t_bl)[{k}]"
        for k, names in enumerate((("phi", "roll"), ("theta", "pitch"), ("psi", "heading-true")))
        for name in names
    },
    **{
        f"attitude/{name}-deg": f"euler_angles(t_bl)[{k}] * DEGREES"
        for k, name in enumerate(("phi", "theta", "psi"))
    },
    "position/h-sl-ft": "altitude",
    "position/geod-alt-ft": "geodetic(place)[2]",
    "position/h-agl-ft": "geodetic(place)[2] - terrain",
    "position/lat-geod-rad": "geodetic(place)[0]",
    "position/long-gc-rad": "geodetic(place)[1]",
    "position/lat-gc-rad": "latitude",
}
_AFTER_ATMOSPHERE = {
    "atmosphere/rho-slugs_ft3": "rho",
    "atmosphere/T-R": "temperature(height, delta_t)",
    "atmosphere/P-psf": "pressure(height, delta_t)",
    "atmosphere/a-fps": "sound_speed(temperature(height, delta_t))",
    "atmosphere/sigma": "rho / (P_SEA / (GAS_CONSTANT * (T_SEA + delta_t)))",
    "atmosphere/theta": "temperature(height, delta_t) / (T_SEA + delta_t)",
    "atmosphere/delta": "pressure(height, delta_t) / P_SEA",
}
_AFTER_AUXILIARY = {
    "aero/alpha-rad": "alpha",
    "aero/beta-rad": "beta",
    "aero/alphadot-rad_sec": "alpha_dot",
    "aero/betadot-rad_sec": "beta_dot",
    "aero/qbar-psf": "qbar",
    "velocities/vt-fps": "vt",
    "aero/alpha-deg": "alpha * DEGREES",
    "aero/beta-deg": "beta * DEGREES",
    "aero/mag-beta-rad": "abs(beta)",
    "aero/mag-beta-deg": "abs(beta) * DEGREES",
    "aero/alphadot-deg_sec": "alpha_dot * DEGREES",
    "aero/betadot-deg_sec": "beta_dot * DEGREES",
    "aero/qbarUW-psf": "0.5 * rho * (uvw_aero[0] * uvw_aero[0] + uvw_aero[2] * uvw_aero[2])",
    "aero/qbarUV-psf": "0.5 * rho * (uvw_aero[0] * uvw_aero[0] + uvw_aero[1] * uvw_aero[1])",
    "velocities/mach": "vt / sound_speed(temperature(height, delta_t))",
    "velocities/machU": "uvw_aero[0] / sound_speed(temperature(height, delta_t))",
    "velocities/ve-fps": "equivalent_airspeed(qbar)",
    "velocities/vtrue-fps": "vt",
    "velocities/ve-kts": "equivalent_airspeed(qbar) * KNOTS",
    "velocities/vtrue-kts": "vt * KNOTS",
    "velocities/vg-fps": "hypot_of(rotate_back(t_bl, uvw))",
    "flight-path/gamma-rad": "path_angle(rotate_back(t_bl, uvw))",
    **{f"velocities/{each}-aero-rad_sec": f"pqr[{k}]" for k, each in enumerate("pqr")},
    **{f"velocities/{each}-aero-fps": f"uvw_aero[{k}]" for k, each in enumerate("uvw")},
}

# Properties of JSBSim that keep their value from the placement, unless the files write them.
_HELD = (
    *GEAR,
    STALL_HYSTERESIS,
    *(f"fcs/{each}-trim-cmd-norm" for each in ("pitch", "roll", "yaw")),
    *(f"fcs/{each}-cmd-norm" for each in ("flap", "speedbrake", "spoiler", "steer")),
    *(f"fcs/{each}-pos-{unit}" for each in SURFACES for unit in ("rad", "deg", "norm")),
    *(f"fcs/mag-{each}-pos-rad" for each in SURFACES if each != "flap"),
)

_AFTER_ACCELERATIONS = {
    **{f"accelerations/{each}dot-ft_sec2": f"uvw_dot[{k}]" for k, each in enumerate("uvw")},
    **{f"accelerations/{each}idot-ft_sec2": f"acceleration[{k}]" for k, each in enumerate("uvw")},
    **{f"accelerations/{each}idot-rad_sec2": f"rates_dot[{k}]" for k, each in enumerate("pqr")},
}

_ATMOSPHERE = """
    # Inertial
    place = earth_fixed(earth_angle, position)
    t_li = local_axes(earth_angle, place)
    t_bi = matrix_of(attitude)
    t_bl = multiply_transposed(t_bi, t_li)
    uvw = rotate(t_bi, earth_velocity(position, velocity))
    earth = earth_rates(t_bi)
    pqr = difference(rates, earth)
    radius = radius_of(place)
    latitude = geocentric_latitude(place)
    attraction = gravity(place, radius, latitude)
    # Atmosphere
    altitude = altitude_of(radius, latitude)
    height = geopotential(altitude)
    rho = pressure(height, delta_t) / (GAS_CONSTANT * temperature(height, delta_t))
"""
_AUXILIARY = """
    # Auxiliary
    uvw_aero = difference(uvw, rotate(t_bl, wind))
    vt2 = square_of(uvw_aero)
    vt = sqrt(vt2)
    alpha, beta, alpha_dot, beta_dot = flow(uvw_aero, vt, uvw_dot)
    qbar = 0.5 * rho * vt2
"""
_ACCELERATIONS = """
    # Aircraft
    force = add(force_aero, force)
    moment = add(moment_aero, moment)
    # Accelerations
    specific = scale(1.0 / mass, force)
    rates_dot = rate_derivatives(tensor, moment, rates)
    uvw_dot = body_derivatives(
        specific, pqr, earth, uvw, position, attraction, t_bi, earth_angle
    )
    acceleration = inertial_derivatives(specific, attraction, t_bi, earth_angle)
"""
_LIMITS = """
    # limits of the model
    if not (vt < FASTEST and abs(rates[0]) < FASTEST and abs(rates[1]) < FASTEST):
        status[row] = IMPLAUSIBLE
        break
    if height > CEILING:
        status[row] = ABOVE_ATMOSPHERE
        break
"""
_HEADER = '''"""The step of an aircraft, translated from its files."""

from math import *

import numpy as np

from testbed.core.compile import kernel
from testbed.compiled.frame import *
from testbed.compiled.kinematic import travel
from testbed.compiled.model_limits import *
from testbed.compiled.function_library import *
'''


@dataclass(frozen=True, slots=True)
class Translation:
    """The function of an aircraft, as source, and the columns of its rows.

    Attributes:
        function: name of the function, different for each source.
        source: of a module with it.
        columns: index of each column by its name.
        memories: names of the columns of older derivatives, the newest first, by the name of the
            derivative's variable.
        own: columns of the aircraft's own properties.
        recalled: columns that JSBSim has no property for.
    """

    function: str
    source: str
    columns: dict[str, int]
    memories: dict[str, tuple[tuple[str, ...], ...]]
    own: tuple[str, ...]
    recalled: dict[str, Recalled]


def translate(
    folder: Path,
    constant: Callable[[str], float | None],
    integrators: Integrators = INTEGRATORS,
) -> Translation:
    """Translate the aircraft in a folder.

    Args:
        folder: of the aircraft, which `check_airframe` has accepted.
        constant: returns the value of a property of the loaded aircraft; None: there is none.
        integrators: of the flight model.

    Raises:
        NotTranslated: the aircraft has a part that only JSBSim flies.
    """
    reasons = list[str]()
    return _Translator(read_aircraft(folder, reasons), reasons, constant, integrators).translate()


class _Translator:
    def __init__(
        self,
        root: XmlNode,
        reasons: list[str],
        constant: Callable[[str], float | None],
        integrators: Integrators,
    ) -> None:
        self._root, self._source = root, StepSource(constant)
        self._source.reasons += reasons
        self._integrators = integrators
        self._memories: dict[str, tuple[tuple[str, ...], ...]] = {}

    def translate(self) -> Translation:
        self._source.attempt_all(self._root, self._write)
        reasons = list(dict.fromkeys(self._source.reasons))
        if not reasons and (lines := len(self._source.lines())) > MOST_LINES:
            why = f"becomes {lines:,} lines of source; up to {MOST_LINES:,} are compiled"
            reasons = [self._root.describe(why)]
        if reasons:
            raise NotTranslated("\n".join(reasons))
        return self._assemble()

    def _write(self) -> None:
        self._declare()
        source = self._source
        self._propagate()
        source.emit(_dedent(_ATMOSPHERE))
        self._provide(_AFTER_PROPAGATE | _AFTER_ATMOSPHERE)
        self._systems()
        source.emit(_dedent(_AUXILIARY))
        self._provide(_AFTER_AUXILIARY | self._heights())
        source.emit("# Propulsion\nforce = moment = (0.0, 0.0, 0.0)")
        propulsion(self._root, source)
        source.emit("# Aerodynamics")
        aerodynamics(self._root, source)
        source.emit(_dedent(_ACCELERATIONS))
        self._provide(_AFTER_ACCELERATIONS)
        source.emit(_dedent(_LIMITS))

    def _declare(self) -> None:
        source, root = self._source, self._root
        source.declare_frame(*CONTROLS.columns, *WIND.columns, "atmosphere/delta-T")
        source.declare_frame(*_AFTER_PROPAGATE, *_AFTER_ATMOSPHERE)
        source.declare_frame(*_AFTER_AUXILIARY, *self._heights(), *_AFTER_ACCELERATIONS)
        source.declare_frame("aero/bi2vel", "aero/ci2vel", "aero/qbar-area")
        source.declare(*_HELD)
        if reads_lift_squared(root):
            source.declare_frame("aero/cl-squared")
        parts = root.find("propulsion")
        for number, _ in enumerate(parts.all("engine") if parts else []):
            outputs_of = ("propeller-rpm", *ENGINE_OUTPUTS)
            source.declare_frame(*(engine_property(number, each) for each in outputs_of))
            source.declare(throttle_property(number))
        written = set[str]()
        for system in self._ordered_systems():
            for node in system.all("property"):
                source.declare(node.word)
            for each in self._components(system):
                try:
                    names = set(outputs(each))
                except NotTranslated:  # without a name: a reason when it is written
                    continue
                source.shared |= written & names
                written |= names
        source.declare(*written)
        for node in root.child("aerodynamics").walk():
            if node.tag == "function" and node.attributes.get("name"):
                source.declare(node.attributes["name"])

    def _provide(self, properties: dict[str, str]) -> None:
        for name, value in properties.items():
            self._source.provide(name, value)

    def _heights(self) -> dict[str, str]:
        """Return the heights of centre of gravity and wing above the terrain, in spans."""
        read = self._source.read
        span = read("metrics/bw-ft", self._root)
        point = ", ".join(read(f"metrics/aero-rp-{each}-in", self._root) for each in "xyz")
        height = "geodetic(place)[2] - terrain"
        return {
            "aero/h_b-cg-ft": f"({height}) / {span}",
            "aero/h_b-mac-ft": f"({height} - rotate_back(t_bl, arm(cg, ({point})))[2]) / {span}",
        }

    def _propagate(self) -> None:
        """Write the integration of attitude, rates, position and velocity."""
        source, methods = self._source, self._integrators
        source.emit("# Propagate")
        source.emit("attitude_dot = attitude_rate(attitude, rates)")
        rotational, translational = methods.position_rotational, methods.position_translational
        self._integrate("attitude", "attitude_dot", 4, rotational)
        source.emit("attitude = unit(attitude)")
        self._integrate("rates", "rates_dot", 3, methods.rate_rotational)
        self._integrate("position", "velocity", 3, translational)
        self._integrate("velocity", "acceleration", 3, methods.rate_translational)
        source.emit("earth_angle += EARTH_RATE * dt")

    def _integrate(self, state: str, derivative: str, size: int, method: int) -> None:
        function, depth = _METHODS[method]
        older = [f"{derivative}_{age}" for age in range(1, depth + 1)]
        self._memories[derivative] = tuple(
            tuple(f"memory/{each}[{k}]" for k in range(size)) for each in older
        )
        emit = self._source.emit
        emit(f"{state} = (")
        for k in range(size):
            values = ", ".join(f"{each}[{k}]" for each in (derivative, *older))
            emit(f"    {state}[{k}] + {function}(dt, {values}),")
        emit(")")
        for newer, old in reversed(list(zip((derivative, *older), older, strict=False))):
            emit(f"{old} = {newer}")

    def _ordered_systems(self) -> list[XmlNode]:
        return [each for kind in _SYSTEMS for each in self._root.all(kind)]

    def _components(self, system: XmlNode) -> Iterator[XmlNode]:
        for channel in system.all("channel"):
            yield from channel.children

    def _systems(self) -> None:
        source = self._source
        source.emit("# Systems")
        throttle = source.read(CONTROLS.columns[3], self._root)
        parts = self._root.find("propulsion")
        for number, engine in enumerate(parts.all("engine") if parts else []):
            source.write(throttle_property(number), throttle, engine)
        for system in self._ordered_systems():
            for each in self._components(system):
                source.attempt(each, partial(component, each, source))

    def _assemble(self) -> Translation:
        source = self._source
        memory = [column for olds in self._memories.values() for old in olds for column in old]
        own = list(dict.fromkeys([*source.loaded(), *source.stored()]))
        names = [*COLUMN, *memory, *own]
        columns = {each: index for index, each in enumerate(names)}
        assert len(columns) == len(names) >= FRAME_COLUMNS
        frame = [*(each for each in FRAME if each not in (CONTROLS, *OUTPUTS)), *self._memory()]
        loads = [_load(each, columns) for each in frame]
        loads += [_load(each, columns) for each in OUTPUTS]
        loads += [
            f"{source.variable(each)} = state[row, {columns[each]}]"
            for each in (*source.loaded(), *source.loaded_frame())
        ]
        kept = [each for each in (*MOTION, *OUTPUTS, *self._memory())]
        stores = [line for each in kept for line in _store(each, columns)]
        stores += [f"state[row, {columns[e]}] = {source.variable(e)}" for e in source.stored()]
        text = _FUNCTION.format(
            wind=_indent(self._wind(columns), 12),
            first=_indent(self._controls(columns, "first"), 12),
            final=_indent(self._controls(columns, "controls"), 16),
            loads=_indent(loads, 8),
            step=_indent(source.lines(), 12),
            stores=_indent(stores, 8),
        )
        text = "\n\n\n".join([_HEADER, *source.helpers, text])
        digest = hashlib.sha256(text.encode()).hexdigest()[:16]
        function = f"run_{digest}"
        return Translation(
            function,
            text.replace("def run_rows(", f"def {function}("),
            columns,
            self._memories,
            tuple(own),
            source.recalled,
        )

    def _memory(self) -> list[RowQuantity]:
        return [
            RowQuantity(f"{name}_{age}", old, False)
            for name, olds in self._memories.items()
            for age, old in enumerate(olds, start=1)
        ]

    def _wind(self, columns: dict[str, int]) -> list[str]:
        names = (*WIND.columns, *(each for each in AIR_INPUTS if each in columns))
        inputs = (*WIND.columns, *AIR_INPUTS)
        return [f"state[row, {columns[n]}] = wind_inputs[row, {inputs.index(n)}]" for n in names]

    def _controls(self, columns: dict[str, int], array: str) -> list[str]:
        lines = []
        for k, name in enumerate(CONTROLS.columns):
            lines.append(f"state[row, {columns[name]}] = {array}[row, {k}]")
            if array == "controls" and name in self._source.loaded_frame():
                lines.append(f"{self._source.variable(name)} = controls[row, {k}]")
        return lines


_FUNCTION = '''
def run_rows(state, wind_inputs, controls, first, changed, dt, ticks, which, status):
    """Advance rows by some steps; see `CompiledAircraft.run_rows`."""
    for row in which:
        if status[row] != 0:
            continue
        if changed[0]:
{wind}
        if changed[1]:
{first}
{loads}
        tensor = (
            (inertia[0], -inertia[3], inertia[4]),
            (-inertia[3], inertia[1], -inertia[5]),
            (inertia[4], -inertia[5], inertia[2]),
        )
        one = 1.0 + 0.0 * dt  # which the compiler does not know, see `tables.power_of`
        for tick in range(ticks[0]):
{step}
            if tick == 0 and changed[1]:
{final}
{stores}
'''


def _dedent(text: str) -> str:
    lines = text.strip("\n").splitlines()
    return "\n".join(line[4:] for line in lines)


def _indent(lines: list[str], depth: int) -> str:
    return "\n".join(" " * depth + line if line else line for line in lines)


def _load(quantity: RowQuantity, columns: dict[str, int]) -> str:
    cells = [f"state[row, {columns[each]}]" for each in quantity.columns]
    return f"{quantity.name} = {cells[0] if len(cells) == 1 else '(' + ', '.join(cells) + ')'}"


def _store(quantity: RowQuantity, columns: dict[str, int]) -> list[str]:
    name, names = quantity.name, quantity.columns
    if len(names) == 1:
        return [f"state[row, {columns[names[0]]}] = {name}"]
    return [f"state[row, {columns[each]}] = {name}[{k}]" for k, each in enumerate(names)]
