"""Files that scenarios name: airframes, scenarios, studies, data, gains, laws; by name or path.

A name is that of a file of `core.library`; no other folder is searched.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from testbed.core.errors import InputError
from testbed.core.library import library as library
from testbed.scenario.checks import check_air, check_sensor_rates
from testbed.scenario.fields import KeyPath, Section
from testbed.scenario.problems import FilePosition, Problem, ScenarioError, did_you_mean
from testbed.scenario.reference_fields import BUILT_IN, Reference, ReferenceKind, references
from testbed.scenario.schema import Scenario
from testbed.scenario.single_aircraft import SingleAircraft
from testbed.scenario.yaml_io import Node, error_at, walk

_Found = TypeVar("_Found")
SectionT = TypeVar("SectionT", bound=Section)
_DATA = Path("scenarios/data")
LAWS = Path(__file__).resolve().parents[1] / "laws"
_YAML, _PARAM = ".yaml", ".param"
FMU = ".fmu"  # end of the path of a law that is an FMU


def list_aircraft() -> tuple[str, ...]:
    """Return the names of the airframes that come with the testbed, sorted."""
    folder = library() / "aircraft"
    return tuple(sorted(f.name for f in folder.glob("*") if (f / f"{f.name}.xml").is_file()))


@dataclass(frozen=True, slots=True)
class _YamlFiles:
    """YAML files of one kind in a folder of the library, which are named without their ending."""

    kind: str
    folder: Path

    def list(self) -> tuple[str, ...]:
        """Return the names of those that come with the testbed, sorted."""
        return _stems(library() / self.folder, _YAML)

    def find(self, name_or_path: str | Path, *, folder: Path | None = None) -> Path:
        """Return the file of a name or path (from `folder`, or here).

        Raises:
            ScenarioError: there is no such file.
        """
        own = library() / self.folder / f"{name_or_path}{_YAML}"
        return _find(self.kind, name_or_path, own, self.list, "a .yaml file", folder)


_SCENARIOS = _YamlFiles("scenario", Path("scenarios"))
_STUDIES = _YamlFiles("study", Path("scenarios/studies"))
_TUNINGS = _YamlFiles("tune", Path("scenarios/studies/tunes"))
list_scenarios, find_scenario = _SCENARIOS.list, _SCENARIOS.find
list_studies, find_study = _STUDIES.list, _STUDIES.find
list_tunings, find_tuning = _TUNINGS.list, _TUNINGS.find


def list_data() -> tuple[str, ...]:
    """Return the names of the data files that scenarios use, sorted."""
    return tuple(sorted(f.name for f in (library() / _DATA).glob("*.csv")))


def list_laws() -> tuple[str, ...]:
    """Return the names of the laws of the library, sorted; the built-in one is not among them."""
    return tuple(sorted(f.stem.replace("_", "-") for f in LAWS.glob("*.py")))


def find_law(name: str) -> Path:
    """Return the file of a law of the library, in which a function has the file's name.

    Raises:
        ScenarioError: there is no such law.
    """
    if name in (known := list_laws()):
        return LAWS / f"{name.replace('-', '_')}.py"
    known = (BUILT_IN, *known)
    hint = did_you_mean(name.replace("_", "-"), known)
    text = f"there is no law {name!r}{hint} (write one of: {', '.join(known)}; or "
    text += "module:Class or module:function for your own law, or the path of an FMU)"
    raise error_at(FilePosition(name), text)


def find_aircraft(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return the folder of an airframe, by name or path (from `folder`, or here).

    Raises:
        ScenarioError: there is no such folder, or it has no <folder's name>.xml.
    """
    text = str(name_or_path)
    own = library() / "aircraft" / text
    path = own if _is_name(text) and _exists(own, Path.is_dir) else absolute(text, folder)
    if is_file(path / f"{path.name}.xml"):
        return path
    if _exists(path, Path.is_dir):
        text = f"{path} has no {path.name}.xml (write a folder with a model of its name)"
        raise error_at(FilePosition(str(path)), text)
    raise _not_found("aircraft", text, list_aircraft(), "a folder with a JSBSim model", path)


def find_tune(aircraft: str | Path, tune: str | Path, *, folder: Path | None = None) -> Path:
    """Return the .param file of an airframe: `<tune>.param` in its folder, or a path.

    Raises:
        ScenarioError: there is no such airframe or file.
    """
    home = find_aircraft(aircraft, folder=folder)
    what, own = f"tune of {home.name}", home / f"{tune}{_PARAM}"
    return _find(what, tune, own, lambda: _stems(home, _PARAM), "a .param file", folder)


def find_data(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return a data file, by name in scenarios/data or path (from `folder`, or here).

    Raises:
        ScenarioError: there is no such file.
    """
    own = library() / _DATA / name_or_path
    return _find("data file", name_or_path, own, list_data, "a CSV file", folder)


def find_code(name: str, *, folder: Path | None = None, within: Path | None = None) -> str:
    """Return the source of code `module:name`: "file.py:name", or itself if installed.

    A module.py in `folder` (of the scenario file) or in scenarios/ precedes an installed module.

    Args:
        name: `module:name` or `file.py:name` of a law's class or of a function, the path of an FMU,
            or the name of a law of the library.
        folder: None: find a resolved name again.
        within: the folder of the file that names it, outside of which a file runs no code; None:
            the caller names it, and may choose any.

    Raises:
        ScenarioError: the file does not exist, or is outside of `within`.
    """
    if name.endswith(FMU):
        path = absolute(name, folder)
        if not is_file(path):
            raise error_at(
                FilePosition(str(path)), f"there is no file {path} (write the path of an FMU)"
            )
        _refuse_outside(path, within)
        return str(path)
    if ":" not in name:
        path = find_law(name)
        return f"{path}:{path.stem}"
    module, _, object_name = name.rpartition(":")
    if module.endswith(".py"):
        path = absolute(module, folder)
        if not is_file(path):
            text = f"there is no file {path} (write module:name, with module.py in this folder)"
            raise error_at(FilePosition(str(path)), text)
        _refuse_outside(path, within)
        return f"{path}:{object_name}"
    file = f"{module.replace('.', '/')}.py"
    for home in (folder, library() / "scenarios"):
        if home is not None and is_file(home / file):
            path = (home / file).resolve()
            _refuse_outside(path, home)  # by a link
            if home == folder:
                _refuse_outside(path, within)
            return f"{path}:{object_name}"
    return name


def _refuse_outside(path: Path, folder: Path | None) -> None:
    if folder is not None and not path.is_relative_to(folder.resolve()):
        text = f"{path} is not in the folder of the file that names it, {folder} (put a copy there)"
        raise error_at(FilePosition(str(path)), text)


def _find(
    what: str,
    name_or_path: str | Path,
    own: Path,
    known: Callable[[], tuple[str, ...]],
    path_of: str,
    folder: Path | None = None,
) -> Path:
    """Return the testbed's own file of a name, or the file at a path."""
    text = str(name_or_path)
    if _is_name(text) and is_file(own):
        return own
    path = absolute(text, folder)
    if is_file(path):
        return path
    raise _not_found(what, text, known(), path_of, path)


def _stems(folder: Path, ending: str) -> tuple[str, ...]:
    return tuple(sorted(f.stem for f in folder.glob(f"*{ending}")))


def _is_name(text: str) -> bool:
    return Path(text).name == text and text not in ("", ".", "..")


def is_file(path: Path) -> bool:
    """Return whether a file exists; a name that no file can have is no error."""
    return _exists(path, Path.is_file)


def _exists(path: Path, kind: Callable[[Path], bool]) -> bool:
    try:
        return kind(path)
    except OSError:  # name too long, or no permission
        return False


def absolute(text: str, folder: Path | None) -> Path:
    """Return the absolute path from `folder` or from here; the file need not exist."""
    path = Path(text)
    try:
        return ((folder or Path.cwd()) / path.expanduser()).resolve()
    except (OSError, RuntimeError, ValueError):  # unknown user, loop of links, invalid byte
        return (folder or Path.cwd()) / path


def _not_found(
    what: str, text: str, known: tuple[str, ...], path_of: str, looked_at: Path
) -> ScenarioError:
    """Make the error of a name or path that does not exist."""
    if not _is_name(text) or Path(text).suffix in (_YAML, _PARAM):
        message = f"there is no file {looked_at}"
        if path_of.startswith("a folder"):
            message = f"there is no folder {looked_at}"
        hint, article = did_you_mean(Path(text).stem, known), "an" if what[0] == "a" else "a"
        message += f" (write the path of {path_of}, or the name of {article} {what}{hint})"
    else:
        names = ", ".join(known) or "none"
        beside = [f"{text}{suffix}" for suffix in (_YAML, _PARAM) if suffix in path_of]
        beside = [each for each in beside if is_file(looked_at.with_name(each))]
        hint = f": did you mean {beside[0]!r}?" if beside else did_you_mean(text, known)
        message = (
            f"there is no {what} {text!r}{hint} (write one of: {names}; or "
            f"the path of {path_of}, relative to {looked_at.parent})"
        )
    return error_at(FilePosition(text), message)


def aircraft_reference(folder: Path) -> str:
    """Return the name of an airframe of the library, or the path of another."""
    return folder.name if folder == library() / "aircraft" / folder.name else str(folder)


def scenario_reference(file: Path) -> str:
    """Return the name of a scenario of the library, or the path of another."""
    return file.stem if file == library() / "scenarios" / file.name else str(file)


def tune_reference(aircraft: Path, tune: Path) -> str:
    """Return the name of a tune in the folder of its airframe, or the path of another."""
    return tune.stem if tune == aircraft / f"{tune.stem}.param" else str(tune)


def data_reference(file: Path) -> str:
    """Return the name of a data file of the library, or the path of another."""
    return file.name if file == library() / _DATA / file.name else str(file)


_GAINS = "middle_loop.yaml"


class _Finder(NamedTuple):
    """How the files of one kind of reference are found, and named in a resolved scenario."""

    find: Callable[..., Path]  # by text, from `folder`
    name: Callable[[Path], str]


def find_gains(file: str, *, folder: Path | None = None) -> Path:
    """Return a file of gains, by its path (from `folder`, or here).

    Raises:
        ScenarioError: there is no such file.
    """
    found = absolute(file, folder)
    if not is_file(found):
        text = f"there is no file {found} (write the path of a file like an airframe's {_GAINS})"
        raise error_at(FilePosition(str(found)), text)
    return found


# the tune of an aircraft and code are found with more than the text and a folder
FINDERS: Mapping[ReferenceKind, _Finder] = {
    "aircraft": _Finder(find_aircraft, aircraft_reference),
    "scenario": _Finder(find_scenario, scenario_reference),
    "data": _Finder(find_data, data_reference),
    "gains": _Finder(find_gains, str),
}


def find_reference(reference: Reference) -> Path:
    """Return the file or folder that a reference of a resolved scenario names, except of code.

    Raises:
        ScenarioError: it does not exist.
    """
    if reference.kind == "tune":
        return find_tune(reference.aircraft, reference.name)
    return FINDERS[reference.kind].find(reference.name)


class _Resolver:
    """Finds files, and collects resolved values and problems."""

    def __init__(self, tree: Node, settings_folder: Path | None) -> None:
        self.tree, self._settings_folder = tree, settings_folder
        self.changes: list[tuple[KeyPath, str]] = []
        self.problems: list[Problem] = []
        self._homes: dict[KeyPath, Path] = {}  # of the aircraft that were found, by section

    def resolve(self, reference: Reference) -> None:
        """Find what a reference names."""
        section = reference.loc[:-1]
        if reference.kind == "tune" and section not in self._homes:
            return  # as its aircraft was not found
        with self._problems_at(*reference.loc) as folders:
            self.changes.append((reference.loc, self._find(reference, folders)))

    def _find(self, reference: Reference, folders: tuple[Path, ...]) -> str:
        """Return the name of what a reference names, or else its absolute path."""
        loc, kind, name, _ = reference
        if kind == "code":
            return self._find_code(loc, name, folders)
        if kind == "tune":
            home = self._homes[loc[:-1]]
            tune = _first(folders, lambda each: find_tune(home, name, folder=each))
            return tune_reference(home, tune)
        finder = FINDERS[kind]
        found = _first(folders, lambda each: finder.find(name, folder=each))
        if kind == "aircraft":
            self._homes[loc[:-1]] = found
        return finder.name(found)

    def _find_code(self, loc: KeyPath, name: str, folders: tuple[Path, ...]) -> str:
        """Return the source of a law or function; a law of the library keeps its name."""
        if ":" not in name and not name.endswith(FMU):
            find_law(name)
            return name
        # in a text or a setting, unlike in a file, the caller chooses the code
        in_file = is_file(Path(walk(self.tree, loc)[0].place.source))
        within = folders[0] if in_file else self._settings_folder
        found = _first(folders, lambda each: _code_file(name, each, within), name)
        file, _, object_name = found.rpartition(":")
        if file and Path(file).parent == library() / "scenarios":
            return f"{Path(file).stem}:{object_name}"
        return found

    @contextmanager
    def _problems_at(self, *loc: str | int) -> Iterator[tuple[Path, ...]]:
        """Yield the bases of relative paths at a location, the place of the block's problems.

        The base is the folder of the file; of a setting in a study, its folder and then the working
        directory.
        """
        node, path, left = walk(self.tree, loc)
        folders = [node.folder]
        if self._settings_folder is not None and node.place.source.startswith("--set "):
            folders.append(Path.cwd())
        try:
            yield tuple(folders)
        except ScenarioError as error:
            texts = (problem.text for problem in error.problems)
            self.problems += [Problem(node.place, text, path + left) for text in texts]


def _first(
    folders: Sequence[Path], find: Callable[[Path], _Found | None], default: _Found | None = None
) -> _Found:
    """Return what is found from the first of these folders, else the default.

    Raises:
        ScenarioError: that of the first folder with an error.
    """
    first: ScenarioError | None = None
    for folder in folders:
        try:
            found = find(folder)
        except ScenarioError as error:
            first = first or error
        else:
            if found is not None:
                return found
    if first is None and default is not None:
        return default
    assert first is not None
    raise first


def _code_file(name: str, folder: Path, within: Path | None) -> str | None:
    """Return what `find_code` does, or None for the name of an installed module."""
    found = find_code(name, folder=folder, within=within)
    return None if found == name and not name.endswith(FMU) else found


def resolve_references(
    section: SectionT, tree: Node, settings_folder: Path | None = None
) -> SectionT:
    """Return a scenario or a section with every reference as a name, or else as an absolute path.

    So a resolved scenario means the same in any folder.

    Args:
        section: validated.
        tree: that it was made of.
        settings_folder: of the file that has the settings, as a study; None: the caller wrote them.
            Their relative paths are from there, or else from here.

    Raises:
        ScenarioError: with every file that cannot be found.
    """
    resolver = _Resolver(tree, settings_folder)
    for reference in references(section):
        resolver.resolve(reference)
    if resolver.problems:
        raise ScenarioError(resolver.problems)
    return with_values(section, resolver.changes)


def resolve_single_aircraft(flight: SingleAircraft) -> SingleAircraft:
    """Check a flight, and return it with every reference as a name or an absolute path.

    Raises:
        InputError: a file does not exist, or parts contradict each other; the text begins with the
            argument of `testbed.Aircraft`.
    """
    for path, text in (
        *check_sensor_rates((), flight.only, flight.rates),
        *check_air(flight.air),
    ):
        raise InputError(f"{'.'.join(map(str, path))}: {text}")
    changes: list[tuple[KeyPath, str]] = []
    home = Path()
    for reference in references(flight):
        loc, kind, name, _ = reference
        with _named(".".join(map(str, loc[1:] if loc[0] == "only" else loc))):
            if kind == "tune":
                changes.append((loc, tune_reference(home, find_tune(home, name))))
                continue
            found = FINDERS[kind].find(name)
        home = found if kind == "aircraft" else home
        changes.append((loc, FINDERS[kind].name(found)))
    return with_values(flight, changes)


@contextmanager
def _named(argument: str) -> Iterator[None]:
    """Begin the text of an error with the argument that names a file."""
    try:
        yield
    except ScenarioError as error:
        raise InputError(f"{argument}: {error.problems[0].text}") from None


def code_references(scenario: Scenario) -> Iterator[tuple[KeyPath, str]]:
    """Yield the key paths and names of a scenario's own laws and functions."""
    for reference in references(scenario):
        if reference.kind == "code":
            yield reference.loc, reference.name


def with_values(section: SectionT, changes: Iterable[tuple[KeyPath, str]]) -> SectionT:
    """Return a scenario or a section with other texts at these keys."""
    data = section.model_dump(by_alias=True)
    for loc, value in changes:
        _put(data, loc, value)
    return type(section).model_validate(data)


def _put(data: Any, loc: KeyPath, value: str) -> None:  # noqa: ANN401 - nested plain data
    for part in loc[:-1]:
        data = data[part]
    data[loc[-1]] = value
