"""A disk that is full, for what this process writes."""

import contextlib
import resource
import signal
import sys


@contextlib.contextmanager
def full_disk(free=0):
    """Fail every write beyond this size of a file, bytes, as a full disk does."""
    limits, unwritten = resource.getrlimit(resource.RLIMIT_FSIZE), sys.dont_write_bytecode
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    sys.dont_write_bytecode = True  # Python would keep a part of a module's, and read it later
    resource.setrlimit(resource.RLIMIT_FSIZE, (free, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        sys.dont_write_bytecode = unwritten
        signal.signal(signal.SIGXFSZ, ignored)
