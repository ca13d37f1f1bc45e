"""References of a scenario to airframes, parameter files, recordings, gains and laws."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from testbed.scenario import resolve
from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.control import Agent, Formation
from testbed.scenario.fields import KeyPath
from testbed.scenario.network_checks import link_entries
from testbed.scenario.problems import Problem, ScenarioError
from testbed.scenario.schema import Scenario
from testbed.scenario.tree import Node, walk

_GAINS = "middle_loop.yaml"


class _Resolver:
    """Finds files, and collects resolved values and problems."""

    def __init__(self, tree: Node) -> None:
        self.tree = tree
        self.changes: list[tuple[KeyPath, str]] = []
        self.problems: list[Problem] = []

    def aircraft(self, loc: KeyPath, aircraft: Leader | Follower) -> None:
        """Resolve the airframe and the autopilot parameters."""
        folder = self.folder(*loc, "aircraft")
        try:
            home = resolve.find_aircraft(aircraft.aircraft, folder=folder)
        except ScenarioError as error:
            self.add(error, *loc, "aircraft")
            return
        own = resolve.library() / "aircraft" / home.name
        self.changes.append(((*loc, "aircraft"), home.name if home == own else str(home)))
        folder = self.folder(*loc, "tune")
        try:
            tune = resolve.find_tune(home, aircraft.tune, folder=folder)
        except ScenarioError as error:
            self.add(error, *loc, "tune")
            return
        name = tune.stem if tune == home / f"{tune.stem}.param" else str(tune)
        self.changes.append(((*loc, "tune"), name))
        binary = getattr(aircraft.autopilot, "binary", None)
        if binary is not None:  # only a run needs it to exist
            folder = self.folder(*loc, "autopilot", "binary")
            found = resolve.absolute(binary, folder)
            self.changes.append(((*loc, "autopilot", "binary"), str(found)))

    def recording(self, loc: KeyPath, file: str) -> None:
        """Resolve a data file."""
        try:
            found = resolve.find_data(file, folder=self.folder(*loc))
        except ScenarioError as error:
            self.add(error, *loc)
            return
        own = resolve.library() / "scenarios" / "data" / found.name
        self.changes.append((loc, found.name if found == own else str(found)))

    def gains(self, loc: KeyPath, file: str) -> None:
        """Resolve a file of gains."""
        found = resolve.absolute(file, self.folder(*loc))
        if resolve.is_file(found):
            self.changes.append((loc, str(found)))
            return
        node, path, left = walk(self.tree, loc)
        text = f"there is no file {found} (write the path of a file like an airframe's {_GAINS})"
        self.problems.append(Problem(node.place, text, path + left))

    def code(self, loc: KeyPath, name: str) -> None:
        """Resolve a user's own law or function."""
        try:
            # in a text or a setting, unlike in a file, the caller chooses the code
            by_caller = not resolve.is_file(Path(walk(self.tree, loc)[0].place.source))
            found = resolve.find_code(name, folder=self.folder(*loc), anywhere=by_caller)
        except ScenarioError as error:
            self.add(error, *loc)
            return
        file, _, object_name = found.rpartition(":")
        if Path(file).parent == resolve.library() / "scenarios":
            found = f"{Path(file).stem}:{object_name}"
        self.changes.append((loc, found))

    def folder(self, *loc: str | int) -> Path:
        """Return the base of a relative path at this location."""
        return walk(self.tree, loc)[0].folder

    def add(self, error: ScenarioError, *loc: str | int) -> None:
        """Add the problems of an error, at the place of the reference."""
        node, path, left = walk(self.tree, loc)
        self.problems += [
            Problem(node.place, problem.text, path + left) for problem in error.problems
        ]


def resolve_references(scenario: Scenario, tree: Node) -> Scenario:
    """Return the scenario with every reference as a name, or else as an absolute path.

    So a resolved scenario means the same in any folder.

    Raises:
        ScenarioError: with every file that cannot be found.
    """
    resolver = _Resolver(tree)
    resolver.aircraft(("leader",), scenario.leader)
    for index, follower in enumerate(scenario.fleet):
        resolver.aircraft(("fleet", index), follower)
    if scenario.leader.path.kind == "replay":
        resolver.recording(("leader", "path", "file"), scenario.leader.path.file)
    if scenario.air.wind.file is not None:
        resolver.recording(("air", "wind", "file"), scenario.air.wind.file)
    for loc, link in link_entries(scenario.network):
        if link.jitter is not None and link.jitter.file is not None:
            resolver.recording((*loc, "jitter", "file"), link.jitter.file)
        if link.trace is not None:
            resolver.recording((*loc, "trace", "file"), link.trace.file)
    if scenario.controller.middle_loop is not None:
        resolver.gains(("controller", "middle_loop"), scenario.controller.middle_loop)
    for loc, name in code_references(scenario):
        resolver.code(loc, name)
    if resolver.problems:
        raise ScenarioError(resolver.problems)
    return with_values(scenario, resolver.changes)


def code_references(scenario: Scenario) -> Iterator[tuple[KeyPath, str]]:
    """Yield where a scenario names code of its own, a law or functions, and the names."""
    if scenario.controller.law != "hbh23":
        yield ("controller", "law"), scenario.controller.law
    places: list[tuple[KeyPath, Formation | Agent]] = [(("formation",), scenario.formation)]
    places += [
        (("formation", "agents", name), agent) for name, agent in scenario.formation.agents.items()
    ]
    for loc, section in places:
        for key in ("control_function", "barrier"):
            own = getattr(section, key)
            if own is not None and own.example == "own":
                yield (*loc, key, "function"), own.function
        if section.speed_model is not None:
            for key in ("f", "g"):
                yield (*loc, "speed_model", key), getattr(section.speed_model, key)


def with_values(scenario: Scenario, changes: Iterable[tuple[KeyPath, str]]) -> Scenario:
    """Return a scenario with other texts at these keys."""
    data = scenario.model_dump(by_alias=True)
    for loc, value in changes:
        _put(data, loc, value)
    return Scenario.model_validate(data)


def _put(data: Any, loc: KeyPath, value: str) -> None:  # noqa: ANN401 - nested plain data
    for part in loc[:-1]:
        data = data[part]
    data[loc[-1]] = value
