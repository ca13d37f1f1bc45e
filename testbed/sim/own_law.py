"""A user's own law: found by `module:Class`, built for a team, and never guessed at.

This runs code by design. It comes from a file that the page names (the scenario's folder) or from
an installed package, and the run says which.
"""

from __future__ import annotations

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
from testbed.scenario import find_law
from testbed.sim.control import blamed


def build_law(name: str, options: Mapping[str, Any], team: Team) -> tuple[Law, str]:
    """The law of a page's `controller.law` for a team, and where its code came from.

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
        return make(team, **options), origin


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
    try:
        module = importlib.import_module(place)
    except ImportError as error:
        raise InputError(
            f"controller.law: no module {place!r} (write a {place}.py beside the page, install "
            f"the package, or check the name): {error}"
        ) from error
    return module, str(getattr(module, "__file__", None) or place)
