"""Pins of the lock file, and the part that `pip install` of the testbed installs."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path
from typing import Any

from packaging.markers import Marker, default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
PROJECT = ROOT / "pyproject.toml"
PYTHON = "Programming Language :: Python :: 3."
EXTRAS = ("all",)  # of a release that is flown, listed and licensed
HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})\b")
Environment = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Pin:
    """One requirement of a lock file, with the hashes of its files."""

    name: str
    version: str
    marker: Marker | None
    hashes: tuple[str, ...]
    text: str

    def wanted(self, environment: Environment) -> bool:
        """Return whether it is installed in this environment."""
        return self.marker is None or self.marker.evaluate(dict(environment))


def pins(text: str) -> list[Pin]:
    """Return the requirements of a lock file; a name may appear several times, for other Pythons.

    Raises:
        ValueError: a requirement is no exact version, or has no hash.
    """
    found: list[Pin] = []
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    for block in re.split(r"\n(?=\S)", lines.strip()):
        requirement = Requirement(re.split(r"\s*\\\n|\s--", block)[0])
        name = canonicalize_name(requirement.name)
        exact = re.fullmatch(r"==([^*,]+)", str(requirement.specifier))
        hashes = tuple(HASH.findall(block))
        if not exact or not hashes:
            raise ValueError(f"{requirement}: is not one version with its hashes")
        found.append(Pin(name, exact[1], requirement.marker, hashes, block))
    return found


def distribution_name() -> str:
    """Return the name that pip installs."""
    return str(project()["name"])


def project() -> dict[str, object]:
    """Return the project table of pyproject.toml."""
    with PROJECT.open("rb") as file:
        table = tomllib.load(file)["project"]
    assert isinstance(table, dict)
    return table


def requirements_with(*extras: str) -> list[str]:
    """Return the requirements of the testbed with some extras, which may name others."""
    table: Any = project()
    name, found = str(table["name"]), list(table["dependencies"])
    for extra in extras:
        for text in table["optional-dependencies"][extra]:
            wanted = Requirement(text)
            ours = wanted.name == name
            found += requirements_with(*wanted.extras) if ours else [text]
    return list(dict.fromkeys(found))


def here() -> Environment:
    """Return the values of markers for this Python on this system."""
    return {key: str(value) for key, value in default_environment().items()}


def supported() -> list[Environment]:
    """Return the same for every supported Python, on this system."""
    classifiers = project()["classifiers"]
    assert isinstance(classifiers, list)
    minors = [each.removeprefix(PYTHON) for each in classifiers if each.startswith(PYTHON)]
    return [
        {**here(), "python_version": f"3.{minor}", "python_full_version": f"3.{minor}.0"}
        for minor in minors
    ]


def requirements_of(name: str) -> list[str]:
    """Return the requirements of an installed package; none if it is for another system."""
    try:
        return requires(name) or []
    except PackageNotFoundError:
        return []


def needed(
    environment: Environment,
    first: Iterable[str] | None = None,
    requirements: Callable[[str], list[str]] = requirements_of,
) -> dict[str, set[str]]:
    """Return the runtime packages of the testbed, each with its own requirements.

    Args:
        environment: values of markers.
        first: requirements of the testbed; default those of pyproject.toml with `EXTRAS`.
        requirements: returns the requirements of a package; default of the installed one.
    """
    if first is None:
        first = requirements_with(*EXTRAS)
    graph: dict[str, set[str]] = {}
    done: set[tuple[str, str]] = set()
    waiting = [Requirement(text) for text in first]
    while waiting:
        wanted = waiting.pop()
        name = canonicalize_name(wanted.name)
        graph.setdefault(name, set())
        for extra in ("", *wanted.extras):
            if (name, extra) in done:
                continue
            done.add((name, extra))
            for each in map(Requirement, requirements(name)):
                if each.marker is None or each.marker.evaluate({**environment, "extra": extra}):
                    graph[name].add(canonicalize_name(each.name))
                    waiting.append(each)
    return graph


def running_pins(environment: Environment, extras: Iterable[str] = EXTRAS) -> dict[str, Pin]:
    """Return the pins of all runtime packages in an environment, by name.

    Args:
        environment: values of markers.
        extras: of the testbed.

    Raises:
        ValueError: the lock file does not have exactly one version of a package.
    """
    names = needed(environment, requirements_with(*extras))
    found: dict[str, Pin] = {}
    for pin in pins(LOCK.read_text(encoding="utf-8")):
        if pin.name in names and pin.wanted(environment):
            if pin.name in found:
                raise ValueError(f"{LOCK.name} has two versions of {pin.name}")
            found[pin.name] = pin
    if missing := names.keys() - found.keys():
        raise ValueError(f"{LOCK.name} lacks {', '.join(sorted(missing))}: run make lock")
    return found


def running_lock(extras: Iterable[str] = EXTRAS) -> list[Pin]:
    """Return the pins of all runtime packages on any supported Python."""
    wanted = {pin for each in supported() for pin in running_pins(each, extras).values()}
    return sorted(wanted, key=lambda pin: pin.text)
