"""Settings of a file in another folder, with paths that a command line here understands."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from testbed.scenario.problems import ScenarioError
from testbed.scenario.references import (
    aircraft_reference,
    data_reference,
    find_aircraft,
    find_code,
    find_data,
    find_gains,
    find_scenario,
    is_file,
    library,
    scenario_reference,
)
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
    if last not in _MOVERS and "{" not in value and "[" not in value:
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
    if not isinstance(value, str) or key not in _MOVERS:
        return value
    with suppress(ScenarioError):
        return _MOVERS[key](value, folder, here)
    return value


def _short(reference: str, name: str, here: Path) -> str:
    """Return the path from `here` of a reference, or the name of what the library has."""
    path = Path(reference)
    if not path.is_absolute():
        return name
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def _code(name: str, folder: Path, here: Path) -> str:
    if ":" not in name:
        return name
    file, _, object_name = find_code(name, folder=folder).rpartition(":")
    if not file.endswith(".py") or Path(file).parent == library() / "scenarios":
        return name
    return f"{_short(file, name, here)}:{object_name}"


def _tune(name: str, folder: Path, here: Path) -> str:
    path = (folder / name).resolve()
    return _short(str(path), name, here) if name.endswith(".param") and is_file(path) else name


def _aircraft(name: str, folder: Path, here: Path) -> str:
    return _short(aircraft_reference(find_aircraft(name, folder=folder)), name, here)


def _data(name: str, folder: Path, here: Path) -> str:
    return _short(data_reference(find_data(name, folder=folder)), name, here)


def _gains(name: str, folder: Path, here: Path) -> str:
    return _short(str(find_gains(name, folder)), name, here)


def _scenario(name: str, folder: Path, here: Path) -> str:
    return _short(scenario_reference(find_scenario(name, folder=folder)), name, here)


_MOVERS: Mapping[str, Callable[[str, Path, Path], str]] = {
    **dict.fromkeys(("law", "function", "f", "g"), _code),
    "aircraft": _aircraft,
    "tune": _tune,
    "file": _data,
    "middle_loop": _gains,
    "scenario": _scenario,
}
