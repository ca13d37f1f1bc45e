"""The one resolver: aircraft, scenarios and data files by name or path.

A checkout keeps `aircraft/` and `scenarios/` beside the package; an installed wheel carries them
inside it. A name means a file kept there, and nothing else is searched.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from testbed.scenario.messages import Place, Problem, ScenarioError, did_you_mean

_SCENARIOS = Path("scenarios")
_STUDIES = _SCENARIOS / "studies"
_TUNINGS = _STUDIES / "tunes"
_DATA = _SCENARIOS / "data"
_PAGE, _TUNE = ".yaml", ".param"
_A_PAGE = "a page ending in .yaml"
_PACKAGE = Path(__file__).resolve().parent.parent


def library() -> Path:
    """Return the folder that holds `aircraft/` and `scenarios/`."""
    checkout = _PACKAGE.parent
    if (checkout / "aircraft").is_dir() and (checkout / "scenarios").is_dir():
        return checkout
    return _PACKAGE / "_data"


def list_aircraft() -> tuple[str, ...]:
    """Return the names of the airframes that come with the testbed, sorted."""
    folder = library() / "aircraft"
    return tuple(sorted(f.name for f in folder.glob("*") if (f / f"{f.name}.xml").is_file()))


def list_scenarios() -> tuple[str, ...]:
    """Return the names of the scenarios that come with the testbed, sorted."""
    return _stems(library() / _SCENARIOS, _PAGE)


def list_studies() -> tuple[str, ...]:
    """Return the names of the studies that come with the testbed, sorted."""
    return _stems(library() / _STUDIES, _PAGE)


def list_tunings() -> tuple[str, ...]:
    """Return the names of the tunes that come with the testbed, sorted."""
    return _stems(library() / _TUNINGS, _PAGE)


def list_data() -> tuple[str, ...]:
    """Return the names of the data files that scenarios use, sorted."""
    return tuple(sorted(f.name for f in (library() / _DATA).glob("*.csv")))


def find_scenario(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return the page of a scenario, from its name or a path (relative to `folder`, or here).

    Raises:
        ScenarioError: there is no such page.
    """
    kept = library() / _SCENARIOS / f"{name_or_path}{_PAGE}"
    return _find("scenario", name_or_path, kept, list_scenarios, _A_PAGE, folder)


def find_study(name_or_path: str | Path) -> Path:
    """Return the page of a study, from its name or a path.

    Raises:
        ScenarioError: there is no such page.
    """
    kept = library() / _STUDIES / f"{name_or_path}{_PAGE}"
    return _find("study", name_or_path, kept, list_studies, _A_PAGE)


def find_tuning(name_or_path: str | Path) -> Path:
    """Return the page of a tune, from its name or a path.

    Raises:
        ScenarioError: there is no such page.
    """
    kept = library() / _TUNINGS / f"{name_or_path}{_PAGE}"
    return _find("tune", name_or_path, kept, list_tunings, _A_PAGE)


def find_aircraft(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return the folder of an airframe, from its name or a path (relative to `folder`, or here).

    Raises:
        ScenarioError: there is no such folder, or it has no <folder's name>.xml.
    """
    text = str(name_or_path)
    kept = library() / "aircraft" / text
    path = kept if _is_name(text) and _is_there(kept, Path.is_dir) else absolute(text, folder)
    if is_file(path / f"{path.name}.xml"):
        return path
    if _is_there(path, Path.is_dir):
        text = f"{path} has no {path.name}.xml: not an aircraft (write a folder with that model)"
        raise ScenarioError([Problem(Place(str(path)), text)])
    raise _not_found("aircraft", text, list_aircraft(), "a folder with a JSBSim model")


def find_tune(aircraft: str | Path, tune: str | Path, *, folder: Path | None = None) -> Path:
    """Return the .param file of an airframe: `<tune>.param` in its folder, or a path.

    Raises:
        ScenarioError: there is no such airframe or file.
    """
    home = find_aircraft(aircraft, folder=folder)
    what, kept = f"tune of {home.name}", home / f"{tune}{_TUNE}"
    return _find(what, tune, kept, lambda: _stems(home, _TUNE), "a .param file", folder)


def find_data(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return a data file, from its name in scenarios/data or a path (from `folder`, or here).

    Raises:
        ScenarioError: there is no such file.
    """
    kept = library() / _DATA / name_or_path
    return _find("data file", name_or_path, kept, list_data, "a CSV file", folder)


def find_law(name: str, *, folder: Path | None = None, anywhere: bool = False) -> str:
    """Return where a law `module:Class` comes from: "file.py:Class", or itself if installed.

    A module.py in `folder` (the page's) or in scenarios/ is meant before an installed module of
    that name. Without a folder, a name that was found before is found again. A path may lead out
    of the folder with `anywhere` alone: no file of a page runs code from elsewhere.

    Raises:
        ScenarioError: the name is the path of a file that is not there, or leaves the folder.
    """
    place, _, class_name = name.rpartition(":")
    if place.endswith(".py"):
        path = absolute(place, folder)
        if not is_file(path):
            text = f"there is no file {path} (write module:Class, with module.py beside the page)"
            raise ScenarioError([Problem(Place(str(path)), text)])
        if not anywhere:
            _refuse_outside(path, folder)
        return f"{path}:{class_name}"
    file = f"{place.replace('.', '/')}.py"
    for home in (folder, library() / "scenarios"):
        if home is not None and is_file(home / file):
            path = (home / file).resolve()
            _refuse_outside(path, home)
            return f"{path}:{class_name}"
    return name


def _refuse_outside(path: Path, folder: Path | None) -> None:
    if folder is not None and not path.is_relative_to(folder.resolve()):
        text = f"{path} is not in the page's folder, {folder} (put a copy beside the page)"
        raise ScenarioError([Problem(Place(str(path)), text)])


def _find(
    what: str,
    name_or_path: str | Path,
    kept: Path,
    known: Callable[[], tuple[str, ...]],
    path_of: str,
    folder: Path | None = None,
) -> Path:
    """The file that is kept, if a name was given, or the one at the path from `folder`, or here."""
    text = str(name_or_path)
    if _is_name(text) and is_file(kept):
        return kept
    path = absolute(text, folder)
    if is_file(path):
        return path
    raise _not_found(what, text, known(), path_of)


def _stems(folder: Path, ending: str) -> tuple[str, ...]:
    return tuple(sorted(f.stem for f in folder.glob(f"*{ending}")))


def _is_name(text: str) -> bool:
    return Path(text).name == text and text not in ("", ".", "..")


def is_file(path: Path) -> bool:
    """Whether there is a file of this name; no name is too odd to ask."""
    return _is_there(path, Path.is_file)


def _is_there(path: Path, kind: Callable[[Path], bool]) -> bool:
    try:
        return kind(path)
    except OSError:  # its name is too long, or it lies where nobody may look
        return False


def absolute(text: str, folder: Path | None) -> Path:
    """The path that a page means, from `folder` or from here; it need not be there."""
    path = Path(text)
    try:
        return ((folder or Path.cwd()) / path.expanduser()).resolve()
    except (OSError, RuntimeError, ValueError):  # a user, a loop of links, a byte that no name has
        return (folder or Path.cwd()) / path


def _not_found(what: str, text: str, known: tuple[str, ...], path: str) -> ScenarioError:
    names = ", ".join(known) or "none"
    message = (
        f"there is no {what} {text!r}{did_you_mean(text, known)} (write one of: {names}; or the "
        f"path of {path})"
    )
    return ScenarioError([Problem(Place(text), message)])
