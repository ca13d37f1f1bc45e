"""From a page, those it extends and the changes asked for, to one frozen object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from testbed.scenario import resolve
from testbed.scenario.gains import GainChanges, Guidance, MiddleLoopFile, MiddleLoopGains
from testbed.scenario.messages import Place, Problem, ScenarioError, did_you_mean, folded
from testbed.scenario.overrides import override
from testbed.scenario.references import settle
from testbed.scenario.schema import Scenario
from testbed.scenario.spread import give_way, of_pattern, spread
from testbed.scenario.tree import Node, inherit, planted, walk
from testbed.scenario.yaml_door import parse, read, stop, validated, write

_LONGEST_CHAIN = 20
_AS_IS: GainChanges = {}
CHANGES = Place("controller.gains")  # of what is wrong in changes to a profile


@dataclass(frozen=True, slots=True)
class Draft:
    """A page that has been read and may be changed many times over; its files are read once."""

    path: Path
    tree: Node

    def page(self, overrides: Sequence[str] = ()) -> Scenario:
        """The page with changes, checked.

        Args:
            overrides: texts `key.path=value`, applied in order after `extends`.

        Raises:
            ScenarioError: with every problem found, each with its place.
        """
        return _scenario(self.tree, overrides)


def open_draft(name_or_path: str | Path, *, folder: Path | None = None) -> Draft:
    """Read a scenario and what it extends, unchecked.

    Args:
        name_or_path: a name of `list_scenarios()`, or the path of a page.
        folder: what a relative path is relative to; here, if None.

    Raises:
        ScenarioError: there is no such page, or it is not YAML.
    """
    path = resolve.find_scenario(name_or_path, folder=folder)
    return Draft(path, _chain(path, ()))


def load(name_or_path: str | Path, overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario by name or path and return it, checked.

    Args:
        name_or_path: a name of `list_scenarios()`, or the path of a page.
        overrides: texts `key.path=value`, applied in order after `extends`.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    return open_draft(name_or_path).page(overrides)


def loads(
    text: str, overrides: Sequence[str] = (), *, source: str = "<page>", look: bool = True
) -> Scenario:
    """Read a scenario from the text of its page; paths in it are relative to here.

    Of a page that a log kept the files that it names may be gone: without `look` nobody asks.

    Raises:
        ScenarioError: as `load` does; `source` stands for the file's name.
    """
    tree = _extended(parse(text, source, Path.cwd()), ())
    return _scenario(tree, overrides) if look else validated(spread(tree), Scenario)


def load_middle_loop(
    aircraft: str | Path,
    profile: str,
    *,
    file: str | Path | None = None,
    changes: GainChanges = _AS_IS,
) -> MiddleLoopGains:
    """Read one profile of an airframe's middle_loop.yaml.

    Args:
        aircraft: name or path of the airframe.
        profile: name of a section of that file.
        file: in place of the airframe's own.
        changes: what is different from the profile.

    Raises:
        ScenarioError: the airframe, the file or the profile is missing, or a gain is wrong; one of
            `changes` has the place `CHANGES`, and its path begins there.
    """
    tree = read(Path(file) if file else resolve.find_aircraft(aircraft) / "middle_loop.yaml")
    profiles = validated(tree, MiddleLoopFile).root
    if profile in profiles:
        own = profiles[profile]
        if not changes:
            return own
        data = own.model_dump(mode="json")
        for key, value in changes.items():
            inner = data.get(key)
            if isinstance(value, Mapping) and isinstance(inner, dict):
                data[key] = {**inner, **value}
            else:
                data[key] = value
        return validated(planted(data, CHANGES), MiddleLoopGains)
    hint = did_you_mean(profile, profiles)
    known = ", ".join(profiles)
    raise stop(tree.place, f"there is no profile {profile!r}{hint} (write one of {known})")


def gains_of(page: Scenario, aircraft: str | Path) -> MiddleLoopGains:
    """The middle loop's gains with which a page flies followers of this airframe.

    Raises:
        ScenarioError: as `load_middle_loop` does.
    """
    controller = page.controller
    return load_middle_loop(
        aircraft, controller.profile, file=controller.middle_loop, changes=controller.gains
    )


def dump_middle_loop(profiles: Mapping[str, MiddleLoopGains]) -> str:
    """Return gains by profile as the text of a middle_loop.yaml."""
    return write({name: gains.model_dump(mode="json") for name, gains in profiles.items()})


def load_guidance(aircraft: str | Path) -> Guidance:
    """Read an airframe's guidance.yaml; without one, what suits the Rascal 110.

    Raises:
        ScenarioError: the airframe is missing, or a gain is wrong.
    """
    path = resolve.find_aircraft(aircraft) / "guidance.yaml"
    return validated(read(path), Guidance) if path.is_file() else Guidance()


def dump(page: Scenario) -> str:
    """Return the whole page as YAML, defaults included; it loads again to an equal object."""
    return write(page.model_dump(mode="json", by_alias=True))


def _scenario(tree: Node, overrides: Sequence[str]) -> Scenario:
    # a pattern is as large as it gets before one aircraft in it is changed
    early = [text for text in overrides if of_pattern(text.partition("=")[0])]
    for text in early:
        tree = override(give_way(tree, override(tree, text, parse)), text, parse)
    tree = spread(tree)
    for text in overrides:
        if text not in early:
            tree = override(tree, text, parse)
    try:
        page = settle(validated(tree, Scenario), tree)
        _check_profile(page, tree)
    except ScenarioError as error:
        raise ScenarioError(folded(error.problems)) from None
    return page


def _check_profile(page: Scenario, tree: Node) -> None:
    node, path, left = walk(tree, ("controller", "profile"))
    problems = []
    airframes = tuple(dict.fromkeys(follower.aircraft for follower in page.fleet))
    if page.controller.middle_loop is not None and len(airframes) > 1:
        file, at, _ = walk(tree, ("controller", "middle_loop"))
        text = f"is for one airframe, and the fleet has {', '.join(airframes)} (leave it out)"
        problems.append(Problem(file.place, text, at))
    for aircraft in airframes:
        try:
            gains_of(page, aircraft)
        except ScenarioError as error:
            for each in error.problems:
                if each.place == CHANGES:
                    wrong, at, rest = walk(tree, ("controller", "gains", *each.path))
                    problems.append(Problem(wrong.place, each.text, at + rest))
                else:
                    problems.append(Problem(node.place, str(each), path + left))
    problems = list(dict.fromkeys(problems))
    if problems:
        raise ScenarioError(problems)


def _chain(path: Path, below: tuple[Path, ...]) -> Node:
    return _extended(read(path), (*below, path))


def _extended(tree: Node, chain: tuple[Path, ...]) -> Node:
    """Put the page on top of the one it extends, and that on top of its own."""
    if not isinstance(tree.value, dict) or "extends" not in tree.value:
        return tree
    own = dict(tree.value)
    wish = own.pop("extends")
    top = Node(own, tree.place, tree.key, tree.folder)
    if not isinstance(wish.value, str):
        raise stop(wish.place, "must be the name or the path of a scenario", ("extends",))
    try:
        base = resolve.find_scenario(wish.value, folder=wish.folder)
    except ScenarioError as error:
        raise stop(wish.place, error.problems[0].text, ("extends",)) from None
    if base in chain:
        raise stop(wish.place, f"{wish.value!r} extends this page in turn", ("extends",))
    if len(chain) >= _LONGEST_CHAIN:
        raise stop(wish.place, f"more than {_LONGEST_CHAIN} pages in a row", ("extends",))
    below = _chain(base, chain)
    return inherit(give_way(below, top), top)
