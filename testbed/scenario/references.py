"""What the page points to: airframes, tunes and recordings, looked up when it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from testbed.scenario import resolve
from testbed.scenario.aircraft import Follower, Leader
from testbed.scenario.link_checks import sections
from testbed.scenario.messages import Problem, ScenarioError
from testbed.scenario.schema import Scenario
from testbed.scenario.tree import Node, walk

_Loc = tuple[str | int, ...]
_GAINS = "middle_loop.yaml"


class _Settler:
    """Looks references up, collecting what changes on the page and what cannot be found."""

    def __init__(self, tree: Node) -> None:
        self.tree = tree
        self.changes: list[tuple[_Loc, str]] = []
        self.problems: list[Problem] = []

    def craft(self, loc: _Loc, craft: Leader | Follower) -> None:
        """Settle the airframe and, if this aircraft is flown, its tune."""
        folder = self.folder(*loc, "aircraft")
        try:
            home = resolve.find_aircraft(craft.aircraft, folder=folder)
        except ScenarioError as error:
            self.blame(error, *loc, "aircraft")
            return
        kept = resolve.library() / "aircraft" / home.name
        self.changes.append(((*loc, "aircraft"), home.name if home == kept else str(home)))
        if isinstance(craft, Leader) and craft.path.kind == "replay":
            return
        folder = self.folder(*loc, "tune")
        try:
            tune = resolve.find_tune(home, craft.tune, folder=folder)
        except ScenarioError as error:
            self.blame(error, *loc, "tune")
            return
        name = tune.stem if tune == home / f"{tune.stem}.param" else str(tune)
        self.changes.append(((*loc, "tune"), name))
        binary = getattr(craft.autopilot, "binary", None)
        if binary is not None:  # whether it is there only matters to who flies the page
            folder = self.folder(*loc, "autopilot", "binary")
            found = resolve.absolute(binary, folder)
            self.changes.append(((*loc, "autopilot", "binary"), str(found)))

    def recording(self, loc: _Loc, file: str) -> None:
        """Settle a data file."""
        try:
            found = resolve.find_data(file, folder=self.folder(*loc))
        except ScenarioError as error:
            self.blame(error, *loc)
            return
        kept = resolve.library() / "scenarios" / "data" / found.name
        self.changes.append((loc, found.name if found == kept else str(found)))

    def gains(self, loc: _Loc, file: str) -> None:
        """Settle a file of gains."""
        found = resolve.absolute(file, self.folder(*loc))
        if resolve.is_file(found):
            self.changes.append((loc, str(found)))
            return
        node, path, left = walk(self.tree, loc)
        text = f"there is no file {found} (write the path of a file like an airframe's {_GAINS})"
        self.problems.append(Problem(node.place, text, path + left))

    def law(self, loc: _Loc, name: str) -> None:
        """Settle a law that is not the paper's."""
        try:
            # who gives a text or an option, not a file, names the code himself
            given = not resolve.is_file(Path(walk(self.tree, loc)[0].place.source))
            found = resolve.find_law(name, folder=self.folder(*loc), anywhere=given)
        except ScenarioError as error:
            self.blame(error, *loc)
            return
        kept = resolve.library() / "scenarios"
        place, _, class_name = found.rpartition(":")
        if Path(place).parent == kept:
            found = f"{Path(place).stem}:{class_name}"
        self.changes.append((loc, found))

    def folder(self, *loc: str | int) -> Path:
        """Return what a relative path at this location is relative to."""
        return walk(self.tree, loc)[0].folder

    def blame(self, error: ScenarioError, *loc: str | int) -> None:
        """Keep a problem, at the place of the page that caused it."""
        node, path, left = walk(self.tree, loc)
        self.problems += [
            Problem(node.place, problem.text, path + left) for problem in error.problems
        ]


def settle(page: Scenario, tree: Node) -> Scenario:
    """Return the page with every reference as a name, or as an absolute path if it has no name.

    So the page means the same wherever it is read again, and a file that is missing is an error
    with a place rather than a surprise in mid-run.

    Raises:
        ScenarioError: naming everything that cannot be found.
    """
    settler = _Settler(tree)
    settler.craft(("leader",), page.leader)
    for index, follower in enumerate(page.fleet):
        settler.craft(("fleet", index), follower)
    if page.leader.path.kind == "replay":
        settler.recording(("leader", "path", "file"), page.leader.path.file)
    if page.air.wind.file is not None:
        settler.recording(("air", "wind", "file"), page.air.wind.file)
    for loc, link in sections(page.network):
        if link.jitter is not None and link.jitter.file is not None:
            settler.recording((*loc, "jitter", "file"), link.jitter.file)
        if link.trace is not None:
            settler.recording((*loc, "trace", "file"), link.trace.file)
    if page.controller.middle_loop is not None:
        settler.gains(("controller", "middle_loop"), page.controller.middle_loop)
    if page.controller.law != "paper":
        settler.law(("controller", "law"), page.controller.law)
    if settler.problems:
        raise ScenarioError(settler.problems)
    data = page.model_dump(by_alias=True)
    for loc, value in settler.changes:
        _put(data, loc, value)
    return Scenario.model_validate(data)


def _put(data: Any, loc: _Loc, value: str) -> None:  # noqa: ANN401 - nested plain data
    for part in loc[:-1]:
        data = data[part]
    data[loc[-1]] = value
