"""Proof that a compiled aircraft equals the installed JSBSim to the bit, on random states.

All columns of a row that JSBSim has a property for, and all numbers that the testbed reads, are
compared with `==` after each step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.compiled.columns import AIR_INPUTS, CONTROLS, WIND
from testbed.compiled.compiled_aircraft import CompiledAircraft
from testbed.compiled.elements import NotTranslated
from testbed.compiled.rows import write_motion
from testbed.core.kept_results import find_result
from testbed.core.random import named_stream
from testbed.core.records import Array, NedOrigin
from testbed.vehicle.folder_results import folder_digest
from testbed.vehicle.jsbsim_adapter import VERSION, load
from testbed.vehicle.jsbsim_io import MOTION_PROPERTIES
from testbed.vehicle.jsbsim_model import JsbsimModel
from testbed.vehicle.trim import Controls, Placement

STATES, STEPS = 50, 3  # random states, and steps from each
FLIGHT_STEPS, HOLD = 200, 4  # a flight with random controls and wind, each held for some steps
_SPUN = 10  # in one state of so many, propeller and surfaces settle first; the next one is high
_HEIGHTS_M, _HIGH_M = (300.0, 3000.0), (8_000.0, 19_000.0)  # the tropopause is between
_ATTEMPTS = 20  # to find a state in which no component is at a limit
_SEED = 20260101


@dataclass(frozen=True, slots=True)
class Proof:
    """Result of comparing a compiled aircraft with JSBSim.

    Attributes:
        compared: numbers that were compared.
        unequal: the first quantity that differs, in words, with the size of the difference; empty:
            all numbers are equal.
    """

    compared: int
    unequal: str = ""

    @property
    def equal(self) -> bool:
        """Whether all numbers are equal."""
        return not self.unequal


def prove_aircraft(aircraft: CompiledAircraft, rate_hz: int) -> Proof:
    """Compare a compiled aircraft with JSBSim, at steps per second; keep the result on disk."""
    of = folder_digest(aircraft.folder), aircraft.source, aircraft.integrators, rate_hz
    return find_result(Proof, "proof", of, lambda: compare(aircraft, rate_hz))


def compare(
    aircraft: CompiledAircraft, rate_hz: int, states: int = STATES, flight_steps: int = FLIGHT_STEPS
) -> Proof:
    """Compare a compiled aircraft with JSBSim from random states, and in a flight."""
    comparison = Comparison(aircraft, rate_hz)
    for number in range(states):
        comparison.place(spin=number % _SPUN == 0, high=number % _SPUN == 1)
        comparison.run(STEPS)
        if comparison.unequal:
            break
    if not comparison.unequal:
        comparison.place(spin=True, calm=True)
        comparison.fly(flight_steps)
    return Proof(comparison.compared, comparison.unequal)


class Comparison:
    """A model of JSBSim and a row beside each other.

    Attributes:
        row: state (S,) of the compiled aircraft.
        compared: numbers compared so far.
        unequal: the first difference, in words.
    """

    def __init__(self, aircraft: CompiledAircraft, rate_hz: int, seed: int = _SEED) -> None:
        self._aircraft, self._dt = aircraft, 1.0 / rate_hz
        self.model: JsbsimModel = load(aircraft.folder, rate_hz, aircraft.integrators)
        aircraft.watch(self.model)
        self._random = named_stream(seed, "compiled")
        self._battery = self.model.find("battery/initial-state-of-charge") is not None
        nodes = {name: self.model.find(name) for name in aircraft.columns}
        self._nodes = [
            (name, column, nodes[name].get_double_value)
            for name, column in aircraft.columns.items()
            if nodes[name]
        ]
        self._motion = [self.model.node(each).get_double_value for each in MOTION_PROPERTIES]
        self._numbers = np.zeros((1, len(MOTION_PROPERTIES)))
        self.row: Array = np.zeros(len(aircraft.columns))
        self.compared, self.unequal = 0, ""

    def place(self, *, spin: bool, calm: bool = False, high: bool = False) -> None:
        """Place both in a random state of flight anywhere on the Earth; high: above 10 km.

        Raises:
            NotTranslated: no state of the aircraft's components is known.
        """
        for attempt in range(_ATTEMPTS):
            self._place(spin=spin, calm=calm, high=high)
            try:
                self.row = self._aircraft.row_of(self.model)
                break
            except NotTranslated:  # a component is at a limit
                if attempt == _ATTEMPTS - 1:
                    raise
        self.check("placed")

    def _place(self, *, spin: bool, calm: bool, high: bool) -> None:
        random, model = self._random, self.model
        spin |= bool(self._aircraft.recalled)
        origin = NedOrigin(
            float(random.uniform(-80.0, 80.0)), float(random.uniform(-180.0, 180.0)), 100.0
        )
        height = random.uniform(*(_HIGH_M if high else _HEIGHTS_M))
        model.locate((0.0, 0.0, float(-height)), origin)
        model.node("atmosphere/delta-T").set_double_value(float(random.uniform(-40.0, 40.0)))
        if self._battery:
            model.power.charge(float(random.uniform(0.1, 1.0)))
        share = 0.1 if calm else 1.0
        x, y, z = (random.uniform(-1.0, 1.0, 3) * share).tolist()
        velocity = (20.0 + 15.0 * x, 10.0 * y, 10.0 * z)
        p, q, r = (random.normal(size=3) * share).tolist()
        roll, pitch, course = (
            random.uniform(-1.0, 1.0, 3) * (share * 3.1, share * 1.5, 3.1)
        ).tolist()
        aileron, elevator, rudder = (random.uniform(-1.0, 1.0, 3) * share).tolist()
        wind = random.normal(size=3) * 5.0 * (random.random() < 0.3)
        model.place(
            Placement(velocity, (p, q, r), roll, pitch, 0.0),
            Controls(aileron, elevator, rudder, float(random.random())),
            course=course,
            wind_ned=tuple(wind.tolist()),
            spin=spin,
        )
        model.fly()

    def blow(self) -> None:
        """Set a random wind in both."""
        random = self._random
        for name in WIND.columns:
            self.set(name, float(random.normal() * 15.0))
        for name in AIR_INPUTS:
            self.set(name, float(random.normal() * (0.01 if "coefficient" in name else 0.3)))

    def steer(self, share: float) -> None:
        """Move the controls of both by a random share of their travel."""
        for name in CONTROLS.columns:
            least = 0.0 if "throttle" in name else -1.0
            now = self.row[self._aircraft.columns[name]]
            moved = now + share * float(self._random.normal())
            self.set(name, min(max(moved, least), 1.0))

    def set(self, name: str, value: float) -> None:
        """Set a property in both, if there is one."""
        node = self.model.find(name)
        if node is not None and name in self._aircraft.columns:
            if name == CONTROLS.columns[3]:
                self.model.power.set_throttle(value)
            else:
                node.set_double_value(value)
            self.row[self._aircraft.columns[name]] = value

    def run(self, steps: int) -> None:
        """Run some steps in a random wind, and compare after each."""
        self.blow()
        for number in range(1, steps + 1):
            self._step()
            self.check(f"{number} steps after a placement")

    def fly(self, steps: int) -> None:
        """Fly with random controls in random wind, and compare after each step."""
        for number in range(steps):
            if number % HOLD == 0:
                self.blow()
                self.steer(0.05)
            if not self.model.node("position/h-agl-ft").get_double_value() > 100.0:
                return
            self._step()
            self.check(f"{number + 1} steps into a flight")

    def _step(self) -> None:
        self.model.fdm.run()
        self._aircraft.run_row(self.row, self._dt, 1)

    def check(self, when: str) -> None:
        """Compare all quantities, and describe the first that is not equal."""
        if self.unequal:
            return
        write_motion(self.row.reshape(1, -1), np.zeros(1, dtype=np.intp), self._numbers)
        pairs = [(name, self.row[column], get()) for name, column, get in self._nodes]
        motion = (get() for get in self._motion)
        pairs += zip(MOTION_PROPERTIES, self._numbers[0], motion, strict=True)
        self.compared += len(pairs)
        for name, value, theirs in pairs:
            ours = float(value)  # not numpy's, which shows its type
            if not (ours == theirs or (math.isnan(ours) and math.isnan(theirs))):
                self.unequal = (
                    f"{name} is {ours!r}, and {theirs!r} in JSBSim {VERSION}: a difference of "
                    f"{abs(ours - theirs):.2g}, {when}"
                )
                return
