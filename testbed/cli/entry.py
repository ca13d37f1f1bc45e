"""Entry of the program: what ends it while the command line is loaded ends it as later."""

from __future__ import annotations

import gc
import sys

from testbed.core.errors import memory_shortage


def main() -> None:
    """Load the command line and run it."""
    # imported modules are never garbage: collecting less often saves a tenth of a run's start
    gc.set_threshold(100_000, 20, 50)
    try:
        _load_and_run()
    finally:
        gc.freeze()  # else the interpreter searches all of them for garbage before it ends


def _load_and_run() -> None:
    try:
        from testbed.cli.exit_codes import ExitCode
        from testbed.cli.main import main as run_command_line
    except KeyboardInterrupt:
        sys.exit(130)
    except Exception as error:
        shortage = memory_shortage(error)
        if shortage is None:
            raise
        sys.stderr.write(f"error: {shortage}\n")
        sys.exit(2)
    try:
        run_command_line()
    except KeyboardInterrupt:  # within the handler of another error
        sys.exit(ExitCode.INTERRUPTED)
