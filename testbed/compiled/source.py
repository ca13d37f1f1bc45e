"""The source of the step of one aircraft, written line by line.

Each property is a variable. One that is read before it is written in a frame has the value of the
frame before: it is state, and has a column of the row.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from testbed.airframes.airframe_grammar import JSBSIM_PROPERTIES
from testbed.compiled.columns import COLUMN
from testbed.compiled.elements import NotTranslated, XmlNode
from testbed.core.errors import describe_error, raise_memory_shortage

MOST_CELLS = 50_000  # numbers of all tables: as many add some seconds to the compiler's time
MOST_LINES = 2_000  # of the step: as many take it a minute
_INDENT = "    "
_INDEX_0 = re.compile(r"\[0\](?=/|$)")
_CONSTANT = ("metrics/",)  # groups of properties that loading sets and no step changes
SURFACES = ("elevator", "left-aileron", "right-aileron", "rudder", "speedbrake", "spoiler", "flap")
_POSITION = re.compile(rf"fcs/({'|'.join(SURFACES)})-pos-(rad|deg)")
_WRITABLE = ("fcs", "aero", "systems")  # groups of JSBSim's that aircraft write
GEAR = ("gear/gear-cmd-norm", "gear/gear-pos-norm")  # in flight only what the files make of it
_WEIGHT_ON_WHEELS = re.compile(r"gear/(unit(\[\d+\])?/WOW|wow)")


class Recalled(NamedTuple):
    """A state of a component that JSBSim does not show: a property, some frames ago."""

    property: str
    sign: float
    frames: int
    low: float  # at or beyond these limits the state is unknown
    high: float
    step: float = math.inf  # as after a change by this much or more from the frame before


class _Line(NamedTuple):
    text: str
    provides: str = ""  # the property of the frame that the line is for, if only for it


def literal(value: float) -> str:
    """Return a number as source."""
    if math.isinf(value):
        return "inf" if value > 0.0 else "(-inf)"
    text = repr(value)
    return f"({text})" if text.startswith("-") else text


def plain(name: str) -> str:
    """Return the name of a property as JSBSim looks it up."""
    return _INDEX_0.sub("", "-".join(name.split()))


class StepSource:
    """Lines of the step, and the variables in it.

    Attributes:
        helpers: functions and arrays that the step uses.
        reasons: why parts of the aircraft are not translated, in the order of the files.
        recalled: the aircraft's own columns that JSBSim has no property for.
        shared: properties that more than one component writes.
    """

    def __init__(self, constant: Callable[[str], float | None]) -> None:
        """Start without lines.

        Args:
            constant: returns the value of a property after loading; None: there is none.
        """
        self._constant = constant
        self._lines: list[_Line] = []
        self._depth = 0
        self._declared: set[str] = set()  # written somewhere in the frame, or given by a file
        self._variables: dict[str, str] = {}  # by property
        self._loaded: dict[str, None] = {}  # read before they are written, in this order
        self._written: dict[str, None] = {}
        self._read: set[str] = set()
        self._frame: set[str] = set()  # properties that the frame provides
        self._explicit: set[str] = set()  # that the files write themselves
        self._count = 0
        self._cells = 0
        self.helpers: list[str] = []
        self.reasons: list[str] = []
        self.recalled: dict[str, Recalled] = {}
        self.shared: set[str] = set()

    # properties

    def declare(self, *names: str) -> None:
        """Announce properties that the aircraft's files write or give a value."""
        self._declared.update(map(plain, names))

    def declare_frame(self, *names: str) -> None:
        """Announce properties that the frame provides."""
        self._frame.update(names)
        self._declared.update(names)

    def variable(self, name: str) -> str:
        """Return the variable of a property."""
        if name not in self._variables:
            base = "p_" + re.sub(r"\W", "_", name, flags=re.ASCII)
            taken = set(self._variables.values())
            while base in taken:
                base += "_"
            self._variables[name] = base
        return self._variables[name]

    def read(self, name: str, node: XmlNode) -> str:
        """Return the expression of a property that an element reads."""
        name = name.strip()
        if name.startswith("-"):
            return f"(-{self.read(name[1:], node)})"
        name = plain(name)
        if name == "simulation/dt":
            return "dt"
        if name == "forces/hold-down" or _WEIGHT_ON_WHEELS.fullmatch(name):
            return "0.0"  # of aircraft in flight
        if name.startswith(_CONSTANT) and name not in self._declared:
            if (value := self._constant(name)) is None:
                node.fail(f"reads {name}, which JSBSim does not have")
            return literal(value)
        if name not in self._declared:
            node.fail(f"reads {name}, which is not translated")
        self._read.add(name)
        if name not in self._written:
            self._loaded[name] = None
        return self.variable(name)

    def write(self, name: str, value: str, node: XmlNode) -> None:
        """Set a property that the aircraft's files write."""
        name = plain(name)
        group = re.split(r"[/\[]", name, maxsplit=1)[0]
        kept = group in JSBSIM_PROPERTIES and group not in _WRITABLE and name not in GEAR
        if name in self._frame or kept:
            node.fail(f"writes {name}, which the compiled model keeps to itself")
        self.emit(f"{self.variable(name)} = {value}")
        self._declared.add(name)
        self._written[name] = None
        self._explicit.add(name)
        if found := _POSITION.fullmatch(name):
            self._write_position(*found.groups())

    def provide(self, name: str, value: str) -> None:
        """Set a property of the frame; the line goes if no file reads the property."""
        self._lines.append(_Line(self._indented(f"{self.variable(name)} = {value}"), name))
        self._written[name] = None

    def _write_position(self, surface: str, unit: str) -> None:
        """Set the same position of a surface in JSBSim's other units."""
        now = self.variable(f"fcs/{surface}-pos-{unit}")
        if unit == "rad":
            self.provide(f"fcs/{surface}-pos-deg", f"{now} * DEGREES")
            self.provide(f"fcs/mag-{surface}-pos-rad", f"abs({now})")
        else:
            self.provide(f"fcs/{surface}-pos-rad", f"{now} * {math.pi / 180.0!r}")
            self.provide(f"fcs/mag-{surface}-pos-rad", f"abs({now} * {math.pi / 180.0!r})")

    def carry(self, name: str) -> str:
        """Return the variable of a property that is state."""
        self._declared.add(name)
        self._loaded[name] = self._written[name] = None
        return self.variable(name)

    def recall_input(self, owner: str, text: str, node: XmlNode, frames: int) -> str:
        """Return the variable of an input of a component, some frames ago.

        Args:
            owner: property of the component.
            text: property of the input, maybe with a sign.
            node: the input.
            frames: 1 or more.
        """
        self.read(text, node)
        sign, name = (-1.0, text.strip()[1:]) if text.strip().startswith("-") else (1.0, text)
        name = plain(name.strip())
        # what is written after the component was read one frame later
        ago = frames if name not in self._written else frames - 1
        column = f"memory/{owner}/input-{frames}"
        self.recalled[column] = Recalled(name, sign, ago, -math.inf, math.inf)
        return self.carry(column)

    def recall_output(self, owner: str, frames: int, low: float, high: float) -> str:
        """Return the variable of an output of a component before its limits, some frames ago."""
        column = f"memory/{owner}/output-{frames}"
        self.recalled[column] = Recalled(owner, 1.0, frames - 1, low, high)
        return self.carry(column)

    def recall_limited(self, owner: str, part: str, low: float, high: float, step: float) -> str:
        """Return the variable of a part of a component that is its output where it is not limited.

        Args:
            owner: property of the component.
            part: of the component.
            low: limit of the output.
            high: limit of the output.
            step: largest change of the output in a frame.
        """
        column = f"memory/{owner}/{part}"
        self.recalled[column] = Recalled(owner, 1.0, 0, low, high, step)
        return self.carry(column)

    # lines

    def emit(self, text: str) -> None:
        """Write lines."""
        self._lines += [_Line(self._indented(line)) for line in text.strip("\n").splitlines()]

    def assign(self, value: str) -> str:
        """Return a new variable with a value."""
        name = self.name()
        self.emit(f"{name} = {value}")
        return name

    def name(self, prefix: str = "t") -> str:
        """Return a name that is not used yet."""
        self._count += 1
        return f"{prefix}{self._count}"

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """Write a line, and indent those of the block."""
        self.emit(head)
        self._depth += 1
        try:
            yield
        finally:
            self._depth -= 1

    def array(self, values: Sequence[float], node: XmlNode, shape: str = "") -> str:
        """Write an array beside the step, and return its name.

        Args:
            values: of the array.
            node: which has them.
            shape: call that shapes it.

        Raises:
            NotTranslated: the aircraft has too many numbers in its tables.
        """
        self._cells += len(values)
        if self._cells > MOST_CELLS:
            node.fail(f"makes more than {MOST_CELLS:,} numbers in tables, which is the most")
        name = self.name("data_")
        numbers = ", ".join(map(literal, values))
        self.helpers.append(f"{name} = np.array([{numbers}]){shape}")
        return name

    def attempt(self, node: XmlNode, write: Callable[[], None]) -> None:
        """Write the lines of a part of the aircraft; why it is not translated becomes a reason."""
        if not any(each.is_refused for each in node.walk()):  # whose reason is there already
            self.attempt_all(node, write)

    def attempt_all(self, node: XmlNode, write: Callable[[], None]) -> None:
        """Do the same for an element with parts that may be refused."""
        try:
            write()
        except NotTranslated as error:
            self.reasons.append(str(error))
        except Exception as error:
            raise_memory_shortage(error)
            self.reasons.append(node.describe(f"cannot be translated ({describe_error(error)})"))

    def _indented(self, line: str) -> str:
        return f"{_INDENT * self._depth}{line}" if line.strip() else ""

    def lines(self) -> list[str]:
        """Return the lines, without properties that nothing reads."""
        read = self._read
        return [each.text for each in self._lines if not each.provides or each.provides in read]

    def loaded(self) -> list[str]:
        """Return the properties, beside those of the frame, that are read before written."""
        return [each for each in self._loaded if each not in COLUMN]

    def loaded_frame(self) -> list[str]:
        """Return the columns of the frame that the files read before they are written."""
        return [each for each in self._loaded if each in COLUMN]

    def stored(self) -> list[str]:
        """Return the properties that are written and read before, or that the files write."""
        return [
            each
            for each in self._written
            if each not in COLUMN and (each in self._loaded or each in self._explicit)
        ]
