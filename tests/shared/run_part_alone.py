"""Import a part and run its snippet while the packages that it may not use cannot be imported.

`main` is called with a dictionary:

    blocked   packages of the testbed whose import fails
    packages  packages of which every module is imported
    names     pairs of a module and a name in it, perhaps dotted
    snippet   text of Python
"""

import importlib
import pkgutil
import sys
from importlib.abc import MetaPathFinder
from operator import attrgetter


class BlockedPackages(MetaPathFinder):
    """Refuse to import some packages of the testbed."""

    def __init__(self, packages):
        self.packages = frozenset(packages)

    def find_spec(self, fullname, path=None, target=None):
        top, _, rest = fullname.partition(".")
        if top == "testbed" and rest.split(".")[0] in self.packages:
            raise ImportError(f"{fullname} is blocked")
        return None


def main(given):
    sys.meta_path.insert(0, BlockedPackages(given["blocked"]))
    for package in given["blocked"]:
        try:
            importlib.import_module(f"testbed.{package}")
        except ImportError:
            continue
        raise AssertionError(f"{package} is imported, although it is blocked")
    for package in given["packages"]:
        folder = importlib.import_module(f"testbed.{package}").__path__
        for module in pkgutil.walk_packages(folder, f"testbed.{package}."):
            importlib.import_module(module.name)
    for module, name in given["names"]:
        attrgetter(name)(importlib.import_module(module))
    exec(compile(given["snippet"], "snippet", "exec"), {"__name__": "__main__"})
