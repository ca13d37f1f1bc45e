"""Read a scenario: its file, the files it extends, and settings."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

from testbed.core.errors import InputError
from testbed.core.numbers import parse_whole
from testbed.core.reads import unrecorded
from testbed.scenario import references
from testbed.scenario.arguments import check_overrides, check_path, with_changes
from testbed.scenario.fields import KeyPath, merge_maps
from testbed.scenario.middle_loop import GainChanges, Guidance, MiddleLoopFile, MiddleLoopGains
from testbed.scenario.pattern import drop_follower_keys, expand_pattern, is_pattern_key
from testbed.scenario.problems import (
    FilePosition,
    Problem,
    ScenarioError,
    did_you_mean,
    merge_repeated,
)
from testbed.scenario.references import resolve_references
from testbed.scenario.schema import Scenario, set_duration, set_seed
from testbed.scenario.set_keys import find_set_keys
from testbed.scenario.single_aircraft import SingleAircraft
from testbed.scenario.validate import validate
from testbed.scenario.yaml_io import (
    Node,
    error_at,
    expand_preset,
    header_of,
    inherit,
    null_removes,
    parse,
    plant,
    read,
    read_source,
    walk,
    write,
)

_MAX_CHAIN = 20  # files that extend each other
_BEGIN = ("scenario", "begin", "scenario")
_MAX_BEGINS = 10  # flights that begin with each other; each is flown twice
_NO_CHANGES: GainChanges = {}
# settings with which published numbers remain those of this scenario
_NEUTRAL = ("limits", "expect", "log")
_NEUTRAL_PATHS = tuple(
    ("scenario", key)
    for key in ("name", "question", "expectation", "seed", "duration_s", "published")
)
_FOREIGN = "has no key of a scenario (write the name or the path of a scenario)"
CHANGES = FilePosition("controller.gains")  # place of problems in changes to a profile


@dataclass(frozen=True, slots=True)
class ScenarioFile:
    """A scenario file merged with those it extends, not yet checked.

    It can be resolved many times with different settings without being read again.

    Args:
        path: of the file.
        tree: of all files together.
        files: this one, and those that it extends.
    """

    path: Path
    tree: Node
    files: tuple[Path, ...]

    def resolve(
        self, overrides: Sequence[str] = (), *, settings_folder: Path | None = None
    ) -> Scenario:
        """Return the scenario with settings, checked.

        Args:
            overrides: texts `key.path=value`, applied in order after `extends`.
            settings_folder: of the file that has them: the first base of their relative paths,
                outside of which they run no code; None: the caller wrote them.

        Raises:
            ScenarioError: with every problem found, each with its place.
        """
        return _resolve(self.tree, overrides, settings_folder)


def open_scenario(
    name_or_path: str | os.PathLike[str], *, folder: Path | None = None
) -> ScenarioFile:
    """Read a scenario file and those it extends.

    Args:
        name_or_path: a name of `list_scenarios()`, or the path of a file.
        folder: base of a relative path that a file has; None: the working directory.

    Raises:
        ScenarioError: a file does not exist or is not YAML.
        InputError: the argument is no path.
    """
    check_path("scenario", name_or_path)
    path = references.find_scenario(os.fspath(name_or_path), folder=folder)
    tree = read(path)
    if folder is not None and not _has_scenario_key(tree):
        raise error_at(FilePosition(str(name_or_path)), f"{path} {_FOREIGN}")
    trees, files = _files(tree, (path,))
    return ScenarioFile(path, _merged(trees), files)


def load_scenario(name_or_path: str | os.PathLike[str], overrides: Sequence[str] = ()) -> Scenario:
    """Read a scenario by name or path and return it, checked.

    Args:
        name_or_path: a name of `list_scenarios()`, or the path of a file.
        overrides: texts `key.path=value`, applied in order after `extends`.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    return open_scenario(name_or_path).resolve(overrides)


def find_loaded(
    scenario: Scenario | str | os.PathLike[str],
    overrides: Sequence[str],
    *,
    duration_s: float | None = None,
    seed: int | None = None,
) -> Scenario:
    """Return the scenario of a call.

    Args:
        scenario: a scenario, or the name or path of one.
        overrides: `key=value` as for `--set`.
        duration_s: see `set_duration`; None: that of the scenario.
        seed: see `set_seed`; None: that of the scenario.

    Raises:
        InputError: there is none, overrides are those of a scenario that is loaded already, or a
            number is out of range.
    """
    texts = check_overrides("overrides", overrides)
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario, texts)
    elif texts:
        raise InputError(
            f"overrides: {', '.join(texts)}: the scenario is loaded already (give them to "
            "load_scenario)"
        )
    if seed is not None:
        scenario = set_seed(scenario, seed)
    return scenario if duration_s is None else set_duration(scenario, duration_s)


def loads(
    text: str,
    overrides: Sequence[str] = (),
    *,
    source: str = "<scenario>",
    check_files: bool = True,
) -> Scenario:
    """Read a scenario from a text; paths in it are from the working directory.

    Args:
        text: of the file.
        overrides: as `load_scenario` has them.
        source: name of the file in errors.
        check_files: look for the files that the scenario names; False for that of a log, whose
            files may be elsewhere.

    Raises:
        ScenarioError: with every problem found, each with its place.
    """
    tree = _merged(_files(parse(text, source, Path.cwd()), ())[0])
    return _resolve(tree, overrides) if check_files else validate(expand_pattern(tree), Scenario)


def load_middle_loop(
    aircraft: str | Path,
    profile: str,
    *,
    file: str | Path | None = None,
    changes: GainChanges = _NO_CHANGES,
) -> MiddleLoopGains:
    """Read one profile of an airframe's middle_loop.yaml.

    Args:
        aircraft: name or path of the airframe.
        profile: name of a section of that file.
        file: in place of the airframe's own.
        changes: values that differ from the profile.

    Raises:
        ScenarioError: the airframe, the file or the profile does not exist, or a gain is wrong; a
            wrong change has the place `CHANGES`, and its path begins there.
    """
    path = Path(file) if file else references.find_aircraft(aircraft) / "middle_loop.yaml"
    profiles, place = _parse_middle_loop(*read_source(path))
    if profile in profiles:
        gains = profiles[profile]
        if not changes:
            return gains
        data = merge_maps(gains.model_dump(mode="json"), changes)
        return validate(plant(data, CHANGES), MiddleLoopGains)
    hint = did_you_mean(profile, profiles)
    known = ", ".join(profiles)
    raise error_at(place, f"there is no profile {profile!r}{hint} (write one of {known})")


@lru_cache(maxsize=64)
def _parse_middle_loop(
    text: str, source: str, folder: Path
) -> tuple[Mapping[str, MiddleLoopGains], FilePosition]:
    """Return the profiles of a middle_loop.yaml, and its place; each flight reads it several times.

    Raises:
        ScenarioError: it is not YAML, or a gain is wrong.
    """
    tree = parse(text, source, folder)
    return validate(tree, MiddleLoopFile).root, tree.place


def middle_loop_gains(scenario: Scenario, aircraft: str | Path) -> MiddleLoopGains:
    """Return the gains of the middle loop for followers of an airframe.

    Raises:
        ScenarioError: as `load_middle_loop` does.
    """
    controller = scenario.controller
    return load_middle_loop(
        aircraft, controller.profile, file=controller.middle_loop, changes=controller.gains
    )


def dump_middle_loop(profiles: Mapping[str, MiddleLoopGains]) -> str:
    """Return gains by profile as the text of a middle_loop.yaml."""
    return write({name: gains.model_dump(mode="json") for name, gains in profiles.items()})


def load_guidance(aircraft: str | Path) -> Guidance:
    """Read an airframe's guidance.yaml; without the file, gains for the Rascal 110.

    Raises:
        ScenarioError: the airframe does not exist, or a gain is wrong.
    """
    path = references.find_aircraft(aircraft) / "guidance.yaml"
    return validate(read(path), Guidance) if path.is_file() else Guidance()


def dump(scenario: Scenario | SingleAircraft) -> str:
    """Return a scenario as YAML with all defaults; it loads again to an equal object."""
    return write(scenario.model_dump(mode="json", by_alias=True))


class ScenarioText:
    """Text of a scenario, which is made when it is first needed."""

    CONSTANT = True

    def __init__(self, scenario: Scenario | SingleAircraft) -> None:
        self._scenario = scenario

    def __call__(self) -> str:
        """Return it, as `dump` does; that is no use of the scenario's keys."""
        return self._text

    @cached_property
    def _text(self) -> str:
        with unrecorded():
            return dump(self._scenario)


def place_of_key(error: str, name_or_path: str | Path, overrides: Sequence[str] = ()) -> str:
    """Return the place, `file:line:column`, of the key that an error begins with.

    Args:
        error: its text, as `leader.path.legs[3].radius_m: ...`.
        name_or_path: of the scenario, which has been loaded with these settings.
        overrides: as `load_scenario` has them.

    Returns:
        The place of the key, or of the deepest map that would have it; empty if the error does not
        begin with a key of the scenario.
    """
    key, colon, _ = error.partition(": ")
    parts = re.split(r"[.\[]", key.replace("]", ""))
    if not colon or parts[0] not in Scenario.model_fields:
        return ""
    loc = tuple(part if (index := parse_whole(part)) is None else index for part in parts)
    (place,) = find_places([loc], name_or_path, overrides)
    return str(place) if place else ""


def find_places(
    paths: Sequence[KeyPath], name_or_path: str | Path, overrides: Sequence[str] = ()
) -> list[FilePosition | None]:
    """Return the places of key paths, or of the deepest maps that exist.

    Args:
        paths: keys and list indices from the top of the file.
        name_or_path: of the scenario, which has been loaded with these settings.
        overrides: as `load` has them.

    Returns:
        None for a path whose first key the scenario does not have.
    """
    settings = [parse_setting(text) for text in overrides]
    _, tree = _set(open_scenario(name_or_path).tree, settings)
    nodes = [walk(tree, path) for path in paths]
    return [node.place if found else None for node, found, _ in nodes]


def _set(tree: Node, settings: Sequence[Setting]) -> tuple[Node, Node]:
    """Return a tree with the settings of its pattern alone, and with all, expanded."""
    # settings of a pattern precede those of one aircraft in it
    for setting in settings:
        if is_pattern_key(setting.keys):
            tree = override(drop_follower_keys(tree, override(tree, setting)), setting)
    unchanged, tree = tree, expand_pattern(tree)
    for setting in settings:
        if not is_pattern_key(setting.keys):
            tree = override(tree, setting)
    return unchanged, tree


def _resolve(tree: Node, overrides: Sequence[str], settings_folder: Path | None = None) -> Scenario:
    texts = check_overrides("overrides", overrides)
    settings = [parse_setting(text, settings_folder) for text in texts]
    unchanged, tree = _set(tree, settings)
    try:
        scenario = resolve_references(validate(tree, Scenario), tree, settings_folder)
        _check_gains(scenario, tree)
        _check_begin(scenario, tree)
    except ScenarioError as error:
        raise ScenarioError(merge_repeated(error.problems)) from None
    scenario = _with_differences(scenario, unchanged, settings)
    return scenario.with_set_keys(
        find_set_keys(tree, unchanged, settings, in_library=_in_library(unchanged))
    )


def _in_library(tree: Node) -> bool:
    return Path(tree.place.source).resolve().parent == references.library() / "scenarios"


def _with_differences(scenario: Scenario, tree: Node, settings: Sequence[Setting]) -> Scenario:
    """Note in the published numbers which settings make this another set-up.

    Args:
        scenario: with the settings.
        tree: without them.
        settings: those that change no number, as the seed's, do not count.
    """
    published = scenario.scenario.published
    paths = [setting.keys for setting in settings]
    keys = [keys for keys in paths if keys[0] not in _NEUTRAL and keys[:2] not in _NEUTRAL_PATHS]
    if published is None or not keys or ("scenario", "published") in [each[:2] for each in paths]:
        return scenario
    with suppress(ScenarioError):
        before = validate(expand_pattern(tree), Scenario)
        if _set_up(resolve_references(before, expand_pattern(tree))) == _set_up(scenario):
            return scenario
    differs = dict.fromkeys((*published.differs, *(".".join(each) for each in keys)))
    published = with_changes(published, differs=tuple(differs))
    return with_changes(scenario, scenario=with_changes(scenario.scenario, published=published))


def _set_up(scenario: Scenario) -> dict[str, object]:
    """Return what decides the numbers of a scenario, but its seed and duration."""
    data = scenario.model_dump(exclude=set(_NEUTRAL))
    for _, key in _NEUTRAL_PATHS:
        data["scenario"].pop(key, None)
    return data


def _check_gains(scenario: Scenario, tree: Node) -> None:
    """Check profile, file and changes of the middle loop for every airframe of the fleet."""
    node, path, rest = walk(tree, ("controller", "profile"))
    problems = []
    airframes = tuple(dict.fromkeys(follower.aircraft for follower in scenario.fleet))
    if scenario.controller.middle_loop is not None and len(airframes) > 1:
        file, at, _ = walk(tree, ("controller", "middle_loop"))
        text = f"is for one airframe, and the fleet has {', '.join(airframes)} (leave it out)"
        problems.append(Problem(file.place, text, at))
    for aircraft in airframes:
        try:
            middle_loop_gains(scenario, aircraft)
        except ScenarioError as error:
            for each in error.problems:
                if each.place == CHANGES:
                    change, at, missing = walk(tree, ("controller", "gains", *each.path))
                    problems.append(Problem(change.place, each.text, at + missing))
                else:
                    problems.append(Problem(node.place, str(each), path + rest))
    problems = list(dict.fromkeys(problems))
    if problems:
        raise ScenarioError(problems)


def _check_begin(scenario: Scenario, tree: Node) -> None:
    """Check that the flights that a flight begins with, one after the other, come to an end.

    Raises:
        ScenarioError: one is named twice, there are too many, or a file cannot be read.
    """
    if scenario.scenario.begin is None:
        return
    here, at, _ = walk(tree, _BEGIN)
    chain: list[Path] = []
    name, folder = scenario.scenario.begin.scenario, here.folder
    while True:
        try:
            prior = open_scenario(name, folder=folder)
        except ScenarioError as error:
            if not chain:
                raise  # with its place
            raise error_at(here.place, f"{chain[-1]} cannot begin: {error}", at) from None
        seen = prior.path.resolve() in chain
        chain.append(prior.path.resolve())
        if seen:
            names = " begins with ".join(each.name for each in chain)
            text = f"never begins: {names} (remove scenario.begin of one of them)"
            raise error_at(here.place, text, at)
        if len(chain) > _MAX_BEGINS:
            text = f"is a chain of more than {_MAX_BEGINS} scenarios (write a shorter one)"
            raise error_at(here.place, text, at)
        begin, _, missing = walk(prior.tree, _BEGIN)
        if missing or not isinstance(begin.value, str):
            return
        name, folder = begin.value, begin.folder


def _files(tree: Node, chain: tuple[Path, ...]) -> tuple[list[Node], tuple[Path, ...]]:
    """Read the files that a scenario extends.

    Args:
        tree: of the scenario.
        chain: files up to this one.

    Returns:
        The trees, this one first, without `extends`; and all files.
    """
    if not isinstance(tree.value, dict) or "extends" not in tree.value:
        return [tree], chain
    own = dict(tree.value)
    extends = own.pop("extends")
    top = replace(tree, value=own)
    if not isinstance(extends.value, str):
        text = "must be the name or the path of a scenario"
        raise error_at(extends.place, text, ("extends",))
    try:
        base = references.find_scenario(extends.value, folder=extends.folder)
    except ScenarioError as error:
        raise error_at(extends.place, error.problems[0].text, ("extends",)) from None
    if base in chain:
        text = f"{extends.value!r} extends this file in turn (write another scenario)"
        raise error_at(extends.place, text, ("extends",))
    if len(chain) >= _MAX_CHAIN:
        text = f"is a chain of more than {_MAX_CHAIN} files (write a shorter one)"
        raise error_at(extends.place, text, ("extends",))
    below = read(base)
    if not _has_scenario_key(below):
        raise error_at(extends.place, f"{base} {_FOREIGN}", ("extends",))
    trees, files = _files(below, (*chain, base))
    return [top, *trees], files


def _has_scenario_key(tree: Node) -> bool:
    """Return whether a file can be a scenario; errors do not quote others."""
    if not isinstance(tree.value, dict):
        return True  # `validate` refuses it without its content
    return not tree.value or not tree.value.keys().isdisjoint({"extends", *Scenario.model_fields})


def _merged(files: list[Node]) -> Node:
    """Merge each file with the next one, which it extends."""
    *tops, tree = files
    for top in reversed(tops):
        tree = inherit(drop_follower_keys(tree, top), top)
    return tree


def uninherited_source(name_or_path: str | os.PathLike[str]) -> str:
    """Return the source of published numbers that a scenario of another name does not inherit.

    Empty if no file that it extends has any, or if it removes them itself.

    Args:
        name_or_path: of a scenario that has been loaded.
    """
    path = references.find_scenario(os.fspath(name_or_path))
    *tops, tree = _files(read(path), (path,))[0]
    source = ""
    for top in reversed(tops):
        before = header_of(tree).get("published")
        tree = inherit(drop_follower_keys(tree, top), top)
        if "published" in header_of(top) or "published" in header_of(tree):
            source = ""
        elif before is not None and isinstance(before.value, dict) and "source" in before.value:
            source = str(before.value["source"].value)
    return source


_LINKS = ("network", "links")  # its maps, by sender and by receiver, have a key '*' for the rest


@dataclass(frozen=True, slots=True)
class Setting:
    """One change of a scenario.

    Args:
        text: as written, `key.path=value`.
        keys: of the path.
        value: every node of it has the setting as its place.
    """

    text: str
    keys: tuple[str, ...]
    value: Node

    @property
    def place(self) -> FilePosition:
        """Return what stands for a place in a file in errors."""
        return FilePosition(f"--set {self.text}")

    @property
    def tree(self) -> Node:
        """Return the value under its keys, as a scenario with nothing else."""
        node = self.value
        for key in reversed(self.keys):
            node = replace(node, value={key: node})
        return node


def parse_setting(text: str, folder: Path | None = None) -> Setting:
    """Read `key.path=value`, the value in YAML.

    Args:
        text: as written.
        folder: base of relative paths in the value; None: the working directory.

    Raises:
        ScenarioError: the text is not of that form.
    """
    key, equals, value = text.partition("=")
    keys = tuple(key.strip().split("."))
    source = f"--set {text}"
    if not text.isprintable() and any("\ud800" <= each <= "\udfff" for each in text):
        raise error_at(FilePosition(source), "is not UTF-8 text (write it in UTF-8)")
    if not equals or not all(keys):
        raise error_at(
            FilePosition(source), "is not key.path=value (write for example rates.log_hz=50)"
        )
    try:
        node = parse(value, source, folder or Path.cwd())
    except ScenarioError as error:
        raise error_at(FilePosition(source), error.problems[0].text, keys) from None
    return Setting(text, keys, _placed(node, FilePosition(source)))


def override(tree: Node, setting: Setting) -> Node:
    """Return the scenario with one value changed.

    In a list a key is an index from 0 or the `name` of an element, and `*` is every element of a
    list or map; below network.links it is every link. A key that the file leaves out is added.
    Null removes a key. A key inside sensors that are the name of a preset changes that preset.

    Raises:
        ScenarioError: the keys lead nowhere.
    """
    return _set_value(tree, setting.keys, (), setting)


def _placed(node: Node, place: FilePosition) -> Node:
    """Give every node of a value one place: a setting has no lines."""
    value = node.value
    if isinstance(value, dict):
        value = {name: _placed(child, place) for name, child in value.items()}
    elif isinstance(value, tuple):
        value = tuple(_placed(child, place) for child in value)
    return Node(value, place, place, node.folder, node.text)


def _set_value(node: Node, keys: tuple[str, ...], done: tuple[str, ...], setting: Setting) -> Node:
    if not keys:
        return setting.value
    key, rest = keys[0], keys[1:]
    parent = done[-1] if done else ""
    node = expand_preset(node, parent)
    if isinstance(node.value, tuple):
        children = list(node.value)
        for index in _indices(node.value, key, done, setting):
            children[index] = _set_value(children[index], rest, (*done, str(index)), setting)
        return replace(node, value=tuple(children))
    if isinstance(node.value, dict) or node.value is None:
        named = dict(node.value or {})
        new = setting.value
        for name in _names(named, key, done, setting):
            child = named.get(name, Node(None, new.place, new.place, new.folder))
            if not rest and new.value is None and null_removes(named, name, parent):
                del named[name]
            else:
                named[name] = _set_value(child, rest, (*done, name), setting)
        return replace(node, value=named)
    raise error_at(setting.place, f"is {node.value!r}, which has no {key!r} inside", done)


def _names(
    named: dict[str, Node], key: str, done: tuple[str, ...], setting: Setting
) -> tuple[str, ...]:
    if key != "*":
        return (key,)
    if done[:2] == _LINKS and len(done) < len(_LINKS) + 2:
        return tuple(dict.fromkeys((*named, "*")))
    if not named:
        raise error_at(setting.place, "is empty: * stands for nothing", done)
    return tuple(named)


def _indices(
    items: tuple[Node, ...], key: str, done: tuple[str, ...], setting: Setting
) -> tuple[int, ...]:
    if key == "*":
        return tuple(range(len(items)))
    index = parse_whole(key)
    if index is not None and 0 <= index < len(items):
        return (index,)
    names = [
        item.value["name"].value if isinstance(item.value, dict) and "name" in item.value else None
        for item in items
    ]
    if key in names:
        return (names.index(key),)
    known = [name for name in names if isinstance(name, str)]
    indices = f"0 to {len(items) - 1}" if items else "nothing: it is empty"
    raise error_at(
        setting.place,
        f"has no element {key!r}{did_you_mean(key, known)} (it has "
        f"{', '.join([indices, *known])}; * is all of them)",
        done,
    )
