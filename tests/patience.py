"""How long tests wait for what must happen: a machine may be busy, and a test must not hang."""

import time

# Also of a process that has to compile first; only what has gone wrong takes so long.
PATIENCE_S = 300.0


def until(happened, what="it did not happen"):
    """Wait for what is true in the end, and return it.

    Args:
        happened: is asked again and again.
        what: is said when it never was.
    """
    stop = time.monotonic() + PATIENCE_S
    while not (found := happened()):
        assert time.monotonic() < stop, f"{what}, in {PATIENCE_S:g} s"
        time.sleep(0.01)
    return found
