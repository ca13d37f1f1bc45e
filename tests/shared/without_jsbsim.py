"""Run Python where neither jsbsim nor scipy can be imported, as on a computer aboard an aircraft.

A program: `without_jsbsim.py CODE ARGUMENT…` runs the text CODE with sys.argv of the arguments.
"""

import sys
from importlib.abc import MetaPathFinder

BLOCKED = ("jsbsim", "scipy")


class NotInstalled(MetaPathFinder):
    """Refuse libraries as Python does where they are not installed."""

    def find_spec(self, fullname, path=None, target=None):
        if fullname.partition(".")[0] in BLOCKED:
            raise ModuleNotFoundError(f"No module named {fullname!r}", name=fullname)
        return None


def main():
    sys.meta_path.insert(0, NotInstalled())
    _, code, *sys.argv[1:] = sys.argv
    exec(compile(code, "code", "exec"), {"__name__": "__main__"})


if __name__ == "__main__":
    main()
