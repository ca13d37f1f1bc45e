"""Check arguments of Python by the fields of the files, so that each bound stands in one place."""

import functools
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, Field, ValidationError, create_model

from testbed.core.errors import InputError
from testbed.scenario.fields import NotNegative, Section, Whole
from testbed.scenario.problems import FilePosition, ScenarioError
from testbed.scenario.validate import explain, shown_value, validate
from testbed.scenario.yaml_io import plant

_NOWHERE = FilePosition("")
_MAX_DEPTH = 50  # of lists and maps in an argument
ModelT = TypeVar("ModelT", bound=BaseModel)


def check_argument(name: str, value: object, model: type[BaseModel], key: str) -> Any:  # noqa: ANN401 - the field's type
    """Return an argument, checked as a key of a file.

    Args:
        name: of the argument, as errors begin.
        value: numbers and arrays of NumPy, paths and tuples are read as plain values.
        model: the section of the files,
        key: and its key.

    Raises:
        InputError: the value is not allowed there; the text has the name, the value, and what to
            write instead.
    """
    data = to_plain(name, value)
    try:
        return getattr(validate(plant({key: data}, _NOWHERE), _holder(model, key)), key)
    except ScenarioError as error:
        first = error.problems[0]
        raise InputError(f"{'.'.join((name, *first.path[1:]))}: {first.text}") from None


def check_arguments(model: type[ModelT], values: Mapping[str, object]) -> ModelT:
    """Return the arguments of a call as a section.

    Raises:
        InputError: one of them is unknown or not allowed; the text begins with its name.
    """
    data = {name: to_plain(name, value) for name, value in values.items()}
    try:
        return validate(plant(data, _NOWHERE), model)
    except ScenarioError as error:
        raise InputError(str(error.problems[0])) from None


def with_changes(section: ModelT, **changes: object) -> ModelT:
    """Return a copy of a section with other values, validated as those of a file.

    Raises:
        InputError: a value is not allowed, or contradicts another one; the text begins with its
            key.
    """
    model = type(section)
    values = {key: getattr(section, key) for key in section.model_fields_set} | changes
    try:
        return model.model_validate(values, by_name=True, by_alias=True)
    except ValidationError as error:
        data = section.model_dump(mode="json", by_alias=True)
        data |= {key: to_plain(key, value) for key, value in changes.items()}
        raise InputError(str(explain(error, plant(data, _NOWHERE), model)[0])) from None


def check_count(name: str, value: object) -> int:
    """Return a number of things, such as processes.

    Raises:
        InputError: it is not a whole number from 1 to a million.
    """
    count: int = check_argument(name, value, _Arguments, "count")
    return count


def check_not_negative(name: str, value: object) -> float:
    """Return a number from 0 to a million.

    Raises:
        InputError: it is none.
    """
    number: float = check_argument(name, value, _Arguments, "not_negative")
    return number


def check_overrides(name: str, value: object) -> tuple[str, ...]:
    """Return settings, `key=value` each.

    Raises:
        InputError: it is not a list of texts.
    """
    if isinstance(value, str):
        raise InputError(f"{name}: is {shown_value(value)} (write a list: [{shown_value(value)}])")
    texts: tuple[str, ...] = check_argument(name, value, _Arguments, "overrides")
    return texts


def check_list(name: str, value: object, what: str) -> list[Any]:
    """Return the elements of a list, tuple, range or array (n,).

    Args:
        name: of the argument, as errors begin.
        value: of it; sets have no order, and texts and bytes are none of these.
        what: its elements are, as the error says what to write.

    Raises:
        InputError: it is none.
    """
    if getattr(value, "ndim", None) == 1 and hasattr(value, "tolist"):  # of NumPy
        return list(value.tolist())
    if isinstance(value, list | tuple | range):
        return list(value)
    raise InputError(f"{name}: is {shown_value(value)} (write a list: {what})")


def check_path(name: str, value: object) -> Path:
    """Return a path.

    Raises:
        InputError: it is neither a text nor a path, or has a null character.
    """
    if not isinstance(value, str | os.PathLike) or isinstance(os.fspath(value), bytes):
        raise InputError(f"{name}: is {shown_value(value)} (write a text or a path)")
    text = str(value)
    try:
        valid = text and b"\0" not in os.fsencode(text)
    except UnicodeEncodeError:
        valid = False
    if not valid:
        raise InputError(f"{name}: is {shown_value(text)}, not a path")
    return Path(text)


def check_calls(name: str, value: object, methods: Sequence[str] = ("__call__",)) -> None:
    """Check that an object has methods.

    Raises:
        InputError: one is missing.
    """
    missing = [method for method in methods if not callable(getattr(value, method, None))]
    if missing:
        what = "a function" if missing == ["__call__"] else f"an object with {', '.join(methods)}"
        raise InputError(f"{name}: is {shown_value(value)} (write {what})")


def to_plain(name: str, value: object, depth: int = 0) -> Any:  # noqa: ANN401 - plain data
    """Return a value of Python as a file would have it: dicts, lists and scalars.

    Raises:
        InputError: it is nested without end, or has bytes.
    """
    if isinstance(value, bytes | bytearray):  # which pydantic reads as text
        raise InputError(f"{name}: is {shown_value(value)} (write a text or a number)")
    if depth > _MAX_DEPTH:
        raise InputError(f"{name}: is nested too deeply (write at most {_MAX_DEPTH} levels)")
    if hasattr(value, "tolist"):  # of NumPy
        return value.tolist()
    if isinstance(value, Mapping):
        return {
            key if isinstance(key, str) else shown_value(key): to_plain(name, each, depth + 1)
            for key, each in value.items()
        }
    if isinstance(value, list | tuple):
        return [to_plain(name, each, depth + 1) for each in value]
    if isinstance(value, BaseModel):
        return value.model_dump(mode="json", by_alias=True)
    return os.fspath(value) if isinstance(value, os.PathLike) else value


class _Arguments(Section):
    """Arguments that no file has."""

    count: Whole = Field(ge=1, le=1_000_000, description="A number above 0.")
    not_negative: NotNegative = Field(description="A number from 0 on.")
    overrides: tuple[str, ...] = Field(description="Texts key=value.")


@functools.cache
def _holder(model: type[BaseModel], key: str) -> type[Section]:
    """Return a section with one of the keys of another, with its type, bounds and description."""
    field = model.model_fields[key]
    holder: type[Section] = create_model(  # type: ignore[call-overload]  # fields by name
        model.__name__, __base__=Section, **{key: (field.rebuild_annotation(), field)}
    )
    return holder
