"""Snapshot of a resolved scenario and its files, and the differences between two snapshots."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Container, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from testbed.autopilot.param_file import read_param_file
from testbed.core.errors import InputError
from testbed.core.input_files import MAX_TABLE_BYTES, read_bounded
from testbed.plan.code_files import code_files
from testbed.scenario import Scenario, open_scenario
from testbed.scenario.reference_fields import Reference, ReferenceKind, references
from testbed.scenario.references import find_reference
from testbed.scenario.yaml_io import plain, read

# keys of `scenario` that change no number, and the seed, which is stored separately
_LEFT_OUT = ("question", "expectation", "published", "name", "seed")
_NO_NUMBERS = ("log", "expect")  # sections that change no number
_OF_AIRCRAFT = (".xml", ".yaml", ".param")  # what is read of an aircraft's folder
_NAME, _VALUE = 5, 3  # characters of `key_digests`


@dataclass(frozen=True, slots=True)
class Inputs:
    """What decides the numbers of a scenario, apart from the program and the seed."""

    scenario: Mapping[str, Any]  # of `snapshot`
    non_default: frozenset[str]  # keys of it that are not at their defaults
    files: Mapping[str, str]  # of `file_digests`
    values: Mapping[str, Any]  # in the YAML and .param files, by name


def read_inputs(scenario: Scenario, folder: Path) -> Inputs:
    """Collect the inputs of a scenario.

    Args:
        scenario: resolved.
        folder: of its file.
    """
    files = referenced_files(referents(scenario))
    return Inputs(
        scenario=snapshot(scenario, folder),
        non_default=frozenset(_leaves(snapshot(scenario, folder, defaults=False))),
        files=_digests(files),
        values=_file_values(files),
    )


def snapshot(scenario: Scenario, folder: Path, *, defaults: bool = True) -> dict[str, Any]:
    """Return the resolved scenario without keys that change no number.

    Args:
        scenario: resolved.
        folder: of its file; paths in the snapshot are relative to it.
        defaults: whether keys at their defaults are included.
    """
    data: dict[str, Any] = scenario.model_dump(
        mode="json", by_alias=True, exclude_defaults=not defaults
    )
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


class Referent(NamedTuple):
    """What a reference of a resolved scenario names.

    Args:
        kind: of the reference.
        name: its text.
        aircraft: of a tune: the aircraft that it is for; else empty.
    """

    kind: ReferenceKind
    name: str
    aircraft: str


def referents(scenario: Scenario) -> dict[Referent, None]:
    """Return what a resolved scenario names, in order."""
    return {Referent(*each[1:]): None for each in references(scenario)}


def file_digests(named: Iterable[Referent]) -> dict[str, str]:
    """Return short SHA-256 digests of all files that references name, by name of the file.

    A file is named with its folder, one of an aircraft from the aircraft's folder on, as in
    `skywalker_x8/Systems/battery.xml`; with more folders where two would have one name.

    Raises:
        InputError: a file cannot be read.
    """
    return _digests(referenced_files(named))


def _digests(files: Mapping[str, Path]) -> dict[str, str]:
    return {
        name: hashlib.sha256(read_bounded(file, MAX_TABLE_BYTES)).hexdigest()[:12]
        for name, file in files.items()
    }


def referenced_files(named: Iterable[Referent]) -> dict[str, Path]:
    """Return the files whose content can change the numbers of a scenario, by name.

    These are all that references name: of an aircraft those of its folder, of code those that it
    imports, of a scenario its file, the files that it extends and all that it names in turn.

    Args:
        named: of `referents`.

    Raises:
        ScenarioError: a file does not exist, or a scenario that is named cannot be flown.
    """
    files: dict[Path, int] = {}  # with the length of its name, in parts of its path
    queue = list(named)
    seen = set(queue)
    for referent in queue:
        kind, name, aircraft = referent
        if kind == "code":
            files |= dict.fromkeys(code_files(name), 2)
            continue
        path = find_reference(Reference((), kind, name, aircraft))
        if kind == "aircraft":
            files |= _files_below(path)
        elif kind == "scenario":
            draft = open_scenario(path)
            files |= dict.fromkeys(draft.files, 2)
            new = [each for each in referents(draft.resolve()) if each not in seen]
            queue += new
            seen |= set(new)
        else:
            files.setdefault(path, 2)
    return _named(files)


def _named(files: Mapping[Path, int]) -> dict[str, Path]:
    """Return files by their names, with as many folders as tell them apart."""
    parts = dict(files)
    while True:
        named: dict[str, Path] = {}
        alike: set[Path] = set()
        for file, count in parts.items():
            other = named.setdefault("/".join(file.parts[-count:]), file)
            alike |= {file, other} if other != file else set()
        if not alike:
            return named
        parts |= {file: parts[file] + 1 for file in alike}


def _files_below(folder: Path) -> dict[Path, int]:
    """Return the files of an aircraft's folder that can be read, without caches and hidden ones."""
    found = {file: len(file.relative_to(folder).parts) for file in sorted(folder.rglob("*"))}
    return {
        file: 1 + depth
        for file, depth in found.items()
        if file.suffix in _OF_AIRCRAFT
        and file.is_file()
        and not any(_is_cache(part) for part in file.parts[-depth:])
    }


def _is_cache(part: str) -> bool:
    return part.startswith(".") or part == "__pycache__"


def _file_values(named: Mapping[str, Path]) -> dict[str, Any]:
    """Return the values in the YAML and .param files that can be read, by file."""
    values: dict[str, Any] = {}
    for name, file in named.items():
        with suppress(InputError):
            if file.suffix == ".yaml":
                values[name] = plain(read(file))
            elif file.suffix == ".param":
                given = read_param_file(file).values
                values[name] = {key: each.value for key, each in given.items()}
    return values


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


def key_digests(values: Any) -> str:  # noqa: ANN401 - nested plain data
    """Return eight characters for each key of a map: five of its name, three of its value."""
    leaves = _leaves(values).items()
    return "".join(sorted(_digest(key, _NAME) + _digest(text, _VALUE) for key, text in leaves))


def scenario_differences(old: Mapping[str, str], inputs: Inputs) -> tuple[str, ...]:
    """Describe keys of a scenario that differ from digests: `key is now x`, `key x is new`.

    A key at its default is not new: the scenarios of this version have gained it.

    Args:
        old: `key_digests` by section.
        inputs: of the present scenario.
    """
    lines = [f"section {name} is removed" for name in old if name not in inputs.scenario]
    for name, section in inputs.scenario.items():
        lines += _key_differences(old.get(name, ""), section, f"{name}.", inputs.non_default)
    return tuple(lines)


def file_differences(
    old: Mapping[str, str], old_values: Mapping[str, str], inputs: Inputs
) -> tuple[str, ...]:
    """Describe every file that was removed, added or changed.

    Args:
        old: digests by name, of `file_digests`.
        old_values: `key_digests` by name; where both have a file, its keys are named:
            `rascal110/middle_loop.yaml: tuned.course.p is now 3.5`.
        inputs: of the present scenario.
    """
    lines = []
    for name in dict.fromkeys((*old, *inputs.files)):
        if name not in inputs.files:
            lines.append(f"file {name} is removed")
        elif name not in old:
            lines.append(f"file {name} is new")
        elif old[name] != inputs.files[name]:
            known = name in old_values and name in inputs.values
            keys = (
                _key_differences(old_values[name], inputs.values[name], f"{name}: ")
                if known
                else ()
            )
            lines += keys
            if not keys:
                lines.append(f"file {name} changed" + (", but no value in it" if known else ""))
    return tuple(lines)


def _key_differences(
    old: str,
    values: Any,  # noqa: ANN401 - nested plain data
    prefix: str,
    non_default: Container[str] | None = None,
) -> list[str]:
    """Describe the keys of a map that differ from its `key_digests`.

    Args:
        old: digests.
        values: the present map.
        prefix: of a key in the text.
        non_default: keys, with prefix, of which a missing digest is a change; None: all.
    """
    size = _NAME + _VALUE
    stored = {old[i : i + _NAME]: old[i + _NAME : i + size] for i in range(0, len(old), size)}
    changed, new = [], {}
    for key, text in _leaves(values).items():
        digest = stored.pop(_digest(key, _NAME), None)
        if digest is None:
            new[prefix + key] = text
        elif digest != _digest(text, _VALUE):
            changed.append(f"{prefix}{key} is now {text}")
    removed = len(stored)
    if non_default is not None and not removed:  # else a default may stand for the removed keys
        new = {key: text for key, text in new.items() if key in non_default}
    lines = [*changed, *(f"{key} {text} is new" for key, text in new.items())]
    if removed:
        lines.append(f"{prefix.rstrip('.: ')}: {removed} key{'s' * (removed > 1)} removed")
    return lines


def _digest(text: str, length: int) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest())[:length].decode()


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
    return f"{value:.12g}" if isinstance(value, float) else str(value) or '""'
