"""Short digests of what the numbers of a table or picture depend on: its resolved inputs.

These are resolved scenarios, the gains and tunes that they use, flight models, data, laws of
scenarios, studies, and pinned packages; not the code of the testbed. The digests stand in a comment
of the page, so that a number which is older than one of its inputs is found without a flight, by
`stale.py`.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from testbed.plan.scenario_files import digests as file_digests
from testbed.plan.scenario_files import referenced_files, referents
from testbed.pool.scenario_snapshot import file_values, snapshot
from testbed.scenario import Scenario, find_tuning, load_scenario
from testbed.scenario.yaml_io import plain, read
from testbed.studies.plan import Plan, load_study

ROOT = Path(__file__).resolve().parents[1]
NUMERIC = ("jsbsim", "llvmlite", "numba", "numpy")  # packages that move numbers of flights
TRAINING = ("stable-baselines3", "torch", "gymnasium")
LOCKS = ("requirements.lock", "examples/training.lock", "examples/torch.lock")
DIGITS = 8
_GAINS, _PARAM = "middle_loop.yaml", ".param"
_NUMBER = re.compile(r"[-+]?[\d.]+(e[-+]?\d+)?$")
_NO_NUMBERS = ("question", "name", "metrics", "seeds")  # of the section `study`; seeds apart


@dataclass(frozen=True, slots=True)
class Case:
    """A scenario with overrides."""

    scenario: str
    overrides: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Inputs:
    """What the numbers of a table or picture depend on, apart from the code.

    Args:
        cases: flown or linearised.
        studies: names or paths of studies, with the cases in them.
        tunings: names of tuning files.
        files: of the repository, such as recordings and models.
        packages: names, whose pins are in `LOCKS`.
    """

    cases: tuple[Case, ...] = ()
    studies: tuple[str, ...] = ()
    tunings: tuple[str, ...] = ()
    files: tuple[str, ...] = ()
    packages: tuple[str, ...] = NUMERIC


def digests(inputs: Inputs) -> dict[str, str]:
    """Return a digest of each input by its name, sorted; of a package its version."""
    found: dict[str, str] = {}
    by_scenario: dict[str, set[tuple[str, ...]]] = {}
    for case in inputs.cases:
        by_scenario.setdefault(case.scenario, set()).add(_without_seed(case.overrides))
    for name, changes in by_scenario.items():
        base = snapshot_of(_loaded(name, ()))
        found[_short(name)] = _digest([base, *sorted(changes)])
        for one in {_naming(each): each for each in sorted(changes)}.values():
            found |= _file_digests(_loaded(name, one))
    for name in inputs.studies:
        study, files = _study_digests(name)
        found |= {f"study {_short(name)}": study} | files
    for name in inputs.tunings:
        found[f"tuning {name}"] = _digest(plain(read(find_tuning(name))))
    for name in inputs.files:
        found[name] = _digest((ROOT / name).read_bytes())
    return dict(sorted(found.items())) | pins(inputs.packages)


def snapshot_of(scenario: Scenario) -> Mapping[str, Any]:
    """Return the resolved scenario without what changes no number."""
    return snapshot(scenario, ROOT)


def files_of(scenario: Scenario) -> tuple[Mapping[str, str], Mapping[str, Any]]:
    """Return digests of all files that a scenario uses, and the values of those with values."""
    return _content(tuple(sorted(referenced_files(referents(scenario)).items())))


@cache
def _content(named: tuple[tuple[str, Path], ...]) -> tuple[Mapping[str, str], Mapping[str, Any]]:
    files = dict(named)
    return file_digests(files), file_values(files)


def pins(packages: Iterable[str]) -> dict[str, str]:
    """Return the pinned versions of packages by name; with one per Python version, all."""
    lines = "\n".join((ROOT / name).read_text(encoding="utf-8") for name in LOCKS)
    found = {}
    for name in packages:
        versions = re.findall(rf"^{re.escape(name)}==([^\s;\\]+)", lines, re.M)
        found[name] = "/".join(dict.fromkeys(versions)) or "missing"
    return found


def _file_digests(scenario: Scenario) -> dict[str, str]:
    """Return digests of a scenario's files: profile and tunes it uses, models as a whole."""
    files, values = files_of(scenario)
    aircraft = [scenario.leader, *scenario.fleet]
    tunes = {Path(each.tune).name.removesuffix(_PARAM) for each in aircraft}
    profile = scenario.controller.profile
    found: dict[str, str] = {}
    models: dict[str, list[tuple[str, str]]] = {}
    for name, digest in files.items():
        file = Path(name)
        if file.name == _GAINS:
            gains = values.get(name, {}).get(profile)
            if gains is not None:
                found[f"{name} {profile}"] = _digest(gains)
        elif file.suffix == _PARAM and file.stem not in tunes:
            continue
        elif name in values:
            found[name] = _digest(values[name])
        elif file.suffix == ".xml":
            models.setdefault(file.parts[0], []).append((name, digest))
        else:
            found[name] = digest[:DIGITS]
    return found | {f"model {name}": _digest(sorted(each)) for name, each in models.items()}


@cache
def _loaded(name: str, overrides: tuple[str, ...]) -> Scenario:
    return load_scenario(_path(name), overrides)


@cache
def _study_digests(name: str) -> tuple[str, dict[str, str]]:
    """Return the digest of a study and its cases, and those of the files they use."""
    study = load_study(_path(name))
    plan = Plan(study)
    config = study.config.model_dump(mode="json", by_alias=True, exclude_none=True)
    config["study"] = {k: v for k, v in config["study"].items() if k not in _NO_NUMBERS}
    parts: list[Any] = [config, list(plan.seeds)]
    files: dict[str, str] = {}
    begun: set[tuple[str, tuple[str, ...]]] = set()
    for case in range(len(plan.cases)):
        for point in range(plan.point_count):
            run = plan.run(case, point)
            kind = run.case, _naming(run.overrides)
            if kind in begun:  # points that differ by numbers name the same files
                continue
            if not any(each == run.case for each, _ in begun):
                parts.append(snapshot_of(plan.scenario(run)))
            begun.add(kind)
            files |= _file_digests(plan.scenario(run))
    return _digest(parts), files


def _path(name: str) -> str:
    """Return the path of a file of the repository, or the name of one of the library."""
    return str(ROOT / name) if "/" in name else name


def _short(name: str) -> str:
    return Path(name).stem if "/" in name else name


def _without_seed(overrides: Iterable[str]) -> tuple[str, ...]:
    return tuple(each for each in overrides if not each.startswith("scenario.seed="))


def _naming(overrides: Iterable[str]) -> tuple[str, ...]:
    """Return the overrides that may name a file: all whose value is no number."""
    return tuple(each for each in overrides if not _NUMBER.match(each.partition("=")[2]))


def _digest(value: Any) -> str:  # noqa: ANN401 - nested plain data, or bytes
    content = value if isinstance(value, bytes) else json.dumps(value, sort_keys=True).encode()
    return hashlib.sha256(content).hexdigest()[:DIGITS]


def describe(found: Mapping[str, str]) -> str:
    """Return digests as the text of a comment, wrapped."""
    lines, line = [], "<!-- inputs:"
    for index, (name, digest) in enumerate(found.items()):
        text = f" {name} {digest}" + (";" if index < len(found) - 1 else " -->")
        if len(line) + len(text) > 128:
            lines.append(line)
            line = "    "
        line += text
    return "\n".join([*lines, line])


def parse(comment: str) -> dict[str, str]:
    """Return the digests of a comment."""
    content = comment.removeprefix("<!-- inputs:").removesuffix("-->")
    pairs = (each.rsplit(maxsplit=1) for each in content.split(";") if each.strip())
    return {" ".join(name.split()): digest for name, digest in pairs}


def changed(old: Mapping[str, str], new: Mapping[str, str]) -> Iterator[str]:
    """Yield a text for each input that is not as it was."""
    for name in dict.fromkeys((*old, *new)):
        if name not in new:
            yield f"{name} is no input any more"
        elif name not in old:
            yield f"{name} is a new input"
        elif old[name] != new[name]:
            yield (
                f"{name} {old[name]} is now {new[name]}" if "." in new[name] else f"{name} changed"
            )
