"""What tests of every folder share: the modules in `shared`, and which tests run."""

import gc
import signal

import pytest
from selection import Selection

# A shell that runs `make test` in the background has it ignore SIGINT, which programs inherit.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# An assertion in these modules prints what differs, as one in a test does.
pytest.register_assert_rewrite("snapshot", "commands", "report_pages", "result_tables")


def pytest_collection_finish(session):
    """Collect garbage as rarely as the command line does, and not what is loaded before a test."""
    gc.freeze()
    gc.set_threshold(100_000, 20, 50)


def pytest_configure(config):
    config.pluginmanager.register(Selection(config), "selection")
