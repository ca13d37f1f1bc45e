"""Entry of the program: what ends it while the command line is loaded ends it as later.

What a run loads before its flight is never garbage, so it is not searched for any.
"""

from __future__ import annotations

import gc
import os
import sys

from testbed.core.errors import memory_shortage


def main() -> None:
    """Load the command line and run it."""
    gc.set_threshold(300_000, 20, 50)  # the start of a run makes 200,000 objects
    _drop_wrong_settings()
    # matrices here are small: threads that wait for work would cost a run 30 ms
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        _load_and_run()
    finally:
        gc.freeze()  # else the interpreter searches all of them for garbage before it ends


def _drop_wrong_settings() -> None:
    """Remove a number of threads that numba does not accept, as of 0 by a job's script.

    No kernel of the testbed runs in numba's threads; a law that does has its default.
    """
    threads = os.environ.get("NUMBA_NUM_THREADS", "1")
    if not (threads.isascii() and threads.isdecimal() and int(threads[:9]) > 0):
        del os.environ["NUMBA_NUM_THREADS"]


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
