"""What the lock file pins, and the part of it that `pip install` of the testbed brings along."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

from packaging.markers import Marker, default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
PROJECT = ROOT / "pyproject.toml"
PYTHON = "Programming Language :: Python :: 3."
HASH = re.compile(r"--hash=sha256:([0-9a-f]{64})\b")
Surroundings = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Pin:
    """One requirement of a lock file: all that may be installed of it."""

    name: str
    version: str
    marker: Marker | None
    hashes: tuple[str, ...]
    text: str

    def wanted(self, surroundings: Surroundings) -> bool:
        """Whether it is installed there."""
        return self.marker is None or self.marker.evaluate(dict(surroundings))


def pins(text: str) -> list[Pin]:
    """The requirements of a lock file; of one name there may be several, for other Pythons.

    Raises:
        ValueError: one of them is no exact version, or has no hash.
    """
    found: list[Pin] = []
    lines = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    for block in re.split(r"\n(?=\S)", lines.strip()):
        asked = Requirement(re.split(r"\s*\\\n|\s--", block)[0])
        name = canonicalize_name(asked.name)
        exact = re.fullmatch(r"==([^*,]+)", str(asked.specifier))
        hashes = tuple(HASH.findall(block))
        if not exact or not hashes:
            raise ValueError(f"{asked}: is not one version with its hashes")
        found.append(Pin(name, exact[1], asked.marker, hashes, block))
    return found


def project() -> dict[str, object]:
    """What pyproject.toml says of the project."""
    with PROJECT.open("rb") as file:
        told = tomllib.load(file)["project"]
    assert isinstance(told, dict)
    return told


def here() -> Surroundings:
    """What markers ask about, of this Python on this system."""
    return {key: str(value) for key, value in default_environment().items()}


def supported() -> list[Surroundings]:
    """The same for every Python that the testbed runs on, on this system."""
    classifiers = project()["classifiers"]
    assert isinstance(classifiers, list)
    minors = [each.removeprefix(PYTHON) for each in classifiers if each.startswith(PYTHON)]
    return [
        {**here(), "python_version": f"3.{minor}", "python_full_version": f"3.{minor}.0"}
        for minor in minors
    ]


def asked_by(name: str) -> list[str]:
    """What an installed package asks for; nothing, if it is of another system."""
    try:
        return requires(name) or []
    except PackageNotFoundError:
        return []


def needed(
    surroundings: Surroundings,
    first: Iterable[str] | None = None,
    asked: Callable[[str], list[str]] = asked_by,
) -> dict[str, set[str]]:
    """What runs with the testbed there: each package, and the packages that it asks for itself.

    Args:
        surroundings: where.
        first: what the testbed asks for; as pyproject.toml has it.
        asked: what a package asks for, by what is installed here.
    """
    if first is None:
        dependencies = project()["dependencies"]
        assert isinstance(dependencies, list)
        first = dependencies
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
            for each in map(Requirement, asked(name)):
                if each.marker is None or each.marker.evaluate({**surroundings, "extra": extra}):
                    graph[name].add(canonicalize_name(each.name))
                    waiting.append(each)
    return graph


def running_pins(surroundings: Surroundings) -> dict[str, Pin]:
    """The pins of all that runs with the testbed there, by name.

    Raises:
        ValueError: the lock file has not exactly one version of something.
    """
    names = needed(surroundings)
    found: dict[str, Pin] = {}
    for pin in pins(LOCK.read_text(encoding="utf-8")):
        if pin.name in names and pin.wanted(surroundings):
            if pin.name in found:
                raise ValueError(f"{LOCK.name} has two versions of {pin.name}")
            found[pin.name] = pin
    if missing := names.keys() - found.keys():
        raise ValueError(f"{LOCK.name} lacks {', '.join(sorted(missing))}: run make lock")
    return found


def running_lock() -> list[Pin]:
    """The pins of all that runs with the testbed on any Python that it runs on."""
    wanted = {pin for each in supported() for pin in running_pins(each).values()}
    return sorted(wanted, key=lambda pin: pin.text)
