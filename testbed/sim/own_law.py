"""A user's own law: found by `module:Class`, built for a team, and never guessed at.

This runs code by design. It comes from a file in the scenario's folder or from an installed
package, and the run says which, with a digest. A file that is not among the testbed's own scenarios
is kept with the run.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, cast

from testbed.errors import InputError
from testbed.formation.law import Law, Team
from testbed.scenario import Scenario, find_law, library
from testbed.sim.control import blamed
from testbed.sim.installed import is_installed


def build_law(name: str, options: Mapping[str, Any], team: Team) -> tuple[Law, str]:
    """The law of a page's `controller.law` for a team, and in words where its code came from.

    Args:
        name: "module:Class" of a file in scenarios/ or an installed module, or
            "path/of/file.py:Class".
        options: keyword arguments for the class.
        team: its first argument.

    Raises:
        InputError: there is no such module or class, or it does not take these options.
    """
    place, _, class_name = find_law(name).rpartition(":")
    module, origin = _import(place)
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
        inspect.signature(found).bind(team, **options)
    except TypeError as error:
        raise InputError(
            f"controller.options: {class_name}{inspect.signature(found)} cannot be built: {error}"
        ) from error
    make = cast(Callable[..., Law], found)
    with blamed(origin):
        return make(team, **options), _said(place, origin)


def with_its_law(page: Scenario) -> tuple[Scenario, Mapping[str, bytes]]:
    """The page as it is kept with its run, and the files that lie beside it there.

    A law's file is named as if it lay beside the page; one that comes with the testbed, or with an
    installed package, is found by its name again.

    Raises:
        InputError: the file cannot be read any more.
    """
    place, _, class_name = find_law(page.controller.law).rpartition(":")
    path = Path(place)
    if path.suffix != ".py" or _ours(path):
        return page, {}
    law = page.controller.model_copy(update={"law": f"{path.name}:{class_name}"})
    return page.model_copy(update={"controller": law}), {path.name: _read(path)}


def _ours(path: Path) -> bool:
    """Whether a file is among the testbed's own scenarios."""
    return path.parent == library() / "scenarios"


def _said(place: str, origin: str) -> str:
    """Whose code it is: the same words wherever a file lies, so that runs of it are the same."""
    path = Path(origin)
    digest = hashlib.sha256(_read(path)).hexdigest()[:12] if path.is_file() else "unknown"
    if not place.endswith(".py"):
        return f"the installed module {place} (SHA-256 {digest})"
    return f"{path.name}{' of the testbed' * _ours(path)} (SHA-256 {digest})"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"controller.law: {path} cannot be read: {error.strerror}") from error


def _import(place: str) -> tuple[ModuleType, str]:
    if place.endswith(".py"):
        path = Path(place)
        # under a name of its own: two pages may each have a law.py
        spec = importlib.util.spec_from_file_location(f"testbed_law_{path.stem}", path)
        if spec is None or spec.loader is None or not path.is_file():
            raise InputError(f"controller.law: there is no file {path}")
        module = importlib.util.module_from_spec(spec)
        # dataclasses look their module up while they are made
        sys.modules[spec.name] = module
        # nothing is left beside a page that nobody asked for
        before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
        try:
            with blamed(str(path)):
                spec.loader.exec_module(module)
        except InputError as error:
            raise InputError(f"controller.law: {path} cannot be imported: {error}") from error
        finally:
            sys.dont_write_bytecode = before
        return module, str(path)
    remedy = f"write a {place}.py beside the page, install the package, or check the name"
    if not all(part.isidentifier() for part in place.split(".")) or not is_installed(place):
        raise InputError(f"controller.law: no module {place!r} ({remedy})")
    try:
        module = importlib.import_module(place)
    except ImportError as error:
        raise InputError(f"controller.law: no module {place!r} ({remedy}): {error}") from error
    return module, str(getattr(module, "__file__", None) or place)
