"""Wait in tests for events of other processes, on a busy machine, with a limit."""

import time

# Also for a process that compiles first; only a failure takes this long.
TIMEOUT_S = 300.0


def until(happened, what="it did not happen"):
    """Wait until a call returns something true, and return that.

    Args:
        happened: called until it returns something true.
        what: text of the error after TIMEOUT_S.
    """
    stop = time.monotonic() + TIMEOUT_S
    while not (found := happened()):
        assert time.monotonic() < stop, f"{what}, in {TIMEOUT_S:g} s"
        time.sleep(0.01)
    return found
