"""Settings of a file in another folder, with paths that a command line here understands."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from testbed.scenario.problems import ScenarioError
from testbed.scenario.reference_fields import ReferenceKind, kinds_of_keys
from testbed.scenario.references import FINDERS, FMU, find_code, is_file, library
from testbed.scenario.schema import Scenario
from testbed.scenario.yaml_io import parse, plain, to_inline


def setting_from_here(text: str, folder: Path, here: Path) -> str:
    """Return a setting with the files that are found from `folder` as paths from `here`.

    What is not found there stays as it is.

    Args:
        text: `key.path=value`.
        folder: of the file that has the setting.
        here: the working directory.
    """
    key, _, value = text.partition("=")
    last = key.rpartition(".")[2]
    if last not in _movers() and "{" not in value and "[" not in value:
        return text  # most settings are numbers
    try:
        before = plain(parse(value, text, folder))
    except ScenarioError:
        return text
    moved = _moved(last, before, folder, here)
    return text if moved == before else f"{key}={to_inline(moved)}"


def _moved(key: str, value: Any, folder: Path, here: Path) -> Any:  # noqa: ANN401 - plain data
    if isinstance(value, Mapping):
        return {name: _moved(str(name), each, folder, here) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_moved(key, each, folder, here) for each in value]
    if not isinstance(value, str) or key not in _movers():
        return value
    with suppress(ScenarioError):
        return _movers()[key](value, folder, here)
    return value


def _short(reference: str, name: str, here: Path) -> str:
    """Return the path from `here` of a reference, or the name of what the library has."""
    path = Path(reference)
    if not path.is_absolute():
        return name
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def _code(name: str, folder: Path, here: Path) -> str:
    if name.endswith(FMU):
        return _short(find_code(name, folder=folder), name, here)
    if ":" not in name:  # of the library
        return name
    file, _, object_name = find_code(name, folder=folder).rpartition(":")
    if not file.endswith(".py") or Path(file).parent == library() / "scenarios":
        return name
    return f"{_short(file, name, here)}:{object_name}"


def _tune(name: str, folder: Path, here: Path) -> str:
    path = (folder / name).resolve()
    return _short(str(path), name, here) if name.endswith(".param") and is_file(path) else name


def _file(kind: ReferenceKind, name: str, folder: Path, here: Path) -> str:
    finder = FINDERS[kind]
    return _short(finder.name(finder.find(name, folder=folder)), name, here)


@functools.cache
def _movers() -> Mapping[str, Callable[[str, Path, Path], str]]:
    """Return what moves a reference, by the last key of a setting."""
    own = {"code": _code, "tune": _tune}
    kinds = kinds_of_keys(Scenario)
    return {key: own.get(kind, functools.partial(_file, kind)) for key, kind in kinds.items()}
