"""What a scenario's page and its files were when a table was written, and what changed since."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from testbed.scenario import Scenario, find_aircraft, find_data, find_law

# What moves no number, and the seed, which the table has its own of.
_IDLE = ("question", "expectation", "published", "name", "seed")
_SUFFIXES = (".xml", ".yaml", ".param", ".csv", ".py")


def page_kept(page: Scenario, folder: Path) -> dict[str, Any]:
    """The resolved page, less what moves no number; paths are relative to its own folder."""
    data: dict[str, Any] = page.model_dump(mode="json", by_alias=True)
    data.pop("log", None)
    data["scenario"] = {k: v for k, v in data["scenario"].items() if k not in _IDLE}
    kept: dict[str, Any] = _relative(data, folder.resolve())
    return kept


def _relative(value: Any, folder: Path) -> Any:  # noqa: ANN401 - nested plain data
    if isinstance(value, dict):
        return {key: _relative(each, folder) for key, each in value.items()}
    if isinstance(value, list):
        return [_relative(each, folder) for each in value]
    if isinstance(value, str) and os.path.isabs(value):
        return Path(os.path.relpath(value, folder)).as_posix()
    return value


def digests(page: Scenario) -> dict[str, str]:
    """Short digests of the files that the page names: the folders of its airframes, and others.

    They decide nothing; a comparison that fails can say which file is not what it was. A file of an
    airframe is named from its folder on, `skywalker_x8/Systems/battery.xml`.
    """
    names = [page.leader.aircraft, *(follower.aircraft for follower in page.fleet)]
    files: dict[str, Path] = {}
    for folder in dict.fromkeys(find_aircraft(name) for name in names):
        files |= _inside(folder)
    others = []
    if page.leader.path.kind == "replay":
        others.append(find_data(page.leader.path.file))
    if page.air.wind.file is not None:
        others.append(find_data(page.air.wind.file))
    if page.controller.middle_loop is not None:
        others.append(Path(page.controller.middle_loop))
    if page.controller.law != "paper":
        place, _, _ = find_law(page.controller.law).rpartition(":")
        others += [Path(place)] if place.endswith(".py") else []
    files |= {f"{file.parent.name}/{file.name}": file for file in others}
    return {
        name: hashlib.sha256(file.read_bytes()).hexdigest()[:12]
        for name, file in files.items()
        if file.suffix in _SUFFIXES
    }


def _inside(folder: Path) -> dict[str, Path]:
    """Every file of a folder and the folders in it, but for what tools leave there."""
    inner = {file.relative_to(folder): file for file in sorted(folder.rglob("*"))}
    return {
        f"{folder.name}/{name.as_posix()}": file
        for name, file in inner.items()
        if file.is_file() and not any(_left_by_tools(part) for part in name.parts)
    }


def _left_by_tools(part: str) -> bool:
    return part.startswith(".") or part == "__pycache__"


def spelt_out(kept: Mapping[str, Any]) -> Mapping[str, Any]:
    """A page that was kept, with the keys that pages have had since then at their defaults."""
    try:
        page = Scenario.model_validate({**kept, "scenario": {**kept["scenario"], "name": "kept"}})
    except (ValueError, KeyError):
        return kept  # a page that cannot be one any more is compared as it is
    return page_kept(page, Path())


def differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> tuple[str, ...]:
    """Every key that differs, one line each: `key from x to y`, `key x is new`, `key x is gone`."""
    old, new = _leaves(then), _leaves(now)
    lines = []
    for key in dict.fromkeys((*old, *new)):
        if key not in new:
            lines.append(f"{key} {old[key]} is gone")
        elif key not in old:
            lines.append(f"{key} {new[key]} is new")
        elif old[key] != new[key]:
            lines.append(f"{key} from {old[key]} to {new[key]}")
    return tuple(lines)


def _leaves(value: Any, path: str = "") -> dict[str, str]:  # noqa: ANN401 - nested plain data
    """What stands at each key, as text; a list without maps is one thing."""
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
    return f"{value:g}" if isinstance(value, float) else str(value)
