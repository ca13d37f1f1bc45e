"""The C compilers that link an FMU, and the only place that starts them.

Their paths come from an option or from PATH, and from no file. They get a part of the environment
and work in a temporary folder.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Sequence
from pathlib import Path

from testbed.core.child_guard import CANNOT_START, guard_command
from testbed.core.errors import InputError

# What a compiler gets of the environment, which may hold passwords of the user.
_KEPT = ("PATH", "HOME", "TMPDIR", "LANG", "LD_LIBRARY_PATH", "XDG_CACHE_HOME")
_KEPT_PREFIXES = ("LC_", "ZIG_")
_ZIG_NAMES = "zig", "python-zig"  # the second is that of the package ziglang
_LINES, _CHARACTERS = 6, 300  # of a compiler's output that an error shows

# Nothing is contracted to a fused multiply-add, which rounds once: results would differ.
_FLAGS = (
    *("-std=c11", "-O2", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-shared"),
    *("-Wall", "-Wextra", "-Wno-unused-command-line-argument"),
)
_MORE_FLAGS = {  # by the suffix of the library; the symbols are stripped
    ".so": ("-Wl,--no-undefined", "-Wl,-Bsymbolic", "-Wl,-z,noexecstack", "-s"),
    # the system's printf: that of the compiler would be a third of the library
    ".dll": ("-D__USE_MINGW_ANSI_STDIO=0", "-s"),
    ".dylib": (),
}


def find_cc(option: Path | None) -> str:
    """Find the C compiler of this machine: of the option --cc, else `cc` on PATH.

    Raises:
        InputError: there is none.
    """
    if option is not None:
        return _program("--cc", option)
    found = shutil.which("cc")
    if found is None:
        raise InputError(
            "an FMU for this machine needs a C compiler, and there is no cc on PATH (install gcc "
            "or clang, or write --cc PATH)"
        )
    return found


def find_zig(option: Path | None, target: str) -> str:
    """Find zig, which compiles for other platforms: of the option --zig, else on PATH.

    Args:
        option: path of zig, or None.
        target: that needs it, for the error.

    Raises:
        InputError: there is none.
    """
    if option is not None:
        return _program("--zig", option)
    found = next(filter(None, map(shutil.which, _ZIG_NAMES)), None)
    if found is None:
        raise InputError(
            f"--target {target} needs the compiler zig, and there is neither zig nor python-zig "
            "on PATH (pip install ziglang has the second, or write --zig PATH)"
        )
    return found


def _program(option: str, path: Path) -> str:
    found = shutil.which(path.expanduser())
    if found is None:
        raise InputError(f"{option} {path}: there is no such program that can be executed")
    return str(Path(found).absolute())


def link_library(command: Sequence[str], sources: Sequence[Path], library: Path) -> None:
    """Compile C sources and link them with object files to a shared library.

    Args:
        command: the compiler with its first arguments.
        sources: C and object files, in the folder in which the compiler works.
        library: to be written; its suffix gives the format.

    Raises:
        InputError: the compiler cannot be started, or fails; with what it printed.
    """
    more = _MORE_FLAGS[library.suffix]
    names = [each.name for each in sources]
    line = [*command, *_FLAGS, *more, "-o", library.name, *names, "-lm"]
    code, output = _run(line, sources[0].parent)
    shown = [row for row in output.splitlines() if row.strip()][:_LINES]
    text = "\n".join(f"    {row[:_CHARACTERS]}" for row in shown)
    if code == CANNOT_START:
        raise InputError(f"{command[0]}: cannot be started\n{text}")
    if code != 0 or not library.is_file():
        raise InputError(f"{command[0]}: failed with exit code {code}; it printed:\n{text}")


def _run(line: list[str], folder: Path) -> tuple[int, str]:
    """Run a compiler in a folder; return its exit code and what it printed.

    It ends with this process; if this is killed, the folder is removed.
    """
    child = subprocess.Popen(
        guard_command(folder, line),
        cwd=folder,
        env=_environment(folder),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,  # Ctrl-C goes to the command only, which then ends it
    )
    assert child.stdin is not None and child.stdout is not None
    try:
        output = child.stdout.read()
        return child.wait(), output.decode("utf-8", "replace")
    except BaseException:
        os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        raise
    finally:
        child.stdin.close()
        child.stdout.close()


def _environment(folder: Path) -> dict[str, str]:
    """Return the environment of a compiler: an allow list of this process's."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name in _KEPT or name.startswith(_KEPT_PREFIXES)
    }
    return {**kept, "ZIG_LOCAL_CACHE_DIR": str(folder / "zig-cache")}
