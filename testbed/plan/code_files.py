"""Files of a user's law or function: its own, and those that its imports reach."""

from __future__ import annotations

import ast
import site
import sys
import sysconfig
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from itertools import accumulate, chain
from pathlib import Path

from testbed.core.errors import InputError
from testbed.core.input_files import read_bounded
from testbed.plan.user_code import import_code, loaded_by
from testbed.scenario import FMU, find_code

_PACKAGE = Path(__file__).resolve().parents[1]


def code_files(name: str) -> tuple[Path, ...]:
    """Return the file of a law or function, and those of the modules that it imports.

    Modules are found by the import statements in each file, also those inside functions, and by
    what the import of the code has loaded. Those of Python, of the testbed and of other installed
    packages are left out. What code reads or imports in any other way is not seen.

    Args:
        name: `module:name`, as in a resolved scenario; it is imported unless it was before. Or the
            path of an FMU, which is one file.

    Returns:
        Absolute paths, the code's own first; none where it cannot be imported.
    """
    if name.endswith(FMU):
        return (Path(name),)
    module_name, _, _ = find_code(name).rpartition(":")
    try:
        origin = _origin(module_name)
    except InputError:  # reported by its flight
        return (Path(module_name),) if module_name.endswith(".py") else ()
    first = origin.resolve()
    root = _root(module_name, first)
    found: dict[Path, None] = {}
    queue = [first]
    find = cache(_file_of)  # in this call: files may be added later
    while queue:
        file = queue.pop()
        if file in found:
            continue
        found[file] = None
        loaded = loaded_by(str(origin)) if file == first else ()
        files = [*_imported(file, find), *(find(each, file.parent) for each in loaded)]
        queue += [each for each in files if each is not None and _is_own(each, root)]
    return (first, *sorted(found.keys() - {first}))


def _origin(module_name: str) -> Path:
    """Return the file of a module, which is imported if it was not before.

    Raises:
        InputError: it cannot be imported.
    """
    is_file = module_name.endswith(".py")
    known = f"testbed_law_{Path(module_name).stem}" if is_file else module_name
    origin = getattr(sys.modules.get(known), "__file__", None)
    if origin is None or (is_file and origin != module_name):
        _, origin = import_code(module_name, "code")
    return Path(origin)


def _root(module_name: str, file: Path) -> Path:
    """Return the folder of a file or of the package of an installed module; of a module, itself."""
    if module_name.endswith(".py"):
        return file.parent
    package = getattr(sys.modules.get(module_name.partition(".")[0]), "__path__", None)
    return Path(next(iter(package))).resolve() if package else file


def _is_own(file: Path, root: Path) -> bool:
    """Return whether a file is the user's, or of the installed package whose code is asked for."""
    return all(
        root.is_relative_to(folder) and file.is_relative_to(root)
        for folder in _installed()
        if file.is_relative_to(folder)
    )


@cache
def _installed() -> tuple[Path, ...]:
    """Return the folders of Python, of installed packages and of the testbed."""
    known = map(sysconfig.get_path, ("stdlib", "platstdlib", "purelib", "platlib"))
    folders = [*known, site.getusersitepackages()]
    return (*(Path(each).resolve() for each in folders), _PACKAGE)


def _file_of(module: str, folder: Path) -> Path | None:
    """Return the file of an imported module; None: it has none, or is no module."""
    loaded = sys.modules.get(module)
    if loaded is not None:
        origin = getattr(loaded, "__file__", None)
        return Path(origin).resolve() if origin else None
    above = sys.modules.get(module.rpartition(".")[0])
    if above is not None and not hasattr(above, "__path__"):
        return None  # a name in a module
    parts = module.split(".")
    for base in (folder, *map(Path, sys.path)):
        if (found := _python_file(base.joinpath(*parts))) is not None:
            return found
    return None


def _python_file(path: Path) -> Path | None:
    """Return the file of a module, or of a package, at a path without a suffix."""
    for file in (path.with_name(f"{path.name}.py"), path / "__init__.py"):
        with suppress(OSError):
            if file.is_file():
                return file.resolve()
    return None


def _imported(file: Path, find: Callable[[str, Path], Path | None]) -> Iterator[Path | None]:
    """Yield the files of the imports in a file of Python, also names in modules that may be files.

    An import also runs the packages that a module is in.

    Args:
        file: of any kind.
        find: returns the file of a module that is imported in a folder.
    """
    if file.suffix != ".py":
        return
    try:
        tree = ast.parse(read_bounded(file))
    except (InputError, SyntaxError, ValueError, RecursionError):
        return
    for node in ast.walk(tree):
        modules: list[str] = []
        if isinstance(node, ast.Import):
            modules = [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level and node.module:
            modules = [f"{node.module}.{each.name}" for each in node.names]
        names = (accumulate(each.split("."), "{}.{}".format) for each in modules)
        for name in dict.fromkeys(chain.from_iterable(names)):
            yield find(name, file.parent)
        if isinstance(node, ast.ImportFrom) and node.level:
            base = file.parents[min(node.level, len(file.parents)) - 1]
            module = base.joinpath(*node.module.split(".")) if node.module else base
            yield _python_file(module) if node.module else _python_file(base / "__init__")
            for each in node.names:
                yield _python_file(module / each.name)
