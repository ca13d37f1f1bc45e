"""Import a user's formation law, named `module:Class`, and functions, named `module:function`.

The code comes from a file in the folder of the scenario, or from an installed package. The run
reports which, with a digest. A file that does not belong to the testbed is stored with the run.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import json
import site
import sys
import sysconfig
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import distributions
from pathlib import Path
from types import ModuleType
from typing import Any, cast
from urllib.parse import unquote, urlsplit

import numpy as np

from testbed.core.errors import InputError
from testbed.core.input_files import read_bounded
from testbed.core.records import Array
from testbed.formation.law import FormationConfig, Law
from testbed.scenario import Scenario, code_references, find_code, library, with_values
from testbed.scenario.fields import KeyPath
from testbed.sim.control import user_code_errors


def build_law(name: str, options: Mapping[str, Any], config: FormationConfig) -> tuple[Law, str]:
    """Import and construct the law of a scenario's `controller.law`.

    Args:
        name: "module:Class" of a file in scenarios/ or an installed module, or
            "path/of/file.py:Class".
        options: keyword arguments for the class.
        config: its first argument.

    Returns:
        The law, and a description of its code with the digest.

    Raises:
        InputError: the module or class does not exist, or does not accept these options.
    """
    module_name, _, class_name = find_code(name).rpartition(":")
    module, origin = _import(module_name, "controller.law")
    found: Any = getattr(module, class_name, None)
    if not isinstance(found, type):
        classes = [n for n, each in vars(module).items() if inspect.isclass(each)]
        raise InputError(
            f"controller.law: {origin} has no class {class_name!r} (it has "
            f"{', '.join(classes) or 'none'})"
        )
    for method in ("start", "step"):
        if not callable(getattr(found, method, None)):
            raise InputError(
                f"controller.law: {class_name} has no method {method} (a law has "
                "start(own) -> memory and step(now, own, inbox, memory) -> command, memory)"
            )
    try:
        inspect.signature(found).bind(config, **options)
    except TypeError as error:
        raise InputError(
            f"controller.options: {class_name}{inspect.signature(found)} cannot be built: {error}"
        ) from error
    make = cast(Callable[..., Law], found)
    with user_code_errors(origin):
        return make(config, **options), _describe(module_name, origin)


def build_function(name: str, key: str) -> tuple[Callable[..., Array], str]:
    """Import a function of the array (K,) that is its first argument.

    Args:
        name: "module:function" of a file in scenarios/ or an installed module, or
            "path/of/file.py:function".
        key: of the scenario, for errors.

    Returns:
        The function, which raises `InputError` unless its values (K,) are finite numbers, and a
        description of its code with the digest.

    Raises:
        InputError: the module or function does not exist.
    """
    module_name, _, function_name = find_code(name).rpartition(":")
    module, origin = _import(module_name, key)
    found: Any = getattr(module, function_name, None)
    if not callable(found):
        functions = [n for n, each in vars(module).items() if inspect.isfunction(each)]
        raise InputError(
            f"{key}: {origin} has no function {function_name!r} (it has "
            f"{', '.join(functions) or 'none'})"
        )

    def call(x: Array, *others: float) -> Array:
        with user_code_errors(origin, "the function"), np.errstate(all="ignore"):
            values = np.asarray(found(x.copy(), *others), dtype=np.float64)
        if values.shape != x.shape:
            raise InputError(
                f"{key}: {function_name} of an array of shape {x.shape} has shape {values.shape} "
                "(write NumPy operations on the whole array)"
            )
        wrong = np.flatnonzero(~np.isfinite(values))
        if wrong.size:
            raise InputError(
                f"{key}: {function_name}({x[wrong[0]]:.4g}) is {values[wrong[0]]} (write a "
                "function that is finite everywhere)"
            )
        return values

    return call, _describe(module_name, origin)


def with_stored_code(scenario: Scenario) -> tuple[Scenario, Mapping[str, bytes]]:
    """Return the scenario and the code files to store with a run.

    A file is named relative to the stored scenario; code of the testbed or of an installed package
    keeps its name.

    Raises:
        InputError: a file cannot be read, or two have the same name.
    """
    changes: list[tuple[KeyPath, str]] = []
    files: dict[str, bytes] = {}
    for loc, name in code_references(scenario):
        module_name, _, object_name = find_code(name).rpartition(":")
        path = Path(module_name)
        if path.suffix != ".py" or _in_library(path):
            continue
        code = _read(path)
        if files.setdefault(path.name, code) != code:
            raise InputError(
                f"{'.'.join(map(str, loc))}: two different files are named {path.name} (rename one)"
            )
        changes.append((loc, f"{path.name}:{object_name}"))
    return (with_values(scenario, changes) if changes else scenario), files


def is_installed(name: str) -> bool:
    """Return whether the package of a module is installed, also in editable mode.

    Nothing is imported. Modules of the standard library do not count: none of them is a law.
    """
    try:
        spec = importlib.util.find_spec(name.partition(".")[0])
    except (ImportError, ValueError):
        return False
    if spec is None:
        return False
    paths = [spec.origin, *(spec.submodule_search_locations or ())]
    found = [Path(path).resolve() for path in paths if path]
    return any(path.is_relative_to(folder) for folder in _package_folders() for path in found)


def _package_folders() -> Iterator[Path]:
    """Yield the site-packages folders, and those of editable installations."""
    for each in (*map(sysconfig.get_path, ("purelib", "platlib")), site.getusersitepackages()):
        yield Path(each).resolve()
    for package in distributions():
        source = json.loads(package.read_text("direct_url.json") or "{}")
        if source.get("dir_info", {}).get("editable"):
            yield Path(unquote(urlsplit(source["url"]).path)).resolve()


def _in_library(path: Path) -> bool:
    """Return whether a file belongs to the testbed's own scenarios."""
    return path.parent == library() / "scenarios"


def _describe(module_name: str, origin: str) -> str:
    """Describe the code independently of the folder it is in."""
    path = Path(origin)
    digest = hashlib.sha256(_read(path)).hexdigest()[:12] if path.is_file() else "unknown"
    if not module_name.endswith(".py"):
        return f"the installed module {module_name} (SHA-256 {digest})"
    return f"{path.name}{' of the testbed' * _in_library(path)} (SHA-256 {digest})"


def _read(path: Path) -> bytes:
    return read_bounded(path, error=InputError)


def _import(name: str, key: str) -> tuple[ModuleType, str]:
    """Import a file or an installed module for a key; return it with its path."""
    what = "the law" if key == "controller.law" else "the module"
    if name.endswith(".py"):
        path = Path(name)
        # under a prefixed name: it must not hide a module of the same name
        spec = importlib.util.spec_from_file_location(f"testbed_law_{path.stem}", path)
        if spec is None or spec.loader is None or not path.is_file():
            raise InputError(f"{key}: there is no file {path}")
        module = importlib.util.module_from_spec(spec)
        # dataclasses look up the module while their class is defined
        sys.modules[spec.name] = module
        # leave no __pycache__ beside the scenario
        before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
        try:
            with user_code_errors(str(path), what):
                spec.loader.exec_module(module)
        except InputError as error:
            raise InputError(f"{key}: {path} cannot be imported: {error}") from error
        finally:
            sys.dont_write_bytecode = before
        return module, str(path)
    remedy = f"write a {name}.py beside the scenario, install the package, or check the name"
    if not all(part.isidentifier() for part in name.split(".")) or not is_installed(name):
        raise InputError(f"{key}: no module {name!r} ({remedy})")
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        raise InputError(f"{key}: no module {name!r} ({remedy}): {error}") from error
    return module, str(getattr(module, "__file__", None) or name)
