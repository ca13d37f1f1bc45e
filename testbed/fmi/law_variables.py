"""The variables of an FMU that is a formation law, by the fields of the law's contract.

`own.position_ned[1]` is the north component of the own position, `inbox.velocity_ned[1,2]` the east
component of the velocity in the leader's message: indices begin with 1, and the leader is the first
of N aircraft. In FMI 3.0 a field may be one array, whose N is a structural parameter.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from testbed.core.errors import InputError
from testbed.fmi.model_description import ModelDescription, Variable
from testbed.fmi.units import unit_fits
from testbed.formation import fmu_step as places
from testbed.scenario.problems import did_you_mean

NOT_USED = "none"  # in `controller.map`: this variable is left as it is
_INDEXED = re.compile(r"(.+?)\[\s*(\d{1,6}(?:\s*,\s*\d{1,6})*)\s*\]")
_N, _VECTOR = "N", 3


@dataclass(frozen=True, slots=True)
class Field:
    """A field of the contract: sizes (3 or N), unit, and the first place of its numbers."""

    shape: tuple[int | str, ...]
    unit: str
    place: int = 0
    is_flag: bool = False


_V, _M = (_VECTOR,), (_N, _VECTOR)
INPUTS: Mapping[str, Field] = {
    "now": Field((), "s", places.NOW),
    "own.position_ned": Field(_V, "m", places.POSITION),
    "own.velocity_ned": Field(_V, "m/s", places.VELOCITY),
    "own.acceleration_ned": Field(_V, "m/s2", places.ACCELERATION),
    "own.euler": Field(_V, "rad", places.EULER),
    "own.rates_body": Field(_V, "rad/s", places.RATES),
    "own.wind_ned": Field(_V, "m/s", places.WIND),
    "own.airspeed": Field((), "m/s", places.AIRSPEED),
    "own.equivalent_airspeed": Field((), "m/s", places.EQUIVALENT_AIRSPEED),
    "inbox.stamp_s": Field((_N,), "s", places.STAMP),
    "inbox.received_s": Field((_N,), "s", places.RECEIVED),
    "inbox.age_s": Field((_N,), "s", places.AGE),
    "inbox.turn_rate": Field((_N,), "rad/s", places.TURN_RATE),
    "inbox.failed": Field((_N,), "1", places.FAILED, is_flag=True),
    "inbox.position_ned": Field(_M, "m", places.MESSAGE_POSITION),
    "inbox.velocity_ned": Field(_M, "m/s", places.MESSAGE_VELOCITY),
    "inbox.acceleration_ned": Field(_M, "m/s2", places.MESSAGE_ACCELERATION),
    "inbox.euler": Field(_M, "rad", places.MESSAGE_EULER),
    "inbox.euler_rates": Field(_M, "rad/s", places.MESSAGE_EULER_RATES),
}
PARAMETERS: Mapping[str, Field] = {
    "config.agents": Field((), "1"),
    "config.slot": Field(_V, "m"),  # the own row of config.offsets
    "config.offsets": Field(_M, "m"),
    "config.gains": Field(_M, "1"),
    "config.airspeed_min": Field((), "m/s"),
    "config.airspeed_max": Field((), "m/s"),
    "config.ground_speed_min": Field((), "m/s"),
    "config.ground_speed_max": Field((), "m/s"),
    "config.speed_min": Field((), "m/s"),
    "config.speed_max": Field((), "m/s"),
    "config.speed_pole": Field((), "1/s"),
    "config.pitch_limit": Field((), "rad"),
    "config.roll_limit": Field((), "rad"),
    "config.trim_throttle": Field((), "1"),
    "config.trim_airspeed": Field((), "m/s"),
    "config.dt": Field((), "s"),
    "config.leader_timeout_s": Field((), "s"),
    "config.neighbour_timeout_s": Field((), "s"),
}
OUTPUTS: Mapping[str, Mapping[str, Field]] = {
    "fly-by-wire": {
        "pitch": Field((), "rad", 0),
        "roll": Field((), "rad", 1),
        "throttle": Field((), "1", 2),
    },
    "velocity": {
        "velocity_ned": Field(_V, "m/s", 0),
        "acceleration_ned": Field(_V, "m/s2", 3),
    },
    "unicycle": {
        "speed": Field((), "m/s", 0),
        "omega": Field(_V, "rad/s", 1),
        "speed_desired": Field((), "m/s", 4),
        "direction": Field(_V, "1", 5),
    },
}
_OPTIONAL = "acceleration_ned"
_ALL_OUTPUTS = {name: each for fields in OUTPUTS.values() for name, each in fields.items()}
_WHOLE = tuple(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64))


@dataclass(frozen=True, slots=True)
class ParameterSetting:
    """Values that a parameter has before a flight: numbers of a field, or an option's.

    Attributes:
        variable: that is set.
        name: field of the configuration; "": an option.
        indices: of the numbers of the field, in the order of the variable.
        values: of an option.
    """

    variable: Variable
    name: str = ""
    indices: tuple[tuple[int, ...], ...] = ()
    values: tuple[Any, ...] = ()


@dataclass(slots=True)
class LawVariables:
    """How the variables of an FMU belong to the law's contract.

    Attributes:
        kind: of its outputs, of `OUTPUTS`.
        inputs: of reals: value reference and places.
        flags: of Booleans, the same.
        outputs: value reference and places in the command.
        settings: of parameters.
        structural: sizes of structural parameters that differ from their start values.
        aircraft: N of which messages are read, the first ones.
    """

    kind: str = ""
    inputs: list[tuple[int, tuple[int, ...]]] = field(default_factory=list)
    flags: list[tuple[int, tuple[int, ...]]] = field(default_factory=list)
    outputs: list[tuple[int, tuple[int, ...]]] = field(default_factory=list)
    settings: list[ParameterSetting] = field(default_factory=list)
    structural: dict[str, int] = field(default_factory=dict)
    aircraft: int = 0

    @property
    def config_names(self) -> set[str]:
        """Fields of the configuration that are read."""
        return {each.name.removeprefix("config.") for each in self.settings if each.name}


def match_variables(
    model: ModelDescription,
    names: Mapping[str, str],
    options: Mapping[str, Any],
    aircraft: int,
    dt: float,
) -> LawVariables:
    """Match the variables of an FMU with the contract.

    Args:
        model: of the FMU.
        names: `controller.map`: names in the FMU, with the fields that they are.
        options: `controller.options`, values of other parameters.
        aircraft: N of the flight.
        dt: control period, s.

    Raises:
        InputError: a name, type, unit, size, start value or the step does not fit; or an option or
            an entry of the map belongs to no variable.
    """
    return _Matching(model, names, options, aircraft).match(dt)


class _Matching:
    def __init__(
        self,
        model: ModelDescription,
        names: Mapping[str, str],
        options: Mapping[str, Any],
        aircraft: int,
    ) -> None:
        self._model, self._names, self._options = model, names, options
        self._n, self._found = aircraft, LawVariables()
        self._used_names, self._used_options = set[str](), set[str]()
        self._seen: dict[str, set[tuple[int, ...]]] = {}  # numbers of outputs
        self._sizes: dict[int, int] = {}  # of structural parameters, by reference

    def match(self, dt: float) -> LawVariables:
        for each in self._model.variables.values():
            if each.causality == "input":
                self._input(each)
            elif each.causality == "output":
                self._output(each)
            elif each.causality == "parameter":
                self._parameter(each)
        self._check_all_used()
        self._set_kind()
        self._set_sizes()
        self._check_step(dt)
        return self._found

    def _field_of(self, variable: Variable) -> tuple[str, tuple[int, ...]]:
        """Return the name of a field, by the map where it has one, and the indices of a scalar."""
        name = variable.name
        base, indices = _split(name)
        for key, tail in ((name, ()), (base, indices)):
            if key in self._names:
                self._used_names.add(key)
                given, own = _split(self._names[key])
                return given, own or tail
        return base, indices

    def _input(self, variable: Variable) -> None:
        name, indices = self._field_of(variable)
        if name == NOT_USED:
            return
        if name not in INPUTS:
            self._refuse_name(variable, name, "input", INPUTS, PARAMETERS, ("parameter",))
        known = INPUTS[name]
        self._check(variable, known, ("Boolean",) if known.is_flag else ("Float64",))
        numbers = self._numbers(variable, name, known, indices)
        of_message = known.shape[:1] == (_N,)
        if of_message:
            self._found.aircraft = max(self._found.aircraft, *(each[0] + 1 for each in numbers))
        found = tuple(_place(known, each, of_message) for each in numbers)
        (self._found.flags if known.is_flag else self._found.inputs).append(
            (variable.reference, found)
        )

    def _output(self, variable: Variable) -> None:
        name, indices = self._field_of(variable)
        if name == NOT_USED:
            return
        if name not in _ALL_OUTPUTS:
            self._refuse_name(variable, name, "output", _ALL_OUTPUTS, {}, ())
        known = _ALL_OUTPUTS[name]
        self._check(variable, known, ("Float64",))
        numbers = self._numbers(variable, name, known, indices)
        seen = self._seen.setdefault(name, set())
        if seen & set(numbers):
            self._model.refuse(variable, f"is {name} a second time (leave one out)")
        seen.update(numbers)
        found = tuple(_place(known, each, False) for each in numbers)
        self._found.outputs.append((variable.reference, found))

    def _parameter(self, variable: Variable) -> None:
        name, indices = self._field_of(variable)
        if name == NOT_USED:
            return
        if name not in PARAMETERS:
            if name.startswith("config.") or name in INPUTS:
                self._refuse_name(variable, name, "parameter", PARAMETERS, INPUTS, ("input",))
            self._option(variable, name, indices)
            return
        known = PARAMETERS[name]
        self._check(variable, known, ("Float64", *(_WHOLE if name == "config.agents" else ())))
        numbers = self._numbers(variable, name, known, indices)
        self._found.settings.append(ParameterSetting(variable, name, tuple(numbers)))

    def _option(self, variable: Variable, base: str, indices: tuple[int, ...]) -> None:
        """Set a parameter of the law's own, where the options have a value of its name."""
        self._check_start(variable)
        for key, of_list in ((variable.name, False), (base, bool(indices))):
            if key not in self._options:
                continue
            self._used_options.add(key)
            value = self._options[key]
            if of_list:
                k = indices[0] - 1
                if not isinstance(value, list | tuple) or len(indices) > 1 or k >= len(value):
                    self._model.refuse(
                        variable, f"has no value in controller.options: {key} is {value!r}"
                    )
                value = value[k]
            values = tuple(value) if isinstance(value, list | tuple) else (value,)
            if len(values) != (size := self._size(variable)):
                self._model.refuse(
                    variable,
                    f"has {size} number{'s' * (size != 1)}, and controller.options {key} "
                    f"{len(values)} (write {size})",
                )
            self._found.settings.append(
                ParameterSetting(
                    variable, values=tuple(self._option_value(variable, key, v) for v in values)
                )
            )
            return

    def _option_value(self, variable: Variable, key: str, value: Any) -> Any:  # noqa: ANN401
        whole = variable.type in _WHOLE
        fits = {
            "Boolean": isinstance(value, bool),
            "String": isinstance(value, str),
        }.get(variable.type, isinstance(value, int | float) and not isinstance(value, bool))
        if whole and fits:
            fits = float(value).is_integer()
        if not fits:
            kind = {"Boolean": "true or false", "String": "a text"}.get(
                variable.type, "a whole number" if whole else "a number"
            )
            self._model.refuse(
                variable,
                f"is {variable.type}, and controller.options {key} is {value!r} (write {kind})",
            )
        if not isinstance(value, str) and not variable.minimum <= value <= variable.maximum:
            self._model.refuse(
                variable,
                f"is {variable.minimum:g} to {variable.maximum:g}, and controller.options {key} is "
                f"{value:g}",
            )
        return int(value) if whole else value

    def _check(self, variable: Variable, known: Field, types: tuple[str, ...]) -> None:
        """Check type, unit and start value."""
        if variable.type not in types:
            wanted = (
                types[0]
                if self._model.version == 3
                else {"Float64": "Real"}.get(types[0], types[0])
            )
            self._model.refuse(variable, f"is {variable.type} (write {wanted})")
        if not unit_fits(variable.unit, known.unit, self._model.units):
            self._model.refuse(
                variable, f"has the unit {variable.unit[:40]!r} (write {known.unit})"
            )
        self._check_start(variable)

    def _check_start(self, variable: Variable) -> None:
        if variable.start is None or variable.type in ("String", "Binary", "Clock"):
            return
        for text in variable.start:
            if variable.type == "Boolean":
                if text not in ("true", "false", "0", "1"):
                    self._model.refuse(variable, f"has the start value {text[:40]!r} (write true)")
                continue
            try:
                value = float(text)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                self._model.refuse(
                    variable, f"has the start value {text[:40]!r} (write a finite number)"
                )
            if not variable.minimum <= value <= variable.maximum:
                self._model.refuse(
                    variable,
                    f"has the start value {text[:40]}, which is not between its min "
                    f"{variable.minimum:g} and max {variable.maximum:g}",
                )
        size = self._start_size(variable)
        if len(variable.start) not in (1, size):
            self._model.refuse(
                variable, f"has {len(variable.start)} start values (write {size}, or one for all)"
            )

    def _start_size(self, variable: Variable) -> int:
        """Return the numbers of a variable with structural parameters at their start values."""
        sizes = []
        for each in variable.dimensions:
            if each.size is not None:
                sizes.append(each.size)
                continue
            start = self._structural(variable, each.reference).start
            sizes.append(int(start[0]) if start and start[0].isdigit() else 0)
        return math.prod(sizes)

    def _structural(self, variable: Variable, reference: int | None) -> Variable:
        for each in self._model.variables.values():
            if each.reference == reference and each.causality == "structuralParameter":
                return each
        self._model.refuse(
            variable, f"has a dimension of value reference {reference}, no structural parameter"
        )

    def _size(self, variable: Variable) -> int:
        """Return the numbers of an option's variable."""
        return self._start_size(variable)

    def _numbers(
        self, variable: Variable, name: str, known: Field, indices: tuple[int, ...]
    ) -> list[tuple[int, ...]]:
        """Return the indices, from 0, of the numbers of a field that a variable has."""
        sizes = tuple(self._n if each == _N else int(each) for each in known.shape)
        wanted = f"{name}[{','.join(map(str, known.shape))}]" if sizes else name
        if variable.dimensions:
            if indices or len(variable.dimensions) != len(sizes):
                self._model.refuse(
                    variable, f"has {len(variable.dimensions)} dimensions (write {wanted})"
                )
            for each, size in zip(variable.dimensions, sizes, strict=True):
                self._match_size(variable, each.size, each.reference, size)
            return list(itertools.product(*map(range, sizes)))
        if len(indices) != len(sizes):
            self._model.refuse(variable, f"is one number of {wanted} (write {len(sizes)} indices)")
        for index, size, kind in zip(indices, sizes, known.shape, strict=True):
            if not 1 <= index <= size:
                of = (
                    f"the formation has {size} aircraft" if kind == _N else f"it has {size} numbers"
                )
                self._model.refuse(variable, f"has the index {index} ({of}, from 1 on)")
        return [tuple(index - 1 for index in indices)]

    def _match_size(
        self, variable: Variable, given: int | None, reference: int | None, size: int
    ) -> None:
        """Check a fixed size, or set that of a structural parameter."""
        if given is not None:
            if given != size:
                self._model.refuse(
                    variable,
                    f"has a dimension of {given}, which is {size} here (name a structural "
                    "parameter as its dimension)",
                )
            return
        parameter = self._structural(variable, reference)
        assert reference is not None, "of a structural parameter"
        before = self._sizes.setdefault(reference, size)
        if before != size:
            self._model.refuse(parameter, f"is the size of arrays of {before} and of {size}")
        if not parameter.minimum <= size <= parameter.maximum:
            self._model.refuse(
                parameter,
                f"is {parameter.minimum:g} to {parameter.maximum:g}, and the formation has {size} "
                "aircraft",
            )

    def _refuse_name(
        self,
        variable: Variable,
        name: str,
        kind: str,
        known: Mapping[str, Field],
        others: Mapping[str, Field],
        remedy: tuple[str, ...],
    ) -> None:
        if name in others:
            self._model.refuse(
                variable,
                f"is an {kind} (write the causality {remedy[0]})"
                if kind == "input"
                else f"is a {kind} (write the causality {remedy[0]})",
            )
        hint = did_you_mean(name, known)
        some = ", ".join(list(known)[:3])
        self._model.refuse(
            variable,
            f"is an {kind} of no field{hint} (name it as {some}, …, or write it in controller.map)"
            if kind != "parameter"
            else f"is no field of the configuration{hint}",
        )

    def _check_all_used(self) -> None:
        """Refuse names and options that no variable has."""
        variables = self._model.variables.values()
        for key, value in self._names.items():
            if key not in self._used_names:
                known = [each.name for each in variables if each.causality in _MATCHED]
                raise InputError(
                    f"controller.map: {self._model.file} has no variable {key!r}"
                    f"{did_you_mean(key, known)}"
                )
            base, _ = _split(value)
            everything = {**INPUTS, **PARAMETERS, **_ALL_OUTPUTS, NOT_USED: None}
            if base not in everything:
                raise InputError(
                    f"controller.map: {key!r} is {value!r}, which is no field"
                    f"{did_you_mean(base, everything)}"
                )
        own = [each.name for each in variables if each.causality == "parameter"]
        for key in self._options:
            if key not in self._used_options:
                known = [each for each in own if not each.startswith("config.")]
                raise InputError(
                    f"controller.options: {self._model.file} has no parameter {key!r}"
                    f"{did_you_mean(key, known)} (it has {', '.join(known[:10]) or 'none'})"
                )

    def _set_kind(self) -> None:
        """Set the kind of the outputs, which must be complete."""
        kinds = [kind for kind, fields in OUTPUTS.items() if set(fields) & set(self._seen)]
        choices = "; or ".join(", ".join(fields) for fields in OUTPUTS.values())
        if len(kinds) != 1:
            what = "has no command" if not kinds else "has outputs of several commands"
            raise InputError(f"{self._model.file}: {what} (name its outputs {choices})")
        self._found.kind = kinds[0]
        for name, known in OUTPUTS[kinds[0]].items():
            size = math.prod(int(each) for each in known.shape)
            missing = size - len(self._seen.get(name, ()))
            if missing and not (name == _OPTIONAL and missing == size):
                raise InputError(
                    f"{self._model.file}: has {'not all numbers of' if missing < size else 'no'} "
                    f"output {name} (a command is {choices})"
                )

    def _set_sizes(self) -> None:
        for each in self._model.variables.values():
            size = (
                self._sizes.get(each.reference) if each.causality == "structuralParameter" else None
            )
            if size is not None and each.start != (str(size),):
                self._found.structural[each.name] = size

    def _check_step(self, dt: float) -> None:
        step = self._model.step_s
        if step is None:
            return
        ratio = dt / step
        if ratio < 0.5 or abs(ratio - round(ratio)) > 1e-6 * ratio:
            raise InputError(
                f"{self._model.file}: its default step {step:g} s does not divide the control "
                f"period {dt:g} s (export it with a step of {dt:g} s, or write rates.control_hz)"
            )


_MATCHED = ("input", "output", "parameter")


def _place(known: Field, index: Iterable[int], of_message: bool) -> int:
    """Return the place of a number of a field."""
    first, *rest = (*index, 0)
    if not of_message:
        return known.place + first
    return places.FIRST_MESSAGE + places.MESSAGE_SIZE * first + known.place + rest[0]


def _split(name: str) -> tuple[str, tuple[int, ...]]:
    """Return a name and its indices: `own.euler[2]` is own.euler and (2,)."""
    found = _INDEXED.fullmatch(name)
    if found is None:
        return name, ()
    return found[1], tuple(int(each) for each in found[2].split(","))
