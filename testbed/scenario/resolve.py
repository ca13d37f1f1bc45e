"""The one resolver: aircraft, scenarios and data files by name or path.

A checkout keeps `aircraft/` and `scenarios/` beside the package; an installed wheel carries them
inside it. A name means a file kept there, and nothing else is searched.
"""

from __future__ import annotations

from pathlib import Path

from testbed.scenario.messages import Place, Problem, ScenarioError, did_you_mean

_TUNINGS = Path("scenarios", "studies", "tunes")
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
    return tuple(sorted(f.stem for f in (library() / "scenarios").glob("*.yaml")))


def list_studies() -> tuple[str, ...]:
    """Return the names of the studies that come with the testbed, sorted."""
    return tuple(sorted(f.stem for f in (library() / "scenarios" / "studies").glob("*.yaml")))


def list_tunings() -> tuple[str, ...]:
    """Return the names of the tunes that come with the testbed, sorted."""
    return tuple(sorted(f.stem for f in (library() / _TUNINGS).glob("*.yaml")))


def list_data() -> tuple[str, ...]:
    """Return the names of the data files that scenarios use, sorted."""
    return tuple(sorted(f.name for f in (library() / "scenarios" / "data").glob("*.csv")))


def find_scenario(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return the page of a scenario, from its name or a path (relative to `folder`, or here).

    Raises:
        ScenarioError: there is no such page.
    """
    text = str(name_or_path)
    kept = library() / "scenarios" / f"{text}.yaml"
    if _is_name(text) and kept.is_file():
        return kept
    path = _absolute(text, folder)
    if path.is_file():
        return path
    raise _not_found("scenario", text, list_scenarios(), "a page ending in .yaml")


def find_study(name_or_path: str | Path) -> Path:
    """Return the page of a study, from its name or a path.

    Raises:
        ScenarioError: there is no such page.
    """
    text = str(name_or_path)
    kept = library() / "scenarios" / "studies" / f"{text}.yaml"
    if _is_name(text) and kept.is_file():
        return kept
    path = _absolute(text, None)
    if path.is_file():
        return path
    raise _not_found("study", text, list_studies(), "a page ending in .yaml")


def find_tuning(name_or_path: str | Path) -> Path:
    """Return the page of a tune, from its name or a path.

    Raises:
        ScenarioError: there is no such page.
    """
    text = str(name_or_path)
    kept = library() / _TUNINGS / f"{text}.yaml"
    if _is_name(text) and kept.is_file():
        return kept
    path = _absolute(text, None)
    if path.is_file():
        return path
    raise _not_found("tune", text, list_tunings(), "a page ending in .yaml")


def find_aircraft(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return the folder of an airframe, from its name or a path (relative to `folder`, or here).

    Raises:
        ScenarioError: there is no such folder, or it has no <folder's name>.xml.
    """
    text = str(name_or_path)
    kept = library() / "aircraft" / text
    path = kept if _is_name(text) and kept.is_dir() else _absolute(text, folder)
    if (path / f"{path.name}.xml").is_file():
        return path
    if path.is_dir():
        text = f"{path} has no {path.name}.xml: not an aircraft (write a folder with that model)"
        raise ScenarioError([Problem(Place(str(path)), text)])
    raise _not_found("aircraft", text, list_aircraft(), "a folder with a JSBSim model")


def find_tune(aircraft: str | Path, tune: str | Path, *, folder: Path | None = None) -> Path:
    """Return the .param file of an airframe: `<tune>.param` in its folder, or a path.

    Raises:
        ScenarioError: there is no such airframe or file.
    """
    home = find_aircraft(aircraft, folder=folder)
    text = str(tune)
    kept = home / f"{text}.param"
    if _is_name(text) and kept.is_file():
        return kept
    path = _absolute(text, folder)
    if path.is_file():
        return path
    known = tuple(sorted(f.stem for f in home.glob("*.param")))
    raise _not_found(f"tune of {home.name}", text, known, "a .param file")


def find_data(name_or_path: str | Path, *, folder: Path | None = None) -> Path:
    """Return a data file, from its name in scenarios/data or a path (from `folder`, or here).

    Raises:
        ScenarioError: there is no such file.
    """
    text = str(name_or_path)
    kept = library() / "scenarios" / "data" / text
    if _is_name(text) and kept.is_file():
        return kept
    path = _absolute(text, folder)
    if path.is_file():
        return path
    raise _not_found("data file", text, list_data(), "a CSV file")


def find_law(name: str, *, folder: Path | None = None) -> str:
    """Return where a law `module:Class` comes from: "file.py:Class", or itself if installed.

    A module.py in `folder` (the page's, or here) or in scenarios/ is meant before an installed
    module of that name.

    Raises:
        ScenarioError: the name is the path of a file that is not there.
    """
    place, _, class_name = name.rpartition(":")
    if place.endswith(".py"):
        path = _absolute(place, folder)
        if path.is_file():
            return f"{path}:{class_name}"
        text = f"there is no file {path} (write module:Class, with module.py beside the page)"
        raise ScenarioError([Problem(Place(str(path)), text)])
    file = f"{place.replace('.', '/')}.py"
    for home in (folder or Path.cwd(), library() / "scenarios"):
        if (home / file).is_file():
            return f"{(home / file).resolve()}:{class_name}"
    return name


def _is_name(text: str) -> bool:
    return Path(text).name == text and text not in ("", ".", "..")


def _absolute(text: str, folder: Path | None) -> Path:
    return ((folder or Path.cwd()) / Path(text).expanduser()).resolve()


def _not_found(what: str, text: str, known: tuple[str, ...], path: str) -> ScenarioError:
    names = ", ".join(known) or "none"
    message = (
        f"there is no {what} {text!r}{did_you_mean(text, known)} (write one of: {names}; or the "
        f"path of {path})"
    )
    return ScenarioError([Problem(Place(text), message)])
