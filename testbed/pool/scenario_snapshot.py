"""Snapshot of a resolved scenario and its files, and the differences between two snapshots."""

from __future__ import annotations

import base64
import hashlib
import os
from collections.abc import Container, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from testbed.autopilot.param_file import read_param_file
from testbed.core.errors import InputError
from testbed.plan.scenario_files import digests, referenced_files, referents
from testbed.scenario import Scenario
from testbed.scenario.yaml_io import plain, read

# keys of `scenario` that change no number, and the seed, which is stored separately
_LEFT_OUT = ("question", "expectation", "published", "name", "seed")
_NO_NUMBERS = ("log", "expect")  # sections that change no number, but see `snapshot`
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
        files=digests(files),
        values=file_values(files),
    )


def snapshot(scenario: Scenario, folder: Path, *, defaults: bool = True) -> dict[str, Any]:
    """Return the resolved scenario without keys that change no number.

    Bounds of `expect` change numbers of flights that `limits.on_violation: stop` ends.

    Args:
        scenario: resolved.
        folder: of its file; paths in the snapshot are relative to it.
        defaults: whether keys at their defaults are included.
    """
    data: dict[str, Any] = scenario.model_dump(
        mode="json", by_alias=True, exclude_defaults=not defaults
    )
    ends_early = scenario.limits.on_violation == "stop"
    for key in _NO_NUMBERS:
        if not (key == "expect" and ends_early):
            data.pop(key, None)
    if not ends_early:
        data.get("limits", {}).pop("on_violation", None)
    if scenario.controller.safety is None:  # as in snapshots from before there was one
        data.get("controller", {}).pop("safety", None)
    if not scenario.controller.map:  # the same
        data.get("controller", {}).pop("map", None)
    companion = data.get("controller", {}).get("companion", {})
    companion.pop("flight", None)  # bounds of `testbed companion` on aircraft
    if scenario.controller.companion.link == "direct":  # as in snapshots from before there was one
        for key in ("link", "acceleration"):
            companion.pop(key, None)
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


def file_values(named: Mapping[str, Path]) -> dict[str, Any]:
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
