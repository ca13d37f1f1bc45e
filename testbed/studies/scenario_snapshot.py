"""Snapshot of a resolved scenario and its files, and the differences between two snapshots."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from testbed.autopilot.param_file import read_values
from testbed.core.errors import InputError
from testbed.core.input_files import MAX_TABLE_BYTES, read_bounded
from testbed.scenario import Scenario, code_references, find_aircraft, find_code, find_data
from testbed.scenario.yaml_io import plain, read

# keys of `scenario` that change no number, and the seed, which is stored separately
_LEFT_OUT = ("question", "expectation", "published", "name", "seed")
_NO_NUMBERS = ("log", "expect")  # sections that change no number
_SUFFIXES = (".xml", ".yaml", ".param", ".csv", ".py")


def snapshot(scenario: Scenario, folder: Path) -> dict[str, Any]:
    """Return the resolved scenario without keys that change no number.

    Args:
        scenario: resolved.
        folder: of its file; paths in the snapshot are relative to it.
    """
    data: dict[str, Any] = scenario.model_dump(mode="json", by_alias=True)
    for key in _NO_NUMBERS:
        data.pop(key, None)
    data["scenario"] = {k: v for k, v in data["scenario"].items() if k not in _LEFT_OUT}
    result: dict[str, Any] = _with_relative_paths(data, folder.resolve())
    return result


def _with_relative_paths(value: Any, folder: Path) -> Any:  # noqa: ANN401 - nested plain data
    if isinstance(value, dict):
        return {key: _with_relative_paths(each, folder) for key, each in value.items()}
    if isinstance(value, list):
        return [_with_relative_paths(each, folder) for each in value]
    if isinstance(value, str) and os.path.isabs(value):
        return Path(os.path.relpath(value, folder)).as_posix()
    return value


def file_digests(scenario: Scenario) -> dict[str, str]:
    """Return short SHA-256 digests of the files a scenario uses: airframes, data, gains, code.

    They explain a comparison that fails, and decide nothing. A file of an airframe is named from
    the airframe's folder on: `skywalker_x8/Systems/battery.xml`.
    """
    return {
        name: hashlib.sha256(read_bounded(file, MAX_TABLE_BYTES)).hexdigest()[:12]
        for name, file in _files(scenario).items()
    }


def file_values(scenario: Scenario) -> dict[str, Any]:
    """Return the values in a scenario's YAML and .param files, by file.

    They name the gain that changed. A file that cannot be read is left out.
    """
    values: dict[str, Any] = {}
    for name, file in _files(scenario).items():
        with suppress(InputError):
            if file.suffix == ".yaml":
                values[name] = plain(read(file))
            elif file.suffix == ".param":
                values[name] = {key: each.value for key, each in read_values(file).items()}
    return values


def _files(scenario: Scenario) -> dict[str, Path]:
    """Return the files whose content can change the numbers of a scenario, by name."""
    names = [scenario.leader.aircraft, *(follower.aircraft for follower in scenario.fleet)]
    files: dict[str, Path] = {}
    for folder in dict.fromkeys(find_aircraft(name) for name in names):
        files |= _files_below(folder)
    others = []
    if scenario.leader.path.kind == "replay":
        others.append(find_data(scenario.leader.path.file))
    if scenario.air.wind.file is not None:
        others.append(find_data(scenario.air.wind.file))
    if scenario.controller.middle_loop is not None:
        others.append(Path(scenario.controller.middle_loop))
    for _, name in code_references(scenario):
        module, _, _ = find_code(name).rpartition(":")
        others += [Path(module)] if module.endswith(".py") else []
    files |= {f"{file.parent.name}/{file.name}": file for file in others}
    return {name: file for name, file in files.items() if file.suffix in _SUFFIXES}


def _files_below(folder: Path) -> dict[str, Path]:
    """Return all files of a folder tree by name, without caches and hidden files."""
    paths = {file.relative_to(folder): file for file in sorted(folder.rglob("*"))}
    return {
        f"{folder.name}/{name.as_posix()}": file
        for name, file in paths.items()
        if file.is_file() and not any(_is_cache(part) for part in name.parts)
    }


def _is_cache(part: str) -> bool:
    return part.startswith(".") or part == "__pycache__"


def with_new_defaults(stored: Mapping[str, Any]) -> Mapping[str, Any]:
    """Add the keys that scenarios have gained since a snapshot was stored, at their defaults.

    A snapshot that is not a valid scenario in this version is returned unchanged.
    """
    header = {**stored.get("scenario", {}), "name": "stored"}
    try:
        scenario = Scenario.model_validate({**stored, "scenario": header})
    except ValueError:
        return stored
    return snapshot(scenario, Path())


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[str, ...]:
    """Describe keys that differ: `key from x to y`, `key x is new`."""
    old_values, new_values = _leaves(old), _leaves(new)
    lines = []
    for key in dict.fromkeys((*old_values, *new_values)):
        if key not in new_values:
            lines.append(f"{key} {old_values[key]} is removed")
        elif key not in old_values:
            lines.append(f"{key} {new_values[key]} is new")
        elif old_values[key] != new_values[key]:
            lines.append(f"{key} from {old_values[key]} to {new_values[key]}")
    return tuple(lines)


def file_differences(
    old: Mapping[str, str],
    new: Mapping[str, str],
    old_values: Mapping[str, Any],
    new_values: Mapping[str, Any],
) -> tuple[str, ...]:
    """Describe every file that was removed, added or changed.

    Args:
        old: digests by name, of `file_digests`.
        new: likewise.
        old_values: of `file_values`; where both have a file, its keys are named:
            `rascal110/middle_loop.yaml: tuned.course.p from 4 to 3.5`.
        new_values: likewise.
    """
    lines = []
    for name in dict.fromkeys((*old, *new)):
        if name not in new:
            lines.append(f"file {name} is removed")
        elif name not in old:
            lines.append(f"file {name} is new")
        elif old[name] != new[name]:
            known = name in old_values and name in new_values
            keys = differences(old_values[name], new_values[name]) if known else ()
            lines += [f"{name}: {key}" for key in keys]
            if not keys:
                lines.append(f"file {name} changed" + (", but no value in it" if known else ""))
    return tuple(lines)


def _leaves(value: Any, path: str = "") -> dict[str, str]:  # noqa: ANN401 - nested plain data
    """Return the value at each key as text; plain lists are values."""
    if isinstance(value, Mapping):
        items = [(str(key), each) for key, each in value.items()]
    elif isinstance(value, list) and any(isinstance(each, Mapping) for each in value):
        items = [(str(index), each) for index, each in enumerate(value)]
    else:
        return {path: _text(value)}
    found: dict[str, str] = {}
    for key, each in items:
        found |= _leaves(each, f"{path}.{key}" if path else key)
    return found


def _text(value: Any) -> str:  # noqa: ANN401 - a scalar or a list
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, bool) or value is None:
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value) or '""'
