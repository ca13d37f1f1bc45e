"""Files that a scenario depends on: all that its references name, and what these name in turn."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from testbed.core.input_files import MAX_TABLE_BYTES, read_bounded
from testbed.plan.code_files import code_files
from testbed.scenario import Scenario, open_scenario
from testbed.scenario.reference_fields import Reference, references
from testbed.scenario.references import find_reference

_OF_AIRCRAFT = (".xml", ".yaml", ".param")  # what is read of an aircraft's folder


def referents(scenario: Scenario) -> dict[Reference, None]:
    """Return what a resolved scenario names, in order: references without their keys."""
    return {each._replace(loc=()): None for each in references(scenario)}


def file_digests(named: Iterable[Reference]) -> dict[str, str]:
    """Return short SHA-256 digests of all files that references name, by name of the file.

    A file is named with its folder, one of an aircraft from the aircraft's folder on, as in
    `skywalker_x8/Systems/battery.xml`; with more folders where two would have one name.

    Raises:
        InputError: a file cannot be read.
    """
    return digests(referenced_files(named))


def digests(files: Mapping[str, Path]) -> dict[str, str]:
    """Return short SHA-256 digests of files, by name.

    Raises:
        InputError: a file cannot be read.
    """
    return {
        name: hashlib.sha256(read_bounded(file, MAX_TABLE_BYTES)).hexdigest()[:12]
        for name, file in files.items()
    }


def referenced_files(named: Iterable[Reference]) -> dict[str, Path]:
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
    for each in queue:
        if each.kind == "code":
            files |= dict.fromkeys(code_files(each.name), 2)
            continue
        path = find_reference(each)
        if each.kind == "aircraft":
            files |= _files_below(path)
        elif each.kind == "scenario":
            draft = open_scenario(path)
            files |= dict.fromkeys(draft.files, 2)
            new = [other for other in referents(draft.resolve()) if other not in seen]
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
